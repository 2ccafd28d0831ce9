"""Export of demonstrations to Minari, Gymnasium's library for offline learning.

Observations and actions are those of the environment `cadenza/Piano-v0`. Actions are as played,
with noise, since they led to the next observation; the demonstrator's choice is the info
`chosen_action`, and views of cameras are infos of their names.

The dataset holds the songs of its environment, and as the options of each episode its score and the
start of the hands. Reset with these options, the environment that Minari recovers answers the
episode's actions with its observations and rewards, to the bit on the same machine. Observations
are of the true state, and so the environment has no noise on them.
"""

import os
import re
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from copy import deepcopy
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from cadenza.configs import MAX_COUNT, whole_number
from cadenza.demonstrations.dataset import Dataset
from cadenza.demonstrations.recorded_episode import EpisodeFacts, written
from cadenza.demonstrations.transitions import SHOWN, pictures_of, shown_by, transitions
from cadenza.errors import CadenzaError, extra_packages, quoted
from cadenza.files import new_folder, plain
from cadenza.sim.render import Picture, Renderer
from cadenza.tasks.config import NOISE_ON_OBSERVATIONS
from cadenza.tasks.env import state_space

_ROOT = "MINARI_DATASETS_PATH"  # variable of Minari's folder of datasets
_NAME = re.compile(r"([A-Za-z0-9_-]+/)*[A-Za-z0-9_-]+")  # Minari makes folders of it
_UNNAMED = re.compile("[^A-Za-z0-9_-]+")
_MAX_BATCH = 20_000  # steps that are written at once, or a longer episode


def minari_id(folder: Path, name: str | None = None, version: int = 0) -> str:
    """The id of a dataset in Minari, by default `cadenza/` and the name of its `folder`.

    Raises CadenzaError if Minari takes no such name or version.
    """
    named = f"cadenza/{_UNNAMED.sub('-', folder.resolve().name)}" if name is None else name
    if not _NAME.fullmatch(named):
        raise CadenzaError(
            f"name {quoted(named)}: give letters, digits, - or _, maybe with folders before them, "
            "such as cadenza/chopin"
        )
    return f"{named}-v{whole_number(version, 'version', 0, MAX_COUNT)}"


def write_minari(
    dataset: Dataset,
    path: Path,
    id_: str,
    advance: Callable[[int, int], None],
    pictures: Sequence[Picture] = (),
) -> None:
    """Write the dataset of that id to a folder, to which MINARI_DATASETS_PATH must point later.

    Other datasets may lie there. It has these `pictures` of every step, as they are: 0.7 MB each at
    640 x 360. Raises CadenzaError if Minari is not installed, there is a dataset of that id in the
    folder, an episode is damaged, or this machine cannot draw.
    """
    with extra_packages("export", "exporting"):
        import minari
        import pyarrow  # noqa: F401 - Minari's error would come late
        from minari.data_collector.episode_buffer import EpisodeBuffer
    with (
        new_folder(path / id_) as folder,
        _root(folder),
        warnings.catch_warnings(),
        ExitStack() as opened,
    ):
        warnings.simplefilter("ignore", UserWarning)  # that it has no author
        renderers = {
            picture.camera: opened.enter_context(closing(Renderer(dataset.scene, picture)))
            for picture in pictures
        }

        def buffer(number: int) -> Any:
            return _buffer(EpisodeBuffer, dataset, number, renderers)

        written_dataset = minari.create_dataset_from_buffers(
            id_,
            [buffer(0)],
            env=_environment(dataset),
            observation_space=state_space(shown_by(dataset)),
            action_space=spaces.Box(
                -1.0, 1.0, (len(dataset.scene.actuator_names) + 1,), np.float32
            ),
            algorithm_name=str(dataset.episodes[0].facts.job["agent"]),
            description="Two simulated robot hands play the piano.",
            requirements=["cadenza"],
            data_format="parquet",
        )
        count, lengths = len(dataset.episodes), [e.facts.num_steps for e in dataset.episodes]
        for batch in batched(range(1, count), lengths, 1 if pictures else _MAX_BATCH):
            written_dataset.update_dataset_from_buffer([buffer(number) for number in batch])
            advance(batch[-1] + 1, count)
        written_dataset.storage.update_metadata(_names(dataset))
        metadata = (_metadata(episode.facts) for episode in dataset.episodes)
        written_dataset.storage.update_episode_metadata(metadata)
        for part in (folder / id_).iterdir():
            part.rename(folder / part.name)
        shutil.rmtree(folder / id_.split("/")[0])


def _names(dataset: Dataset) -> dict[str, Any]:
    layout = shown_by(dataset).observation_layout
    return {
        "observation_layout": {name: [part.start, part.stop] for name, part in layout.items()},
        "joint_names": list(dataset.scene.hand_joint_names),
        "action_names": [*dataset.scene.actuator_names, "sustain_pedal"],
    }


def _environment(dataset: Dataset) -> EnvSpec:
    """The environment that `recover_environment` of Minari makes, which draws from all songs."""
    facts = dataset.episodes[0].facts
    spec = deepcopy(gymnasium.spec("cadenza/Piano-v0"))
    task = asdict(facts.task) | facts.job["task"] | SHOWN
    randomization = task["randomization"] | dict.fromkeys(NOISE_ON_OBSERVATIONS, 0.0)
    task |= {"randomization": randomization}
    songs = dict.fromkeys(episode.song for episode in dataset.episodes)
    spec.kwargs = plain({"song": [written(song) for song in songs]} | task | asdict(facts.scene))
    return spec


def _buffer(kind: Any, dataset: Dataset, number: int, renderers: dict[str, Renderer]) -> Any:
    made, episode = transitions(dataset, number), dataset.episodes[number]
    count, facts = len(made.chosen), episode.facts
    drawn = facts.task.randomization.seed
    options = {"score": written(episode.score), "start": facts.start}
    # Minari has as many infos as observations.
    chosen = np.concatenate([made.chosen, np.zeros_like(made.chosen[:1])])
    return kind(
        observations=made.observation,
        actions=made.played[1:],
        rewards=made.reward,
        terminations=np.zeros(count, bool),
        truncations=np.arange(count) == count - 1,
        infos={"chosen_action": chosen}
        | {name: np.stack([*pictures_of(dataset, number, r)]) for name, r in renderers.items()},
        seed=facts.job["seed"],
        options=options if drawn is None else {**options, "randomization": drawn},
    )


def _metadata(facts: EpisodeFacts) -> dict[str, Any]:
    return {
        "song": facts.song,
        "f1": facts.f1,
        "note_onset_f1": facts.note_onset_f1,
        "rewarded_fingers": facts.metrics.get("rewarded_fingers"),
        **facts.drawn,
    }


@contextmanager
def _root(folder: Path) -> Iterator[None]:
    before = os.environ.get(_ROOT)
    os.environ[_ROOT] = str(folder.resolve())
    try:
        yield
    finally:
        if before is None:
            del os.environ[_ROOT]
        else:
            os.environ[_ROOT] = before


def batched(
    episodes: range, lengths: Sequence[int], max_steps: int = _MAX_BATCH
) -> Iterator[range]:
    """Yield episodes that are written together: of `max_steps`, or a single longer one."""
    first, steps = episodes.start, 0
    for episode in episodes:
        if steps and steps + lengths[episode] > max_steps:
            yield range(first, episode)
            first, steps = episode, 0
        steps += lengths[episode]
    if steps:
        yield range(first, episodes.stop)
