"""Melodies that can be sung: phrases with rests, mostly steps, chord tones on strong beats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cadenza.music.etudes.band.chords import (
    SongChord,
    SongPassage,
    happens,
    melody_scale,
    one_at_a_time,
)
from cadenza.music.etudes.band.styles import tables
from cadenza.music.etudes.harmony import FORBIDDEN, Costs, Pitches, random_costs
from cadenza.music.etudes.sheet import Tone, pick
from cadenza.music.score import OCTAVE
from cadenza.music.viterbi import cheapest_sequence

Rhythm = tuple[float, ...]
"""Onsets in quarters from the beginning of a bar."""
Phrase = tuple[tuple[float, float], ...]
"""Onset and length of the notes of a phrase, in quarters from its beginning."""

_ENDS: tuple[Rhythm, ...] = ((0,), (0, 1), (0, 0.5, 1), (0, 1.5), (0, 0.5), (0, 0.5, 1, 1.5))
"""Rhythms of the last bars of phrases, after whose last notes the singer breathes."""
_PICKUPS: tuple[Rhythm, ...] = ((), (), (-0.5,), (-1, -0.5), (-1,), (-1.5, -1, -0.5))
_PHRASE = 4  # bars
_FORMS = {1: ("a",), 2: ("a", "b"), 3: ("a", "a", "b"), 4: ("a", "b", "a", "c")}
"""Phrases of a section: the same letters have the same rhythm, and the same pitches if they can."""
_SAME_PHRASES = 40  # [%] of sections of two phrases in which the second is like the first
_BREATH = 1  # least rest at the end of a phrase, in quarters
_LAST_LENGTHS = (1, 1.5, 2, 2, 3)  # quarters of notes before a breath, at most
_LONGEST = 4  # quarters of a note within a phrase
_BREATHS_IN_MIDDLE = 60  # [%] of phrases of four bars

# Costs of a pitch.
_RANDOM = 70
_STRONG_DISSONANCE, _WEAK_DISSONANCE = 400, 15  # a note that is no chord tone
_CLASH = 80  # an important note a semitone above a chord tone, such as the root of a major seventh
_BLUE_NOTE = 40  # a note of the blues that is no chord tone on a strong beat
_OFF_TARGET = 6  # a semitone away from the line that the phrase follows
_ROUGH = 3  # semitones by which that line goes up and down at random, at most
_OFF_MODEL, _FAR_OFF_MODEL = 30, 150  # a semitone away from an earlier phrase, and the most
_NO_TONIC = 200  # the last note of a section over the tonic is another tone
_NOT_BY_STEP = 120  # a leap to or from a note that is no chord tone
_NEW_PHRASE = 3  # by which leaps are cheaper between phrases
_LONG = 1.5  # quarters from which a note is as important as one on a strong beat
_SONG_STEP = 2  # [semitones]
_SECOND_VOICE = (4, 3, 5, 2, 6, 7)  # semitones from the melody, the first that fits is taken
_RUN = 0.5  # quarters of the notes of an answer
_MIN_ANSWERED = 2  # quarters of a rest
_SAME_TIME = 0.5  # quarters by which a note on a weak beat may anticipate a chord
_INTERVALS = np.array([8, 6, 2, 12, 20, 30, 250, 48, 120, 110, 250, 350, 100])
"""Costs by semitones: steps are cheapest, then repeated notes; tritones and sevenths are rare."""


@dataclass(frozen=True)
class Singing:
    """How a melody is sung or played: its range, the rhythms of its bars, and its scale."""

    low: int
    high: int
    cells: str
    colour: str


@dataclass(frozen=True)
class _Slot:
    """A note of a phrase that has no pitch yet, in quarters from the section."""

    at: float
    length: float
    strong: bool

    def chord(self, passage: SongPassage) -> SongChord:
        """The chord to which it belongs: that which it anticipates, if it is held into it."""
        held = self.length > _SAME_TIME and self.at % 1 == _SAME_TIME
        return passage.chord(self.at + _SAME_TIME if held else self.at)


def melody(
    passage: SongPassage, singing: Singing, pickups: bool, before: int | None = None
) -> list[Tone]:
    """The melody of a section, one note at a time, by a player whose last pitch was `before`.

    With `pickups`, phrases may begin before their first bars; the first of the section, too.
    """
    rng = passage.rng
    count = max(passage.bars // _PHRASE, 1)
    form = _FORMS[count]
    if count == 2 and happens(rng, _SAME_PHRASES):
        form = ("a", "a")
    bars = passage.bars // count
    pickup = pick(rng, [p for p in _PICKUPS if passage.beats + min(p, default=0) > 2 * _BREATH])
    pickup = pickup if pickups else ()
    known: dict[str, tuple[Phrase, list[int]]] = {}
    tones: list[Tone] = []
    for i, letter in enumerate(form):
        rhythm, model = known.get(letter) or (_phrase_rhythm(passage, singing, bars, pickup), [])
        slots = _slots(rhythm, i * bars * passage.beats, passage.beats)
        pitches = _pitches(passage, singing, slots, model, before, last=i == count - 1)
        known.setdefault(letter, (rhythm, pitches))
        before = pitches[-1]
        tones += [
            Tone(slot.at, slot.length, pitch) for slot, pitch in zip(slots, pitches, strict=True)
        ]
    return one_at_a_time(tones)


def _phrase_rhythm(passage: SongPassage, singing: Singing, bars: int, pickup: Rhythm) -> Phrase:
    """The rhythm of a phrase, whose second half often is like the first, after a breath."""
    rng, beats = passage.rng, passage.beats
    until = beats - _BREATH + min(pickup, default=0)  # so that there is time before the next one
    ends = [end for end in _ENDS if end[-1] < until]
    known: list[Rhythm] = tables()["cells"][singing.cells]
    first, second = pick(rng, known), pick(rng, known)
    cells = [*(first, second, first, second)[: bars - 1], pick(rng, ends)]
    ending_bars = [bars - 1]
    if bars >= _PHRASE and happens(rng, _BREATHS_IN_MIDDLE):
        cells[1] = pick(rng, ends)
        ending_bars.append(1)
    onsets = [*pickup, *(bar * beats + at for bar, cell in enumerate(cells) for at in cell)]
    lengths = {at: min(after - at, _LONGEST) for at, after in pairwise([*onsets, bars * beats])}
    for bar in ending_bars:
        at = cells[bar][-1]
        lengths[bar * beats + at] = min(pick(rng, _LAST_LENGTHS), until - at)
    return tuple(lengths.items())


def _slots(phrase: Phrase, start: float, beats: int) -> list[_Slot]:
    """The notes of a phrase that begins at `start`."""
    strong = (0, 2) if beats == 4 else (0,)
    return [
        _Slot(start + at, length, at % beats in strong or length >= _LONG) for at, length in phrase
    ]


def _pitches(
    passage: SongPassage,
    singing: Singing,
    slots: Sequence[_Slot],
    model: Sequence[int],
    before: int | None,
    last: bool,
) -> list[int]:
    """Pitches of a phrase after the pitch `before`, if any.

    It resembles the pitches of an earlier one, its `model`, if there is one; the `last` phrase of a
    section may end in another way.
    """
    candidates = [_candidates(passage, singing, slot) for slot in slots]
    targets = _line(passage.rng, singing, len(slots))
    costs = []
    for slot, pitches, target in zip(slots, candidates, targets, strict=True):
        cost = random_costs(passage.rng, len(pitches), _RANDOM)
        cost += _OFF_TARGET * np.abs(pitches - target)
        costs.append(cost + _dissonance(passage, singing, slot, pitches))
    for i, pitch in enumerate(model[:-1] if last else model):
        costs[i] += np.minimum(_OFF_MODEL * np.abs(candidates[i] - pitch), _FAR_OFF_MODEL)
    if last:
        costs[-1] += _NO_TONIC * ((candidates[-1] - passage.key.pitch(0)) % OCTAVE != 0)
    if before is not None:
        costs[0] += _interval_costs(candidates[0] - before) // _NEW_PHRASE
    belongs = [_in_chord(slot.chord(passage), p) for slot, p in zip(slots, candidates, strict=True)]
    steps = [
        _moves(candidates[i], candidates[i + 1], belongs[i], belongs[i + 1])
        for i in range(len(slots) - 1)
    ]
    chosen = cheapest_sequence(costs, steps)
    return [int(pitches[i]) for pitches, i in zip(candidates, chosen, strict=True)]


def _candidates(passage: SongPassage, singing: Singing, slot: _Slot) -> Pitches:
    scale = melody_scale(passage.key, slot.chord(passage), singing.colour)
    pitches = np.arange(singing.low, singing.high + 1)
    return pitches[np.isin(pitches % OCTAVE, list(scale))]


def _in_chord(chord: SongChord, pitches: Pitches) -> NDArray[np.bool_]:
    return np.isin(pitches % OCTAVE, chord.classes)


def _dissonance(passage: SongPassage, singing: Singing, slot: _Slot, pitches: Pitches) -> Costs:
    """Costs of pitches that are no chord tones, at the note or at a chord within its time."""
    important = _BLUE_NOTE if singing.colour == "blues" else _STRONG_DISSONANCE
    total = np.zeros(len(pitches), np.int64)
    for chord in {slot.chord(passage), passage.chord(slot.at + slot.length - _SAME_TIME)}:
        total += (important if slot.strong else _WEAK_DISSONANCE) * ~_in_chord(chord, pitches)
        total += _CLASH * slot.strong * _in_chord(chord, pitches - 1)
    return total


def _line(rng: np.random.Generator, singing: Singing, count: int) -> list[int]:
    """The line that a phrase follows: an arch, a rise, or a fall, within the range."""
    span = singing.high - singing.low
    low = singing.low + span // 4
    rise = int(rng.integers(span // 4, span // 2, endpoint=True))
    shape = int(rng.integers(4))
    heights = []
    for i in range(count):
        up, down = rise * i // count, rise * (count - i) // count
        height = (2 * min(up, down), up, down, 2 * min(up, down))[shape]
        heights.append(low + height + int(rng.integers(-_ROUGH, _ROUGH, endpoint=True)))
    return heights


def _interval_costs(semitones: Pitches) -> Costs:
    size = np.abs(semitones)
    return np.where(size <= OCTAVE, _INTERVALS[np.minimum(size, OCTAVE)], FORBIDDEN)


def _moves(
    before: Pitches, after: Pitches, belonged: NDArray[np.bool_], belongs: NDArray[np.bool_]
) -> Costs:
    """(n, n') costs of the intervals from each pitch to each next; whether they are chord tones."""
    semitones = after - before[:, None]
    dissonant = (~belonged).astype(int)[:, None] + ~belongs
    return _interval_costs(semitones) + _NOT_BY_STEP * (np.abs(semitones) > _SONG_STEP) * dissonant


def second_voice(passage: SongPassage, tones: Sequence[Tone], above: bool, low: int) -> list[Tone]:
    """A voice a third or so above or below a melody, which is silent where it would be below `low`.

    Its long notes are tones of the chord.
    """
    side = 1 if above else -1
    found = []
    for tone in tones:
        chord = passage.chord(tone.at)
        scale = melody_scale(passage.key, chord, "scale")
        wanted = chord.classes if tone.length >= 1 else scale
        near = (tone.pitch + side * interval for interval in (*_SECOND_VOICE, OCTAVE))
        pitch = next((p for p in near if p % OCTAVE in wanted), tone.pitch + side * OCTAVE)
        if pitch >= low:
            found.append(Tone(tone.at, tone.length, pitch))
    return found


def answers(passage: SongPassage, tones: Sequence[Tone], singing: Singing) -> Iterator[Tone]:
    """Yield short runs of another instrument in the rests of a melody."""
    rests = [(a.at + a.length, b.at) for a, b in pairwise(tones)]
    rests.append((tones[-1].at + tones[-1].length, passage.length))
    for begin, end in rests:
        onsets = np.arange(np.ceil(begin / _RUN) * _RUN + _RUN, end, _RUN).tolist()
        if onsets and end - begin >= _MIN_ANSWERED:
            slots = [_Slot(at, _RUN, strong=at == onsets[0]) for at in onsets]
            pitches = _pitches(passage, singing, slots, [], None, last=False)
            yield from (Tone(s.at, s.length, p) for s, p in zip(slots, pitches, strict=True))
