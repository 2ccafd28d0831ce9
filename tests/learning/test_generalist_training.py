"""A generalist is cloned from demonstrations, reinforced over a library, and plays."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import cadenza
from cadenza.agents.generalist import generalist
from cadenza.agents.generalist.config import GeneralistConfig
from cadenza.agents.planner.search.networks.weights import Weights
from cadenza.cli import main
from cadenza.errors import CadenzaError
from cadenza.evaluation.collecting.variation import Variation
from cadenza.learning.algorithms.generalist.cloning import GeneralistCloning
from cadenza.learning.algorithms.generalist.config import (
    GeneralistCloningConfig,
    GeneralistStrikingConfig,
)
from cadenza.learning.algorithms.generalist.striking import GeneralistStriking
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from demonstrations.made import collected

SHIPPED = Path(generalist.__file__).parent / "shadow.npz"
SONG = Score((Note(0.0, 0.3, 60), Note(0.3, 0.6, 64)), title="song")
SCALE = Score(tuple(Note(0.3 * i, 0.3 * i + 0.3, 60 + i) for i in range(10)), title="scale")
CLONE = ["--batch-size", "8", "--num-epochs", "2", "--hidden-sizes", "8", "8", "-q"]
REINFORCE = [
    *("--num-envs", "2", "--rollout-steps", "4", "--batch-size", "8", "--seconds", "1"),
    *("--value-warmup", "1", "--learning-rate", "0.01", "-q"),
]


STRIKE = ["--num-envs", "2", "--rollout-steps", "40", "--num-epochs", "2", "--seconds", "3", "-q"]


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory):
    """Episodes of three songs."""
    folder = tmp_path_factory.mktemp("made") / "demonstrations"
    for i in range(3):
        score = Score((Note(0.0, 0.3, 60 + 2 * i), Note(0.3, 0.6, 50 - i)), title=f"song {i}")
        write_midi(score, folder.parent / "demonstrations-songs" / f"song{i}.mid")
    collected(folder, Variation(noise=0.2, mirror=False))
    return folder


@pytest.fixture(scope="module")
def cloned(demonstrations, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cloned") / "run"
    main(["generalist", "clone", str(demonstrations), "-o", str(folder), *CLONE])
    return folder


def same(one: Path, other: Path) -> bool:
    arrays = Weights.load(one).arrays
    return all(np.array_equal(a, arrays[n]) for n, a in Weights.load(other).arrays.items())


def test_a_cloned_generalist_plays(cloned):
    agent = cadenza.make_agent("generalist", GeneralistConfig(str(cloned / "weights.npz")))
    own = cadenza.play(SONG, agent=agent).episode
    shipped = cadenza.play(SONG, agent="generalist").episode
    assert (own["action"] != shipped["action"]).any()


def test_cloning_goes_on_where_it_was_stopped(demonstrations, cloned, tmp_path):
    config = GeneralistCloningConfig(batch_size=8, num_epochs=2, hidden_sizes=(8, 8))
    run = GeneralistCloning(config, [demonstrations], tmp_path / "run")
    run.run(lambda: run.step < 4)
    assert not (tmp_path / "run/weights.npz").exists()
    again = GeneralistCloning(config, [demonstrations], tmp_path / "run")
    assert again.step == 4
    again.run(lambda: True)
    assert same(tmp_path / "run/weights.npz", cloned / "weights.npz")
    with pytest.raises(CadenzaError, match="holds a run with other options"):
        GeneralistCloning(GeneralistCloningConfig(), [demonstrations], tmp_path / "run")


@pytest.mark.slow
def test_reinforcement_goes_on_where_it_was_stopped_and_changes_the_networks(cloned, tmp_path):
    write_midi(SONG, tmp_path / "songs" / "song.mid")
    library = str(tmp_path / "songs")
    weights, folder = cloned / "weights.npz", tmp_path / "reinforced"
    command = ["generalist", "reinforce", library, "--weights", str(weights), "-o", str(folder)]
    main([*command, "--num-rounds", "1", *REINFORCE])  # in which only values are learnt
    assert same(folder / "weights.npz", weights)
    main([*command, "--num-rounds", "3", *REINFORCE])
    assert not same(folder / "weights.npz", weights)
    assert len((folder / "metrics.jsonl").read_text().splitlines()) == 3
    shutil.copy(folder / "weights.npz", tmp_path / "copy.npz")
    main([*command, "--num-rounds", "3", *REINFORCE])  # nothing is left to do
    assert same(folder / "weights.npz", tmp_path / "copy.npz")
    agent = cadenza.make_agent("generalist", GeneralistConfig(str(folder / "weights.npz")))
    assert cadenza.play(SONG, agent=agent).episode.num_steps > 0


@pytest.mark.slow
def test_fingers_learn_to_strike_and_nothing_else_changes(tmp_path):
    library, folder = str(tmp_path / "songs"), tmp_path / "striking"
    write_midi(SCALE, tmp_path / "songs" / "scale.mid")
    main(["generalist", "strike", library, "-o", str(folder), "--num-rounds", "1", *STRIKE])
    learnt, before = Weights.load(folder / "weights.npz"), Weights.load(SHIPPED)
    assert len(learnt.striking) == 2
    assert same_networks(learnt, before)
    played = [
        cadenza.play(SCALE, cadenza.make_agent("generalist", GeneralistConfig(str(path)))).episode
        for path in (folder / "weights.npz", SHIPPED)
    ]
    assert (played[0]["action"] != played[1]["action"]).any()


def same_networks(one: Weights, other: Weights) -> bool:
    inputs = np.random.default_rng(0).normal(size=one.sizes[0]).astype(np.float32)
    return np.array_equal(one(inputs), other(inputs))


@pytest.mark.slow
def test_learning_to_strike_goes_on_where_it_was_stopped(tmp_path):
    config = GeneralistStrikingConfig(
        num_envs=2, rollout_steps=40, num_epochs=2, num_rounds=2, seconds=3.0
    )

    def run_in(folder: Path) -> GeneralistStriking:
        return GeneralistStriking(config, "scales", [SCALE], folder)

    run = run_in(tmp_path / "run")
    run.run(lambda: run.step < 1)
    again = run_in(tmp_path / "run")
    assert again.step == 1
    again.run(lambda: True)
    assert again.finished
    assert len(Weights.load(tmp_path / "run/weights.npz").striking) == 2


def test_too_few_songs_are_refused(tmp_path):
    collected(tmp_path / "made", Variation(noise=0.2, mirror=False))
    with pytest.raises(CadenzaError, match=r"1 songs with episodes .*; 3 are needed"):
        GeneralistCloning(GeneralistCloningConfig(), [tmp_path / "made"], tmp_path / "run")
