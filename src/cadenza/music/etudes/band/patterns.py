"""What bass, drums and chords of an accompaniment play in a section."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import count, pairwise

import numpy as np

from cadenza.music.etudes.band.chords import SongChord, SongPassage, happens
from cadenza.music.etudes.band.voicings import Slots, Voicing, guitar, led_voicings, nearest
from cadenza.music.etudes.sheet import Tone, pick
from cadenza.music.score import OCTAVE

Pattern = Callable[[SongPassage], Iterator[Tone]]
"""What an instrument plays in a section; the velocity 72 is neither accented nor light."""
MEDIUM = 72
_ACCENT, _LIGHT, _GHOST = 84, 62, 44  # velocities

# Basses

_LOWEST, _HIGHEST = 28, 52  # E1 to E3
_ROOTS = 36  # [MIDI pitch] near which roots are


def _root(chord: SongChord) -> int:
    return max(nearest([chord.bass], _ROOTS), _LOWEST)


def _fifth(chord: SongChord) -> int:
    """The fifth below the root, where the bass has it, or above."""
    root = _root(chord)
    above = root + (chord.fifth - root) % OCTAVE
    return above - OCTAVE if above - OCTAVE >= _LOWEST else above


def patterned_bass(rhythm: Sequence[tuple[float, float, str]]) -> Pattern:
    """A bass with a rhythm (onset, length, tone) of one or more bars.

    Tones are "r" for the root, "f" for the fifth below or above it, "o" for the octave.
    """

    def play(passage: SongPassage) -> Iterator[Tone]:
        tones = {at: tone for at, _, tone in rhythm}
        bars = 1 + int(max(tones)) // passage.beats
        starts = {harmony.at for harmony in passage.harmonies}
        for at, length in passage.in_bars([(at, length) for at, length, _ in rhythm]):
            chord = passage.chord(at)
            tone = "r" if at in starts else tones.get(at % (bars * passage.beats), "r")
            pitch = {"r": _root(chord), "f": _fifth(chord), "o": _root(chord) + OCTAVE}[tone]
            yield Tone(at, length, pitch, MEDIUM if at % 1 == 0 else _LIGHT)

    return play


def approached(play: Pattern, percent: int) -> Pattern:
    """A bass that often comes to new roots by a step in the last half of a beat."""

    def play_approached(passage: SongPassage) -> Iterator[Tone]:
        tones = list(play(passage))
        starts = {harmony.at for harmony in passage.harmonies}
        for tone, after in pairwise(tones):
            distance = after.pitch - tone.pitch
            lasts = after.at - 0.5 - tone.at
            walks = after.at in starts and abs(distance) > 1 and lasts >= 0.5
            if walks and happens(passage.rng, percent):
                yield Tone(tone.at, min(tone.length, lasts), tone.pitch, tone.velocity)
                step = 2 if distance > 0 else -2
                yield Tone(after.at - 0.5, 0.5, max(after.pitch - step, _LOWEST), _LIGHT)
            else:
                yield tone
        yield tones[-1]

    return play_approached


def walking_bass(passage: SongPassage) -> Iterator[Tone]:
    """Yield quarters: roots, tones of the chord, and a step to the next root."""
    if passage.final:
        yield Tone(0, passage.length, _root(passage.chord(0)))
        return
    pitch = _root(passage.chord(0))
    roots = [_root(chord) for chord in passage.chords]
    for harmony, after in zip(passage.harmonies, [*roots[1:], roots[0]], strict=True):
        beats = int(harmony.length)
        goal = nearest([after % OCTAVE], pitch)
        goal += OCTAVE * (goal < _LOWEST) - OCTAVE * (goal > _HIGHEST)
        start = nearest([harmony.chord.bass], pitch)
        start += OCTAVE * (start < _LOWEST) - OCTAVE * (start > _HIGHEST)
        for beat in range(beats):
            if beat == 0:
                pitch = start
            elif beat == beats - 1:
                pitch = goal + pick(passage.rng, (-1, 1, -2, 2))
                pitch += OCTAVE * (pitch < _LOWEST)
            else:
                pitch = _between(passage, harmony.chord, pitch, start, goal)
            yield Tone(harmony.at + beat, 1, pitch, pick(passage.rng, (MEDIUM, _LIGHT)))


def _between(passage: SongPassage, chord: SongChord, pitch: int, start: int, goal: int) -> int:
    """Another tone of the chord near the one before, rather towards the goal."""
    towards = 3 if goal >= start else -3
    classes = [c for c in chord.classes[:3] if c != pitch % OCTAVE]
    choice = nearest(classes, pitch + pick(passage.rng, (towards, towards, -towards)))
    return choice if _LOWEST <= choice <= _HIGHEST else nearest(classes, _ROOTS + 4)


# Drums

DRUMS = {
    "kick": 36,
    "stick": 37,
    "snare": 38,
    "clap": 39,
    "closed_hat": 42,
    "pedal_hat": 44,
    "open_hat": 46,
    "crash": 49,
    "ride": 51,
    "tambourine": 54,
    "low_conga": 64,
    "high_conga": 63,
    "shaker": 70,
    "claves": 75,
}
"""Name of a drum -> its number in General MIDI."""
_KICK, _SNARE, _CRASH = (DRUMS[name] for name in ("kick", "snare", "crash"))
_TOMS = (50, 47, 45, 43)  # from the highest
_STROKE = 0.2  # quarters that a note of a drum lasts
_HITS = {"X": _ACCENT, "x": MEDIUM, "o": _LIGHT, ".": _GHOST}
_FILLS = ("xxxx", "x.xx", "xx..", "--xx")
_FILL_EVERY = 4  # bars after which there may be a fill; there is one at the end of a section
_FILLS_SHARE = 30  # [%] of those times


def drums(*patterns: Mapping[str, str]) -> Pattern:
    """Drums with one of these patterns, a crash where a section begins, and fills.

    A pattern has the steps of a bar for each drum, or of several bars with `|` between them: `X` is
    an accent, `x` a stroke, `o` a light one, `.` a ghost note, `-` nothing.
    """

    def play(passage: SongPassage) -> Iterator[Tone]:
        if passage.final:
            yield from (Tone(0, _STROKE, drum, _ACCENT) for drum in (_KICK, _CRASH))
            return
        pattern = pick(passage.rng, patterns)
        yield Tone(0, _STROKE, _CRASH, MEDIUM)
        for bar in range(passage.bars):
            last = bar == passage.bars - 1
            turn = (bar + 1) % _FILL_EVERY == 0 and happens(passage.rng, _FILLS_SHARE)
            until = passage.beats - 1 if last or turn else passage.beats
            start = bar * passage.beats
            for drum, steps in pattern.items():
                bars = steps.split("|")
                signs = bars[bar % len(bars)]
                for i, sign in enumerate(signs):
                    at = i * passage.beats / len(signs)
                    if sign in _HITS and at < until:
                        yield Tone(start + at, _STROKE, DRUMS[drum], _HITS[sign])
            if until < passage.beats:
                yield from _fill(passage, start + until)

    return play


def _fill(passage: SongPassage, start: float) -> Iterator[Tone]:
    """Yield a beat of strokes on snare and toms."""
    struck = pick(passage.rng, ((_SNARE,) * 4, (_SNARE, _SNARE, *_TOMS[1:3]), _TOMS))
    for i, (drum, sign) in enumerate(zip(struck, pick(passage.rng, _FILLS), strict=True)):
        if sign in _HITS:
            yield Tone(start + i / 4, _STROKE, drum, _HITS[sign])


# Chords

Rhythm = Sequence[tuple[float, float]]
"""Onset and length of notes, in quarters from the beginning of a bar."""
_SOFT = 64  # velocity off the beat

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
            velocity = MEDIUM if at % 1 == 0 else _SOFT
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
                yield Tone(at, length, pitch, _SOFT)

    return play


def picked(passage: SongPassage) -> Iterator[Tone]:
    """Yield broken chords of a guitar in eighths, which ring on until the chord changes."""
    for harmony in passage.harmonies:
        strings = guitar(harmony.chord)
        if passage.final:
            yield from (Tone(0, harmony.length, pitch) for pitch in strings)
            continue
        for i in range(int(2 * harmony.length)):
            place = min(_PICKED[i % len(_PICKED)], len(strings) - 1)
            at = i / 2
            yield Tone(harmony.at + at, min(2, harmony.length - at), strings[place], _SOFT)


def boom_chick(passage: SongPassage) -> Iterator[Tone]:
    """Yield a root on the beat and the upper strings after it, as a country guitar does."""
    for harmony in passage.harmonies:
        strings = guitar(harmony.chord)
        if passage.final:
            yield from (Tone(0, harmony.length, pitch) for pitch in strings)
            continue
        for beat in range(int(harmony.length)):
            if (harmony.at + beat) % passage.beats % 2 == 0 and (passage.beats == 4 or beat == 0):
                yield Tone(harmony.at + beat, 1, strings[0])
            else:
                yield from (Tone(harmony.at + beat, 0.5, p, _SOFT) for p in strings[2:])


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
            yield Tone(at, _STACCATO * length, pitch, MEDIUM if at % 1 == 0 else _SOFT)

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
                yield Tone(at, step, ladder[order[place]], MEDIUM if at % 1 == 0 else _SOFT)

    return play
