"""Compares the fingers that Cadenza finds with those written beside the bundled pieces.

    python tools/compare_fingering.py [PIECE ...] -o docs/results/fingering.csv

writes a row for each piece, with columns for the robot's fingers and the pianist's: the shares of
notes with the same hand and the same finger as written. The pianist's are found for the written
hands.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from cadenza.errors import errors_in_a_line
from cadenza.evaluation.tables import write_csv
from cadenza.fingering.pianist import pianist_fingering
from cadenza.fingering.search import solve
from cadenza.fingers import Finger
from cadenza.music.libraries.library import load_score, songs
from cadenza.music.score import Score
from cadenza.scene.scene import build_scene
from cadenza.tasks.goal_track import players_of

HANDS = players_of(build_scene())


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("pieces", nargs="*", help="bundled pieces; all by default")
    parser.add_argument("-o", "--output", type=Path, required=True, help="table, as CSV")
    options = parser.parse_args()
    rows = []
    for name in options.pieces or [piece.name for piece in songs()]:
        written = load_score(name)
        robot = solve(written.without_fingers(), HANDS).score
        pianist = pianist_fingering(written, HANDS)[0]
        rows.append({"piece": name, "notes": len(written.notes)})
        rows[-1] |= _shares("robot", written, robot) | _shares("pianist", written, pianist)
        print(*rows[-1].values(), flush=True)
    write_csv(options.output, rows)


def _shares(fingering: str, written: Score, score: Score) -> dict[str, float]:
    pairs = [(a.finger, b.finger) for a, b in zip(written.notes, score.notes, strict=True)]
    hands = sum(_hand(a) == _hand(b) for a, b in pairs) / len(pairs)
    fingers = sum(a == b for a, b in pairs) / len(pairs)
    return {f"{fingering}_hand": round(hands, 4), f"{fingering}_finger": round(fingers, 4)}


def _hand(finger: Finger | None) -> int | None:
    return finger and finger.hand


if __name__ == "__main__":
    main()
