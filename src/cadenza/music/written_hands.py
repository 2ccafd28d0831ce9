"""The hand that a note is written for, by the fingers of a score, its staves or its tracks."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from statistics import median

from cadenza.fingers import LEFT, RIGHT, SIDES
from cadenza.music.score import Note, Score, Track

_NAMED = {
    RIGHT: r"right( ?hand)?|r\.? ?h|rechte?( ?hand)?|droite|destra",
    LEFT: r"left( ?hand)?|l\.? ?h|linke?s?( ?hand)?|gauche|sinistra",
}
"""How a track is called if nothing else can be meant than a hand."""
_ALONE = {RIGHT: r"upper|up|treble|m\.? ?d", LEFT: r"lower|down|bass|m\.? ?[gs]"}
"""How a hand's track may be called if there is only the other hand's beside it."""
_SAYS_NOTHING = "", "piano", "pianoforte", "klavier", "staff", "track", "part", "channel"
_LOWER = 7  # semitones by which the left hand's track is lower, by its median: a fifth
_FINGERED = 0.9  # share of notes with fingers from which on fingers say which hand plays what
_PARTS = "|".join((*_NAMED.values(), *_ALONE.values(), *filter(None, _SAYS_NOTHING)))


def names_only_a_part(name: str) -> bool:
    """Whether the name of a track says no more than which hand, staff or channel it is."""
    letter = r"[^\W\d_]"
    rest, count = re.subn(rf"(?<!{letter})({_PARTS}|hand|main)(?!{letter})", "", name.lower())
    return bool(count) and not re.search(letter, rest)


def with_written_hands(score: Score) -> Score:
    """The score whose notes know which hand plays them as written, where anything says so.

    The first of these sources counts: fingers, if nearly all notes have one; the hands that the
    reader gives, as from the staves of a part for two hands; two tracks of a keyboard, one for each
    hand. Tracks differ by name, such as "RH" and "LH", or else by pitch, if one is clearly lower.
    Several parts for two hands, such as those of a duet, give no hands.
    """
    if sum(note.finger is not None for note in score.notes) >= _FINGERED * len(score.notes):
        return _with_hands(score, [(n.finger.hand,) if n.finger else () for n in score.notes])
    parts = {note.tracks for note in score.notes if note.hands and len(note.tracks) <= 1}
    if parts:
        return score if len(parts) == 1 else _with_hands(score, [()] * len(score.notes))
    hands = _hands_of_tracks(score)
    hands_of_notes = (
        {hands[number] for number in note.tracks if number in hands} for note in score.notes
    )
    return _with_hands(score, map(tuple, map(sorted, hands_of_notes)))


def _with_hands(score: Score, hands: Iterable[tuple[int, ...]]) -> Score:
    notes = zip(score.notes, hands, strict=True)
    return replace(score, notes=tuple(replace(note, hands=each) for note, each in notes))


def _hands_of_tracks(score: Score) -> dict[int, int]:
    """The hands of tracks by their numbers; none if the tracks are not those of two hands."""
    # MusicXML tells no instruments beside the names of parts.
    tracks = [each for each in score.tracks if each.is_keyboard or each.channel is None]
    if hands := _by_name(tracks, _NAMED):
        return hands
    numbers = {number for note in score.notes for number in note.tracks}
    together = [each for each in score.tracks if each.number in numbers]
    if len(together) != len(SIDES) or any(each not in tracks for each in together):
        return {}
    return _by_name(together, _ALONE) or _by_pitch(together, score.notes)


def _by_name(tracks: Sequence[Track], names: Mapping[int, str]) -> dict[int, int]:
    """The hands of tracks whose names say so, if there is one pair of hands."""
    hands: dict[int, int] = {}
    rests: dict[int, set[str]] = {RIGHT: set(), LEFT: set()}
    for track in tracks:
        for hand, words in names.items():
            rest, count = re.subn(rf"(?<![a-z])({words})(?![a-z])", "", track.name.lower())
            if count:
                hands[track.number] = hand
                rests[hand].add(re.sub(r"[\W_]", "", rest))
    one_pair = all(rests.values()) and len(rests[RIGHT] & rests[LEFT]) <= 1
    return hands if one_pair else {}


def _by_pitch(tracks: Sequence[Track], notes: Sequence[Note]) -> dict[int, int]:
    """The hands of two tracks by their pitches, if their names say nothing else."""
    upper, lower = sorted(tracks, key=lambda each: each.highest, reverse=True)
    names = {re.sub(r"[\W\d_]", "", each.name.lower()) for each in tracks}
    middle = {
        each.number: median(note.pitch for note in notes if each.number in note.tracks)
        for each in tracks
    }
    is_lower = middle[upper.number] - middle[lower.number] >= _LOWER and lower.lowest < upper.lowest
    if not is_lower or (len(names) > 1 and not names.issubset(_SAYS_NOTHING)):
        return {}
    return {upper.number: RIGHT, lower.number: LEFT}
