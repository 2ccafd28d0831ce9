"""Exports: what Minari loads, and what the files of LeRobot hold."""

import json
import shutil
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episodes
from cadenza.cli import main
from cadenza.demonstrations import lerobot_export, minari_export
from cadenza.demonstrations.dataset import Dataset, open_dataset
from cadenza.demonstrations.recorded_episode import played_actions
from cadenza.demonstrations.transitions import shown_by, transitions
from cadenza.errors import CadenzaError
from cadenza.evaluation.collecting.variation import Variation
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from cadenza.performing.replaying import task_of
from cadenza.scene.config import SceneConfig
from cadenza.sim.render import Picture
from cadenza.tasks.config import DomainRandomization
from cadenza.tasks.env import PianoEnv
from cadenza.tasks.view import View
from demonstrations.made import SCORE, collected
from refusals import refused

minari = pytest.importorskip("minari")
pq = pytest.importorskip("pyarrow.parquet")


RANDOM = DomainRandomization(
    mass=(0.8, 1.2), latency=(0.0, 0.08), control_noise=0.02, joint_noise=0.01, key_noise=0.1
)
OTHER = Score(tuple(Note(i / 3, (i + 1) / 3, 55 + 2 * i) for i in range(5)))


class Watching(Playback):
    """An agent that keeps its observations."""

    def act(self, view: View) -> np.ndarray:
        seen.append(view.observation[0].copy())
        return super().act(view)


seen: list[np.ndarray] = []


@pytest.fixture
def felt(tmp_path):
    """Demonstrations of a hand that observes its touch and how fast it moves."""
    scene = SceneConfig(touch=True, hands="right")
    collected(tmp_path / "felt", Variation(), scene=scene, joint_velocities=True)
    return tmp_path / "felt"


@pytest.mark.parametrize("observed", ["made", "felt"])
def test_observations_are_those_of_the_environment(observed, request):
    dataset = open_dataset(request.getfixturevalue(observed))
    episode, exported = dataset.episodes[0], transitions(dataset, 0)
    seen.clear()
    with task_of(episode, dataset.scene) as task:
        (result,) = play_episodes(task, Watching(played_actions(episode.steps, task.scene)), [0])
        seen.append(task.observation()[0])
        layout = task.spec.observation_layout
    shown = np.array(seen)
    fingering = exported.fingering.shape[1]  # played again without looking for fingers
    at = layout["goal"].stop
    ours = np.delete(exported.observation, np.s_[at : at + fingering], axis=1)
    assert ours.shape == shown.shape
    assert observed == "made" or exported.touch.max() > 0
    np.testing.assert_array_equal(ours, shown)
    assert result.metrics["f1"] == episode.facts.f1


def test_minari_loads_what_was_recorded(made, tmp_path, monkeypatch):
    export = ["dataset", "export", str(made), "-o", str(tmp_path / "minari")]
    main([*export, "--version", "3"])  # in the same folder
    main([*export, "--name", "cadenza/demonstrations"])
    with pytest.raises(SystemExit):
        main([*export, "--name", "../demonstrations"])
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    ids = {"cadenza/demonstrations-v0", f"cadenza/{made.name}-v3"}
    assert minari.list_local_datasets().keys() == ids
    assert minari.load_dataset(f"cadenza/{made.name}-v3").total_episodes == 2
    loaded, dataset = minari.load_dataset("cadenza/demonstrations-v0"), open_dataset(made)
    assert (loaded.total_episodes, loaded.total_steps) == (2, dataset.num_steps)
    for number, episode in enumerate(loaded.iterate_episodes()):
        ours = transitions(dataset, number)
        assert loaded.observation_space.contains(episode.observations[5])
        assert loaded.action_space.contains(episode.actions[5])
        np.testing.assert_array_equal(episode.observations, ours.observation)
        np.testing.assert_array_equal(episode.actions, ours.played[1:])
        np.testing.assert_array_equal(episode.infos["chosen_action"][:-1], ours.chosen)
        assert episode.truncations.tolist() == [False] * (len(ours.chosen) - 1) + [True]
        (metadata,) = loaded.storage.get_episode_metadata([number])
        about = dataset.episodes[number].facts
        assert (metadata["seed"], metadata["f1"], metadata["song"]) == (
            about.job["seed"],
            about.f1,
            about.song,
        )
        assert about.drawn.items() <= metadata.items()
    environment = loaded.recover_environment()
    assert environment.observation_space == loaded.observation_space
    assert environment.action_space == loaded.action_space


def test_minari_recovers_the_task_that_was_recorded(tmp_path, monkeypatch):
    task = {"fingering": "off", "n_seconds_lookahead": 0.2, "stretch": 2.0, "transpose": 5}
    exact = {"random_stretch": 0.0, "random_pitch_shift": 0, "random_hand_position": 0.0}
    collected(tmp_path / "made", Variation(noise=0.0, mirror=False), **(exact | task))
    dataset = open_dataset(tmp_path / "made")
    minari_export.write_minari(dataset, tmp_path / "minari", "made-v0", lambda *_: None)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    loaded = minari.load_dataset("made-v0")
    environment = loaded.recover_environment()
    assert environment.observation_space == loaded.observation_space
    (episode,) = loaded.iterate_episodes()
    shown = [environment.reset()[0]]
    for action in episode.actions:
        observation, *_, truncated, _ = environment.step(action)
        shown.append(observation)
    assert truncated
    np.testing.assert_array_equal(episode.observations, shown)


@pytest.mark.parametrize(
    ("variation", "task", "scene"),
    [
        (
            Variation(noise=1.0, mirror=True, excerpt=1.0, student="zero"),
            {"stretch": 1.5, "transpose": 2, "sustain_term": True, "forearm_term": True},
            {},
        ),
        (
            Variation(mirror=True),
            {"randomization": RANDOM, "control_timestep": 0.04, "random_octave_shift": 1}
            | {"fingering": "transport", "key_press": "graded"},
            {"hands": "right"},
        ),
    ],
    ids=["excerpts with a student", "one randomized hand"],
)
def test_minari_plays_every_episode_again_to_the_bit_wherever_it_is(
    variation, task, scene, tmp_path, monkeypatch
):
    """The songs are given by a path from where they were collected, and are gone."""
    monkeypatch.chdir(tmp_path)
    write_midi(SCORE, Path("made-songs/song.mid"))
    write_midi(OTHER, Path("made-songs/other.mid"))
    collected(Path("made"), variation, episodes=2, scene=SceneConfig(**scene), **task)
    shutil.rmtree("made-songs")
    Path("elsewhere").mkdir()
    Path("made").rename("elsewhere/moved")
    monkeypatch.chdir("elsewhere")
    main(["dataset", "export", "moved", "-o", "minari"])
    monkeypatch.setenv("MINARI_DATASETS_PATH", "minari")
    loaded = minari.load_dataset("cadenza/moved-v0")
    environment = loaded.recover_environment()
    metadata = list(loaded.storage.get_episode_metadata(range(4)))
    assert {each["song"] for each in metadata} == {"made-songs/song.mid", "made-songs/other.mid"}
    assert {each["mirrored"] for each in metadata} == {False, True}
    for episode, each in zip(loaded.iterate_episodes(), metadata, strict=True):
        shown = [environment.reset(seed=each["seed"], options=each["options"])[0]]
        steps = [environment.step(action) for action in episode.actions]
        shown += [observation for observation, *_ in steps]
        np.testing.assert_array_equal(shown, episode.observations)
        np.testing.assert_array_equal([reward for _, reward, *_ in steps], episode.rewards)
        assert [truncated for *_, truncated, _ in steps] == episode.truncations.tolist()
    first, _ = environment.reset(seed=0)  # draws from the songs themselves, as was asked for
    again, _ = environment.reset(seed=1)
    assert not np.array_equal(first, again)


@pytest.mark.parametrize("form", ["minari", "lerobot"])
def test_exports_of_the_same_demonstrations_are_the_same_bytes(form, made, copied, tmp_path):
    name = ["--name", "made"] if form == "minari" else []
    for folder, out in ((made, "first"), (copied, "second")):
        main(["dataset", "export", str(folder), "--format", form, "-o", str(tmp_path / out), *name])
    written = (tmp_path / "first", tmp_path / "second")
    first, second = ({p.relative_to(at): p for p in at.rglob("*")} for at in written)
    assert first.keys() == second.keys()
    files = [name for name, path in first.items() if path.is_file()]
    assert all(first[name].read_bytes() == second[name].read_bytes() for name in files)


def test_lerobot_files_hold_what_was_recorded(made, tmp_path, monkeypatch):
    monkeypatch.setattr(lerobot_export, "_MAX_ROWS", 1)
    folder = tmp_path / "lerobot"
    main(["dataset", "export", str(made), "--format", "lerobot", "-o", str(folder)])
    dataset = open_dataset(made)
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"]) == ("v3.0", 20)
    assert info["total_frames"] == dataset.num_steps
    features, scene = info["features"], dataset.scene
    assert features["action"]["names"] == [*scene.actuator_names, "sustain_pedal"]
    assert features["observation.state"]["names"] == list(scene.hand_joint_names)
    layout, first = shown_by(dataset).observation_layout, transitions(dataset, 0)
    named = features["observation.environment_state"]["names"]
    parts = dict.fromkeys(name.split(".")[0] for name in named)
    shown = np.concatenate([first.observation[:, layout[part]] for part in parts], axis=1)
    np.testing.assert_array_equal(shown, first.environment)
    for of in features.values():
        assert of["names"] is None or len(of["names"]) == of["shape"][0]
    frames = pq.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(frames.column_names) == set(info["features"])
    assert frames["index"].to_pylist() == list(range(dataset.num_steps))
    actions = np.array(frames["action"].to_pylist(), np.float32)
    ours = np.concatenate([transitions(dataset, number).chosen for number in range(2)])
    np.testing.assert_array_equal(actions, ours)
    rows = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [row["dataset_from_index"] for row in rows] == dataset.first.tolist()
    stats = json.loads((folder / "meta/stats.json").read_text())["action"]
    np.testing.assert_allclose(stats["mean"], actions.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(stats["std"], actions.std(axis=0), atol=1e-5)
    assert stats["count"] == [dataset.num_steps]


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Two episodes of a note: pictures take long."""
    folder = tmp_path_factory.mktemp("short") / "made"
    write_midi(Score((Note(0.0, 0.2, 60),)), folder.parent / "made-songs" / "song.mid")
    collected(folder, Variation(noise=0.2, mirror=False), episodes=2)
    return folder


@pytest.fixture(scope="module")
def shown(short):
    """What its camera sees of each episode."""
    return [pictures_of(open_dataset(short), number) for number in range(2)]


@pytest.mark.slow
def test_lerobot_files_hold_what_cameras_see(short, shown, tmp_path, monkeypatch):
    export = ["dataset", "export", str(short), "--format", "lerobot", "--video-size", "64", "48"]
    main([*export, "--video-cameras", "player", "left", "-o", str(tmp_path / "one")])
    monkeypatch.setattr(lerobot_export, "FILE_BYTES", 0)
    main([*export, "--video-cameras", "player", "-o", str(tmp_path / "several")])
    dataset = open_dataset(short)
    shown = np.concatenate(shown)
    for folder, sides in ((tmp_path / "one", {"left"}), (tmp_path / "several", set[str]())):
        info = json.loads((folder / "meta/info.json").read_text())
        cameras = {name for name, of in info["features"].items() if of["dtype"] == "video"}
        assert cameras == {f"observation.images.{name}" for name in ("player", *sides)}
        feature = info["features"]["observation.images.player"]
        assert (feature["shape"], feature["names"][-1]) == ([48, 64, 3], "channels")
        frames = pq.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
        assert cameras.isdisjoint(frames.column_names)
        rows = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
        seen = np.concatenate([frames_of(folder, info, row) for row in rows])
        assert seen.shape == shown.shape
        assert np.abs(seen - shown.astype(float)).mean() < 6  # of 255, as videos lose some
        stats = json.loads((folder / "meta/stats.json").read_text())["observation.images.player"]
        assert np.shape(stats["mean"]) == (3, 1, 1)
        np.testing.assert_allclose(np.ravel(stats["mean"]), shown.mean((0, 1, 2)) / 255, atol=1e-3)
        np.testing.assert_allclose(np.ravel(stats["std"]), shown.std((0, 1, 2)) / 255, atol=1e-3)
        assert stats["count"] == [dataset.num_steps]
    assert len(list((tmp_path / "one").rglob("*.mp4"))) == 2
    assert len(list((tmp_path / "several").rglob("*.mp4"))) == 2


def test_minari_has_what_cameras_see(short, shown, tmp_path, monkeypatch):
    export = ["dataset", "export", str(short), "--video-size", "64", "48", "--name", "seen"]
    main([*export, "--video-cameras", "player", "left", "-o", str(tmp_path)])
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    for shown_of, episode in zip(
        shown, minari.load_dataset("seen-v0").iterate_episodes(), strict=True
    ):
        assert episode.infos["left"].shape == episode.infos["player"].shape
        assert episode.infos["player"].dtype == np.uint8
        assert len(episode.infos["player"]) == len(shown_of) + 1
        seen = episode.infos["player"][:-1].astype(float)
        assert np.abs(seen - shown_of).mean() < 1  # of 255: keys are recorded in single precision


def pictures_of(dataset: Dataset, number: int) -> np.ndarray:
    """(T, height, width, 3) what the environment shows before each step."""
    episode = dataset.episodes[number]
    start, actions = episode.facts.start, episode.steps["played"][1:]
    small = Picture(64, 48, "player")
    env = PianoEnv(episode.score, task=episode.facts.task, pixels=True, picture=small)
    shown = [env.reset(options={"score": episode.score, "start": start})[0]]
    shown += [env.step(action)[0] for action in actions[:-1]]
    env.close()
    return np.array([each["pixels"] for each in shown])


def frames_of(folder: Path, info: dict[str, Any], row: dict[str, Any]) -> np.ndarray:
    """(T, height, width, 3) those of an episode, found by their times."""
    name = "observation.images.player"
    at = {key.removeprefix(f"videos/{name}/"): value for key, value in row.items()}
    times = at["from_timestamp"] + np.arange(row["length"]) / info["fps"]
    assert at["to_timestamp"] == pytest.approx(times[-1] + 1 / info["fps"])
    places = {n: at[n] for n in ("chunk_index", "file_index")}
    with av.open(folder / info["video_path"].format(video_key=name, **places)) as video:
        frames = {round(f.time, 4): f.to_ndarray(format="rgb24") for f in video.decode(video=0)}
    return np.array([frames[round(time, 4)] for time in times.tolist()])


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--video-cameras", "front"], "no camera 'front': choose from"),
        (["--format", "lerobot", "--video-cameras", "front"], "no camera 'front': choose from"),
        (
            ["--format", "lerobot", "--video-cameras", "back", "--video-size", "65", "48"],
            "a video of 65 x 48 pixels cannot be encoded: choose even numbers",
        ),
    ],
)
def test_videos_that_cannot_be_are_told(words, what, made, tmp_path, capsys):
    assert what in refused(capsys, "dataset", "export", made, *words, "-o", tmp_path / "new")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(made, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit, match="1"):
        main(["dataset", "export", str(made), "--format", "lerobot", "-o", str(tmp_path)])
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_current_folder_can_be_written_to(made, tmp_path, monkeypatch):
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    main(["dataset", "export", str(made.resolve()), "--format", "lerobot", "-o", "."])
    assert (tmp_path / "empty" / "meta" / "info.json").exists()


def test_minari_is_given_so_many_steps_at_once_whatever_episodes_they_are_of():
    batches = list(minari_export.batched(range(1, 7), [9, 4, 6, 1, 30, 2, 3], max_steps=10))
    assert batches == [range(1, 3), range(3, 4), range(4, 5), range(5, 7)]


def test_half_of_an_export_is_never_seen(made, tmp_path, monkeypatch):
    def fails(*_: object) -> None:
        raise CadenzaError("damaged")

    monkeypatch.setattr("cadenza.demonstrations.lerobot_export.Statistics.of", fails)
    with pytest.raises(SystemExit, match="1"):
        main(["dataset", "export", str(made), "--format", "lerobot", "-o", str(tmp_path / "new")])
    assert list(tmp_path.iterdir()) == []
