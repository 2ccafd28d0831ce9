"""A sentence tells how a song was played, and what to try follows from what went wrong most."""

import re
from collections.abc import Sequence
from dataclasses import replace

import pytest

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.misses import Miss
from cadenza.agents.planner.planner import Planner
from cadenza.music.metrics import expressive_metrics
from cadenza.music.score import Note, Score
from cadenza.performing.performance import play
from cadenza.performing.verdict import Advice, advice, verdict

EARLY = ["finger needed elsewhere"] * 30


def advice_for(
    missed: Sequence[str],
    early: Sequence[str],
    f1: float,
    hands: str = "both",
    arranged: bool = False,
) -> Advice | None:
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
    missed, early, f1, hands, arranged, option
):
    tip = advice_for(missed, early, f1, hands, arranged)
    assert tip is not None
    assert tip.option == option
    assert str(tip).endswith(f" ({option})")


def test_what_is_played_well_needs_no_advice():
    assert advice_for(["no finger"] * 9, EARLY, 0.93) is None
    assert advice_for([], [], 0.5) is None  # who plays has no plan to tell by


def test_advice_is_among_the_notices():
    """Of a chord of twelve keys, the hands have fingers for ten."""
    chords = tuple(Note(at, at + 0.4, pitch) for at in (0.0, 0.5) for pitch in range(60, 72))
    played = play(Score(chords), Planner(PlannerConfig(method="none")))
    assert played.advice is not None
    assert played.settings["notices"] == [f"{played.advice}."]
    assert played.advice.option == "--level 10"
    counts = re.match(r"(\d+) of 24 notes in time \(within 50 ms\), (\d+) missed, ", played.verdict)
    assert counts
    assert int(counts[1]) + int(counts[2]) == 24


WRITTEN = Score(tuple(Note(at, at + 0.4, pitch, 70) for at, pitch in enumerate(range(60, 70))))


def performed(*changed: Note, late: float = 0.0, louder: int = 0, first: int = 0) -> Score:
    """What is written from its note `first` on, later and louder, and other notes."""
    notes = (
        replace(n, start=n.start + late, end=n.end + late, velocity=n.velocity + louder)
        for n in WRITTEN.notes[first:]
    )
    return Score((*changed, *notes))


@pytest.mark.parametrize(
    ("played", "sentence"),
    [
        (
            performed(),
            "All 10 notes in time (within 50 ms), evenly timed to 0 ms, loudness as written.",
        ),
        (
            performed(Note(0.06, 0.4, 60, 70), Note(2, 2.2, 50, 70), first=2, louder=9),
            "8 of 10 notes in time (within 50 ms), 1 early or late, 1 missed, 1 note that nobody "
            "wrote, evenly timed to 0 ms, loudness half a step off what is written (mp to mf is a "
            "step).",
        ),
        (
            performed(late=0.03, louder=20),
            "All 10 notes in time (within 50 ms), evenly timed to 0 ms, 30 ms late throughout, "
            "loudness a step or more off what is written (mp to mf is a step).",
        ),
        (Score(()), "0 of 10 notes in time (within 50 ms), 10 missed."),
    ],
)
def test_a_sentence_counts_notes_and_tells_of_time_and_loudness(played, sentence):
    assert verdict(played, WRITTEN, expressive_metrics(played, WRITTEN)) == sentence
