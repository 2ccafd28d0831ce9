"""Notes with the signs at them, as they are written, notes as they sound, and their voices."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum, auto
from fractions import Fraction
from itertools import pairwise

from cadenza.fingers import Finger

MIN_LENGTH = 0.05
"""How long a note lasts at least that a sign makes shorter, if it is written so [s]; a choice, as
long as a control step."""


class Mark(Enum):
    """A sign at a note that says all by its kind."""

    STACCATO = auto()
    STACCATISSIMO = auto()  # a wedge, or MusicXML's spiccato
    TENUTO = auto()
    # MusicXML's detached-legato; staccato under a slur, or with tenuto, means the same
    PORTATO = auto()
    ACCENT = auto()
    STRONG_ACCENT = auto()  # marcato, the upright wedge
    BREATH = auto()  # a breath mark after the note


class OrnamentKind(Enum):
    """A sign for several notes; the names are those of MusicXML."""

    TRILL = auto()  # a trill mark, a shake, or a wavy line, for the whole note
    MORDENT = auto()  # the sign with a stroke through it: the lower neighbour
    INVERTED_MORDENT = auto()  # the sign without a stroke, a short trill: the upper neighbour
    TURN = auto()
    INVERTED_TURN = auto()
    SLIDE = auto()  # a schleifer: two notes from below


@dataclass(frozen=True, slots=True)
class Ornament:
    """An ornament at a note.

    `above` and `below` are the alterations [semitones] of accidental marks, such as -1 for a flat
    and 0 for a natural; None where there is none, and the key says how high the neighbours are.
    `begins` is the first note where the file says so: 1 for the upper neighbour, 0 for the note
    itself, -1 for the lower neighbour. `delayed` is a turn between this note and the next. A `long`
    mordent has one more beat.

    Further fields are what the file says for playback, which goes before the rest: the `interval`
    to the neighbour [semitones], the one down to the first of two notes with which a trill or
    mordent ends (`turn`), how many `notes` there are before those, 0 for as many as are usual, and
    whether a trill `accelerates`.
    """

    kind: OrnamentKind
    above: int | None = None
    below: int | None = None
    begins: int | None = None
    delayed: bool = False
    long: bool = False
    interval: int | None = None
    turn: int | None = None
    notes: int = 0
    accelerates: bool = False


class Role(Enum):
    """What a note or chord is in a tremolo."""

    ALONE = auto()  # it is repeated
    FIRST = auto()  # it alternates with the one that follows in its voice
    SECOND = auto()  # it alternates with the one before it in its voice


@dataclass(frozen=True, slots=True)
class Tremolo:
    """A tremolo with a number of `marks`, the strokes through the stem; 0 is one without measure.

    Notes of a tremolo of two last as long as they take, which is half of what each of them shows.
    """

    marks: int
    role: Role = Role.ALONE


@dataclass(frozen=True, slots=True)
class Arpeggio:
    """A wavy line before a chord.

    Chords of one part that begin together with the same `number` are broken as one, across staves;
    without a number, those of each staff are. `step` is 1 for upwards, -1 for downwards, and 0 for
    a bracket: together.
    """

    number: int | None = None
    step: int = 1


@dataclass(frozen=True, slots=True)
class Grace:
    """The sign of a grace note, the `index`-th, from 0, of those together in its voice.

    Notes with the same index are a chord. `slash` is the stroke through its stem; the shares 0 to 1
    say how much of the note before or after it takes, and `takes` how much time it has of its own
    [quarters], where the file says so. `after` is whether it ends the note before it, since no note
    follows in its bar.
    """

    index: int
    slash: bool = False
    of_previous: float | None = None
    of_following: float | None = None
    takes: Fraction | None = None
    after: bool = False


@dataclass(frozen=True, slots=True)
class SlurEnd:
    """One end of a slur, the beginning or not; `number` tells those apart that overlap."""

    begins: bool
    number: int = 1


@dataclass(frozen=True, slots=True)
class SignedNote:
    """A note as written, with its signs; tied notes are one.

    `onset` and `duration` are in quarters from the beginning of the piece as it is played, repeats
    unrolled; those of a grace note are the onset of the note that it leads to, or the end of the
    one before it (`Grace.after`), and the length that it shows, 0 if unknown. `velocity` is that
    of the dynamics, without accents. `alter` is by how many semitones the note is sharp (1) or
    flat (-1): together with `pitch` it says on which line it stands. `fifths` is the key there, by
    its sharps, negative for flats. `attack` and `release` move its beginning and end [quarters],
    where the file says so for playback. `hands` are those that play it, none where nobody knows.
    """

    onset: Fraction
    duration: Fraction
    pitch: int
    velocity: int
    part: int = 1
    staff: int = 1
    voice: str = "1"
    alter: int = 0
    fifths: int = 0
    finger: Finger | None = None
    marks: frozenset[Mark] = frozenset()
    ornament: Ornament | None = None
    tremolo: Tremolo | None = None
    arpeggio: Arpeggio | None = None
    grace: Grace | None = None
    slurs: tuple[SlurEnd, ...] = ()
    attack: Fraction = Fraction(0)
    release: Fraction = Fraction(0)
    hands: tuple[int, ...] = ()

    @property
    def end(self) -> Fraction:
        """When the note ends as written [quarters]; a grace note takes no time."""
        return self.onset if self.grace else self.onset + self.duration

    @property
    def plain(self) -> SignedNote:
        """The note without its signs, as it stands; a grace note is a short one, with a stroke."""
        return replace(
            self,
            marks=frozenset(),
            ornament=None,
            tremolo=None,
            arpeggio=None,
            grace=self.grace and replace(self.grace, slash=True),
            slurs=(),
        )


Times = list[tuple[float, float]]
"""Notes sound from the first time [s] of each pair up to the second."""


@dataclass(slots=True, eq=False)
class SoundingNote:
    """A note as it sounds, from `start` to `end` [s]; `of` is the written one that it is part of.

    Several come of one with an ornament or a tremolo, which takes `turns`; in an ornament `pitch`
    may differ. The written one has the signs of its whole chord. `cut` is whether a sign has made
    it end earlier than it is written, and `led_to` whether a grace note leads to it.
    """

    of: SignedNote
    start: float
    end: float
    pitch: int
    velocity: float
    cut: bool = False
    led_to: bool = False
    turns: Times | None = None

    @property
    def length(self) -> float:
        """How long the note lasts [s]."""
        return self.end - self.start

    def end_by(self, time: float) -> None:
        """End the note at a time [s] or before, but not before it has sounded."""
        if time < self.end:
            self.end = max(time, self.start + min(self.length, MIN_LENGTH))
            self.cut = True


Chord = list[SoundingNote]


def even_times(start: float, end: float, count: int) -> Times:
    """The times of `count` notes that share the time between two [s] evenly."""
    return list(pairwise([*(start + (end - start) * k / count for k in range(count)), end]))


@dataclass(slots=True)
class Voice:
    """One voice of a part: its chords by onset [quarters], and the grace notes at each onset.

    Both are in order of time; grace notes of one place are chords, too, in their order.
    """

    part: int
    name: str
    chords: dict[Fraction, Chord]
    graces: dict[Fraction, list[Chord]]


def voices_of(notes: Iterable[SoundingNote]) -> list[Voice]:
    """The voices that notes are in."""
    voices: dict[tuple[int, str], Voice] = {}
    indices: dict[tuple[int, str, Fraction], dict[int, Chord]] = {}
    for note in sorted(notes, key=lambda note: note.of.onset):
        of = note.of
        voice = voices.setdefault((of.part, of.voice), Voice(of.part, of.voice, {}, {}))
        if of.grace is None:
            voice.chords.setdefault(of.onset, []).append(note)
        else:
            chords = indices.setdefault((of.part, of.voice, of.onset), {})
            chords.setdefault(of.grace.index, []).append(note)
    for (part, name, onset), chords in indices.items():
        voices[part, name].graces[onset] = [chords[index] for index in sorted(chords)]
    return list(voices.values())
