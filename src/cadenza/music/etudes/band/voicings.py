"""Voicings of chords as instruments have them: frets of a guitar, voices that move little."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations, pairwise, product

import numpy as np
from numpy.typing import NDArray

from cadenza.music.etudes.band.chords import SongChord
from cadenza.music.etudes.harmony import Costs, are_parallel
from cadenza.music.score import OCTAVE
from cadenza.music.viterbi import cheapest_sequence

Voicing = tuple[int, ...]
"""MIDI pitches from the lowest."""
Slots = tuple[tuple[int, int], ...]
"""The lowest and highest MIDI pitch of each voice."""
_STRINGS = (40, 45, 50, 55, 59, 64)  # E2 A2 D3 G3 B3 E4
_OPEN_ROOTS = {0: 1, 2: 2, 4: 0, 7: 0, 9: 1}  # roots of open chords -> their lowest string
_OPEN_FRETS, _SPAN = 3, 3  # the highest fret of open chords; frets from a barre to the last finger
_MAX_BARRE = 7  # the highest fret of a barre on the lowest string; higher ones go to the next
# Costs of voicings.
_MOVE = 10  # a semitone that a voice moves
_PARALLEL = 60  # parallel fifths or octaves of two voices
_INVERTED = 40  # the lowest voice has not the bass of the chord
_NO_SEVENTH = 30  # a voicing without the chord's last tone


def guitar(chord: SongChord) -> Voicing:
    """The pitches of a strummed chord: open where there is an open one, else with a barre."""
    if chord.root in _OPEN_ROOTS:
        return _fretted(chord, _OPEN_ROOTS[chord.root], 0, _OPEN_FRETS)
    string = 0 if (chord.root - _STRINGS[0]) % OCTAVE <= _MAX_BARRE else 1
    fret = (chord.root - _STRINGS[string]) % OCTAVE
    return _fretted(chord, string, fret, fret + _SPAN)


def _fretted(chord: SongChord, string: int, low: int, high: int) -> Voicing:
    """The root on a string, and on each above it the first tone of the chord from fret `low` on."""
    root = _STRINGS[string] + (chord.root - _STRINGS[string]) % OCTAVE
    pitches = [root]
    for tuned in _STRINGS[string + 1 :]:
        pitches += [tuned + fret for fret in range(low, high + 1) if chord.has(tuned + fret)][:1]
    return tuple(pitches)


def power_chord(chord: SongChord) -> Voicing:
    """Root, fifth and octave on the low strings of a guitar."""
    root = _STRINGS[0] + (chord.root - _STRINGS[0]) % OCTAVE
    return root, root + (chord.fifth - chord.root) % OCTAVE, root + OCTAVE


@lru_cache(maxsize=256)
def led_voicings(chords: tuple[SongChord, ...], slots: Slots) -> tuple[Voicing, ...]:
    """Voicings of successive chords whose voices move little, without parallels where possible."""
    candidates = [_candidates(chord, slots) for chord in chords]
    costs = [_costs(chord, pitches) for chord, pitches in zip(chords, candidates, strict=True)]
    steps = [_steps(before, after) for before, after in pairwise(candidates)]
    chosen = cheapest_sequence(costs, steps)
    return tuple(tuple(pitches[i].tolist()) for pitches, i in zip(candidates, chosen, strict=True))


def _candidates(chord: SongChord, slots: Slots) -> NDArray[np.int64]:
    """(n, voices) rising voicings with the third, if any has it."""
    voices = [[p for p in range(low, high + 1) if chord.has(p)] for low, high in slots]
    rising = np.array([v for v in product(*voices) if all(a < b for a, b in pairwise(v))])
    with_third = (rising % OCTAVE == chord.third).any(axis=1)
    return rising[with_third] if with_third.any() else rising


def _costs(chord: SongChord, pitches: NDArray[np.int64]) -> Costs:
    classes = pitches % OCTAVE
    missing = ~(classes == chord.classes[-1]).any(axis=1)
    return _INVERTED * (classes[:, 0] != chord.bass) + _NO_SEVENTH * missing


def _steps(before: NDArray[np.int64], after: NDArray[np.int64]) -> Costs:
    old, new = before[:, None], after[None]
    cost: Costs = _MOVE * np.abs(new - old).sum(axis=-1)
    for i, j in combinations(range(before.shape[1]), 2):
        cost += _PARALLEL * are_parallel(old[..., i], old[..., j], new[..., i], new[..., j])
    return cost


def nearest(classes: Sequence[int], pitch: int) -> int:
    """The pitch nearest to `pitch` among those of these pitch classes, the lower of two."""
    return min(
        (p for p in range(pitch - OCTAVE // 2, pitch + OCTAVE // 2 + 1) if p % OCTAVE in classes),
        key=lambda p: (abs(p - pitch), p),
    )
