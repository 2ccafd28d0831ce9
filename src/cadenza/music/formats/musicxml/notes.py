"""The notes of a part as they are written: their pitches, hands, fingers and signs."""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import groupby, islice
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

from cadenza.fingers import Finger
from cadenza.music.formats.musicxml.marks import PartLoudness
from cadenza.music.formats.musicxml.timeline import (
    MAX_STAVES,
    ZERO,
    Placed,
    attribute,
    exact,
    length_of,
    number,
    number_or_none,
    passes_of,
)
from cadenza.music.score import NATURALS, OCTAVE, STEPS
from cadenza.music.signs.notes import (
    Arpeggio,
    Grace,
    Mark,
    Ornament,
    OrnamentKind,
    Role,
    SignedNote,
    SlurEnd,
    Tremolo,
)

_FINGERS = "12345"
_STAVES = 2  # staves of a part for both hands: the upper one is for the right hand
_OTHER_STAVES = frozenset(("ossia", "cue", "editorial", "alternate"))
"""Types of staves with what may be played instead of another, or is for reference only."""
_MARKS = {
    "staccato": Mark.STACCATO,
    "staccatissimo": Mark.STACCATISSIMO,
    "spiccato": Mark.STACCATISSIMO,
    "tenuto": Mark.TENUTO,
    "detached-legato": Mark.PORTATO,
    "accent": Mark.ACCENT,
    "strong-accent": Mark.STRONG_ACCENT,
    "breath-mark": Mark.BREATH,
}
_ORNAMENTS = {
    **dict.fromkeys(("trill-mark", "shake", "wavy-line"), OrnamentKind.TRILL),
    "mordent": OrnamentKind.MORDENT,
    "inverted-mordent": OrnamentKind.INVERTED_MORDENT,
    **dict.fromkeys(("turn", "delayed-turn", "vertical-turn", "haydn"), OrnamentKind.TURN),
    **dict.fromkeys(
        ("inverted-turn", "delayed-inverted-turn", "inverted-vertical-turn"),
        OrnamentKind.INVERTED_TURN,
    ),
    "schleifer": OrnamentKind.SLIDE,
}
_ALTERATIONS = {
    **{"natural": 0, "sharp": 1, "flat": -1, "natural-sharp": 1, "natural-flat": -1},
    **{"double-sharp": 2, "sharp-sharp": 2, "flat-flat": -2},
}
_OPENINGS = {"upper": 1, "main": 0, "below": -1}  # notes of ornaments
_INTERVALS = {"whole": 2, "half": 1, "unison": 0}
_MAX_ORNAMENT = 128  # notes
_ROLES = {"start": Role.FIRST, "stop": Role.SECOND}
_DIRECTIONS = {"up": 1, "down": -1}


@dataclass(frozen=True, slots=True)
class SheetNote:
    """A note in its measure, with times on the sheet.

    `tied` and `ties` say whether a tie leads to it and on from it. It is played on some `passes`
    through its section only, or on all if there are none.
    """

    measure: int
    signed: SignedNote
    tied: bool
    ties: bool
    passes: frozenset[int]


class _Transposition(NamedTuple):
    """How much higher an instrument sounds than written, and `doubled` beyond, if not 0."""

    steps: int = 0
    semitones: int = 0
    doubled: int = 0


def notes_of(
    part: Sequence[Placed],
    track: int,
    silence: Callable[[Placed], str],
    plain: bool,
    counts: Counter[str],
) -> list[SheetNote]:
    """The notes of a part that sound; others are added to `counts`.

    Args:
        part: its elements.
        track: its number.
        silence: why the instrument of a note is not heard, as a name in `counts`; "" if it is.
        plain: whether notes are without their signs, as they stand.
        counts: the numbers of notes that are left out or changed, by what they are.
    """
    note_elements = [placed for placed in part if placed.element.tag == "note"]
    loudness = PartLoudness(part, plain)
    key = attribute(part, "key", lambda each: int(number(each.findtext("fifths"))), 0)
    transposition = attribute(part, "transpose", _transposition, _Transposition())
    kind = attribute(
        part, "staff-details[staff-type]", lambda e: e.findtext("staff-type", "").strip(), ""
    )
    slash = attribute(part, "measure-style[slash]", lambda e: e.find("slash[@type='start']"), None)
    is_on_other_staff = [kind(placed) in _OTHER_STAVES for placed in note_elements]
    graces, hand_of = _graces(note_elements), _hands_of(part, is_on_other_staff)
    notes: list[SheetNote] = []
    for index, placed in enumerate(note_elements):
        note, hand, grace = placed.element, hand_of[index], graces.get(index)
        if note.find("cue") is not None or note.find("rest") is not None:
            continue
        is_slash = note.findtext("notehead", "").strip() == "slash" or slash(placed) is not None
        velocity = loudness.velocity(placed)
        why = "other staff" if is_on_other_staff[index] else silence(placed)
        why = why or ("slash" if is_slash else "" if velocity else "silent")
        if why:
            counts[why] += 1
            continue
        pitch = _written_pitch(note, counts)
        if pitch is None:
            continue
        shift, (step, semitones) = transposition(placed), pitch
        natural = _natural(step + shift.steps)
        sounds = semitones + shift.semitones
        shape = length_of(note.findtext("type", ""), len(note.findall("dot")))  # 0 if unknown
        signed = SignedNote(
            onset=placed.quarter,
            duration=shape if grace else placed.duration,
            pitch=sounds,
            velocity=velocity,
            part=track,
            staff=placed.staff or 1,
            voice=f"{placed.voice} {hand}",  # staves may have voices of one name
            alter=sounds - natural,
            fifths=key(placed) + 7 * shift.semitones - 12 * shift.steps,
            finger=_finger(note, hand, counts),
            grace=grace,
            attack=exact(number(note.get("attack")) / placed.divisions),
            release=exact(number(note.get("release")) / placed.divisions),
            hands=() if hand is None else (hand,),
            **_signs_of(note),
        )
        tied, ties = _ties(note)
        signed = signed.plain if plain else signed
        notes.append(SheetNote(placed.measure, signed, tied, ties, passes_of(note)))
        if shift.doubled:
            octave = replace(signed, pitch=signed.pitch + shift.doubled, finger=None)
            notes.append(replace(notes[-1], signed=octave))
    return notes


def _written_pitch(note: Element, counts: Counter[str]) -> tuple[int, int] | None:
    """The pitch of a note, among the white keys from C0 and in MIDI; None without one."""
    counts["unpitched"] += note.find("unpitched") is not None
    pitch = note.find("pitch")
    if pitch is None:
        return None
    step, octave = pitch.findtext("step", "").strip(), number_or_none(pitch.findtext("octave"))
    if step not in [*STEPS] or octave is None:
        counts["unreadable"] += 1
        return None
    alter = number(pitch.findtext("alter"))
    counts["microtone"] += alter.denominator > 1
    key = STEPS.index(step) + len(STEPS) * int(octave)
    return key, _natural(key) + round(alter)


def _natural(step: int) -> int:
    """The MIDI pitch of a white key, C0 being 0."""
    octave, degree = divmod(step, len(STEPS))
    return NATURALS[degree] + OCTAVE * (octave + 1)


def _transposition(transpose: Element) -> _Transposition:
    octaves = int(number(transpose.findtext("octave-change")))
    semitones = int(number(transpose.findtext("chromatic")))
    steps = int(number(transpose.findtext("diatonic"))) or round(semitones * 7 / 12)
    double = transpose.find("double")
    doubled = 0 if double is None else OCTAVE if double.get("above") == "yes" else -OCTAVE
    return _Transposition(steps + 7 * octaves, semitones + OCTAVE * octaves, doubled)


def _graces(notes: Sequence[Placed]) -> dict[int, Grace]:
    """The grace notes among notes and rests, by their indices."""
    graces: dict[int, Grace] = {}
    waiting: defaultdict[str, list[int]] = defaultdict(list)  # for the next note, by voice
    measure = 0
    for i, placed in enumerate(notes):
        note = placed.element
        if placed.measure != measure:
            measure = placed.measure
            waiting.clear()
        grace, is_chord = note.find("grace"), note.find("chord") is not None
        earlier = waiting[placed.voice]
        if grace is not None:
            index = graces[earlier[-1]].index + (not is_chord) if earlier else 0
            graces[i] = _grace(grace, index, placed)
            earlier.append(i)
        elif not is_chord:
            for each in earlier if note.find("rest") is None else ():
                graces[each] = replace(graces[each], after=False)
            earlier.clear()
    return graces


def _grace(grace: Element, index: int, placed: Placed) -> Grace:
    """A grace note that leads to no note yet."""
    shares = [grace.get(f"steal-time-{where}") for where in ("previous", "following")]
    previous, following = (None if each is None else float(number(each)) / 100 for each in shares)
    make_time = grace.get("make-time")
    takes = None if make_time is None else exact(number(make_time) / placed.divisions)
    return Grace(index, grace.get("slash") == "yes", previous, following, takes, after=True)


def _ties(note: Element) -> tuple[bool, bool]:
    """Whether a tie leads to the note, and one on from it."""
    kinds = {tie.get("type") for tie in (*note.iterfind("tie"), *note.iterfind("notations/tied"))}
    return "stop" in kinds or "continue" in kinds, "start" in kinds or "continue" in kinds


def _finger(note: Element, hand: int | None, counts: Counter[str]) -> Finger | None:
    """The finger of a note that a hand plays, the first where several are written."""
    for sign in note.iterfind("notations/technical/fingering"):
        digit = re.search("[0-9]", sign.text or "")
        counts["fingering"] += digit is None
        if digit and digit[0] in _FINGERS and hand is not None:
            return Finger(hand, int(digit[0]) - 1)
    return None


@dataclass(slots=True)
class _Run:
    """Notes that follow each other in a voice of a bar, and the staff where they begin."""

    voice: str
    staff: int
    indices: list[int] = field(default_factory=list)
    end: Fraction = ZERO
    sounds: bool = False


def _hands_of(part: Sequence[Placed], is_on_other_staff: Sequence[bool]) -> list[int | None]:
    """The hands that play the notes and rests of a part, in their order; None where nobody knows.

    The upper staff is the right hand's. A voice that goes to the other staff stays with the hand of
    the staff where it began, unless in a bar it begins on the other while others are on its own.
    `is_on_other_staff` marks notes on a staff that is not played, such as an ossia.
    """
    notes = [placed for placed in part if placed.element.tag == "note"]
    played_notes = [(i, note) for i, note in enumerate(notes) if not is_on_other_staff[i]]
    staves = {note.staff or 1 for _, note in played_notes}
    if len(staves) < _STAVES:
        declared = max((number(each.element.findtext("staves")) for each in part), default=ZERO)
        silent = {note.staff or 1 for note in notes} - staves
        staves |= {*range(1, min(int(declared), MAX_STAVES) + 1)} - silent
    hands: list[int | None] = [None] * len(notes)
    if len(staves) != _STAVES:
        return hands
    home: dict[str, int] = {}  # the staff on which a voice began
    for _, bar in groupby(played_notes, key=lambda each: each[1].measure):
        runs = _runs(bar)
        busy = {run.staff for run in runs if run.sounds}
        for run in runs:
            first_staff = home.setdefault(run.voice, run.staff)
            hand = int((run.staff if first_staff in busy else first_staff) == max(staves))
            for index in run.indices:
                hands[index] = hand
    return hands


def _runs(bar: Iterable[tuple[int, Placed]]) -> list[_Run]:
    """The runs of a bar, whose notes come with their indices."""
    runs: list[_Run] = []
    going: dict[str, _Run] = {}
    for index, placed in bar:
        staff = placed.staff or 1
        run = going.get(placed.voice)
        is_chord = placed.element.find("chord") is not None
        if run is None or (placed.quarter < run.end and not is_chord):
            run = going[placed.voice] = _Run(placed.voice, staff)
            runs.append(run)
        run.indices.append(index)
        run.end = run.end if is_chord else placed.quarter + placed.duration
        run.sounds |= placed.element.find("rest") is None
    return runs


def _signs_of(note: Element) -> dict[str, Any]:
    """The signs at a note, as fields of a `SignedNote`."""
    signs: dict[str, Any] = {}
    marks = {_MARKS[e.tag] for e in note.iterfind("notations/articulations/*") if e.tag in _MARKS}
    if marks:
        signs["marks"] = frozenset(marks)
    for ornaments in note.iterfind("notations/ornaments"):
        for tremolo in ornaments.iterfind("tremolo"):
            is_measured = tremolo.get("type") != "unmeasured"
            strokes = int(number(tremolo.text)) if is_measured else 0
            signs["tremolo"] = Tremolo(strokes, _ROLES.get(tremolo.get("type", ""), Role.ALONE))
        if "ornament" not in signs and (ornament := next(_ornaments(ornaments), None)):
            signs["ornament"] = ornament
    for wave in note.iterfind("notations/arpeggiate"):
        chord = int(number(wave.get("number"))) or None
        signs["arpeggio"] = Arpeggio(chord, _DIRECTIONS.get(wave.get("direction", ""), 1))
    if note.find("notations/non-arpeggiate") is not None:
        signs["arpeggio"] = Arpeggio(step=0)
    slurs = [
        SlurEnd(slur.get("type") == "start", int(number(slur.get("number", "1"))))
        for slur in note.iterfind("notations/slur")
        if slur.get("type") in ("start", "stop")
    ]
    if slurs:
        signs["slurs"] = tuple(slurs)
    return signs


def _ornaments(parent: Element) -> Iterator[Ornament]:
    """Yield the ornaments, each with the accidentals that follow it.

    What is given for playback with one of them is for all, such as with a line after a trill.
    """
    signs = list(parent)
    playback = {k: v for sign in reversed(signs) if sign.tag in _ORNAMENTS for k, v in sign.items()}
    for i, sign in enumerate(signs):
        if sign.tag not in _ORNAMENTS or (sign.tag == "wavy-line" and sign.get("type") == "stop"):
            continue
        kind = _ORNAMENTS[sign.tag]
        altered: dict[str, int | None] = {"above": None, "below": None}
        for mark in islice(signs, i + 1, None):
            if mark.tag != "accidental-mark":
                break
            usual = "below" if kind is OrnamentKind.MORDENT else "above"
            place = mark.get("placement", usual)
            altered[place if place in altered else usual] = _ALTERATIONS.get(
                (mark.text or "").strip()
            )
        yield Ornament(
            kind,
            altered["above"],
            altered["below"],
            begins=_OPENINGS.get(playback.get("start-note", "")),
            delayed=sign.tag.startswith("delayed"),
            long=playback.get("long") == "yes",
            interval=_INTERVALS.get(playback.get("trill-step", "")),
            turn=_INTERVALS.get(playback.get("two-note-turn", "")),
            notes=min(int(number(playback.get("beats"))), _MAX_ORNAMENT),
            accelerates=playback.get("accelerate") == "yes",
        )
