"""Chords of accompaniments: strummed, picked, comped, held, broken, stabbed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import count

import numpy as np

from cadenza.music.etudes.band.chords import SongChord
from cadenza.music.etudes.band.passage import SongPassage
from cadenza.music.etudes.band.rhythm_section import MEDIUM, Pattern
from cadenza.music.etudes.band.voicings import Slots, Voicing, guitar, led_voicings, nearest
from cadenza.music.etudes.sheet import Tone, pick
from cadenza.music.score import OCTAVE

Rhythm = Sequence[tuple[float, float]]
"""Onset and length of notes, in quarters from the beginning of a bar."""
_LIGHT = 64  # velocity off the beat

VOICES: dict[str, Slots] = {
    "close": ((55, 64), (59, 68), (63, 72)),  # of a right hand around middle C
    "high_close": ((60, 69), (64, 73), (68, 77)),
    "organ": ((53, 62), (58, 66), (62, 71), (67, 76)),
    "rootless": ((51, 58), (55, 62), (60, 67), (64, 71)),  # of jazz: the bass has the root
    "strings": ((36, 47), (48, 56), (55, 63), (64, 73), (74, 83)),
    "four_strings": ((43, 54), (55, 63), (64, 72), (74, 84)),
    "high_strings": ((67, 76), (74, 84)),
    "brass": ((58, 67), (63, 71), (67, 77)),
}
"""Instrument -> the lowest and highest pitch of each of its voices."""
_LEFT_ROOTS = 46  # [MIDI pitch] near which roots of pianists' left hands are
_RIFF_TONES = 5  # tones of the chord that a riff is made of
_STACCATO = 0.8  # sounding share of the notes of riffs
_PICKED = (0, 2, 3, 4, 3, 2)  # strings of a broken chord on a guitar, from the root's


def chords(
    voicings: Callable[[tuple[SongChord, ...]], Iterable[Voicing]], *rhythms: Rhythm
) -> Pattern:
    """Chords in one of these rhythms."""

    def play(passage: SongPassage) -> Iterator[Tone]:
        pitches = list(voicings(passage.chords))
        for at, length in passage.in_bars(pick(passage.rng, rhythms)):
            velocity = MEDIUM if at % 1 == 0 else _LIGHT
            for pitch in pitches[passage.harmony(at)]:
                yield Tone(at, length, pitch, velocity)

    return play


def held(slots: Slots) -> Pattern:
    """Chords that are held as long as the harmony; a voice that stays is held on, up to 2 bars."""

    def play(passage: SongPassage) -> Iterator[Tone]:
        voicings = led_voicings(passage.chords, slots)
        sounding: dict[int, Tone] = {}
        for harmony, pitches in zip(passage.harmonies, voicings, strict=True):
            for pitch in [p for p in sounding if p not in pitches]:
                yield sounding.pop(pitch)
            for pitch in pitches:
                before = sounding.get(pitch)
                if before and before.length + harmony.length <= 2 * passage.beats:
                    at, length = before.at, before.length + harmony.length
                else:
                    at, length = harmony.at, harmony.length
                    if before:
                        yield before
                sounding[pitch] = Tone(at, length, pitch)
        yield from sounding.values()

    return play


def piano(slots: Slots, left: Rhythm, *right: Rhythm) -> Pattern:
    """Chords of the right hand, and roots, fifths and octaves or tenths of the left."""
    above = chords(partial(led_voicings, slots=slots), *right)

    def play(passage: SongPassage) -> Iterator[Tone]:
        yield from above(passage)
        starts = {harmony.at for harmony in passage.harmonies}
        wide = pick(passage.rng, ("octaves", "fifths", "broken"))
        for i, (at, length) in enumerate(passage.in_bars(left)):
            chord = passage.chord(at)
            root = nearest([chord.bass], _LEFT_ROOTS)
            fifth = root + (chord.fifth - root) % OCTAVE
            tenth = root + OCTAVE + (chord.third - root) % OCTAVE
            if wide == "octaves":
                pitches = [root - OCTAVE, root] if at in starts else [root]
            elif wide == "fifths":
                pitches = [root, fifth] if at in starts else [fifth]
            else:
                broken = (root, fifth, root + OCTAVE, tenth)
                pitches = [root if at in starts else broken[i % len(broken)]]
            for pitch in pitches:
                yield Tone(at, length, pitch, _LIGHT)

    return play


def picked(passage: SongPassage) -> Iterator[Tone]:
    """Yields broken chords of a guitar in eighths, which ring on until the chord changes."""
    for harmony in passage.harmonies:
        strings = guitar(harmony.chord)
        if passage.final:
            yield from (Tone(0, harmony.length, pitch) for pitch in strings)
            continue
        for i in range(int(2 * harmony.length)):
            place = min(_PICKED[i % len(_PICKED)], len(strings) - 1)
            at = i / 2
            yield Tone(harmony.at + at, min(2, harmony.length - at), strings[place], _LIGHT)


def boom_chick(passage: SongPassage) -> Iterator[Tone]:
    """Yields a root on the beat and the upper strings after it, as a country guitar does."""
    for harmony in passage.harmonies:
        strings = guitar(harmony.chord)
        if passage.final:
            yield from (Tone(0, harmony.length, pitch) for pitch in strings)
            continue
        for beat in range(int(harmony.length)):
            if (harmony.at + beat) % passage.beats % 2 == 0 and (passage.beats == 4 or beat == 0):
                yield Tone(harmony.at + beat, 1, strings[0])
            else:
                yield from (Tone(harmony.at + beat, 0.5, p, _LIGHT) for p in strings[2:])


def riff(lowest: int, *rhythms: Sequence[float]) -> Pattern:
    """A figure of single notes that comes again in every bar, on the tones of its chord."""

    def play(passage: SongPassage) -> Iterator[Tone]:
        onsets = pick(passage.rng, rhythms)
        places = passage.rng.integers(0, _RIFF_TONES, len(onsets))
        lengths = np.diff([*onsets, passage.beats])
        rhythm = [(at, float(length)) for at, length in zip(onsets, lengths, strict=True)]
        for i, (at, length) in enumerate(passage.in_bars(rhythm)):
            chord = passage.chord(at)
            ladder = [p for p in range(lowest, lowest + 2 * OCTAVE) if chord.has(p)]
            pitch = ladder[int(places[i % len(places)])]
            yield Tone(at, _STACCATO * length, pitch, MEDIUM if at % 1 == 0 else _LIGHT)

    return play


def broken(lowest: int, step: float, *orders: Sequence[int]) -> Pattern:
    """Arpeggios of a synthesizer: tones of the chord from `lowest` on in one of these orders."""

    def play(passage: SongPassage) -> Iterator[Tone]:
        order = pick(passage.rng, orders)
        for harmony in passage.harmonies:
            ladder = [p for p in range(lowest, lowest + 3 * OCTAVE) if harmony.chord.has(p)]
            if passage.final:
                yield from (Tone(0, harmony.length, pitch) for pitch in ladder[:4])
                continue
            for i in count():
                at = harmony.at + i * step
                if i * step >= harmony.length:
                    break
                place = int(at / step) % len(order)
                yield Tone(at, step, ladder[order[place]], MEDIUM if at % 1 == 0 else _LIGHT)

    return play
