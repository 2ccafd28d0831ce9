"""Marks and words that change how fast the music goes, and the time of each place in it."""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from fractions import Fraction
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.music.signs import (
    ACCELERANDO,
    CAESURA,
    FERMATA,
    MENO_MOSSO,
    OPEN_RAMP,
    PIU_MOSSO,
    RITARDANDO,
)

Floats = NDArray[np.float64]

MAX_SEGMENTS = 100_000  # more, with all repeats, are taken for damage
_SLOWEST, _FASTEST = 60.0, 0.006  # [s] a quarter lasts at most and at least, however it changes
_SECONDS_PER_QUARTER = 0.5  # until the score says otherwise, as in MIDI
_AT_BARLINE = Fraction(1)  # [quarters]: over a barline, a fermata is as long as over a quarter


@dataclass(frozen=True, slots=True)
class Tempo:
    """A tempo mark: a quarter lasts `seconds` [s] from an `onset` on."""

    onset: Fraction
    seconds: float


class TempoChange(Enum):
    """A change of tempo in words."""

    RITARDANDO = auto()  # slower little by little: rit., rall., allargando, and the like
    ACCELERANDO = auto()  # faster little by little: accel., stringendo
    MENO_MOSSO = auto()  # slower at once: meno mosso, ritenuto
    PIU_MOSSO = auto()  # faster at once
    A_TEMPO = auto()  # the tempo before the last change
    TEMPO_PRIMO = auto()  # the tempo at the beginning


@dataclass(frozen=True, slots=True)
class TempoWord:
    """The tempo changes at `onset`.

    One that changes little by little goes on until `end`, if the score says how far it goes, as a
    line does; else up to the next mark of a tempo.
    """

    onset: Fraction
    change: TempoChange
    end: Fraction | None = None


@dataclass(frozen=True, slots=True)
class Modulation:
    """A metric modulation: a quarter lasts `slower` times as long from `onset` on as before."""

    onset: Fraction
    slower: Fraction


@dataclass(frozen=True, slots=True)
class Fermata:
    """A fermata over a note, a chord or a rest from `onset` to `end`: all parts wait.

    The note is `factor` times as long. One over a barline has its onset at its end.
    """

    onset: Fraction
    end: Fraction
    factor: float = FERMATA


@dataclass(frozen=True, slots=True)
class Caesura:
    """Two strokes at `onset`: what sounds ends there, and all parts pause."""

    onset: Fraction


TempoMark = Tempo | TempoWord | Modulation | Fermata | Caesura


def says_tempo(mark: TempoMark) -> bool:
    """Whether a mark gives a tempo, and not a way to play: a change by degrees, or a wait."""
    if isinstance(mark, TempoWord):
        return mark.change is TempoChange.TEMPO_PRIMO
    return isinstance(mark, Tempo | Modulation)


@dataclass(frozen=True, slots=True)
class Swing:
    """Two notes of a `unit` last as `first : second` from an `onset` on.

    The unit is in quarters: 1/2 for eighths, 1/4 for sixteenths. With 1 : 1 notes are straight.
    `beat` is any place where the first of two may stand, such as the beginning of a full bar.
    """

    onset: Fraction
    first: int = 2
    second: int = 1
    unit: Fraction = Fraction(1, 2)
    beat: Fraction = Fraction(0)


@dataclass(frozen=True, slots=True)
class TempoSegment:
    """A segment of a tempo map, in which the length of a quarter is linear.

    It begins at `place` [quarters] and at `time` [s], when all waiting there is over. A quarter at
    its beginning lasts `seconds` [s], and `slope` [s per quarter] more for each quarter since.
    Before it all is silent for `silence` [s].
    """

    place: Fraction
    seconds: float
    slope: float = 0.0
    time: float = 0.0
    silence: float = 0.0


class TempoMap:
    """Time as a function of places in the music, by segments in their order, one or more."""

    def __init__(self, segments: Sequence[TempoSegment]) -> None:
        self.segments = tuple(segments)
        self._places = [segment.place for segment in segments]
        self._quarter = np.array([float(place) for place in self._places])
        self._time = np.array([segment.time for segment in segments])
        self._seconds = np.array([segment.seconds for segment in segments])
        self._slope = np.array([segment.slope for segment in segments])
        self._silence = np.array([segment.silence for segment in segments])

    @classmethod
    def of(cls, marks: Iterable[TempoMark], end: Fraction | None = None) -> TempoMap:
        """The map of a score by its marks, in any order, up to its `end` [quarters].

        A `Tempo` overrules a word at the same place that means it. Fermatas that sound together are
        one. A gradual change whose end the score does not show goes on up to the next mark of a
        tempo, or for `OPEN_RAMP` quarters, after which it is forgotten.
        """
        marks = list(marks)
        flow = cls(_tempos(marks, end))
        waits = _waits(marks, flow)
        waited, segments = 0.0, []
        for place in sorted({*flow._places, *waits}):
            hold, silence = waits.get(place, (0.0, 0.0))
            waited += hold + silence
            segment = flow._from(place, silence)
            segments.append(replace(segment, time=segment.time + waited))
        return cls(segments)

    def onsets(self, places: Sequence[Fraction] | Floats) -> Floats:
        """Onsets (N,) [s] at `places` (N,) [quarters], after all waiting there."""
        return self._at(np.asarray(places, np.float64))[0]

    def ends(self, places: Sequence[Fraction] | Floats) -> Floats:
        """Offsets (N,) [s] at `places` (N,) [quarters].

        A fermata there delays them; the silence of a caesura comes after them.
        """
        quarters = np.asarray(places, np.float64)
        time, segment = self._at(quarters)
        is_at_wait = self._quarter[segment] == quarters
        return time - np.where(is_at_wait, self._silence[segment], 0.0)

    def played(self, sections: Iterable[tuple[Fraction, Fraction]]) -> TempoMap:
        """The map of music that is played section by section, from begin to end of each [quarters].

        Raises CadenzaError if there would be more than `MAX_SEGMENTS`.
        """
        at, time, silence = Fraction(0), 0.0, 0.0
        segments: list[TempoSegment] = []
        for begin, end in sections:
            first, last = self.onsets([begin, end]).tolist()
            inside = slice(bisect_right(self._places, begin), bisect_left(self._places, end))
            for segment in (self._from(begin, silence), *self.segments[inside]):
                begin_time = time + segment.time - first
                segments.append(replace(segment, place=at + segment.place - begin, time=begin_time))
            if len(segments) > MAX_SEGMENTS:
                raise CadenzaError(f"over {MAX_SEGMENTS} tempos with all repeats, too many")
            silence = last - float(self.ends([end])[0])
            at, time = at + end - begin, time + last - first
        if not segments:
            return self
        return TempoMap([*segments, TempoSegment(at, self._from(end).seconds, 0.0, time, silence)])

    def _at(self, quarters: Floats) -> tuple[Floats, NDArray[np.intp]]:
        """(N,) onsets [s] of places [quarters], and (N,) the segments in which they are."""
        segment = np.maximum(np.searchsorted(self._quarter, quarters, side="right") - 1, 0)
        inside = quarters - self._quarter[segment]
        is_before = inside < 0  # the music, and the silence with which it may begin: steady
        slope = np.where(is_before, 0.0, self._slope[segment])
        time = self._time[segment] - np.where(is_before, self._silence[segment], 0.0)
        return time + inside * (self._seconds[segment] + slope * inside / 2), segment

    def _from(self, place: Fraction, silence: float = 0.0) -> TempoSegment:
        """The rest of a segment from a place within it, with this silence before it."""
        segment = self.segments[max(bisect_right(self._places, place) - 1, 0)]
        seconds = segment.seconds + segment.slope * float(place - segment.place)
        time = float(self.onsets([place])[0])
        return TempoSegment(place, seconds, segment.slope, time, silence)


_SUDDEN = (TempoChange.MENO_MOSSO, TempoChange.PIU_MOSSO)
_GRADUAL = (TempoChange.RITARDANDO, TempoChange.ACCELERANDO)


def _tempos(marks: Iterable[TempoMark], end: Fraction | None) -> list[TempoSegment]:
    """The segments of a map without waits."""
    tempos = {mark.onset: mark for mark in marks if isinstance(mark, Tempo)}
    changes: list[Tempo | TempoWord | Modulation] = list(tempos.values())
    words = {(mark.onset, mark.change): mark for mark in marks if isinstance(mark, TempoWord)}
    equal = {mark.onset: mark for mark in marks if isinstance(mark, Modulation)}
    changes += [*words.values(), *equal.values()]  # once, if every staff has them
    changes.sort(key=lambda mark: mark.onset)  # at one place, tempos first
    primo = next((mark.seconds for mark in changes if isinstance(mark, Tempo)), None)
    speeds = [TempoSegment(Fraction(0), _SECONDS_PER_QUARTER)]
    primo = _SECONDS_PER_QUARTER if primo is None else primo
    steady, gradual = _SECONDS_PER_QUARTER, False  # the tempo of "a tempo"; whether in a ramp
    for mark, following in zip_longest(changes, changes[1:]):
        current = min(max(speeds[-1].seconds, _FASTEST), _SLOWEST)
        if mark.onset in tempos and not isinstance(mark, Tempo) and _matches_tempo(mark, speeds):
            continue
        if isinstance(mark, TempoWord) and mark.change in _GRADUAL:
            steady, gradual = steady if gradual else current, True
            if isinstance(following, TempoWord) and following.change is TempoChange.TEMPO_PRIMO:
                following = Tempo(following.onset, primo)
            speeds += _ramp(mark, current, steady, following, end)
            continue
        if isinstance(mark, Tempo):
            seconds = mark.seconds
        elif isinstance(mark, Modulation):
            seconds = current * float(mark.slower)
        else:
            seconds = {
                TempoChange.MENO_MOSSO: current / MENO_MOSSO,
                TempoChange.PIU_MOSSO: current / PIU_MOSSO,
                TempoChange.A_TEMPO: steady,
                TempoChange.TEMPO_PRIMO: primo,
            }[mark.change]
        sudden = isinstance(mark, TempoWord) and mark.change in _SUDDEN
        steady, gradual = current if sudden else seconds, False
        speeds.append(TempoSegment(mark.onset, seconds))
    return _timed(speeds)


def _matches_tempo(word: TempoWord | Modulation, speeds: Sequence[TempoSegment]) -> bool:
    """Whether a word means the tempo at its place, the last of `speeds`, and no later change."""
    if isinstance(word, Modulation) or word.change not in _GRADUAL:
        return True
    earlier = [speed.seconds for speed in speeds[-2:] if speed.place < word.onset]
    slower = word.change is TempoChange.RITARDANDO
    return any(earlier) and (speeds[-1].seconds > earlier[-1]) == slower


def _ramp(
    word: TempoWord,
    begin: float,
    previous: float,
    following: Tempo | TempoWord | Modulation | None,
    end: Fraction | None,
) -> list[TempoSegment]:
    """A gradual change of the length of a quarter from `begin` [s] on, and the tempo after it.

    It leads to the following tempo, if that is faster or slower as the word says. If the score does
    not end the change, the `previous` tempo returns.
    """
    slower = word.change is TempoChange.RITARDANDO
    open_end = word.onset + OPEN_RAMP
    reaches = [open_end if word.end is None else word.end]
    reaches += [] if following is None else [following.onset]
    reaches += [] if end is None else [end]
    reach = min(reaches)
    if reach <= word.onset:
        return []
    goal = begin / (RITARDANDO if slower else ACCELERANDO)
    if (
        isinstance(following, Tempo)
        and following.onset == reach
        and (following.seconds > begin) == slower
    ):
        goal = following.seconds
    slope = (goal - begin) / float(reach - word.onset)
    final = previous if word.end is None and reach == open_end else goal
    return [TempoSegment(word.onset, begin, slope), TempoSegment(reach, final)]


def _timed(segments: Iterable[TempoSegment]) -> list[TempoSegment]:
    """The segments with their times, the first at 0; of those at one place the last counts."""
    timed: list[TempoSegment] = []
    for segment in {segment.place: segment for segment in segments}.values():
        if timed:
            previous = timed[-1]
            length = float(segment.place - previous.place)
            time = previous.time + length * (previous.seconds + previous.slope * length / 2)
            segment = replace(segment, time=time)
        timed.append(segment)
    return timed


def _waits(marks: Iterable[TempoMark], flow: TempoMap) -> Mapping[Fraction, tuple[float, float]]:
    """Places [quarters] -> how long sounds are held there, and the silence after them [s].

    Fermatas that sound together are one: they hold where the first of them ends, and the shortest
    of their notes counts.
    """
    waits: dict[Fraction, tuple[float, float]] = {}
    groups: list[list[Fermata]] = []
    for fermata in sorted((m for m in marks if isinstance(m, Fermata)), key=lambda m: m.end):
        if groups and (fermata.onset < groups[-1][0].end or fermata.end == groups[-1][0].end):
            groups[-1].append(fermata)
        else:
            groups.append([fermata])
    for group in groups:
        place = group[0].end
        begins = (
            fermata.onset if fermata.onset < fermata.end else place - _AT_BARLINE
            for fermata in group
        )
        begin, end = flow.onsets([max(begins), place]).tolist()
        factor = max(fermata.factor for fermata in group)
        if factor > 1:
            waits[place] = (factor - 1) * (end - begin), 0.0
    for mark in marks:
        if isinstance(mark, Caesura):
            waits[mark.onset] = waits.get(mark.onset, (0.0, 0.0))[0], CAESURA
    return waits


# Each with the words that the change is called by; \b before all, so that "brit." is no "rit.".
_CHANGES = (
    (TempoChange.TEMPO_PRIMO, r"(tempo (primo|i\b|1)|(1o|1\.|primo) tempo)"),
    (TempoChange.A_TEMPO, r"(a tempo|au mouvement|im zeitma(ss|ß))"),
    (
        TempoChange.MENO_MOSSO,
        r"(meno (mosso|allegro|vivo|presto)|ritenut|riten\b|langsamer|plus lent)",
    ),
    (TempoChange.PIU_MOSSO, r"(pi(ù|u'?) (mosso|allegro|vivo|presto)|schneller|plus vite)"),
    (
        TempoChange.RITARDANDO,
        r"(rit\b|ritard|rallent|rall\b|allarg|slarg|lentando|calando|morendo|smorz|cédez|"
        r"ritenendo)",
    ),
    (TempoChange.ACCELERANDO, r"(accel|string(endo|\b)|affrett|precipit|serrez|beschleunig)"),
)
# Quarters a minute, those of MuseScore's palette; words of two tempos come first.
_USUAL_TEMPOS = {
    "allegro moderato": 118,
    "grave": 35,
    "largo": 50,
    "lento": 52.5,
    "larghetto": 63,
    "adagio": 71,
    "andante": 92,
    "andantino": 94,
    "moderato": 114,
    "allegretto": 116,
    "allegro": 144,
    "vivace": 172,
    "presto": 187,
    "prestissimo": 200,
}
_MAX_WORDS = 40  # letters of words of tempo; titles and credits may have more
AS_USUAL = "played as usual, as the file gives no tempo"  # what is done with such words
_LOUDER = r"(cresc|rinforzando|dal niente)"
_SOFTER = r"(decresc|dim\b|dimin|calando|morendo|smorz|perdendosi|al niente)"
_TRIPLETS = 2, 1  # "Swing": the first note is about twice as long (MuseScore's handbook)
_EVEN = 1, 1


def tempo_change(text: str) -> TempoChange | None:
    """The change of tempo that words such as "poco rit." ask for, if any."""
    return next((change for change, words in _CHANGES if _has(text, words)), None)


def usual_tempo(text: str) -> float | None:
    """The quarters a minute that are usual for words such as "Andante con moto", if any."""
    if tempo_change(text) is not None:
        return None
    tempos = _USUAL_TEMPOS.items()
    return next((tempo for word, tempo in tempos if _has(text, rf"{word}\b")), None)


def is_of_tempo(text: str) -> bool:
    """Whether words are few and say how fast the music goes, as "Allegro" and "poco rit." do."""
    is_short = 0 < len(text) <= _MAX_WORDS
    return is_short and (tempo_change(text) is not None or usual_tempo(text) is not None)


def loudness_step(text: str) -> int | None:
    """1 for words such as "cresc.", -1 for "dim." and the like, None for others."""
    if _has(text, _LOUDER):
        return 1
    return -1 if _has(text, _SOFTER) else None


def swing(text: str) -> tuple[int, int] | None:
    """How words such as "Swing" or "Straight" divide a beat in two, if they do."""
    if _has(text, "straight"):
        return _EVEN
    return _TRIPLETS if _has(text, "swing") else None


def _has(text: str, words: str) -> bool:
    return re.search(rf"(?<!\w){words}", " ".join(text.split()), re.IGNORECASE) is not None
