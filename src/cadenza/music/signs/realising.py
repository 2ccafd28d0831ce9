"""The signs of notes and chords realised: from a score as written to notes as they sound."""

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import zip_longest

from cadenza.errors import CadenzaError
from cadenza.music.score import check_end
from cadenza.music.signs import (
    ACCENT,
    ARPEGGIO_STEP,
    BREATH,
    MARCATO,
    NOTES_A_SECOND,
    PHRASE_LIFT,
    PORTATO,
    STACCATISSIMO,
    STACCATO,
    STRONG_ACCENT,
)
from cadenza.music.signs.loudness import within_midi
from cadenza.music.signs.notes import (
    Chord,
    Mark,
    Role,
    SignedNote,
    SoundingNote,
    Times,
    Voice,
    even_times,
    voices_of,
)
from cadenza.music.signs.ornaments import ornament_notes, place_graces
from cadenza.music.signs.tempo_map import Swing, TempoMap

MAX_NOTES = 100_000  # more, with repeats and ornaments, are taken for damage


def realised(
    notes: Iterable[SignedNote], tempo: TempoMap, swings: Iterable[Swing] = ()
) -> list[SoundingNote]:
    """The notes of all parts as they sound, by their beginnings.

    Notes that no sign concerns begin and end where the tempo map says, to the bit. Grace notes
    before the first beat begin before 0 s. Raises CadenzaError if there would be more notes than
    `MAX_NOTES`, or one ends too late for a score.
    """
    notes = with_signs_of_chords(list(notes))
    timed = _timed(notes, tempo, swings)
    voices = voices_of(timed)
    slurred = slurred_onsets(notes)
    for voice in voices:
        place_graces(voice, tempo)
    break_chords(timed)
    for voice in voices:
        articulate(voice, slurred.get((voice.part, voice.name), set()))
        play_tremolos(voice)
    sounding_notes: list[SoundingNote] = []
    for note in timed:
        note.velocity = within_midi(note.velocity)
        if note.of.ornament is not None and note.of.grace is None:
            for start, end, pitch in ornament_notes(note):
                sounding_notes.append(replace(note, start=start, end=end, pitch=pitch))
        elif note.turns is not None:
            sounding_notes += (replace(note, start=start, end=end) for start, end in note.turns)
        else:
            sounding_notes.append(note)
        if len(sounding_notes) > MAX_NOTES:
            raise CadenzaError(
                f"over {MAX_NOTES} notes with all ornaments and repeats, too many; read the song "
                "as plain"
            )
    return sorted(sounding_notes, key=lambda note: (note.start, note.pitch))


def _timed(
    notes: Sequence[SignedNote], tempo: TempoMap, swings: Iterable[Swing]
) -> list[SoundingNote]:
    """The notes at their written times, which swing and the file's own shifts change."""
    if not notes:
        return []
    swung = _SwungTimes(swings, notes)
    starts = tempo.onsets([swung.moved(note, note.onset) + note.attack for note in notes])
    ends = tempo.ends([swung.moved(note, note.end) + note.release for note in notes])
    check_end(float(max(ends)))  # before ornaments and tremolos fill hours with notes
    return [
        SoundingNote(note, start, end, note.pitch, note.velocity)
        for note, start, end in zip(notes, starts.tolist(), ends.tolist(), strict=True)
    ]


class _SwungTimes:
    """Where notes swing: as in MuseScore, the middle of a pair that no shorter notes fill."""

    def __init__(self, swings: Iterable[Swing], notes: Iterable[SignedNote]) -> None:
        self._swings = sorted(swings, key=lambda swing: swing.onset)
        self._filled: set[tuple[int, str, Fraction]] = set()
        for note in notes:
            swing = self._at(note.onset)
            if swing is not None and note.grace is None and note.duration < swing.unit:
                self._filled.add((note.part, note.voice, _pair(swing, note.onset)))

    def moved(self, note: SignedNote, place: Fraction) -> Fraction:
        """The place [quarters] where a note begins or ends that is written at `place`."""
        swing = self._at(place)
        if swing is None or swing.first == swing.second:
            return place
        begin = _pair(swing, place)
        if place - begin != swing.unit or (note.part, note.voice, begin) in self._filled:
            return place
        return begin + 2 * swing.unit * Fraction(swing.first, swing.first + swing.second)

    def _at(self, place: Fraction) -> Swing | None:
        index = bisect_right(self._swings, place, key=lambda swing: swing.onset)
        return self._swings[index - 1] if index else None


def _pair(swing: Swing, place: Fraction) -> Fraction:
    """The beginning of the pair in which a place lies."""
    pair = 2 * swing.unit
    return swing.beat + (place - swing.beat) // pair * pair


# Articulation

_MAX_LIFTED = 0.5  # share of a note by which it ends earlier at most


def articulate(voice: Voice, slurred: set[Fraction]) -> None:
    """Give the chords of a voice their lengths and velocities, `slurred` as `slurred_onsets` says.

    Notes last as long as they are written, if no sign says otherwise. Under a slur they last to the
    next note, even where that is late.
    """
    in_slur, chords = False, list(voice.chords.values())
    for chord, following in zip_longest(chords, chords[1:]):
        was_in_slur, in_slur = in_slur, chord[0].of.onset in slurred
        for note in chord:
            share = _share(note.of.marks, in_slur or was_in_slur)
            if share < 1:
                note.end_by(note.start + share * note.length)
            elif in_slur:
                _join(note, following)
            elif was_in_slur:
                _lift(note, PHRASE_LIFT)
            if Mark.BREATH in note.of.marks:
                _lift(note, BREATH)
            note.velocity *= _loudness(note.of.marks)


def slurred_onsets(notes: Iterable[SignedNote]) -> dict[tuple[int, str], set[Fraction]]:
    """Voices, by part and name -> the onsets of chords from which a slur leads to the next.

    A slur goes through the voice in which it begins. One that does not end, or ends before it
    begins, has no meaning.
    """
    onsets: dict[tuple[int, str], set[Fraction]] = {}
    ends: list[tuple[Fraction, bool, int, tuple[int, str]]] = []
    for note in notes:
        voice = note.part, note.voice
        if note.grace is None:
            onsets.setdefault(voice, set()).add(note.onset)
        ends += ((note.onset, end.begins, end.number, voice) for end in note.slurs)
    spans: dict[tuple[int, str], list[tuple[Fraction, Fraction]]] = {}
    starts: dict[tuple[int, int], tuple[Fraction, tuple[int, str]]] = {}
    for onset, begins, number, voice in sorted(ends):  # at one place, ends first
        if begins:
            starts[voice[0], number] = onset, voice
        elif (start := starts.pop((voice[0], number), None)) is not None:
            spans.setdefault(start[1], []).append((start[0], onset))
    return {
        voice: _onsets_within(sorted(onsets[voice]), spans[voice])
        for voice in spans
        if voice in onsets
    }


def _onsets_within(onsets: list[Fraction], spans: list[tuple[Fraction, Fraction]]) -> set[Fraction]:
    """The `onsets`, sorted, that lie in any of the spans, which do not contain their ends."""
    onsets_inside: set[Fraction] = set()
    spans.sort()
    reach, span = Fraction(0), 0
    for onset in onsets:
        while span < len(spans) and spans[span][0] <= onset:
            reach = max(reach, spans[span][1])
            span += 1
        if span and onset < reach:
            onsets_inside.add(onset)
    return onsets_inside


def _share(marks: frozenset[Mark], slurred: bool) -> float:
    """The length of a note with these marks, as a share of the written one."""
    if Mark.STACCATISSIMO in marks:
        return STACCATISSIMO
    if Mark.PORTATO in marks:
        return PORTATO
    if Mark.STACCATO in marks:
        return PORTATO if slurred or Mark.TENUTO in marks else STACCATO
    if Mark.STRONG_ACCENT in marks and not slurred and Mark.TENUTO not in marks:
        return MARCATO
    return 1.0


def _loudness(marks: frozenset[Mark]) -> float:
    """The velocity of a note with these marks, as a multiple of that of others."""
    if Mark.STRONG_ACCENT in marks:
        return STRONG_ACCENT
    return ACCENT if Mark.ACCENT in marks else 1.0


def _join(note: SoundingNote, following: Chord | None) -> None:
    """Have a note last until the next chord of its voice begins, if it is written so."""
    if following and following[0].of.onset == note.of.end and not note.cut:
        note.end = max(note.end, min(each.start for each in following))


def _lift(note: SoundingNote, seconds: float) -> None:
    """End a note earlier by a time [s], or half of it."""
    note.end_by(note.end - min(seconds, _MAX_LIFTED * note.length))


# Chords


def with_signs_of_chords(notes: Sequence[SignedNote]) -> list[SignedNote]:
    """The notes, in their order, each with the signs that its chord has.

    Articulations and tremolos are for all notes of a chord in one voice, and so is the sign of an
    arpeggio. An ornament that one of them has is for the highest, as it stands above the chord.
    """
    chords = defaultdict[tuple[int, str, Fraction], list[int]](list)
    for index, note in enumerate(notes):
        if note.grace is None:
            chords[note.part, note.voice, note.onset].append(index)
    signed = list(notes)
    for chord in chords.values():
        if len(chord) > 1:
            for index, note in zip(chord, _shared([notes[i] for i in chord]), strict=True):
                signed[index] = note
    return signed


def _shared(chord: Sequence[SignedNote]) -> list[SignedNote]:
    marks = frozenset(mark for note in chord for mark in note.marks)
    tremolo = next((note.tremolo for note in chord if note.tremolo), None)
    arpeggio = next((note.arpeggio for note in chord if note.arpeggio), None)
    shared = [
        replace(
            note, marks=marks, tremolo=note.tremolo or tremolo, arpeggio=note.arpeggio or arpeggio
        )
        for note in chord
    ]
    ornaments = [note.ornament for note in chord if note.ornament]
    if len(ornaments) == 1:
        shared = [replace(note, ornament=None) for note in shared]
        top = max(range(len(chord)), key=lambda index: chord[index].pitch)
        shared[top] = replace(shared[top], ornament=ornaments[0])
    return shared


_MAX_OF_CHORD = 0.5  # share of the shortest note within which the last one begins; a choice


def break_chords(notes: Iterable[SoundingNote]) -> None:
    """Have notes with an arpeggio sign begin one after the other, the first of them on the beat.

    All last as long as they are written (Gehrkens); that the first is on the beat is a choice.
    """
    groups = defaultdict[tuple[Fraction, int, int | None, int], Chord](list)
    for note in notes:
        sign = note.of.arpeggio
        if sign is not None and sign.step and note.of.grace is None:
            staff = note.of.staff if sign.number is None else 0
            groups[note.of.onset, note.of.part, sign.number, staff].append(note)
    for chord in groups.values():
        step = chord[0].of.arpeggio.step if chord[0].of.arpeggio else 1
        chord.sort(key=lambda note: step * note.of.pitch)
        start = max(note.start for note in chord)
        room = _MAX_OF_CHORD * min(note.end for note in chord) - _MAX_OF_CHORD * start
        each = min(ARPEGGIO_STEP, max(room, 0.0) / max(len(chord) - 1, 1))
        for place, note in enumerate(chord):
            note.start = start + place * each


_UNMEASURED = 3  # marks, as a tremolo without measure has none
_MAX_MARKS = 8  # as in MusicXML


def play_tremolos(voice: Voice) -> None:
    """Give the notes of a voice with a tremolo their turns.

    A tremolo is measured: each of its marks halves the value of its notes, from eighths on. Where
    they would follow each other faster than `NOTES_A_SECOND`, they are as fast as that.
    """
    first: Chord | None = None
    for chord in voice.chords.values():
        sign = chord[0].of.tremolo
        role = sign.role if sign else None
        for note in chord if role is Role.ALONE else ():
            assert note.of.tremolo is not None  # as the whole chord has it
            count = _count(note.of.duration, note.of.tremolo.marks)
            note.turns = _even(note.start, note.end, count)
        if role is Role.SECOND and first is not None:
            _alternate(first, chord)
        first = chord if role is Role.FIRST else None


def _alternate(first: Chord, second: Chord) -> None:
    """Have two chords take turns."""
    sign = first[0].of.tremolo
    assert sign is not None
    start, end = min(note.start for note in first), max(note.end for note in second)
    count = _count(first[0].of.duration + second[0].of.duration, sign.marks)
    times = _even(start, end, max(count, 2), times=2)
    for chord, turns in ((first, times[::2]), (second, times[1::2])):
        for note in chord:
            note.turns = turns


def _count(duration: Fraction, marks: int) -> int:
    """The number of notes of a tremolo, by how many quarters it lasts."""
    if duration <= 0:
        return 1
    value = duration * _as_shown(duration)
    strokes = 2 ** min(marks or _UNMEASURED, _MAX_MARKS)
    return max(1, round(value * strokes if value >= 1 else strokes * (value * _undotted(value))))


def _as_shown(duration: Fraction) -> Fraction:
    """What a length in a tuplet is multiplied by to be the one that its notes show: 3/2 of 3."""
    odd = duration.denominator
    while odd % 2 == 0:
        odd //= 2
    return Fraction(odd, 1 << (odd.bit_length() - 1))


def _undotted(value: Fraction) -> int:
    """How many of the value of a flagged note, without its dots, are in a quarter."""
    parts = 1
    while Fraction(1, parts) > value:
        parts *= 2
    return parts


def _even(start: float, end: float, count: int, times: int = 1) -> Times:
    """So many even notes between two times [s], fewer if too fast; a multiple of `times`."""
    max_count = max(int((end - start) * NOTES_A_SECOND + 1e-9), 1)
    return even_times(start, end, max(min(count, max_count) // times, 1) * times)
