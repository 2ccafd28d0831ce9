"""The notes of a part, as they are written."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple
from xml.etree.ElementTree import Element

from cadenza.fingers import Finger
from cadenza.music.formats.musicxml.dynamics import PartLoudness
from cadenza.music.formats.musicxml.hands import hands_of
from cadenza.music.formats.musicxml.note_signs import signs_of
from cadenza.music.formats.musicxml.timeline import (
    Placed,
    attribute,
    exact,
    length_of,
    number,
    passes_of,
)
from cadenza.music.score import NATURALS, OCTAVE, STEPS
from cadenza.music.signs.signed_note import Grace, SignedNote

_OCTAVES = re.compile(r"-?\d{1,2}")
_FINGERS = "12345"


@dataclass(frozen=True, slots=True)
class WrittenNote:
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
    """So many steps and semitones an instrument sounds higher than it is written."""

    steps: int
    semitones: int


def notes_of(
    part: Sequence[Placed],
    track: int,
    is_drum: Callable[[Element], bool],
    plain: bool,
    counts: Counter[str],
) -> list[WrittenNote]:
    """The notes of a part that sound; others are added to `counts`.

    Args:
        part: its elements.
        track: its number.
        is_drum: whether a note belongs to the drums.
        plain: whether notes are without their signs, as they stand.
        counts: the numbers of notes that are left out or changed, by what they are.
    """
    written = [placed for placed in part if placed.element.tag == "note"]
    loudness = PartLoudness(part, plain)
    key = attribute(part, "key", lambda each: int(number(each.findtext("fifths"))), 0)
    transposition = attribute(part, "transpose", _transposition, _Transposition(0, 0))
    graces, hand_of = _graces(written), hands_of(part)
    found: list[WrittenNote] = []
    for index, placed in enumerate(written):
        note, hand, grace = placed.element, hand_of[index], graces.get(index)
        pitch = _written_pitch(note, is_drum, counts)
        if pitch is None:
            continue
        shift, (step, semitones) = transposition(placed), pitch
        natural = _natural(step + shift.steps)
        sounds = semitones + shift.semitones
        signed = SignedNote(
            onset=placed.quarter,
            duration=_shown_length(note) if grace else placed.duration,
            pitch=sounds,
            velocity=loudness.velocity(placed),
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
            **signs_of(note),
        )
        tied, ties = _ties(note)
        signed = signed.plain if plain else signed
        found.append(WrittenNote(placed.measure, signed, tied, ties, passes_of(note)))
    return found


def _written_pitch(
    note: Element, is_drum: Callable[[Element], bool], counts: Counter[str]
) -> tuple[int, int] | None:
    """The pitch of a note that is played: its number among the white keys, C0 being 0, and in MIDI.

    It is None for a rest, a cue and what has no pitch that can be read.
    """
    if note.find("cue") is not None or note.find("rest") is not None:
        return None
    if is_drum(note):
        counts["drums"] += 1
        return None
    counts["unpitched"] += note.find("unpitched") is not None
    pitch = note.find("pitch")
    if pitch is None:
        return None
    step, octave = (pitch.findtext(tag, "").strip() for tag in ("step", "octave"))
    if step not in [*STEPS] or not _OCTAVES.fullmatch(octave):
        counts["unreadable"] += 1
        return None
    alter = number(pitch.findtext("alter"))
    counts["microtone"] += alter.denominator > 1
    key = STEPS.index(step) + len(STEPS) * int(octave)
    return key, _natural(key) + round(alter)


def _natural(step: int) -> int:
    """The MIDI pitch of a white key, C0 being 0."""
    octave, within = divmod(step, len(STEPS))
    return NATURALS[within] + OCTAVE * (octave + 1)


def _transposition(transpose: Element) -> _Transposition:
    octaves = int(number(transpose.findtext("octave-change")))
    semitones = int(number(transpose.findtext("chromatic")))
    steps = int(number(transpose.findtext("diatonic"))) or round(semitones * 7 / 12)
    return _Transposition(steps + 7 * octaves, semitones + OCTAVE * octaves)


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
        before = waiting[placed.voice]
        if grace is not None:
            index = graces[before[-1]].index + (not is_chord) if before else 0
            graces[i] = _grace(grace, index, placed)
            before.append(i)
        elif not is_chord:
            for each in before if note.find("rest") is None else ():
                graces[each] = replace(graces[each], after=False)
            before.clear()
    return graces


def _grace(grace: Element, index: int, placed: Placed) -> Grace:
    """A grace note that leads to no note yet."""
    shares = [grace.get(f"steal-time-{where}") for where in ("previous", "following")]
    previous, following = (None if each is None else float(number(each)) / 100 for each in shares)
    made = grace.get("make-time")
    takes = None if made is None else exact(number(made) / placed.divisions)
    return Grace(index, grace.get("slash") == "yes", previous, following, takes, after=True)


def _shown_length(note: Element) -> Fraction:
    """The length of a note by its shape [quarters]; 0 if unknown."""
    return length_of(note.findtext("type", ""), len(note.findall("dot")))


def _ties(note: Element) -> tuple[bool, bool]:
    """Whether a tie leads to the note, and one on from it."""
    kinds = {tie.get("type") for tie in (*note.iterfind("tie"), *note.iterfind("notations/tied"))}
    return "stop" in kinds or "continue" in kinds, "start" in kinds or "continue" in kinds


def _finger(note: Element, hand: int | None, counts: Counter[str]) -> Finger | None:
    """The finger of a note that a hand plays, the first where several are written."""
    for sign in note.iterfind("notations/technical/fingering"):
        digit = re.search(r"\d", sign.text or "")
        counts["fingering"] += digit is None
        if digit and digit[0] in _FINGERS and hand is not None:
            return Finger(hand, int(digit[0]) - 1)
    return None
