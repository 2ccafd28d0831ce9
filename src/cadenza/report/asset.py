"""The files that pages are made of."""

from __future__ import annotations

from importlib import resources


def asset(name: str) -> str:
    """The text of a file of `assets`."""
    return resources.files("cadenza.report").joinpath("assets", name).read_text("utf-8")
