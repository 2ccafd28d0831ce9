"""The moments of a song at which notes begin, or at which some may be struck again."""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import chain, pairwise
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np

from cadenza.arranging.parts import TOGETHER, SourceNote
from cadenza.music.notation.beats import estimated_bars
from cadenza.music.score import MIDI_PITCHES, Score, chords

MIN_LENGTH = 0.05  # length of a note that ends early, at least [s]
_USUAL_BEAT = 0.5  # [s] where a song has a single one
_PARTS = 2  # parts of a beat at which notes may be struck without being written there
_APART = 0.1  # [s] from such a moment to others
_MIN_REST = 0.15  # [s] that a note of an earlier beat must go on for to be worth striking


class SongMoment(NamedTuple):
    """A moment at which notes begin."""

    time: float
    begins_beat: bool
    melody: tuple[SourceNote, ...]  # the notes of the melody, the highest first
    bass: tuple[SourceNote, ...]  # the notes of the bass, the lowest first
    harmony: tuple[SourceNote, ...]  # the other notes that begin, by pitch
    # Notes of the harmony that began before, and in this beat or still sounding, by pitch
    sounding: tuple[SourceNote, ...]
    ceiling: int  # the highest pitch to which notes may be moved: that of the melody
    floor: int  # the lowest pitch to which notes may be moved: that of the bass


def beats_of(score: Score) -> list[float]:
    """The times at which beats begin [s], from before the first note to after the last.

    They are estimated for a score without bars, which has to have notes.
    """
    end = score.total_time
    bars = score.bars or estimated_bars(score.notes)
    beats = [beat for bar in bars for beat in bar.beats or (bar.time,)]
    beat = beats[-1] - beats[-2] if len(beats) > 1 else _USUAL_BEAT
    return [min(beats[0], 0.0), *beats[1:], *np.arange(beats[-1] + beat, end + beat, beat).tolist()]


def moments_of(notes: Sequence[SourceNote], beats: Sequence[float]) -> list[SongMoment]:
    """The moments of a song with these notes, in order."""
    notes = sorted(notes, key=attrgetter("start", "pitch"))
    melody, bass = [n for n in notes if n.melody], [n for n in notes if n.bass]
    moments, beat_before = [], -1
    sounding: list[SourceNote] = []
    for time, group in _groups(notes, beats):
        beat = bisect_right(beats, time + TOGETHER) - 1
        since = beats[beat] - TOGETHER
        sounding = [n for n in sounding if n.end > time + _MIN_REST or n.start > since]
        inner = sorted((n for n in group if not n.melody and not n.bass), key=attrgetter("pitch"))
        moments.append(
            SongMoment(
                time,
                beat != beat_before,
                tuple(sorted((n for n in group if n.melody), key=lambda n: -n.pitch)),
                tuple(sorted((n for n in group if n.bass), key=attrgetter("pitch"))),
                tuple(inner),
                tuple(sorted(sounding, key=attrgetter("pitch"))),
                _pitch_at(melody, time, MIDI_PITCHES[-1]),
                _pitch_at(bass, time, MIDI_PITCHES[0]),
            )
        )
        sounding += inner
        beat_before = beat
    return moments


def _groups(
    notes: Sequence[SourceNote], beats: Sequence[float]
) -> list[tuple[float, list[SourceNote]]]:
    """The times at which notes, in order, begin together, and parts of beats where none do."""
    groups = [(group[0].start, group) for group in chords(notes, TOGETHER)]
    begins = np.array([time for time, _ in groups])
    parts = (np.linspace(*beat, _PARTS, endpoint=False).tolist() for beat in pairwise(beats))
    for time in chain.from_iterable(parts):
        if begins[0] < time < begins[-1] and np.abs(begins - time).min() >= _APART:
            groups.append((time, []))
    return sorted(groups, key=itemgetter(0))


def _pitch_at(voice: Sequence[SourceNote], time: float, otherwise: int) -> int:
    """The pitch of a voice, by its notes in order, at a time [s]; `otherwise` if it is silent."""
    i = bisect_right(voice, time + TOGETHER, key=attrgetter("start")) - 1
    return voice[i].pitch if i >= 0 and voice[i].end >= time else otherwise
