"""Titles of songs, as text that a terminal and a page can show."""

from __future__ import annotations

import os
from pathlib import Path

_LONGEST = 500  # letters


def printable(text: str) -> str:
    """`text` on one line, without characters that cannot be printed, and shortened."""
    if not text.isprintable():
        text = "".join(c if c.isprintable() else " " for c in text)
    return " ".join(text.split())[:_LONGEST].rstrip()


def title_of(path: Path) -> str:
    """The file's name without its suffix, with a mark for each byte that is not UTF-8."""
    return printable(os.fsencode(path.stem).decode("utf-8", "replace"))
