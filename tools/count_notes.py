"""Counts the extra and the missed notes of performances by kind, as a listener does.

    python tools/count_notes.py FOLDER...

FOLDERs are what `cadenza play` leaves, or hold such folders; the notes are those of wanted.mid and
played.mid. Kinds are those of `cadenza.music.metrics`. Below them stands how far from the
middle of their keys fingertips strike, of folders with an episode.npz.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import numpy as np
from strike_offsets import strike_offsets

from cadenza.episode import load_episode
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.music.formats.midi import read_midi
from cadenza.music.metrics import note_errors

IN_THE_MIDDLE = 0.003  # [m] from the middle of a key
ROWS = {
    "extra_notes": "extra",
    "extra_neighbour": "  a key beside a right one",
    "extra_brushed": "    shorter than 60 ms",
    "extra_off_time": "  more than 50 ms late or early",
    "extra_again": "  the own key struck again",
    "extra_other": "  others",
    "missed_notes": "missed",
    "missed_silent": "  key never sounds",
    "missed_off_time": "  late or early",
    "missed_held": "  key still down from before",
}


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path, help="of performances, or of such folders")
    paths = (path for folder in parser.parse_args().folders for path in _played(folder))
    counts, offsets = Counter[str](), [np.zeros(0)]
    for folder in dict.fromkeys(path.parent for path in paths):
        of_folder, across = _counted(folder)
        counts += of_folder
        offsets.append(across)
        extra, missed = (_rate(of_folder, f"{name}_notes") for name in ("extra", "missed"))
        print(f"{extra} extra {missed} missed  {folder}")
    print(f"\n{counts['written']} written notes, {counts['right']} played in time; per 100:\n")
    for kind, title in ROWS.items():
        print(f"{title:32}{counts[kind]:6}{_rate(counts, kind)}")
    if len(distances := 1000 * np.concatenate(offsets)):
        median, most = np.percentile(distances, [50, 90])
        near = 100 * np.mean(distances <= 1000 * IN_THE_MIDDLE)
        print(
            f"\nfrom the middle of the key, of {len(distances)} strikes: median {median:.1f} mm, "
            f"90 % within {most:.1f} mm; {near:.0f} % within {1000 * IN_THE_MIDDLE:.0f} mm"
        )


def _played(folder: Path) -> list[Path]:
    """The files of what was played in a folder.

    Raises:
        CadenzaError: there is none.
    """
    if not (files := sorted(folder.rglob("played.mid"))):
        raise CadenzaError(f"{folder}: holds no played.mid; give folders of cadenza play")
    return files


def _counted(folder: Path) -> tuple[Counter[str], np.ndarray]:
    """The numbers of notes by kind, and how far from the middle keys are struck [m]."""
    written, played = (read_midi(folder / f"{name}.mid").notes for name in ("wanted", "played"))
    errors = note_errors(written, played)
    counts = Counter(written=len(written), right=len(errors.pairs), **errors.counts)
    if not (recording := folder / "episode.npz").exists():
        return counts, np.zeros(0)
    return counts, strike_offsets(load_episode(recording), (note for _, note in errors.pairs))


def _rate(counts: Counter[str], kind: str) -> str:
    return f"{100 * counts[kind] / max(counts['written'], 1):7.1f}"


if __name__ == "__main__":
    main()
