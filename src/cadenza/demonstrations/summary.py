"""The summary of a folder of demonstrations."""

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from cadenza.demonstrations.dataset import EPISODES, dataset_folder, finished
from cadenza.demonstrations.recorded_episode import SONGS, EpisodeFacts
from cadenza.errors import counted
from cadenza.files import files_in
from cadenza.music.formats.source import printable

_MIB = 2**20


def summarize(folder: Path) -> Iterator[str]:
    """Yield songs, episodes, steps, F1, size on disk, and which versions made it.

    Raises CadenzaError if it holds no demonstrations, or a result.json is damaged.
    """
    folder = dataset_folder(folder)
    episodes = finished(folder)
    kept_facts = [facts for _, facts in episodes if facts.kept]
    names = {at.name for at, _ in episodes}
    folders = (path for path in (folder / EPISODES).iterdir() if path.is_dir())
    unfinished = sum(path.name not in names for path in folders)
    songs = {facts.song for facts in kept_facts}
    yield f"{counted(len(kept_facts), 'episode')} of {counted(len(songs), 'song')} kept"
    yield f"{len(episodes) - len(kept_facts)} not kept, {unfinished} not finished"
    seconds = sum(facts.num_steps * facts.task.control_timestep for facts in kept_facts)
    steps = sum(facts.num_steps for facts in kept_facts)
    yield f"{steps:,} steps, {seconds / 60:.1f} min of music"
    if kept_facts:
        yield _spread("F1", [facts.f1 for facts in kept_facts])
        yield _spread("note onset F1", [facts.note_onset_f1 for facts in kept_facts])
        yield from _rewarded(kept_facts)
        yield f"{sum(facts.drawn['mirrored'] for facts in kept_facts):,} mirrored"
    files = (folder / part / file for part in (EPISODES, SONGS) for file in files_in(folder / part))
    size = sum(file.lstat().st_size for file in files)
    yield f"{size / _MIB:.1f} MiB, {size / max(steps, 1):,.0f} bytes a step"
    hours = sum(facts.cpu_seconds for _, facts in episodes) / 3600
    yield f"{hours:.2f} hours of one core to make"
    yield from _versions(facts for _, facts in episodes)


def _spread(name: str, values: list[float]) -> str:
    return f"{name} {np.mean(values):.3f} on average, {min(values):.3f} to {max(values):.3f}"


def _rewarded(kept: list[EpisodeFacts]) -> Iterator[str]:
    """Yield the sources of rewarded fingers, see `GoalTrack.rewarded_fingers`."""
    counts = Counter(str(facts.metrics.get("rewarded_fingers")) for facts in kept)
    for fingers, count in sorted(counts.items()):
        yield f"rewarded fingers: {printable(fingers)} in {counted(count, 'episode')}"


def _versions(episodes: Iterable[EpisodeFacts]) -> Iterator[str]:
    counts = Counter(
        printable(f"{name} {version}")
        for facts in episodes
        for name, version in facts.versions.items()
    )
    for version, count in sorted(counts.items()):
        yield f"made with {version}: {counted(count, 'episode')}"
