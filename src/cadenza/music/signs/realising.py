"""The signs of notes realised: from a score as written to notes as they sound."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction

from cadenza.errors import CadenzaError
from cadenza.music.score import check_end
from cadenza.music.signs.articulation import articulate, slurred_onsets
from cadenza.music.signs.chords import break_chords, play_tremolos, with_signs_of_chords
from cadenza.music.signs.graces import place_graces
from cadenza.music.signs.loudness import within_midi
from cadenza.music.signs.notes import SignedNote, SoundingNote, voices_of
from cadenza.music.signs.ornaments import ornament_notes
from cadenza.music.signs.tempo_map import Swing, TempoMap

MAX_NOTES = 100_000
"""More, with repeats and ornaments, are taken for damage."""


def realised(
    notes: Iterable[SignedNote], tempo: TempoMap, swings: Iterable[Swing] = ()
) -> list[SoundingNote]:
    """The notes as they sound, by their beginnings.

    Notes that no sign concerns begin and end where the tempo map says, to the bit. Grace notes
    before the first beat begin before 0 s.

    Args:
        notes: the notes as written, of all parts.
        tempo: the time of each place in the music.
        swings: where notes swing.

    Raises:
        CadenzaError: there would be more notes than `MAX_NOTES`, or one ends too late for a score.
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
    sounding: list[SoundingNote] = []
    for note in timed:
        note.velocity = within_midi(note.velocity)
        if note.of.ornament is not None and note.of.grace is None:
            for start, end, pitch in ornament_notes(note):
                sounding.append(replace(note, start=start, end=end, pitch=pitch))
        elif note.turns is not None:
            sounding += (replace(note, start=start, end=end) for start, end in note.turns)
        else:
            sounding.append(note)
        if len(sounding) > MAX_NOTES:
            raise CadenzaError(
                f"over {MAX_NOTES} notes with all ornaments and repeats, too many; read the song "
                "as plain"
            )
    return sorted(sounding, key=lambda note: (note.start, note.pitch))


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
    """Where notes begin and end that are to swing.

    As in MuseScore, only the middle of a pair moves, and not where shorter notes fill the pair.

    Args:
        swings: where the rhythm changes.
        notes: all notes, to know which pairs have shorter ones.
    """

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
