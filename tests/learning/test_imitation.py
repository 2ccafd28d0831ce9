"""A policy of many songs, learnt from demonstrations: stopped, resumed, and what it plays."""

import shutil
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import cadenza
from cadenza.cli import main
from cadenza.demonstrations.dataset import LOOKAHEAD, Dataset, open_dataset
from cadenza.demonstrations.recorded_episode import read_facts, write_facts
from cadenza.demonstrations.transitions import transitions
from cadenza.errors import CadenzaError
from cadenza.evaluation.collecting.variation import Variation
from cadenza.files import ANY, read_tensors
from cadenza.learning.algorithms.cloning.config import CloningConfig
from cadenza.learning.config import ImitationConfig
from cadenza.learning.imitation import Imitation, observed
from cadenza.learning.policy_folder import POLICY_FILE, load_policy
from cadenza.learning.ranges import Ranges
from cadenza.music.score import Note, Score
from cadenza.resumable import CHECKPOINT
from cadenza.scene.config import SceneConfig
from cadenza.tasks.view import to_range
from demonstrations.made import SCORE, collected
from refusals import refused_in_a_line
from rounds import so_often

CONFIG = ImitationConfig(
    learner=CloningConfig(hidden_sizes=(32,), batch_size=32),
    num_updates=120,
    log_interval=50,
    n_steps_lookahead=4,
)
SAME = {"random_stretch": 0.0, "random_pitch_shift": 0, "random_hand_position": 0.0}
OTHER = Score((Note(0.0, 0.3, 62), Note(0.3, 0.6, 50)), title="other")


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory):
    """Two episodes of a song."""
    folder = tmp_path_factory.mktemp("made") / "demonstrations"
    collected(folder, Variation(noise=0.2, mirror=False), episodes=2, **SAME)
    return folder


@pytest.fixture(scope="module")
def run(demonstrations, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    trained(CONFIG, demonstrations, folder)
    return folder


def trained(
    config: ImitationConfig,
    demonstrations: Path,
    folder: Path,
    goes_on: Callable[[], bool] = lambda: True,
) -> Imitation:
    run = Imitation(config, demonstrations, folder)
    run.run(goes_on)
    return run


def seen_in(
    dataset: Dataset, steps: np.ndarray, ranges: Ranges, lookahead: int = CONFIG.n_steps_lookahead
) -> np.ndarray:
    """(B, D) what a policy observes in steps (B,)."""
    return observed(dataset.batch(steps, lookahead), ranges, dataset.onsets(steps, lookahead))


def test_an_error_that_is_no_longer_finite_stops_it_before_it_is_kept(demonstrations, tmp_path):
    overflows = replace(CONFIG.learner, learning_rate=1e30, hidden_sizes=(32, 32, 32))
    wild = replace(CONFIG, learner=overflows)
    with pytest.raises(CadenzaError, match="no longer finite; choose a smaller --learning-rate"):
        trained(wild, demonstrations, tmp_path / "run")
    assert not (tmp_path / "run" / "checkpoint").exists()


def test_the_error_falls(demonstrations, tmp_path):
    rows = trained(replace(CONFIG, log_interval=20), demonstrations, tmp_path / "run").rows
    assert [row["step"] for row in rows] == [20, 40, 60, 80, 100, 120]
    for error in "train/error", "held_out/error":
        assert rows[-1][error] < rows[0][error] / 2


def test_observes_what_the_environments_show(demonstrations):
    dataset = open_dataset(demonstrations)
    shown = transitions(dataset, 0)
    count = len(shown.chosen)
    joints = np.repeat([[-1.0], [1.0]], shown.joints.shape[1], axis=1)
    ranges = Ranges(joints, np.stack([dataset.scene.action_low, dataset.scene.action_high]))
    seen = seen_in(dataset, dataset.first[0] + np.arange(count), ranges, LOOKAHEAD)
    size = shown.observation.shape[1]
    assert_array_equal(seen[:, :size], shown.observation[:-1])
    assert_allclose(seen[:, size:-1], shown.played[:-1], atol=1e-6)
    assert_array_equal(seen[1:, -1], shown.reward[:-1].astype(np.float32))


@pytest.mark.parametrize("previous_action", [False, True])
def test_sees_in_a_performance_what_it_has_learnt_from(demonstrations, tmp_path, previous_action):
    """Demonstrations begin in the state in which the performance does."""
    trained(replace(CONFIG, previous_action=previous_action), demonstrations, tmp_path / "run")
    assert_sees_the_same(tmp_path / "run" / "last", demonstrations)


def assert_sees_the_same(policy: Path, demonstrations: Path) -> None:
    """In a performance as in demonstrations, where these begin."""
    learnt, dataset = load_policy(policy), open_dataset(demonstrations)
    assert learnt.ranges is not None
    assert learnt.task.trim_silence
    seen = seen_in(dataset, np.zeros(1, np.intp), learnt.ranges)
    assert seen.shape[1] == learnt.observation.size
    done = learnt.policy.mode(seen[:, list(learnt.inputs.kept)])
    expected = to_range(done, *learnt.ranges.actions)
    action = cadenza.play(SCORE, policy).episode["action"]
    assert_allclose(action[:1, :-1], expected[:, :-1], atol=1e-5)


@pytest.mark.parametrize("task", [{"fingering": "off"}, {"n_seconds_lookahead": 0.1}])
def test_sees_the_same_however_the_recorded_task_shows_it(tmp_path, task):
    collected(tmp_path / "made", Variation(noise=0.0, mirror=False), **(SAME | task))
    trained(replace(CONFIG, held_out=0), tmp_path / "made", tmp_path / "run", so_often(1))
    assert_sees_the_same(tmp_path / "run" / "last", tmp_path / "made")


def test_resumed_it_ends_with_the_same_bits(demonstrations, run, tmp_path):
    other = tmp_path / "run"
    for asked in 2, 1, 100:  # stops between two rows of metrics, and twice
        ended = trained(CONFIG, demonstrations, other, so_often(asked))
    assert ended.finished
    last = Path("last") / POLICY_FILE
    assert (other / last).read_bytes() == (run / last).read_bytes()
    ours, theirs = (read_tensors(at / CHECKPOINT, ANY, 2**28)[0] for at in (other, run))
    assert {n: a.tobytes() for n, a in ours.items()} == {n: a.tobytes() for n, a in theirs.items()}
    rows, expected = (Imitation(CONFIG, demonstrations, at).rows for at in (other, run))
    assert [row | {"seconds": 0} for row in rows] == [row | {"seconds": 0} for row in expected]


def test_what_does_not_fit_into_memory_is_learnt_with_the_same_bits(
    demonstrations, run, tmp_path, monkeypatch
):
    monkeypatch.setattr("cadenza.learning.imitation._MAX_CACHED", 1_000)
    trained(CONFIG, demonstrations, tmp_path / "too-large")
    arrays = Path("last") / POLICY_FILE
    assert (tmp_path / "too-large" / arrays).read_bytes() == (run / arrays).read_bytes()


def test_what_cannot_begin_leaves_nothing_in_the_way(demonstrations, tmp_path):
    growing = tmp_path / "growing"
    (growing / "runs").mkdir(parents=True)
    with pytest.raises(CadenzaError, match="no demonstrations: none was kept"):
        Imitation(CONFIG, growing, tmp_path / "run")
    shutil.copytree(demonstrations / "runs", growing / "runs", dirs_exist_ok=True)
    assert Imitation(CONFIG, growing, tmp_path / "run").songs


def test_episodes_held_out_go_together_with_the_others(demonstrations, tmp_path):
    mixed = Path(shutil.copytree(demonstrations, tmp_path / "mixed"))
    last = max((mixed / "runs").iterdir())
    made = read_facts(last)
    write_facts(last, replace(made, scene=replace(made.scene, physics="fast")))
    with pytest.raises(CadenzaError, match="has another scene than"):
        Imitation(CONFIG, mixed, tmp_path / "run")


def test_a_name_that_several_songs_have_is_told(demonstrations, tmp_path):
    mixed = Path(shutil.copytree(demonstrations, tmp_path / "mixed"))
    for folder, song in zip(sorted((mixed / "runs").iterdir()), ("a/song", "b/song"), strict=True):
        write_facts(folder, replace(read_facts(folder), song=song))
    config = replace(CONFIG, held_out=0)
    with pytest.raises(CadenzaError, match="song is a/song and b/song; give one of these"):
        Imitation(replace(config, songs=("song",)), mixed, tmp_path / "run")
    assert Imitation(replace(config, songs=("b/song",)), mixed, tmp_path / "run").songs == (
        "b/song",
    )


def test_a_policy_of_many_songs_plays_any(run):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        performance = cadenza.play(OTHER, run / "last")
    assert performance.score.title == "other"
    assert np.isfinite(performance.episode["action"]).all()


def test_it_cannot_play_with_another_hand(run):
    with pytest.raises(CadenzaError, match=r"trained with hand shadow, .* allegro") as error:
        cadenza.play(OTHER, run / "last", scene=SceneConfig(hand="allegro"))
    assert "\n" not in str(error.value)


def test_its_folder_names_no_song(run):
    with pytest.raises(CadenzaError, match="is no song; give a piece"):
        cadenza.play(run / "last")
    with pytest.raises(CadenzaError, match=r"its latest policy is .*last"):
        cadenza.play("OdeToJoy", run)


def test_another_run_in_its_folder_is_refused(demonstrations, run, tmp_path):
    with pytest.raises(CadenzaError, match="holds a run with other options"):
        Imitation(replace(CONFIG, seed=1), demonstrations, run)
    (tmp_path / "run.json").write_text('{"command": "cadenza train"}')
    with pytest.raises(CadenzaError, match=r"holds a run of cadenza train, .*another folder"):
        Imitation(CONFIG, demonstrations, tmp_path)


def test_songs_are_chosen_by_name(demonstrations, tmp_path):
    chosen = Imitation(replace(CONFIG, songs=("song",)), demonstrations, tmp_path / "run")
    assert [Path(song).stem for song in chosen.songs] == ["song"]
    with pytest.raises(CadenzaError, match="no demonstration of nothing; there is song"):
        Imitation(replace(CONFIG, songs=("nothing",)), demonstrations, tmp_path / "other")


def test_the_command_trains_and_says_how_to_play(demonstrations, tmp_path, capsys):
    small = ["--num-updates", "20", "--hidden-sizes", "8", "--batch-size", "8"]
    main(["clone", str(demonstrations), "-o", str(tmp_path / "run"), *small])
    assert f"--agent {tmp_path / 'run' / 'last'}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("nothing",), "nothing: holds no demonstrations"),
        (("nothing", "--num-updates", "0"), "num_updates 0"),
        (("nothing", "--learning-rate", "0"), "learning_rate 0"),
        (("nothing", "--hidden-sizes", "0"), "hidden_sizes (0,)"),
    ],
)
def test_what_cannot_be_is_told_in_a_line(words, what, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert what in refused_in_a_line(capsys, "clone", *words)
