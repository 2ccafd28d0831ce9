"""Grades of difficulty, against plain loops and against what pianists call easy or hard."""

import itertools
import tomllib
from dataclasses import astuple, replace
from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.stats import spearmanr

from cadenza.errors import CadenzaError
from cadenza.fingering.difficulty import FITTED, features_of, grade
from cadenza.music import libraries
from cadenza.music.etudes import KINDS, make_etude
from cadenza.music.libraries.library import load_score, songs
from cadenza.music.score import Note, Score, is_black
from music_strategies import scores
from numbered import finger
from players import find_fingering, shadow_hands

FINGER_TO_FINGER = 12 / 7


def moments_of(notes: list[Note]) -> list[list[Note]]:
    """Notes that begin within 0.03 s of the first of them."""
    moments: list[list[Note]] = []
    for note in notes:
        if moments and note.start <= moments[-1][0].start + 0.03:
            moments[-1].append(note)
        else:
            moments.append([note])
    return moments


def by_loops(score: Score) -> tuple[float, ...]:
    """The features, note by note. Moments are those of both hands together."""
    notes = list(score.notes)
    seconds = max(n.end for n in notes) - notes[0].start
    moments = moments_of(notes)
    times = sorted({t for n in notes for t in (n.start, n.end)})
    counts = [
        (b - a, sum(n.start <= a and n.end >= b for n in notes))
        for a, b in itertools.pairwise(times)
    ]
    down = sum(length * count for length, count in counts)
    any_down = sum(length for length, count in counts if count)
    spread = travel = crossings = hurry = 0.0
    for hand in (0, 1):
        outward = 1 if hand == 0 else -1
        own = [[n for n in m if n.finger and n.finger.hand == hand] for m in moments]
        own = [m for m in own if m]
        spread += sum(max(n.pitch for n in m) - min(n.pitch for n in m) for m in own)
        stands = [
            np.mean([n.pitch - outward * FINGER_TO_FINGER * n.finger.index for n in m]) for m in own
        ]
        travel += sum(abs(b - a) for a, b in itertools.pairwise(stands))
        for one, other in itertools.pairwise(own):
            a, b = one[-1], other[0]
            way = outward * (b.pitch - a.pitch) * (b.finger.index - a.finger.index)
            crossings += b.start - a.start < 0.5 and way < 0
    for used in {n.finger for n in notes if n.finger}:
        for a, b in itertools.pairwise([n for n in notes if n.finger == used]):
            if a.pitch != b.pitch:
                hurry += min(max(1 - (b.start - a.end) / 0.3, 0.0), 1.0)
    black = sum(is_black(n.pitch) for n in notes)
    total = len(notes)
    return (
        total / seconds,
        total / len(moments) - 1,
        down / any_down - 1,
        spread / total,
        travel / seconds,
        hurry / total,
        crossings / seconds,
        black / total,
    )


@settings(deadline=None)
@given(scores())
def test_features_are_those_of_plain_loops(score):
    np.testing.assert_allclose(astuple(features_of(score)), by_loops(score), atol=1e-9)


@settings(deadline=None)
@given(scores())
def test_grades_go_from_1_to_10_and_faster_is_never_easier(score):
    given_fingers = Score(tuple(replace(n, finger=n.finger or finger(0)) for n in score.notes))
    slow, fast = (FITTED.grade(features_of(given_fingers.stretched(by))) for by in (1.0, 0.5))
    assert slow >= 1
    assert fast <= 10
    # Moments that begin within 0.03 s become one, which changes the way of a hand.
    if len(moments_of(list(given_fingers.notes))) == len(
        moments_of(list(given_fingers.stretched(0.5).notes))
    ):
        assert slow <= fast + 1e-9


def test_no_weight_makes_anything_easier():
    assert min(astuple(FITTED.weights)) >= 0
    assert sum(weight > 0 for weight in astuple(FITTED.weights)) >= 5


def test_pieces_that_are_called_harder_have_higher_grades():
    levels = {"easy": 1, "intermediate": 2, "hard": 3}
    grades = [grade(load_score(piece.name), shadow_hands()) for piece in songs()]
    assert [piece.difficulty for piece in songs()] == pytest.approx(grades, abs=0.05)
    index = tomllib.loads(files(libraries).joinpath("pieces/index.toml").read_text("utf-8"))
    called = [levels[index[piece.name]["difficulty"]] for piece in songs()]
    assert spearmanr(grades, called).statistic > 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_harder_etudes_have_higher_grades(kind):
    easy, middle, hard = (
        np.mean([grade(make_etude(kind, level, seed), shadow_hands()) for seed in range(2)])
        for level in (1, 5, 10)
    )
    assert easy < middle < hard


def test_the_fingers_of_the_score_count_unless_players_are_given():
    score = load_score("MoonlightOpening")
    fingered, _ = find_fingering(score.without_fingers())
    assert grade(fingered) == grade(score, shadow_hands())
    assert grade(score) != grade(fingered)


def test_long_scores_are_graded():
    notes = tuple(
        Note(0.1 * i, 0.1 * i + 0.1, 40 + (7 * i) % 40, finger=finger(3 * i % 10))
        for i in range(20_000)
    )
    short, long = Score(notes[:2000]), Score(notes)
    assert grade(long) == pytest.approx(grade(short), abs=0.05)


def test_what_cannot_be_graded_is_said():
    with pytest.raises(CadenzaError, match="without fingers; say who plays"):
        grade(Score((Note(0.0, 1.0, 60),), title="A"))
    with pytest.raises(CadenzaError, match="without notes"):
        features_of(Score(()))
