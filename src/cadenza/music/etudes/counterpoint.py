"""Counterpoint of two voices: first species, then two or four notes against one."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cadenza.music.etudes.harmony import (
    FORBIDDEN,
    STEPS,
    Costs,
    Form,
    Pitches,
    are_hidden,
    are_parallel,
    is_awkward_leap,
    is_consonant,
    is_perfect,
    random_costs,
)
from cadenza.music.etudes.sheet import PHRASE, EtudeSheet, Tone
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
    steps = [_pair_costs(low, high, *now, *then) for now, then in pairwise(pitches)]
    chosen = cheapest_sequence(costs, steps)
    return [_Pair(int(low[c]), int(high[c]), form) for c, form in zip(chosen, forms, strict=True)]


def _pitches(sheet: EtudeSheet, degrees: Pitches, form: Form) -> Pitches:
    return np.array([sheet.key.pitch(int(degree), form) for degree in degrees])


def _pair_costs(
    low: Pitches, high: Pitches, below: Pitches, above: Pitches, then_below: Pitches, then: Pitches
) -> Costs:
    """(n, n) costs of the motion from each pair of notes to each next, by degrees and pitches."""
    cost = _melodic_costs(low, below, then_below) + _melodic_costs(high, above, then)
    voices = below[:, None], above[:, None], then_below, then
    cost += _SIMILAR * ((then_below - below[:, None]) * (then - above[:, None]) > 0)
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
            then = pair if k + 1 < notes else phrase[min(i + 1, len(phrase) - 1)]
            steps.append(_florid_costs(sheet, degrees, upper, pair, then))
    chosen = cheapest_sequence(costs, steps[:-1])[:-1]
    return [
        sheet.key.pitch(int(degrees[c]), phrase[i // against].form) for i, c in enumerate(chosen)
    ]


def _florid_costs(
    sheet: EtudeSheet, degrees: Pitches, upper: bool, now: _Pair, then: _Pair
) -> Costs:
    """(n, n) costs of the motion from a note against that held in `now` to one against `then`'s."""
    pitches, will = _pitches(sheet, degrees, now.form), _pitches(sheet, degrees, then.form)
    held, held_then = (
        _pitches(sheet, np.array([pair.low if upper else pair.high]), pair.form)
        for pair in (now, then)
    )
    cost = _melodic_costs(degrees, pitches, will)
    by_step = np.abs(degrees - degrees[:, None]) == 1
    before, after = _sorted(held, pitches[:, None]), _sorted(held_then, will)
    free = is_consonant(*before) & is_consonant(*after)
    wrong = are_parallel(*before, *after) | ~(free | by_step)
    cost += _REPEATED * (pitches[:, None] == will)
    return np.where(wrong, FORBIDDEN, cost)


def _sorted(one: Pitches, many: Pitches) -> tuple[Pitches, Pitches]:
    return np.minimum(one, many), np.maximum(one, many)
