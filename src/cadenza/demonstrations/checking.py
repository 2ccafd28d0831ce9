"""Says what a folder of demonstrations holds, and what is damaged in it."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from cadenza.demonstrations.dataset import (
    EPISODES,
    dataset_folder,
    finished,
    results_in,
    wrong_values,
)
from cadenza.demonstrations.recorded_episode import (
    MAKE_AGAIN,
    RESULT,
    SONGS,
    STEPS,
    EpisodeFacts,
    RecordedEpisode,
    read_facts,
)
from cadenza.demonstrations.replay import differences, wrong_start
from cadenza.errors import CadenzaError, counted, in_a_line
from cadenza.files import files_in
from cadenza.music.formats.source import printable
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene


def problems(
    folder: Path, replays: int, progress: Callable[[int, int], None] = lambda *_: None
) -> Iterator[str]:
    """Yield every problem of the episodes in a folder, as a line of text.

    So many episodes as `replays`, spread evenly over all, are played again and compared. `progress`
    is told how many of how many episodes have been looked at. Raises CadenzaError if it holds no
    demonstrations.
    """
    folder = dataset_folder(folder)
    if not (folder / EPISODES).is_dir():
        raise CadenzaError(f"{folder}: holds no demonstrations")
    yield from _unfinished(folder / EPISODES)
    paths = results_in(folder / EPISODES)
    scenes, intact = dict[SceneConfig, Scene](), list[tuple[RecordedEpisode, Scene]]()
    for done, path in enumerate(paths, start=1):
        at = path.parent
        with _reported(at, problems := list[str]()):
            recorded = RecordedEpisode(at, read_facts(at))
            if recorded.facts.kept:
                if (config := recorded.facts.scene) not in scenes:
                    scenes[config] = recorded.build_scene()
                scene = scenes[config]
                problems += list(recorded.wrong_files()) or _content_problems(recorded, scene)
                if not problems:  # anew, as what is mapped holds an open file
                    intact.append((RecordedEpisode(at, recorded.facts), scene))
        yield from problems
        progress(done, len(paths))
    chosen = np.unique(np.linspace(0, len(intact) - 1, min(replays, len(intact))).astype(int))
    for recorded, scene in (intact[i] for i in chosen.tolist()):
        with _reported(recorded.folder, problems := list[str]()):
            problems += _replay_problems(recorded, scene)
        yield from problems


def _unfinished(runs: Path) -> Iterator[str]:
    """Yield episodes whose arrays are there, but not the file that says that they are whole."""
    for at in sorted(runs.iterdir()):
        if (at / STEPS).exists() and not (at / RESULT).exists():
            yield f"{at}: has no {RESULT}, so it does not count; collect again, or delete it"


@contextmanager
def _reported(folder: Path, problems: list[str]) -> Iterator[None]:
    """Add an error of the block to the problems of an episode, with its folder and what to do."""
    try:
        yield
    except OSError as error:
        problems.append(f"{folder}: cannot be read ({error.strerror or error})")
    except Exception as error:  # whatever an episode causes, the others are checked
        message = in_a_line(error)
        message = message if str(folder) in message else f"{folder}: {message}"
        problems.append(message if message.endswith(MAKE_AGAIN) else f"{message}; or {MAKE_AGAIN}")


def _content_problems(recorded: RecordedEpisode, scene: Scene) -> Iterator[str]:
    """Yield which arrays have wrong shapes or values; raises if the score does not fit them."""
    yield from wrong_values(recorded, scene)
    if wrong := wrong_start(recorded, scene):
        yield wrong
    recorded.goals(scene)  # or says what is wrong with its score
    _ = recorded.song


def _replay_problems(recorded: RecordedEpisode, scene: Scene) -> Iterator[str]:
    """Yield by how much states and rewards differ when the episode is played again."""
    errors = differences(recorded, scene)
    if errors:
        what = ", ".join(f"{name} by {most:.1g}" for name, most in errors.items())
        yield (
            f"{recorded.folder / STEPS}: played again it differs: {what}; "
            f"where versions are the same as then, {MAKE_AGAIN}"
        )


_MIB = 2**20


def summarize(folder: Path) -> Iterator[str]:
    """Yield songs, episodes, steps, F1, size on disk, and which versions made it.

    Raises CadenzaError if it holds no demonstrations, or a result.json is damaged.
    """
    folder = dataset_folder(folder)
    episodes = finished(folder)
    kept = [facts for _, facts in episodes if facts.kept]
    names = {at.name for at, _ in episodes}
    there = (path for path in (folder / EPISODES).iterdir() if path.is_dir())
    unfinished = sum(path.name not in names for path in there)
    songs = {facts.song for facts in kept}
    yield f"{counted(len(kept), 'episode')} of {counted(len(songs), 'song')} kept"
    yield f"{len(episodes) - len(kept)} not kept, {unfinished} not finished"
    yield _steps(kept)
    if kept:
        yield _spread("F1", [facts.f1 for facts in kept])
        yield _spread("note onsets F1", [facts.note_onset_f1 for facts in kept])
        yield from _rewarded(kept)
        yield f"{sum(facts.drawn['mirrored'] for facts in kept):,} mirrored"
    there = (folder / part / file for part in (EPISODES, SONGS) for file in files_in(folder / part))
    size = sum(file.lstat().st_size for file in there)
    steps = sum(facts.num_steps for facts in kept)
    yield f"{size / _MIB:.1f} MiB, {size / max(steps, 1):,.0f} bytes a step"
    hours = sum(facts.cpu_seconds for _, facts in episodes) / 3600
    yield f"{hours:.2f} hours of one core to make"
    yield from _versions(facts for _, facts in episodes)


def _steps(kept: list[EpisodeFacts]) -> str:
    seconds = sum(facts.num_steps * facts.task.control_timestep for facts in kept)
    return f"{sum(facts.num_steps for facts in kept):,} steps, {seconds / 60:.1f} min of music"


def _spread(what: str, values: list[float]) -> str:
    return f"{what} {np.mean(values):.3f} on average, {min(values):.3f} to {max(values):.3f}"


def _rewarded(kept: list[EpisodeFacts]) -> Iterator[str]:
    """Yield whose fingers the rewards are for, see `GoalTrack.rewarded_fingers`."""
    counts = Counter(str(facts.metrics.get("rewarded_fingers")) for facts in kept)
    for fingers, count in sorted(counts.items()):
        yield f"rewarded fingers: {printable(fingers)} in {counted(count, 'episode')}"


def _versions(episodes: Iterable[EpisodeFacts]) -> Iterator[str]:
    counts = Counter(
        printable(f"{name} {version}")
        for facts in episodes
        for name, version in facts.versions.items()
    )
    for what, count in sorted(counts.items()):
        yield f"made with {what}: {counted(count, 'episode')}"
