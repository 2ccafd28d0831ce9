"""The colours and names of keys, by pitch: middle C is 60."""

from __future__ import annotations

_NAMES = ("C", "C♯", "D", "D♯", "E", "F", "F♯", "G", "G♯", "A", "A♯", "B")


def is_black(pitch: int) -> bool:
    """Whether the key of a MIDI pitch is black."""
    return "♯" in _NAMES[pitch % 12]


def note_name(pitch: int) -> str:
    """Such as C4 for the middle C; black keys by their sharps."""
    return f"{_NAMES[pitch % 12]}{pitch // 12 - 1}"
