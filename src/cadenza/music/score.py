"""A score: the notes and pedal movements that are to be played; its bars, tracks and chords."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from numbers import Integral, Real
from operator import attrgetter
from typing import TypeVar

from cadenza.errors import CadenzaError, quoted
from cadenza.fingers import LEFT, RIGHT, Finger

_N = TypeVar("_N")

NUM_KEYS = 88
LOWEST_PITCH = 21  # MIDI number of A0, key 0
PITCHES = range(LOWEST_PITCH, LOWEST_PITCH + NUM_KEYS)
MIDI_PITCHES = range(128)
OCTAVE = 12  # the semitones of an octave
STEPS, NATURALS = "CDEFGAB", (0, 2, 4, 5, 7, 9, 11)
"""The names of the white keys of an octave, and their semitones above C."""
SOFTEST, LOUDEST = 1, 127  # the least and the largest MIDI velocity
PEDAL_DOWN = 64  # the least value of a pedal that is down
MIRROR = 124  # sum of a pitch and its mirror image: twice D4, about which black keys are symmetric
MAX_SECONDS = 3600.0  # seconds of music; a longer song is taken for a mistake
MAX_SCORE_LENGTH = 4 * 3600.0  # [s]; a part may be played, and bars of days would fill memory
MS_PER_SECOND = 1000  # times are in seconds, and shown to people in milliseconds
CHORD_TOLERANCE = 0.03  # [s] within which notes begin together
RELEASE_TIME = 0.05  # [s] a note with less left than this does not keep its finger from the next
MAX_SIGNS = 7  # sharps or flats of a key signature
_MAX_FLATS = 5  # flats of a key that is chosen: rather six sharps than six flats
BEAT_TYPES = frozenset(1 << k for k in range(7))  # whole notes to 64ths
_MIN_LENGTH = 1e-9  # [s] of a note when its times are changed
_DECIMALS = 9  # decimals of shifted times [s]
_BAR_TOLERANCE = 1e-6  # [s] by which a time may lie before the bar that it is in, by rounding
_KEYBOARDS = "piano", "organ", "harpsichord", "clavinet", "celesta", "keyboard"
_NAMES = ("C", "C♯", "D", "D♯", "E", "F", "F♯", "G", "G♯", "A", "A♯", "B")


@dataclass(frozen=True, slots=True)
class Note:
    """A note: `start` and `end` in [s], MIDI `pitch` 0..127, `velocity` 1..127, and its finger.

    `tracks` are the numbers of the tracks of the file that have it. `hands`, `RIGHT` and `LEFT`,
    play it as written: none where the file does not say, both where it is written for both. Notes
    that differ only in tracks or hands are equal. Raises CadenzaError if a value is outside its
    range, or the note does not end after it starts.
    """

    start: float
    end: float
    pitch: int
    velocity: int = 80
    finger: Finger | None = None
    tracks: tuple[int, ...] = field(default=(), compare=False)
    hands: tuple[int, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        if not 0 <= self.start < self.end < float("inf"):
            raise CadenzaError(
                f"note from {self.start} to {self.end} s: it must start at 0 or later, then end"
            )
        if not isinstance(self.pitch, Integral) or self.pitch not in MIDI_PITCHES:
            raise CadenzaError(f"note of pitch {self.pitch}: MIDI has 0..{MIDI_PITCHES[-1]}")
        if not isinstance(self.velocity, Integral) or not SOFTEST <= self.velocity <= LOUDEST:
            raise CadenzaError(f"note of velocity {self.velocity}: give 1..127")
        if not isinstance(self.finger, Finger | None):
            raise CadenzaError(
                f"note with finger {quoted(self.finger)}: give Finger(hand, index), such as "
                "Finger(0, 1) for the right index finger, or None"
            )
        if not set(self.hands) <= {RIGHT, LEFT}:
            raise CadenzaError(f"note with hands {self.hands}: give 0 (right), 1 (left) or both")


@dataclass(frozen=True, slots=True)
class PedalEvent:
    """The sustain pedal (MIDI controller 64) moves to `value` 0..127 at `time` [s].

    Raises CadenzaError if a value is outside its range.
    """

    time: float
    value: int

    def __post_init__(self) -> None:
        if not 0 <= self.time < float("inf"):
            raise CadenzaError(f"pedal event at {self.time} s: give a time of 0 or later")
        if not isinstance(self.value, Integral) or not 0 <= self.value <= 127:
            raise CadenzaError(f"pedal event of value {self.value}: give 0..127")


@dataclass(frozen=True, slots=True)
class Bar:
    """The bar of this `number` begins at `time` [s], which may lie before the song.

    Its beats begin at `beats` [s], the first of them with the bar; they are empty where the metre
    is unknown. Each is written as the part `1 / beat_type` of a whole note. `key` is the number of
    sharps of its key signature, negative for flats, if that is known. `words` of tempo in it, such
    as "Andante" and "rit.", have their times [s]; under `fermatas` notes or rests begin at these
    times [s]. Raises CadenzaError if a time is not finite, or there is no such part of a whole
    note.
    """

    time: float
    number: int
    beats: tuple[float, ...] = ()
    beat_type: int = 4
    key: int | None = None
    words: tuple[tuple[float, str], ...] = ()
    fermatas: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        times_of_words = (time for time, _ in self.words)
        if not all(map(isfinite, (self.time, *self.beats, *times_of_words, *self.fermatas))):
            raise CadenzaError(f"bar at {self.time} s: give finite times")
        if self.beat_type not in BEAT_TYPES:
            raise CadenzaError(
                f"beats of 1/{self.beat_type} of a whole note: give 1, 2, 4, 8, 16, 32 or 64"
            )

    def moved(self, move: Callable[[float], float]) -> Bar:
        """The bar with `move` applied to all of its times [s]."""
        words = tuple((move(time), text) for time, text in self.words)
        beats, fermatas = (tuple(map(move, times)) for times in (self.beats, self.fermatas))
        return replace(self, time=move(self.time), beats=beats, words=words, fermatas=fermatas)

    def transposed(self, semitones: int) -> Bar:
        """The bar with the key signature transposed upwards."""
        return replace(self, key=None if self.key is None else key_above(self.key, semitones))


@dataclass(frozen=True, slots=True)
class Track:
    """The part of one instrument: the number of its notes, its lowest and its highest pitch.

    `number` counts the tracks with notes from 1; `channel` is that of MIDI, 1 to 16, or None if
    the file is not MIDI.
    """

    number: int
    name: str
    instrument: str
    channel: int | None
    notes: int
    lowest: int
    highest: int

    @property
    def is_keyboard(self) -> bool:
        """Whether the instrument is called like one with keys."""
        return any(word in self.instrument.lower() for word in _KEYBOARDS)


@dataclass(frozen=True, slots=True)
class Score:
    """A score: notes by (start, pitch) and pedal events by time, which are given in any order.

    `remarks` say in plain words what was repaired when the score was read. `tracks` are those of
    the file, played or not. `bars` are in the order in which they are played; there are none if the
    file has no metre. `composer` is empty if the file does not say who wrote it. Scores that differ
    only in tracks, bars or composer are equal. Raises CadenzaError if something in it is later than
    `MAX_SCORE_LENGTH`.
    """

    notes: tuple[Note, ...]
    pedal: tuple[PedalEvent, ...] = ()
    title: str = ""
    remarks: tuple[str, ...] = ()
    tracks: tuple[Track, ...] = field(default=(), compare=False)
    bars: tuple[Bar, ...] = field(default=(), compare=False)
    composer: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        notes = tuple(sorted(self.notes, key=lambda note: (note.start, note.pitch)))
        pedal = tuple(sorted(self.pedal, key=lambda event: event.time))
        object.__setattr__(self, "notes", notes)
        object.__setattr__(self, "pedal", pedal)
        object.__setattr__(self, "bars", tuple(sorted(self.bars, key=lambda bar: bar.time)))
        moments = [self.total_time, *(event.time for event in pedal[-1:])]
        moments += [abs(time) for bar in self.bars for time in (bar.time, *bar.beats)]
        check_end(max(moments))

    def __repr__(self) -> str:
        return f"Score({self.title!r}, {len(self.notes)} notes, {self.total_time:.1f} s)"

    @property
    def total_time(self) -> float:
        """The end of the last note [s]; 0 without notes."""
        return max((note.end for note in self.notes), default=0.0)

    @property
    def has_fingering(self) -> bool:
        """Whether any note says which finger plays it."""
        return any(note.finger is not None for note in self.notes)

    @property
    def has_written_hands(self) -> bool:
        """Whether any note says which hand plays it."""
        return any(note.hands for note in self.notes)

    def without_fingers(self) -> Score:
        """The score without fingering."""
        return self.with_fingers([None] * len(self.notes))

    def with_fingers(self, fingers: Iterable[Finger | None]) -> Score:
        """The score with these `fingers` for its notes, in their order."""
        notes = zip(self.notes, fingers, strict=True)
        return replace(self, notes=tuple(replace(note, finger=finger) for note, finger in notes))

    def stretched(self, factor: float) -> Score:
        """The score with all times multiplied by `factor` (2 is half as fast).

        Raises CadenzaError if `factor` is not a positive number, or the song would last over an
        hour.
        """
        if not isinstance(factor, Real) or not 0 < factor < float("inf"):
            raise CadenzaError(f"cannot stretch by {quoted(factor)}: give a positive number")
        check_length(self.total_time * factor, f"stretched by {factor:g}, the song")
        return self.with_times(lambda time: time * factor)

    def transposed(self, semitones: int) -> Score:
        """The score with pitches moved by `semitones`; raises CadenzaError if one leaves MIDI's."""
        pitches = [note.pitch + semitones for note in self.notes]
        if outside := [pitch for pitch in pitches if pitch not in MIDI_PITCHES]:
            raise CadenzaError(
                f"cannot transpose by {semitones} semitones: a note would have pitch {outside[0]}, "
                f"but MIDI has 0 to {MIDI_PITCHES[-1]}; choose less"
            )
        notes = (replace(n, pitch=p) for n, p in zip(self.notes, pitches, strict=True))
        bars = (bar.transposed(semitones) for bar in self.bars)
        return replace(self, notes=tuple(notes), bars=tuple(bars))

    @property
    def mirrored(self) -> Score:
        """The mirror image about D4, with left and right hand exchanged; black keys stay black.

        Raises CadenzaError if a note would have a pitch that MIDI does not have.
        """
        if (highest := max((note.pitch for note in self.notes), default=0)) > MIRROR:
            raise CadenzaError(f"cannot mirror pitch {highest}: choose pitches up to {MIRROR}")
        notes = (
            replace(
                n,
                pitch=MIRROR - n.pitch,
                finger=n.finger and n.finger.mirrored,
                hands=tuple(LEFT if hand == RIGHT else RIGHT for hand in n.hands),
            )
            for n in self.notes
        )
        bars = (replace(bar, key=None if bar.key is None else -bar.key) for bar in self.bars)
        return replace(self, notes=tuple(notes), bars=tuple(bars))

    def with_silence_trimmed(self) -> Score:
        """The score from the start of the first note, at time 0, to the end of the last.

        A pedal that is down when the first note starts is down from time 0.
        """
        if not self.notes:
            return self
        start = min(note.start for note in self.notes)
        end = self.total_time
        before = [event for event in self.pedal if event.time <= start]
        during = [event for event in self.pedal if start < event.time <= end]
        held = [replace(before[-1], time=start)] if before else []
        return replace(self, pedal=tuple(held + during))._shifted(-start)

    def until(self, seconds: float) -> Score:
        """The score up to `seconds`, at which held notes end."""
        notes = (replace(n, end=min(n.end, seconds)) for n in self.notes if n.start < seconds)
        pedal = (event for event in self.pedal if event.time < seconds)
        bars = (bar for bar in self.bars if bar.time < seconds)
        return replace(self, notes=tuple(notes), pedal=tuple(pedal), bars=tuple(bars))

    def since(self, seconds: float) -> Score:
        """The notes that begin at `seconds` or later, on a clock that begins there, no pedal."""
        if not seconds:
            return self
        notes = [n for n in self.notes if round(n.start - seconds, 9) >= 0]
        moved = (replace(n, start=max(0.0, n.start - seconds), end=n.end - seconds) for n in notes)
        return Score(tuple(moved), title=self.title)

    def with_initial_silence(self, seconds: float) -> Score:
        """The score later by `seconds`, so that the hands have time to get into place.

        Raises CadenzaError if `seconds` is negative or not finite, or the song would last over an
        hour.
        """
        if not 0 <= seconds < float("inf"):
            raise CadenzaError(f"initial silence of {seconds} s: give zero or more seconds")
        check_length(self.total_time + seconds, "with the silence before it, the song")
        return self._shifted(seconds)

    def beginning(self, seconds: float) -> Score:
        """The first `seconds` of the score from the first note on, after which held notes end.

        Raises CadenzaError if `seconds` is not a positive number.
        """
        check_beginning(seconds)
        first = min((note.start for note in self.notes), default=0.0)
        return self.until(round(first + seconds, _DECIMALS))

    def _shifted(self, seconds: float) -> Score:
        # To the nanosecond: 0.15 - 0.05 must give 0.1 and not the float below it, which would
        # put the note a control step too early.
        return self.with_times(lambda time: round(time + seconds, _DECIMALS))

    def with_times(self, move: Callable[[float], float]) -> Score:
        """The score with `move` applied to all of its times [s]."""

        def moved(note: Note) -> Note:
            start = move(note.start)
            return replace(note, start=start, end=max(move(note.end), start + _MIN_LENGTH))

        notes = tuple(moved(note) for note in self.notes)
        pedal = tuple(replace(event, time=move(event.time)) for event in self.pedal)
        bars = tuple(bar.moved(move) for bar in self.bars)
        return replace(self, notes=notes, pedal=pedal, bars=bars)


def chords(
    notes: Iterable[_N],
    within: float = CHORD_TOLERANCE,
    start: Callable[[_N], float] = attrgetter("start"),
) -> Iterator[list[_N]]:
    """Yield the chords of notes in order of time: groups that begin `within` [s] of the first.

    `start` says when a note begins [s], or what stands for one.
    """
    chord: list[_N] = []
    for note in notes:
        if chord and start(note) > start(chord[0]) + within:
            yield chord
            chord = []
        chord.append(note)
    if chord:
        yield chord


def check_beginning(seconds: float) -> None:
    """Check the length of a beginning [s]; raises CadenzaError if not positive or not finite."""
    if not 0 < seconds < float("inf"):
        raise CadenzaError(f"--first-seconds {seconds:g}: give a positive number")


def check_length(seconds: float, what: str, advice: str = "") -> None:
    """Check the length of `what` [s].

    Raises CadenzaError if it would last longer than is sensible; the message ends with `advice`.
    """
    if seconds > MAX_SECONDS:
        raise CadenzaError(
            f"{what} would last {seconds / 60:.4g} minutes; the longest is {MAX_SECONDS / 60:.0f}"
            f"{advice}"
        )


def check_end(seconds: float) -> None:
    """Check that a score ends within `MAX_SCORE_LENGTH`. Raises CadenzaError if it ends later."""
    if not seconds <= MAX_SCORE_LENGTH:  # also where it is not a number
        raise CadenzaError(
            f"a score of {seconds / 3600:.4g} hours; the longest is {MAX_SCORE_LENGTH / 3600:.0f}, "
            "so correct its times, or leave out silence"
        )


def check_chosen(chosen: Collection[int], tracks: Sequence[Track]) -> None:
    """Check that tracks of a file have the `chosen` numbers; raises CadenzaError if not."""
    if missing := sorted(set(chosen) - {track.number for track in tracks}):
        tracks_text = f"tracks 1 to {len(tracks)}" if len(tracks) > 1 else "one track"
        raise CadenzaError(f"there is no track {missing[0]}; the file has {tracks_text}")


# Keys of a piano and of music, and bars


def key_above(key: int, semitones: int) -> int:
    """The key signature `semitones` above one of `key` sharps, or -`key` flats.

    A different key signature has at most six sharps or five flats.
    """
    fifths = (7 * semitones) % OCTAVE
    return (key + fifths + _MAX_FLATS) % OCTAVE - _MAX_FLATS if fifths else key


def is_black(pitch: int) -> bool:
    """Whether the key of a MIDI pitch is black."""
    return "♯" in _NAMES[pitch % 12]


def note_name(pitch: int) -> str:
    """The name of a MIDI pitch, such as C4 for the middle C; black keys by their sharps."""
    return f"{_NAMES[pitch % 12]}{pitch // 12 - 1}"


def bar_at(score: Score, time: float) -> int:
    """The number of the bar in which `time` [s] lies, or of the first; for a score with bars."""
    count = bisect_right(score.bars, time + _BAR_TOLERANCE, key=lambda bar: bar.time)
    return score.bars[max(count - 1, 0)].number


def describe_times(score: Score, times: Iterable[float]) -> str:
    """Times [s] in words, such as "bar 12" or "bars 3, 7-9"; "4.5, 6.0 s" without bars."""
    times = sorted(times)
    if not score.bars:
        return f"{', '.join(f'{time:.1f}' for time in times)} s"
    numbers = list(dict.fromkeys(bar_at(score, time) for time in times))
    runs: list[list[int]] = []
    for number in numbers:
        if runs and runs[-1][-1] + 1 == number:
            runs[-1].append(number)
        else:
            runs.append([number])
    text = ", ".join("-".join(map(str, run[:: max(len(run) - 1, 1)])) for run in runs)
    return f"bar{'s'[: len(numbers) > 1]} {text}"
