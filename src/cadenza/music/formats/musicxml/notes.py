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
    number_or_none,
    passes_of,
)
from cadenza.music.score import NATURALS, OCTAVE, STEPS
from cadenza.music.signs.notes import Grace, SignedNote

_FINGERS = "12345"
_OTHER_STAVES = frozenset(("ossia", "cue", "editorial", "alternate"))


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
    """So many steps and semitones an instrument sounds higher than it is written.

    It also sounds `doubled` semitones higher than that, if not 0.
    """

    steps: int = 0
    semitones: int = 0
    doubled: int = 0


def notes_of(
    part: Sequence[Placed],
    track: int,
    silence: Callable[[Placed], str],
    plain: bool,
    counts: Counter[str],
) -> list[WrittenNote]:
    """The notes of a part that sound; others are added to `counts`.

    Args:
        part: its elements.
        track: its number.
        silence: why the instrument of a note is not heard, as a name in `counts`; "" if it is.
        plain: whether notes are without their signs, as they stand.
        counts: the numbers of notes that are left out or changed, by what they are.
    """
    written = [placed for placed in part if placed.element.tag == "note"]
    loudness = PartLoudness(part, plain)
    key = attribute(part, "key", lambda each: int(number(each.findtext("fifths"))), 0)
    transposition = attribute(part, "transpose", _transposition, _Transposition())
    is_other = attribute(part, "staff-details[staff-type]", _is_other_staff, before=False)
    is_slashed = attribute(part, "measure-style[slash]", _is_slashed, before=False)
    others = [is_other(placed) for placed in written]
    graces, hand_of = _graces(written), hands_of(part, others)
    found: list[WrittenNote] = []
    for index, placed in enumerate(written):
        note, hand, grace = placed.element, hand_of[index], graces.get(index)
        if note.find("cue") is not None or note.find("rest") is not None:
            continue
        is_slash = note.findtext("notehead", "").strip() == "slash" or is_slashed(placed)
        velocity = loudness.velocity(placed)
        why = "other staff" if others[index] else silence(placed)
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
        signed = SignedNote(
            onset=placed.quarter,
            duration=_shown_length(note) if grace else placed.duration,
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
            **signs_of(note),
        )
        tied, ties = _ties(note)
        signed = signed.plain if plain else signed
        found.append(WrittenNote(placed.measure, signed, tied, ties, passes_of(note)))
        if shift.doubled:
            octave = replace(signed, pitch=signed.pitch + shift.doubled, finger=None)
            found.append(replace(found[-1], signed=octave))
    return found


def _is_other_staff(details: Element) -> bool:
    """Whether a staff has what may be played instead of another, or is for reference only."""
    return details.findtext("staff-type", "").strip() in _OTHER_STAVES


def _is_slashed(style: Element) -> bool:
    """Whether slashes stand for notes from a style of measures on."""
    return style.find("slash[@type='start']") is not None


def _written_pitch(note: Element, counts: Counter[str]) -> tuple[int, int] | None:
    """The pitch of a note: its number among the white keys, C0 being 0, and in MIDI.

    It is None for what has no pitch that can be read.
    """
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
    octave, within = divmod(step, len(STEPS))
    return NATURALS[within] + OCTAVE * (octave + 1)


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
        digit = re.search("[0-9]", sign.text or "")
        counts["fingering"] += digit is None
        if digit and digit[0] in _FINGERS and hand is not None:
            return Finger(hand, int(digit[0]) - 1)
    return None
