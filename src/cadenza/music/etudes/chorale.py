"""Chorales: chords in two to four voices, led by the rules of strict writing."""

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.music.etudes.harmony import (
    FORBIDDEN,
    LEADING,
    STEPS,
    TONIC,
    Costs,
    Pitches,
    Triad,
    are_hidden,
    are_parallel,
    is_awkward_leap,
    progression,
    random_costs,
)
from cadenza.music.etudes.sheet import EtudeSheet, Tone, pick
from cadenza.music.score import OCTAVE
from cadenza.music.viterbi import cheapest_sequence

_RANGES = {"bass": (38, 57), "tenor": (48, 62), "alto": (58, 72), "soprano": (62, 79)}
_VOICES = (("bass", "soprano"), ("bass", "alto", "soprano"), tuple(_RANGES))
_PHRASE = 7  # chords of a phrase of eight beats; the last chord lasts two
_WIDEST = OCTAVE + 7  # [semitones] between the bass and the alto, which the other hand plays
# Costs of voicings and of voice leading
_DOUBLED_THIRD, _INVERSION, _NO_FIFTH, _HIDDEN, _NOT_RESOLVED = 40, 30, 60, 60, 80
_SOPRANO_STAYS = 50
_LEAP = 12  # per semitone beyond a second
_OFF_TARGET = 8  # per semitone between the soprano and its random target
_RANDOM = 60  # largest random cost of a voicing
_SECOND, _MAX_LEAP = 2, 7  # [semitones]; the bass may leap by more, up to an octave
_TWO_VOICES, _THREE_VOICES = 2, 4  # difficulties up to which there are 2 and 3 voices
_PASSING_NOTES = 7  # difficulty from which thirds are filled


class _Voicings(NamedTuple):
    """The n voicings of a chord in v voices, from the bass: (n, v) degrees and pitches."""

    degrees: Pitches
    pitches: Pitches
    costs: Costs


def chorale(sheet: EtudeSheet) -> Iterator[Tone]:
    """Yield phrases of eight beats; harder etudes fill thirds with passing notes."""
    names = _VOICES[(sheet.difficulty > _TWO_VOICES) + (sheet.difficulty > _THREE_VOICES)]
    beats = sheet.bars * sheet.beats
    chords = progression(sheet.rng, beats // (_PHRASE + 1), _PHRASE)
    choices = [
        _voicings(sheet, chord, names, ends=i % _PHRASE >= _PHRASE - 2)
        for i, chord in enumerate(chords)
    ]
    steps = [_voice_leading_costs(before, after) for before, after in pairwise(choices)]
    chosen = cheapest_sequence([each.costs for each in choices], steps)
    degrees = [each.degrees[c] for each, c in zip(choices, chosen, strict=True)]
    pitches = [each.pitches[c] for each, c in zip(choices, chosen, strict=True)]
    for i, chord in enumerate(chords):
        phrase, place = divmod(i, _PHRASE)
        at = (phrase * (_PHRASE + 1) + place) * sheet.division
        length = sheet.division * (2 if place == _PHRASE - 1 else 1)
        passing = None
        if sheet.difficulty >= _PASSING_NOTES and place < _PHRASE - 1:
            passing = _passing(sheet, chord, degrees[i : i + 2], pitches[i : i + 2])
        for voice, pitch in enumerate(pitches[i].tolist()):
            if passing and passing[0] == voice:
                yield Tone(at, length / 2, pitch)
                yield Tone(at + length / 2, length / 2, passing[1])
            else:
                yield Tone(at, length, pitch)


def _voicings(sheet: EtudeSheet, chord: Triad, names: Sequence[str], ends: bool) -> _Voicings:
    """The voicings of a chord that keep the rules, in root position if it `ends` a phrase."""
    degrees = np.arange(-3 * STEPS, 3 * STEPS)
    pitches = np.array([sheet.pitch(int(degree), chord) for degree in degrees])
    belongs = np.array([chord.has(int(degree)) for degree in degrees])
    in_range = [
        (belongs & (pitches >= low) & (pitches <= high)).nonzero()[0].tolist()
        for low, high in (_RANGES[name] for name in names)
    ]
    voicings = np.array(list(product(*in_range)))
    p, d = pitches[voicings], degrees[voicings]
    tones = (d - chord.root) % STEPS  # 0 the root, 2 the third, 4 the fifth
    good = _is_complete(tones) & _is_close(p) & (tones[:, 0] != 4)
    good &= (d % STEPS == LEADING).sum(axis=1) <= 1
    if _is_diminished(sheet, chord):
        good &= tones[:, 0] == 2
    elif ends:
        good &= tones[:, 0] == 0
    costs = random_costs(sheet.rng, len(p), _RANDOM)
    low, high = _RANGES["soprano"]
    costs += _OFF_TARGET * np.abs(p[:, -1] - pick(sheet.rng, range(low, high)))
    costs += _DOUBLED_THIRD * ((tones == 2).sum(axis=1) > 1)
    costs += _INVERSION * (tones[:, 0] != 0)
    costs += _NO_FIFTH * ~(tones == 4).any(axis=1)
    return _Voicings(d[good], p[good], costs[good])


def _is_complete(tones: Pitches) -> NDArray[np.bool_]:
    """Whether three voices have a third, and four the triad; `tones` (n, v) above the root."""
    wanted = {2: [], 3: [2], 4: [0, 2, 4]}[tones.shape[1]]
    return (tones[..., None] == np.array(wanted, int)).any(axis=1).all(axis=1)


def _is_close(pitches: Pitches) -> NDArray[np.bool_]:
    """(n,) whether voices do not cross, and those of one hand lie within an octave."""
    gaps = np.diff(pitches, axis=1)
    below = {2: 3 * OCTAVE, 3: _WIDEST, 4: OCTAVE}[pitches.shape[1]]
    return (gaps > 0).all(axis=1) & (gaps[:, 0] <= below) & (gaps[:, 1:] <= OCTAVE).all(axis=1)


def _is_diminished(sheet: EtudeSheet, chord: Triad) -> bool:
    root, fifth = (sheet.pitch(chord.tone(i), chord) for i in (0, 2))
    return fifth - root == OCTAVE // 2


def _voice_leading_costs(before: _Voicings, after: _Voicings) -> Costs:
    """(n, n') costs of the voice leading from each voicing to each of the next."""
    old, new = before.pitches[:, None], after.pitches
    moved = new - old
    leap = np.abs(moved)
    cost = _LEAP * np.maximum(leap[..., 1:] - _SECOND, 0).sum(axis=-1)  # the bass may leap
    cost += _SOPRANO_STAYS * (moved[..., -1] == 0)
    degrees = after.degrees - before.degrees[:, None]
    wrong = is_awkward_leap(degrees, moved).any(axis=-1) | (leap > OCTAVE).any(axis=-1)
    wrong |= (leap[..., 1:] > _MAX_LEAP).any(axis=-1)
    for low, high in combinations(range(old.shape[-1]), 2):
        voices = old[..., low], old[..., high], new[..., low], new[..., high]
        wrong |= are_parallel(*voices)
        if high == low + 1:  # a voice passes where the one beside it was
            wrong |= (voices[2] > voices[1]) | (voices[3] < voices[0])
    outer = old[..., 0], old[..., -1], new[..., 0], new[..., -1]
    cost += _HIDDEN * (are_hidden(*outer) & (leap[..., -1] > _SECOND))
    unresolved = (before.degrees % STEPS == LEADING)[:, None] & (moved != 1)
    tonic = (after.degrees % STEPS == TONIC).any(axis=-1)
    cost += _NOT_RESOLVED * unresolved.any(axis=-1) * tonic
    return np.where(wrong, FORBIDDEN, cost)


def _passing(
    sheet: EtudeSheet, chord: Triad, degrees: Sequence[Pitches], pitches: Sequence[Pitches]
) -> tuple[int, int] | None:
    """A voice that moves by a third, and the passing note between, if no rule forbids it."""
    moved = degrees[1] - degrees[0]
    for voice in reversed((np.abs(moved) == 2).nonzero()[0].tolist()):
        between = pitches[0].copy()
        between[voice] = sheet.pitch(int(degrees[0][voice] + moved[voice] // 2), chord)
        pairs = list(combinations(range(len(between)), 2))
        faults = (
            are_parallel(between[low], between[high], pitches[1][low], pitches[1][high])
            for low, high in pairs
        )
        gaps = np.diff(between)
        if (gaps > 0).all() and (gaps <= OCTAVE).all() and not any(faults):
            return voice, int(between[voice])
    return None
