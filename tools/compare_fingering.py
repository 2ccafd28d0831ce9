"""Compares the fingers that Cadenza finds with those written beside the bundled pieces.

    python tools/compare_fingering.py [PIECE ...] [--pianoplayer PYTHON]

With the Python of an environment that has pianoplayer (pip install 'pianoplayer[midi]'), its
fingers are compared, too. It is told the hand of every note, as it does not choose hands, and takes
up to minutes a piece.

The hands are found for the robot's fingers, and those written for the pianist's.

`hand` and `finger` are the shares of notes with the same hand and finger as written, `cost` what
a fingering costs by `cadenza.fingering.search`, and `against` how many of its notes break what that
takes for possible (they are left out of the cost).
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import mido

from cadenza.errors import errors_in_a_line
from cadenza.fingering.pianist import pianist_fingering
from cadenza.fingering.search import solve
from cadenza.fingers import Finger
from cadenza.music.libraries.library import load_score, songs
from cadenza.music.score import Note, Score
from cadenza.scene.scene import build_scene
from cadenza.tasks.goal_track import players_of

HANDS = players_of(build_scene())


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("pieces", nargs="*", help="bundled pieces; all by default")
    parser.add_argument("--pianoplayer", help="the Python of an environment that has it")
    options = parser.parse_args()
    pianoplayer, names = options.pianoplayer, options.pieces
    print(f"{'':31} notes  written (against)   found: hand, finger, cost (against)   a pianist's")
    for name in names or [piece.name for piece in songs()]:
        written = load_score(name)
        found = solve(written.without_fingers(), HANDS).score
        row = f"{name:31} {len(written.notes):5} {_cost(written)}   {_agreement(written, found)}"
        row += f"   {_agreement(written, pianist_fingering(written, HANDS)[0])}"
        if pianoplayer:
            begin = time.perf_counter()
            row += f"   pianoplayer: {_agreement(written, _by_pianoplayer(pianoplayer, written))}"
            row += f", {time.perf_counter() - begin:.0f} s"
        print(row, flush=True)


def _agreement(written: Score, found: Score) -> str:
    pairs = [(a.finger, b.finger) for a, b in zip(written.notes, found.notes, strict=True)]
    hand = sum(_hand(a) == _hand(b) for a, b in pairs) / len(pairs)
    finger = sum(a == b for a, b in pairs) / len(pairs)
    return f"{hand:4.2f} {finger:4.2f} {_cost(found)}"


def _hand(finger: Finger | None) -> int | None:
    return finger and finger.hand


def _cost(score: Score) -> str:
    """Cost of a fingering, and how many of its notes are against the limits."""
    solution = solve(score, HANDS)
    return f"{solution.cost:6.1f} ({len(solution.ignored)})"


def _by_pianoplayer(python: str, written: Score) -> Score:
    """The fingers of pianoplayer, none where it gives none."""
    sides = sorted({note.finger.hand for note in written.notes if note.finger})
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "given.mid", Path(folder) / "found.txt"
        _write_a_track_a_hand(written, sides, given)
        hands = [] if len(sides) == 2 else [("--right-only", "--left-only")[sides[0]]]
        options = ["--quiet", "--sound-off", "--chord-note-stagger-s", "0", *hands]
        subprocess.run(
            [python, "-m", "pianoplayer.cli", given, "-o", found, *options],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        rows = [line.split() for line in found.read_text().splitlines()]
    fingers = {
        (float(start), int(pitch)): Finger(int(channel), abs(int(finger)) - 1)
        for _, start, _, pitch, _, _, channel, finger, *_ in rows
        if int(finger)
    }

    def finger(note: Note) -> Finger | None:
        near = (
            f
            for (start, p), f in fingers.items()
            if p == note.pitch and abs(start - note.start) < 0.01
        )
        return next(near, None)

    notes = tuple(replace(note, finger=finger(note)) for note in written.notes)
    return replace(written, notes=notes)


def _write_a_track_a_hand(score: Score, sides: list[int], path: Path) -> None:
    midi = mido.MidiFile(ticks_per_beat=480)  # 960 ticks a second
    for side in sides:
        notes = [note for note in score.notes if _hand(note.finger) == side]
        events = [(round(960 * n.start), 1, n.pitch) for n in notes]
        events += [(round(960 * n.end), 0, n.pitch) for n in notes]
        track, now = mido.MidiTrack(), 0
        for tick, on, pitch in sorted(events):
            kind = "note_on" if on else "note_off"
            track.append(mido.Message(kind, note=pitch, channel=side, time=tick - now))
            now = tick
        midi.tracks.append(track)
    midi.save(path)


if __name__ == "__main__":
    main()
