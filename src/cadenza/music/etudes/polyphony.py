"""Etudes in several voices: counterpoint of two, and chorales of two to four, in strict writing."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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
    Form,
    Pitches,
    Triad,
    are_hidden,
    are_parallel,
    is_awkward_leap,
    is_consonant,
    is_perfect,
    progression,
    random_costs,
)
from cadenza.music.etudes.sheet import PHRASE, EtudeSheet, Tone, pick
from cadenza.music.score import OCTAVE
from cadenza.music.viterbi import cheapest_sequence

_RANGE = np.arange(-3, 6)  # degrees around the tonics on which both voices end
_LOW, _HIGH = _RANGE - STEPS, STEPS - _RANGE[::-1]
_INTERVAL_COSTS = np.array([60, 0, 15, 40, 80])  # by degrees: seconds are cheapest
_SIMILAR = 40  # cost of both voices moving in one direction
_REPEATED = 500  # cost of a repeated note in the faster voice
_RANDOM = 100  # largest random cost of a note
_FIRST_SPECIES, _SECOND_SPECIES = 3, 6  # difficulties up to which there are 1 and 2 notes against 1


@dataclass(frozen=True)
class _Pair:
    """A note of each voice, as degrees, and the minor scale that they are of."""

    low: int
    high: int
    form: Form


def counterpoint(sheet: EtudeSheet) -> Iterator[Tone]:
    """Yield two voices, which take turns to be the faster one in the second and third species."""
    easy, moderate = (sheet.difficulty <= at_most for at_most in (_FIRST_SPECIES, _SECOND_SPECIES))
    against = 1 if easy else 2 if moderate else 4
    per_phrase = PHRASE * sheet.bar // against
    pairs = _first_species(sheet, (sheet.length - sheet.bar) // against + 1, per_phrase)
    *moving, last = pairs
    yield Tone(sheet.length - sheet.bar, sheet.bar, sheet.key.pitch(last.low, last.form))
    yield Tone(sheet.length - sheet.bar, sheet.bar, sheet.key.pitch(last.high, last.form))
    for first in range(0, len(moving), per_phrase):
        phrase = pairs[first : first + per_phrase + 1]
        at = first * against
        upper = (first // per_phrase) % 2 == 0
        for i, pair in enumerate(phrase[:-1]):
            held = pair.low if upper else pair.high
            yield Tone(at + i * against, against, sheet.key.pitch(held, pair.form))
        for i, pitch in enumerate(_florid(sheet, phrase, upper, against)):
            yield Tone(at + i, 1, pitch)


def _first_species(sheet: EtudeSheet, count: int, per_phrase: int) -> list[_Pair]:
    """The pairs of first species, note against note, on which the faster voice is built."""
    low, high = (grid.ravel() for grid in np.meshgrid(_LOW, _HIGH, indexing="ij"))
    forms: list[Form] = ["natural"] * count
    forms[-2] = "melodic"
    pitches = [(_pitches(sheet, low, form), _pitches(sheet, high, form)) for form in forms]
    costs = []
    for i, (below, above) in enumerate(pitches):
        cost = random_costs(sheet.rng, len(low), _RANDOM)
        cost[~is_consonant(below, above)] = FORBIDDEN
        if (i + 1) % per_phrase == 0:  # phrases end with an open sound
            cost[~is_perfect(below, above)] = FORBIDDEN
        costs.append(cost)
    tonic = low == -STEPS
    costs[0][~(tonic & np.isin(high, (4, STEPS)))] = FORBIDDEN
    into = (low == 1 - STEPS) & (high == STEPS - 1) | (low == -1 - STEPS) & (high == STEPS + 1)
    costs[-2][~into] = FORBIDDEN
    costs[-1][~(tonic & (high == STEPS))] = FORBIDDEN
    steps = [_pair_costs(low, high, *pair, *following) for pair, following in pairwise(pitches)]
    chosen = cheapest_sequence(costs, steps)
    return [_Pair(int(low[c]), int(high[c]), form) for c, form in zip(chosen, forms, strict=True)]


def _pitches(sheet: EtudeSheet, degrees: Pitches, form: Form) -> Pitches:
    return np.array([sheet.key.pitch(int(degree), form) for degree in degrees])


def _pair_costs(
    low: Pitches,
    high: Pitches,
    below: Pitches,
    above: Pitches,
    next_below: Pitches,
    next_above: Pitches,
) -> Costs:
    """(n, n) costs of the motion from each pair of notes to each next, by degrees and pitches."""
    cost = _melodic_costs(low, below, next_below) + _melodic_costs(high, above, next_above)
    voices = below[:, None], above[:, None], next_below, next_above
    cost += _SIMILAR * ((next_below - below[:, None]) * (next_above - above[:, None]) > 0)
    wrong = are_parallel(*voices) | are_hidden(*voices)
    wrong |= (low[:, None] == low) & (high[:, None] == high)
    return np.where(wrong, FORBIDDEN, cost)


def _melodic_costs(degrees: Pitches, pitches: Pitches, then: Pitches) -> Costs:
    """(n, n) costs of the intervals of one voice."""
    moved = degrees - degrees[:, None]
    interval = np.abs(moved)
    cost = _INTERVAL_COSTS[np.minimum(interval, len(_INTERVAL_COSTS) - 1)]
    wrong = (interval >= len(_INTERVAL_COSTS)) | is_awkward_leap(moved, then - pitches[:, None])
    return np.where(wrong, FORBIDDEN, cost)


def _florid(sheet: EtudeSheet, phrase: Sequence[_Pair], upper: bool, against: int) -> list[int]:
    """The pitches of the faster voice up to the last pair, which begins what follows."""
    degrees = _HIGH if upper else _LOW
    costs, steps = [], []
    for i, pair in enumerate(phrase):
        notes = against if pair is not phrase[-1] else 1
        for k in range(notes):
            cost = random_costs(sheet.rng, len(degrees), _RANDOM)
            if k == 0:
                cost[degrees != (pair.high if upper else pair.low)] = FORBIDDEN
            costs.append(cost)
            next_pair = pair if k + 1 < notes else phrase[min(i + 1, len(phrase) - 1)]
            steps.append(_florid_costs(sheet, degrees, upper, pair, next_pair))
    chosen = cheapest_sequence(costs, steps[:-1])[:-1]
    return [
        sheet.key.pitch(int(degrees[c]), phrase[i // against].form) for i, c in enumerate(chosen)
    ]


def _florid_costs(
    sheet: EtudeSheet, degrees: Pitches, upper: bool, now: _Pair, next_pair: _Pair
) -> Costs:
    """Costs (n, n) from a note against the held one of `now` to the next against `next_pair`'s."""
    pitches = _pitches(sheet, degrees, now.form)
    next_pitches = _pitches(sheet, degrees, next_pair.form)
    held, next_held = (
        _pitches(sheet, np.array([pair.low if upper else pair.high]), pair.form)
        for pair in (now, next_pair)
    )
    cost = _melodic_costs(degrees, pitches, next_pitches)
    by_step = np.abs(degrees - degrees[:, None]) == 1
    before, after = _sorted(held, pitches[:, None]), _sorted(next_held, next_pitches)
    free = is_consonant(*before) & is_consonant(*after)
    wrong = are_parallel(*before, *after) | ~(free | by_step)
    cost += _REPEATED * (pitches[:, None] == next_pitches)
    return np.where(wrong, FORBIDDEN, cost)


def _sorted(one: Pitches, many: Pitches) -> tuple[Pitches, Pitches]:
    return np.minimum(one, many), np.maximum(one, many)


# Chorales

_RANGES = {"bass": (38, 57), "tenor": (48, 62), "alto": (58, 72), "soprano": (62, 79)}
_VOICES = (("bass", "soprano"), ("bass", "alto", "soprano"), tuple(_RANGES))
_PHRASE = 7  # chords of a phrase of eight beats; the last chord lasts two
_WIDEST = OCTAVE + 7  # [semitones] between the bass and the alto, which the other hand plays
# Costs of voicings and of voice leading
_DOUBLED_THIRD, _INVERSION, _NO_FIFTH, _HIDDEN, _NOT_RESOLVED = 40, 30, 60, 60, 80
_SOPRANO_STAYS = 50
_LEAP = 12  # per semitone beyond a second
_OFF_TARGET = 8  # per semitone between the soprano and its random target
_RANDOM_VOICING = 60  # largest random cost of a voicing
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
    chosen = cheapest_sequence([choice.costs for choice in choices], steps)
    degrees = [choice.degrees[c] for choice, c in zip(choices, chosen, strict=True)]
    pitches = [choice.pitches[c] for choice, c in zip(choices, chosen, strict=True)]
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
    costs = random_costs(sheet.rng, len(p), _RANDOM_VOICING)
    low, high = _RANGES["soprano"]
    costs += _OFF_TARGET * np.abs(p[:, -1] - pick(sheet.rng, range(low, high)))
    costs += _DOUBLED_THIRD * ((tones == 2).sum(axis=1) > 1)
    costs += _INVERSION * (tones[:, 0] != 0)
    costs += _NO_FIFTH * ~(tones == 4).any(axis=1)
    return _Voicings(d[good], p[good], costs[good])


def _is_complete(tones: Pitches) -> NDArray[np.bool_]:
    """Whether three voices have a third, and four the triad; `tones` (n, v) above the root."""
    steps = {2: [], 3: [2], 4: [0, 2, 4]}[tones.shape[1]]
    return (tones[..., None] == np.array(steps, int)).any(axis=1).all(axis=1)


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
        passing_chord = pitches[0].copy()
        passing_chord[voice] = sheet.pitch(int(degrees[0][voice] + moved[voice] // 2), chord)
        pairs = list(combinations(range(len(passing_chord)), 2))
        faults = (
            are_parallel(passing_chord[low], passing_chord[high], pitches[1][low], pitches[1][high])
            for low, high in pairs
        )
        gaps = np.diff(passing_chord)
        if (gaps > 0).all() and (gaps <= OCTAVE).all() and not any(faults):
            return voice, int(passing_chord[voice])
    return None
