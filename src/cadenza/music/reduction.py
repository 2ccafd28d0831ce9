"""Music for many instruments, reduced to what two hands can play."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cadenza.music.score import LETTING_GO, Note, Score, chords

_SINGLE = 0.9  # of a track's onsets are one note, where it is a voice and no chords
_FILL = 0.25  # of the notes of the busiest voice; a track with fewer only fills in


def melody_and_bass_tracks(tracks: Mapping[int, Score]) -> tuple[int, ...]:
    """The numbers of the tracks that have the melody and the bass, of more than two `tracks`.

    Those are the highest and the lowest in the mean of the tracks that are voices, one note after
    the other: chords held above a tune are not the tune. All, where fewer than two are voices.
    """
    voices = {
        number: score.notes
        for number, score in tracks.items()
        if sum(1 for _ in chords(score.notes)) >= _SINGLE * len(score.notes)
    }
    busiest = max(map(len, voices.values()), default=0)
    height = {
        number: sum(note.pitch for note in notes) / len(notes)
        for number, notes in voices.items()
        if len(notes) >= _FILL * busiest
    }
    if len(height) < 2:
        return tuple(tracks)
    return max(height, key=height.__getitem__), min(height, key=height.__getitem__)


def melody_and_bass(score: Score) -> Score:
    """The highest and the lowest voice of `score`, at most one note each at a time.

    Of the notes that begin together the highest goes on with the melody, unless one that is kept
    sounds above it, and the lowest with the bass, unless one that is kept sounds below it. In
    either voice a note ends where the next begins; one about to end does not sound any more. A
    note that begins alone can be both melody and bass.
    """
    kept: list[Note] = []
    voices = {"melody": -1, "bass": -1}  # where in `kept` their latest notes are
    for notes in chords(score.notes):
        time = notes[0].start
        latest = {i for i in voices.values() if i >= 0}
        sounding = [kept[i].pitch for i in latest if kept[i].end > time + LETTING_GO]
        high = max(notes, key=lambda note: note.pitch)
        low = min(notes, key=lambda note: note.pitch)
        begin = {}
        if high.pitch >= max(sounding, default=high.pitch):
            begin["melody"] = high
        if low.pitch <= min(sounding, default=low.pitch):
            begin["bass"] = low
        for note in dict.fromkeys(begin.values()):
            kept.append(note)
            voices |= {voice: len(kept) - 1 for voice in begin if begin[voice] is note}
        for i in latest - set(voices.values()):
            kept[i] = replace(kept[i], end=min(kept[i].end, time))
    return replace(score, notes=tuple(kept))
