"""Measures how much of songs is arranged for two hands, and how well the planner plays it.

    python -m benchmarks.arranging [SONG ...] [--begin S] [--seconds S]

prints a table as CSV, a row as soon as a song is done. SONG is a file or a name, in which melody
and bass are found first; without any, it measures the songs for a band of the benchmark whose
melody and bass are known, and by which no weights were chosen. The whole song is arranged, and an
excerpt played.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np

from benchmarks.arguments import parser_for
from cadenza.arranging.fidelity import pitch_classes
from cadenza.arranging.moments import beats_of
from cadenza.arranging.parts import sources_of
from cadenza.errors import errors_in_a_line
from cadenza.music.arrangement import LoadedSong
from cadenza.music.formats.midi import score_of
from cadenza.music.formats.midi_messages import parsed
from cadenza.music.libraries.library import load_score
from cadenza.music.performance import played_in
from cadenza.music.score import OCTAVE, Note, Score
from cadenza.performing.arranging import HandArrangement, arrange_song
from cadenza.performing.performance import perform
from cadenza.performing.setup import find_player, set_up
from cadenza.scene.scene import build_scene

IN_TIME = 0.08  # [s] within which a note of melody or bass counts as played
_LINES = Path(__file__).with_name("arranging_lines.zip")  # NAME.mid, with melody and bass as tracks
COLUMNS = (
    *("f1", "note_onset_f1", "original_f1", "melody", "bass", "pitch_classes"),
    *("grade", "cpu_seconds"),
)


Lines = tuple[tuple[Note, ...], tuple[Note, ...]]
"""The notes of melody and bass."""


def bands() -> Iterator[tuple[str, Lines]]:
    """Yield songs for a band of which melody and bass are known, by their names."""
    with ZipFile(_LINES) as files:
        for name in files.namelist():
            file = parsed(files.read(name))
            melody, bass = (score_of(file, (track,), "").notes for track in (1, 2))
            yield f"benchmark/{Path(name).stem}", (melody, bass)


def excerpt(notes: Sequence[Note], begin: float, seconds: float) -> tuple[Note, ...]:
    """The notes that begin within a time, cut at its end, on its clock."""
    end = begin + seconds
    inside = (note for note in notes if begin <= note.start < end - IN_TIME)
    return tuple(replace(n, start=n.start - begin, end=min(n.end, end) - begin) for n in inside)


def share(wanted: Sequence[Note], played: Sequence[Note], octaves: bool) -> float:
    """The share of notes that are played in time, or 1 if there are none."""
    modulus = OCTAVE if octaves else OCTAVE**3

    def is_there(note: Note) -> bool:
        return any(
            abs(each.start - note.start) <= IN_TIME and not (each.pitch - note.pitch) % modulus
            for each in played
        )

    return float(np.mean([is_there(note) for note in wanted])) if wanted else 1.0


def measure(
    score: Score, melody: Sequence[Note], bass: Sequence[Note], begin: float, seconds: float
) -> tuple[float, ...]:
    """The values of `COLUMNS` for a song of which melody and bass are known."""
    started = time.process_time()
    found = arrange_song(LoadedSong(score.title, score), build_scene())
    took = time.process_time() - started
    begin = min(begin, max(score.total_time - seconds, 0.0))
    part = Score(excerpt(found.arranged.score.notes, begin, seconds))
    original = Score(excerpt(score.notes, begin, seconds))
    with set_up(part, find_player()) as setup:
        performance, track = perform(setup), setup.task.tracks[0]
    arranged = replace(found.arranged, score=part)
    against = HandArrangement(original, arranged, found.hands).metrics(performance.episode, track)
    delay = track.silent_steps * track.config.control_timestep - part.notes[0].start
    notes = [
        replace(note, start=note.start - delay, end=note.end - delay)
        for note in played_in(performance.episode).notes
        if note.start >= delay
    ]
    beats = [beat - begin for beat in beats_of(score) if begin <= beat < begin + seconds]
    wanted, sounding = pitch_classes(original.notes, beats), pitch_classes(notes, beats)
    return (
        performance.metrics["f1"],
        performance.metrics["note_onset_f1"],
        against["original_f1"],
        share(excerpt(melody, begin, seconds), notes, octaves=False),
        share(excerpt(bass, begin, seconds), notes, octaves=True),
        float((wanted & sounding).sum() / max(wanted.sum(), 1)),
        found.arranged.grade,
        took,
    )


@errors_in_a_line()
def main() -> None:
    """Measures the songs and prints the table."""
    parser = parser_for(__doc__)
    parser.add_argument("songs", nargs="*")
    parser.add_argument("--begin", type=float, default=20.0, help="of the excerpts [s]")
    parser.add_argument("--seconds", type=float, default=15.0, help="of the excerpts [s]")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print("song", *COLUMNS, sep=",")

    def add(name: str, score: Score, melody: Sequence[Note], bass: Sequence[Note]) -> None:
        row = measure(score, melody, bass, options.begin, options.seconds)
        print(name, *(f"{value:.4f}" for value in row), sep=",", flush=True)

    for song in options.songs:
        score = load_score(song)
        notes = sources_of(score)
        melody = [Note(*note[:4]) for note in notes if note.melody]
        add(Path(song).stem, score, melody, [Note(*note[:4]) for note in notes if note.bass])
    for name, lines in () if options.songs else bands():
        add(name, load_score(name), *lines)


if __name__ == "__main__":
    main()
