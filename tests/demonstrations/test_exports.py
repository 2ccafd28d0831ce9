"""Exports: what Minari loads, and what the files of LeRobot hold."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episodes
from cadenza.cli import main
from cadenza.demonstrations import lerobot_export, minari_export
from cadenza.demonstrations.dataset import open_dataset
from cadenza.demonstrations.recorded import played_actions
from cadenza.demonstrations.replay import task_of
from cadenza.demonstrations.transitions import transitions
from cadenza.errors import CadenzaError
from cadenza.evaluation.collecting.variation import Variation
from cadenza.tasks.view import View
from demonstrations.made import collected

minari = pytest.importorskip("minari")
pq = pytest.importorskip("pyarrow.parquet")


class Watching(Playback):
    """Keeps what it is shown."""

    def act(self, view: View) -> np.ndarray:
        seen.append(view.observation[0].copy())
        return super().act(view)


seen: list[np.ndarray] = []


def test_observations_are_those_of_the_environment(made: Path) -> None:
    dataset = open_dataset(made)
    episode, exported = dataset.episodes[0], transitions(dataset, 0)
    seen.clear()
    with task_of(episode, dataset.scene) as task:
        (result,) = play_episodes(task, Watching(played_actions(episode.steps)), [0])
        seen.append(task.observation()[0])
        layout = task.observation_layout
    shown = np.array(seen)
    fingering = exported.fingering.shape[1]  # played again without looking for fingers
    at = layout["goal"].stop
    ours = np.delete(exported.observation, np.s_[at : at + fingering], axis=1)
    assert ours.shape == shown.shape
    np.testing.assert_allclose(ours, shown, atol=1e-3)  # keys are kept as float16
    assert result.metrics["f1"] == episode.about.f1


def test_minari_loads_what_was_recorded(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    main(["dataset", "export", str(made), "--format", "minari", "-o", str(tmp_path / "minari")])
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
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
        (told,) = loaded.storage.get_episode_metadata([number])
        about = dataset.episodes[number].about
        assert (told["seed"], told["options"]["f1"]) == (about.job["seed"], about.f1)
        assert told["options"]["song"] == about.song
    environment = loaded.recover_environment()
    assert environment.observation_space == loaded.observation_space
    assert environment.action_space == loaded.action_space


@pytest.mark.parametrize(
    "task", [{"fingering": "off"}, {"n_seconds_lookahead": 0.2}, {"stretch": 2.0, "transpose": 5}]
)
def test_minari_recovers_the_task_that_was_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, task: dict[str, Any]
) -> None:
    exact = {"random_stretch": 0.0, "random_pitch_shift": 0, "random_hand_position": 0.0}
    collected(tmp_path / "made", Variation(noise=0.0, mirror=False), **(exact | task))
    dataset = open_dataset(tmp_path / "made")
    minari_export.write_minari(dataset, tmp_path / "minari", lambda *_: None)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    loaded = minari.load_dataset("cadenza/demonstrations-v0")
    environment = loaded.recover_environment()
    assert environment.observation_space == loaded.observation_space
    (episode,) = loaded.iterate_episodes()
    shown = [environment.reset()[0]]
    for action in episode.actions:
        observation, *_, truncated, _ = environment.step(action)
        shown.append(observation)
    assert truncated
    np.testing.assert_allclose(episode.observations, shown, atol=1e-3)  # keys are float16


def test_lerobot_files_hold_what_was_recorded(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lerobot_export, "_ROWS_AT_ONCE", 1)
    folder = tmp_path / "lerobot"
    main(["dataset", "export", str(made), "--format", "lerobot", "-o", str(folder)])
    dataset = open_dataset(made)
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"]) == ("v3.0", 20)
    assert info["total_frames"] == dataset.num_steps
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


def test_nothing_is_overwritten(made: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit, match="2"):
        main(["dataset", "export", str(made), "--format", "lerobot", "-o", str(tmp_path)])
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_current_folder_can_be_written_to(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    main(["dataset", "export", str(made.resolve()), "--format", "lerobot", "-o", "."])
    assert (tmp_path / "empty" / "meta" / "info.json").exists()


def test_minari_is_given_so_many_steps_at_once_whatever_episodes_they_are_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(minari_export, "_AT_ONCE", 10)
    batches = list(minari_export._batched(range(1, 7), [9, 4, 6, 1, 30, 2, 3]))
    assert batches == [range(1, 3), range(3, 4), range(4, 5), range(5, 7)]


def test_half_of_an_export_is_never_seen(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> None:
        raise CadenzaError("damaged")

    monkeypatch.setattr("cadenza.demonstrations.lerobot_export._stats_of", fails)
    with pytest.raises(SystemExit, match="2"):
        main(["dataset", "export", str(made), "--format", "lerobot", "-o", str(tmp_path / "new")])
    assert list(tmp_path.iterdir()) == []
