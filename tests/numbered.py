"""Fingers of five-fingered hands by the numbers that they have in arrays and files."""

from cadenza.fingers import Finger, Fingers
from cadenza.music.score import Note, Score

FIVE = Fingers(per_hand=5)


def finger(number: int) -> Finger | None:
    """0..4 right thumb to little, 5..9 left, -1 none."""
    return FIVE.finger(number)


def recorded_note(start: float, end: float, pitch: int, velocity: int, number: int) -> Note:
    """As tests/data/songs.json has it."""
    return Note(start, end, pitch, velocity, finger(number))


def numbers(score: Score) -> list[int]:
    """Of the finger of each note."""
    return [FIVE.number(note.finger) for note in score.notes]
