"""What the options of benchmarks are checked by."""

from __future__ import annotations

from argparse import ArgumentTypeError


def one_or_more(text: str) -> int:
    """A whole number, 1 or more."""
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"{text!r} is no number of 1 or more")
    return int(text)
