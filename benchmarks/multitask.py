"""Measures one network for n songs, cloned from the planner, on songs learnt and on others.

    python -m benchmarks.multitask -o multitask [--songs 1 2 4 ... 64 --more LIBRARY --widths 1024]

The experiment of the paper (Zakka et al., CoRL 2023) on multitask behaviour cloning, with the
planner as the expert. The songs are the beginnings of the bundled pieces, in an order that is drawn
once and begins with Für Elise. The last eight are never learnt from. After the other sixteen come
pieces of another library, also in an order that is drawn once. Sets of songs grow, so that a larger
one holds the smaller ones. All that is finished is kept: the same command goes on.

The folder then holds multitask.csv, a row for each policy and song, and multitask.svg.
"""

from __future__ import annotations

import argparse
import html
import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.arguments import one_or_more
from cadenza.agents.rollout import play_episode
from cadenza.cli import main as cadenza
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.evaluation.statistics import mean_interval
from cadenza.evaluation.tables import write_csv
from cadenza.files import write_atomically
from cadenza.learning.algorithms.cloning.config import CloningConfig
from cadenza.learning.config import ImitationConfig
from cadenza.learning.imitation import Imitation
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.policy_folder import load_policy
from cadenza.music.formats.midi import write_midi
from cadenza.music.libraries.folder import unique
from cadenza.music.libraries.library import load_score, open_library
from cadenza.music.libraries.songs import songs
from cadenza.tasks.piano_task import PianoTask

FIRST = "FurEliseOpening"
SECONDS = 8.0  # of each piece
NOT_LEARNT = 8  # songs
LAYERS = 3  # hidden ones, as the paper's actor has; its width is the default
FIGURES = ("f1", "precision", "recall", "note_onset_f1")


class Policy(NamedTuple):
    """A policy that was trained."""

    learnt_from: tuple[str, ...]
    width: int
    seed: int
    learnt: LearntPolicy


def order() -> list[str]:
    """The bundled pieces as they are learnt, one after the other; the last are not learnt from."""
    return [FIRST, *shuffled([piece.name for piece in songs() if piece.name != FIRST])]


def to_learn(most: int, more: str | None) -> list[str]:
    """The songs from which the policy of `most` songs learns; smaller sets are their beginning.

    Raises:
        CadenzaError: there are not so many.
    """
    names = order()[:-NOT_LEARNT]
    if more is not None:
        names += shuffled([song.name for song in open_library(more).songs])
    if most > len(names):
        raise CadenzaError(f"{most} songs to learn, but there are {len(names)}: add some by --more")
    return names[:most]


def shuffled(names: Sequence[str]) -> list[str]:
    """The names in a random order, always the same."""
    shuffled: list[str] = np.random.default_rng(0).permutation(names).tolist()
    return shuffled


def write_songs(folder: Path, seen: Sequence[str], unseen: Sequence[str]) -> list[list[Path]]:
    """Writes the beginnings of pieces that are learnt and of others, and returns their files."""
    short = iter(unique([Path(name).name for name in (*seen, *unseen)]))
    files = [
        [folder / kind / f"{next(short)}.mid" for _ in names]
        for kind, names in (("seen", seen), ("unseen", unseen))
    ]
    for name, file in zip((*seen, *unseen), (*files[0], *files[1]), strict=True):
        write_midi(load_score(name).beginning(SECONDS), file)
    return files


def train(
    demonstrations: Path, run: Path, songs: Sequence[str], width: int, seed: int, updates: int
) -> Policy:
    """A policy of these songs, with hidden layers of this width."""
    run.mkdir(parents=True, exist_ok=True)
    config = ImitationConfig(
        learner=CloningConfig(hidden_sizes=(width,) * LAYERS),
        songs=tuple(songs),
        num_updates=updates,
        held_out=0,
        seed=seed,
    )
    Imitation(config, demonstrations, run).run(lambda: True)
    return Policy(config.songs, width, seed, load_policy(run / "last"))


def play(song: Path, policies: Sequence[Policy], unseen: bool) -> Iterator[dict[str, object]]:
    """Rows of the table: how a song is played by those that have learnt it, or by all if unseen."""
    first, score = policies[0].learnt, load_score(song)
    with closing(PianoTask([score], first.task, first.scene)) as task:
        for policy in policies:
            if not unseen and song.stem not in policy.learnt_from:
                continue
            metrics = play_episode(task, policy.learnt.agent, 0).metrics
            yield {
                "songs": len(policy.learnt_from),
                "width": policy.width,
                "seed": policy.seed,
                "song": song.stem,
                "learnt": not unseen,
                **{name: metrics[name] for name in FIGURES},
            }


class Mean(NamedTuple):
    """F1 on songs, with its 95 % interval over songs and seeds together, and note onset F1."""

    songs: int
    width: int
    learnt: bool
    f1: float
    low: float
    high: float
    note_onset_f1: float


def means(rows: Sequence[dict[str, object]]) -> list[Mean]:
    """Means for each number of songs and width, on songs learnt and on those nobody has learnt."""
    found: dict[tuple[bool, int, int], list[list[float]]] = {}
    for row in rows:
        of = bool(row["learnt"]), int(str(row["width"])), int(str(row["songs"]))
        both = [float(str(row[name])) for name in ("f1", "note_onset_f1")]
        found.setdefault(of, []).append(both)
    result = []
    for (learnt, width, count), scores in sorted(found.items()):
        mean, low, high = mean_interval(np.array(scores))
        figures = *(float(part[0]) for part in (mean, low, high)), float(mean[1])
        result.append(Mean(count, width, learnt, *figures))
    return result


# The picture, in the style of that of the results

_WIDTH, _HEIGHT, _LEFT, _TOP, _LINE = 730, 300, 56, 40, 16  # [px]
_STYLE = """
  svg { --card: #ffffff; --ink: #14181f; --soft: #566070; --line: #e2e5ea; --one: #2f5bd7;
    --other: #c2571a; font: 13px system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
  @media (prefers-color-scheme: dark) { svg {
    --card: #161a21; --ink: #e9edf3; --soft: #a0aab9; --line: #2b323d; --one: #86a8ff;
    --other: #ff9f6b; } }
  .card { fill: var(--card); } .grid { stroke: var(--line); } text { fill: var(--soft); }
  path { fill: none; } .learnt { color: var(--one); } .others { color: var(--other); }
  .narrow { stroke-dasharray: 5 3; }
  .learnt, .others { stroke: currentColor; stroke-width: 2; } circle { fill: currentColor; }
  g text { fill: currentColor; stroke: none; font-weight: 600; } .end { text-anchor: end; }
"""


def drawn(found: Sequence[Mean]) -> Iterator[str]:
    """An SVG picture of F1 by the number of songs learnt from, which doubles from left to right."""
    most = math.log2(max(mean.songs for mean in found)) or 1.0
    width = _WIDTH - _LEFT - 250

    def x(count: int) -> float:
        return _LEFT + width * math.log2(count) / most

    def y(f1: float) -> float:
        return _TOP + _HEIGHT * (1 - min(max(f1, 0.0), 1.0))

    total = _TOP + _HEIGHT + 50
    words = "F1 by the number of songs that one network has learnt from"
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {total}" role="img">'
        f"<title>{html.escape(words)}</title><style>{_STYLE}</style>"
        f'<rect class="card" width="{_WIDTH}" height="{total}" rx="10"/>'
        f'<text x="{_LEFT}" y="22">F1</text>'
        f'<text x="{_LEFT}" y="{total - 10}">songs that one network has learnt from</text>'
    )
    for tick in (0, 0.25, 0.5, 0.75, 1):
        yield f'<path class="grid" d="M{_LEFT} {y(tick):g}h{width}"/>'
        yield f'<text class="end" x="{_LEFT - 8}" y="{y(tick) + 4:g}">{tick:g}</text>'
    for count in sorted({mean.songs for mean in found}):
        yield f'<text x="{x(count) - 4:g}" y="{_TOP + _HEIGHT + 18}">{count}</text>'
    kinds = sorted({(mean.learnt, mean.width) for mean in found})
    lines = [[mean for mean in found if (mean.learnt, mean.width) == kind] for kind in kinds]
    widest, below = max(mean.width for mean in found), -math.inf
    for line in sorted(lines, key=lambda line: -line[-1].f1):
        last = line[-1]
        dashed = "" if last.width == widest else ' class="narrow"'
        path = "L".join(f"{x(m.songs):.1f} {y(m.f1):.1f}" for m in line)
        yield f'<g class="{"learnt" if last.learnt else "others"}"><path{dashed} d="M{path}"/>'
        for m in line:
            yield f'<circle cx="{x(m.songs):.1f}" cy="{y(m.f1):.1f}" r="3"/>'
            if not math.isnan(m.low):
                yield f'<path d="M{x(m.songs):.1f} {y(m.low):.1f}V{y(m.high):.1f}"/>'
        below = max(y(last.f1) + 4, below + _LINE)  # of the label before it
        name = f"{'songs learnt' if last.learnt else 'other songs'}, {last.width} units"
        at = f'x="{x(last.songs) + 10:.1f}" y="{below:.1f}"'
        yield f"<text {at}>{last.f1:.2f} {name}</text></g>"
    yield "</svg>\n"


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("multitask"))
    parser.add_argument("--songs", type=one_or_more, nargs="+", default=[1, 2, 4, 8, 16])
    parser.add_argument("--more", metavar="LIBRARY", help="of songs after the bundled ones")
    parser.add_argument(
        "--widths", type=one_or_more, nargs="+", default=[256], help="of the hidden layers"
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument(
        "--episodes", type=one_or_more, default=6, help="demonstrations of each song"
    )
    parser.add_argument("--updates", type=one_or_more, default=625, help="for each song")
    parser.add_argument("--least-updates", type=one_or_more, default=3_000)
    options = parser.parse_args()
    folder = options.output
    learnt = to_learn(max(options.songs), options.more)
    seen, unseen = write_songs(folder / "songs", learnt, order()[-NOT_LEARNT:])
    # Named after how many there are of each song: with more, nothing that was learnt is kept.
    demonstrations = folder / f"demonstrations-{options.episodes}"
    collect = ["dataset", "collect", "--songs", str(folder / "songs/seen")]
    cadenza([*collect, "-o", str(demonstrations), "--episodes", str(options.episodes)])
    names = [song.stem for song in seen]
    policies = [
        train(
            demonstrations,
            folder / f"runs-{options.episodes}" / f"{count}-{width}-{seed}",
            names[:count],
            width,
            seed,
            max(options.updates * count, options.least_updates),
        )
        for seed in options.seeds
        for width in options.widths
        for count in options.songs
    ]
    rows = [row for song in seen for row in play(song, policies, unseen=False)]
    rows += [row for song in unseen for row in play(song, policies, unseen=True)]
    summed_up(folder, rows)


def summed_up(folder: Path, rows: Sequence[dict[str, object]]) -> None:
    """Writes the table and the picture, and prints the means."""
    write_csv(folder / "multitask.csv", rows)
    found = means(rows)
    with write_atomically(folder / "multitask.svg") as file:
        file.write("\n".join(drawn(found)).encode())
    print("| songs | units | | F1 | 95 % interval | note onset F1 |")
    print("| --- " * 6 + "|")
    for mean in found:
        kind = "learnt" if mean.learnt else "others"
        interval = "all the same" if math.isnan(mean.low) else f"{mean.low:.3f} to {mean.high:.3f}"
        figures = f"{mean.f1:.3f} | {interval} | {mean.note_onset_f1:.3f}"
        print(f"| {mean.songs} | {mean.width} | {kind} | {figures} |")


if __name__ == "__main__":
    main()
