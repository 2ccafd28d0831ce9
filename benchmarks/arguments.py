"""The command lines of benchmarks."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, RawTextHelpFormatter


def parser_for(doc: str | None) -> ArgumentParser:
    """A parser whose help begins with the docstring of a benchmark."""
    return ArgumentParser(description=doc, formatter_class=RawTextHelpFormatter)


def one_or_more(text: str) -> int:
    """The whole number that an option gives.

    Raises:
        ArgumentTypeError: it is less than 1, or no number.
    """
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"{text!r} is no number of 1 or more")
    return int(text)
