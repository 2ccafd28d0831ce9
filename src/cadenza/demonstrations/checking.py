"""Looks for damage in a folder of demonstrations; every problem is a line that says what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from cadenza.demonstrations.dataset import EPISODES, results_in, wrong_values
from cadenza.demonstrations.recorded import MAKE_AGAIN, RESULT, STEPS, Recorded, about
from cadenza.demonstrations.replay import differences, wrong_start
from cadenza.errors import CadenzaError
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene


class _Scenes:
    """Builds each scene once."""

    def __init__(self) -> None:
        self._built = dict[SceneConfig, Scene]()

    def __call__(self, recorded: Recorded) -> Scene:
        config = recorded.about.scene
        if config not in self._built:
            self._built[config] = recorded.build_scene()
        return self._built[config]


def problems(
    folder: Path, replays: int, progress: Callable[[int, int], None] = lambda *_: None
) -> Iterator[str]:
    """Everything that is wrong with the episodes, a line each.

    Args:
        folder: of the demonstrations.
        replays: how many episodes are played again and compared, spread evenly over all.
        progress: is told how many of how many episodes have been looked at.

    Raises:
        CadenzaError: it holds no demonstrations.
    """
    if not (folder / EPISODES).is_dir():
        raise CadenzaError(f"{folder}: holds no demonstrations")
    yield from _unfinished(folder / EPISODES)
    paths = results_in(folder / EPISODES)
    scenes, sound = _Scenes(), list[tuple[Recorded, Scene]]()
    for done, path in enumerate(paths, start=1):
        try:
            recorded = Recorded(path.parent, about(path.parent))
            if recorded.about.kept:
                scene = scenes(recorded)
                found = list(recorded.wrong_files()) or list(_of_content(recorded, scene))
                yield from found
                if not found:  # anew, as what is mapped holds an open file
                    sound.append((Recorded(path.parent, recorded.about), scene))
        except CadenzaError as error:
            yield _of(path.parent, error)
        except OSError as error:
            yield _unreadable(path.parent, error)
        progress(done, len(paths))
    chosen = np.unique(np.linspace(0, len(sound) - 1, min(replays, len(sound))).astype(int))
    for i in chosen.tolist():
        try:
            yield from _of_replay(*sound[i])
        except CadenzaError as error:
            yield _of(sound[i][0].folder, error)
        except OSError as error:
            yield _unreadable(sound[i][0].folder, error)


def _unfinished(runs: Path) -> Iterator[str]:
    """Episodes whose arrays are there, but not what says that they are whole."""
    for at in sorted(runs.iterdir()):
        if (at / STEPS).exists() and not (at / RESULT).exists():
            yield f"{at}: has no {RESULT}, so it does not count; collect again, or delete it"


def _of(folder: Path, error: CadenzaError) -> str:
    """What is wrong with an episode, its folder, and what to do."""
    said = str(error) if str(folder) in str(error) else f"{folder}: {error}"
    return said if said.endswith(MAKE_AGAIN) else f"{said}; or {MAKE_AGAIN}"


def _unreadable(folder: Path, error: OSError) -> str:
    return f"{folder}: cannot be read ({error.strerror or error})"


def _of_content(recorded: Recorded, scene: Scene) -> Iterator[str]:
    """Whether the arrays have their shapes and sensible values, and the score its steps."""
    yield from wrong_values(recorded, scene)
    if wrong := wrong_start(recorded, scene):
        yield wrong
    recorded.goals(scene)  # or says what is wrong with its score
    _ = recorded.song


def _of_replay(recorded: Recorded, scene: Scene) -> Iterator[str]:
    found = differences(recorded, scene)
    if found:
        what = ", ".join(f"{name} by {most:.1g}" for name, most in found.items())
        yield (
            f"{recorded.folder / STEPS}: played again it differs: {what}; "
            f"where versions are the same as then, {MAKE_AGAIN}"
        )
