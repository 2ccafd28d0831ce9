"""What to try next follows from what went wrong most."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from cadenza.agents.planner.misses import Miss
from cadenza.music.score import Note, Score
from cadenza.performing.advice import advice
from cadenza.performing.performance import play

EARLY = ["finger needed elsewhere"] * 30


def said(
    missed: Sequence[str],
    early: Sequence[str],
    f1: float,
    hands: str = "both",
    arranged: bool = False,
) -> str | None:
    misses = [
        Miss(0.0, "C4", None, "", cause, "", sounded)
        for causes, sounded in ((missed, False), (early, True))
        for cause in causes
    ]
    settings = {"task": {"stretch": 1.0}, "scene": {"hands": hands}}
    return advice(misses, 100, f1, settings, arranged)


@pytest.mark.parametrize(
    ("missed", "early", "f1", "hands", "arranged", "option"),
    [
        (["no finger"] * 12, EARLY, 0.95, "both", False, "--level 10"),
        (["no finger"] * 12, [], 0.7, "right", False, "--hands both"),
        (["no finger"] * 12, [], 0.7, "both", True, "--stretch 1.5"),
        (["too fast to get there", "no finger"] * 4, EARLY, 0.8, "both", False, "--stretch 1.5"),
        ([], EARLY, 0.8, "right", False, "--stretch 1.5"),
    ],
)
def test_an_option_is_named_that_helps_against_most_of_what_was_missed(
    missed: Sequence[str], early: Sequence[str], f1: float, hands: str, arranged: bool, option: str
) -> None:
    line = said(missed, early, f1, hands, arranged)
    assert line is not None
    assert f"({option})" in line
    assert line.startswith(f"{len(missed)} of 100 notes were missed")


def test_what_is_played_well_needs_no_advice() -> None:
    assert said(["no finger"] * 9, EARLY, 0.93) is None
    assert said([], [], 0.5) is None  # who plays has no plan to tell by


def test_advice_is_among_the_remarks() -> None:
    """Of a chord of twelve keys, the hands have fingers for ten."""
    chords = tuple(Note(at, at + 0.4, pitch) for at in (0.0, 0.5) for pitch in range(60, 72))
    played = play(Score(chords))
    assert played.advice is not None
    assert played.advice in played.remarks
    assert "--level 10" in played.advice
