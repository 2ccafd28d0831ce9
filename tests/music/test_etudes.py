"""Etudes: that they are playable, that difficulty means something, and that they keep the rules."""

import hashlib
import itertools
from collections import Counter

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.music.etudes import KINDS, etude_names, make_etude
from cadenza.music.etudes.harmony import Key, progression
from cadenza.music.goals import score_to_goals
from cadenza.music.libraries.library import load_score
from cadenza.music.score import PITCHES, Score
from players import find_fingering

LETTERS = {"C": 0, "D": 2, "E": 4, "F": 5, "G": 7, "A": 9, "B": 11}
FIFTHS = ["F", "C", "G", "D", "A", "E", "B"]  # the order of sharps; of flats from its end

kinds = st.sampled_from(KINDS)
difficulties = st.integers(1, 10)
seeds = st.integers(0, 2**32)
few = settings(deadline=None, max_examples=40)


def tonic_and_minor(score: Score) -> tuple[int, bool]:
    """Of the key that the title names, as anyone would spell it."""
    key = score.title.split(" in ")[1].split(",")[0]
    tonic, mode = key.split()
    letter, _, accidental = tonic.partition("-")
    return (LETTERS[letter] + {"": 0, "sharp": 1, "flat": -1}[accidental]) % 12, mode == "minor"


def scale_of_key(tonic: int, minor: bool) -> set[int]:
    steps = (0, 2, 3, 5, 7, 8, 9, 10, 11) if minor else (0, 2, 4, 5, 7, 9, 11)
    return {(tonic + step) % 12 for step in steps}


def verticals(score: Score) -> list[list[int]]:
    """All that sounds at each moment at which a note begins, from the lowest pitch."""
    return [
        sorted(n.pitch for n in score.notes if n.start <= time < n.end)
        for time in sorted({note.start for note in score.notes})
    ]


# What can be relied on


@few
@given(kinds, difficulties, seeds)
@example("leaps", 10, 1)
def test_any_etude_fits_the_piano_and_the_hands(kind, difficulty, seed):
    score = make_etude(kind, difficulty, seed)
    assert all(note.pitch in PITCHES for note in score.notes)
    assert 15 <= score.total_time <= 40
    assert max(map(len, verticals(score))) <= 10
    assert not score.has_fingering
    ends: dict[int, float] = {}
    for note in score.notes:
        assert note.start >= ends.get(note.pitch, 0.0)
        ends[note.pitch] = note.end


@few
@given(kinds, st.integers(1, 7), seeds)
def test_two_hands_have_a_finger_for_every_note(kind, difficulty, seed):
    _, dropped = find_fingering(make_etude(kind, difficulty, seed))
    assert dropped == ()


@few
@given(kinds, difficulties, seeds)
def test_a_key_comes_up_before_it_is_struck_again(kind, difficulty, seed):
    """At 20 steps a second, with notes held while their step begins."""
    score = make_etude(kind, difficulty, seed)
    if difficulty <= 7:
        goals = score_to_goals(score, 0.05)
        pressed = np.diff(goals.keys.astype(int), axis=0, prepend=0) == 1
        assert pressed.sum() >= 0.97 * len(score.notes)


@given(kinds, difficulties, seeds)
@settings(deadline=None, max_examples=10)
def test_the_same_seed_gives_the_same_etude(kind, difficulty, seed):
    score = make_etude(kind, difficulty, seed)
    assert score == make_etude(kind, difficulty, seed)
    others = (make_etude(kind, difficulty, seed + more).notes for more in range(1, 5))
    assert any(score.notes != notes for notes in others)  # two may be alike by chance


def test_etudes_are_the_same_on_every_machine():
    """A benchmark names etudes by their seeds only."""
    digest = hashlib.sha256()
    for kind, difficulty in itertools.product(KINDS, range(1, 11)):
        score = make_etude(kind, difficulty, 0)
        times = [
            (round(n.start * 1e6), round(n.end * 1e6), n.pitch, n.velocity) for n in score.notes
        ]
        digest.update(repr((score.title, times)).encode())
    assert digest.hexdigest()[:16] == "4d51cb1ab483f469"


@pytest.mark.parametrize("kind", KINDS)
def test_harder_etudes_have_more_notes_a_second_and_more_accidentals(kind):
    def rate(difficulty: int) -> float:
        scores = [make_etude(kind, difficulty, seed) for seed in range(3)]
        return sum(len(s.notes) for s in scores) / sum(s.total_time for s in scores)

    easy, middle, hard = map(rate, (1, 5, 10))
    assert 1.3 * easy < middle
    assert 1.3 * middle < hard
    assert {tonic_and_minor(make_etude(kind, 1, seed)) for seed in range(8)} == {
        (0, False),
        (9, True),
    }


def test_the_hardest_etudes_are_in_all_keys():
    drawn = {tonic_and_minor(make_etude("hanon", 10, seed)) for seed in range(200)}
    assert drawn == {(tonic, minor) for tonic in range(12) for minor in (False, True)}


@pytest.mark.parametrize(
    ("kind", "difficulty", "seed", "message"),
    [
        ("waltz", 3, 0, "no etudes of kind 'waltz': choose from scales, arpeggios"),
        ("scales", 0, 0, "difficulty 0: choose 1 to 10"),
        ("scales", 11, 0, "difficulty 11: choose 1 to 10"),
        ("scales", 3, -1, "seed -1: choose 0 or more"),
    ],
)
def test_what_cannot_be_made_is_said(kind, difficulty, seed, message):
    with pytest.raises(CadenzaError, match=message):
        make_etude(kind, difficulty, seed)


# Names


def test_an_etude_has_a_name():
    assert load_score("etudes/broken-chords-3-7") == make_etude("broken-chords", 3, 7)
    assert load_score("etudes/Scales-10-0") == make_etude("scales", 10, 0)


@pytest.mark.parametrize("name", ["etudes/scales-3", "scales-3-7", "etudes/waltz-3-7", "etudes/"])
def test_other_names_are_refused(name):
    with pytest.raises(CadenzaError):
        load_score(name)


def test_names_are_spread_evenly_over_kinds_and_difficulties():
    names = etude_names(250, seed=3)
    assert len(set(names)) == 250
    counts = Counter(name.rsplit("-", 1)[0] for name in names)
    assert len(counts) == 100
    assert set(counts.values()) == {2, 3}
    assert names[:120] == etude_names(120, seed=3)
    assert names != etude_names(250, seed=4)


# Harmony


@pytest.mark.parametrize("sharps", range(-5, 7))
@pytest.mark.parametrize("minor", [False, True])
def test_keys_have_the_scales_of_their_signatures(sharps, minor):
    signature = {letter: LETTERS[letter] for letter in FIFTHS}
    for letter in FIFTHS[:sharps] if sharps > 0 else FIFTHS[sharps:] if sharps else []:
        signature[letter] += 1 if sharps > 0 else -1
    key = Key(sharps, minor)
    assert {key.pitch(degree) % 12 for degree in range(7)} == {p % 12 for p in signature.values()}
    tonic, _ = tonic_and_minor(Score((), title=f"Scales in {key.name}, 1"))
    assert key.pitch(0) % 12 == tonic
    assert [key.pitch(degree + 7) - key.pitch(degree) for degree in range(-7, 7)] == [12] * 14
    assert key.pitch(0) - key.pitch(-1, "harmonic") == 1


@few
@given(kinds.filter(lambda kind: kind != "scales"), difficulties, seeds)
def test_all_notes_belong_to_the_key_and_it_ends_on_the_tonic(kind, difficulty, seed):
    score = make_etude(kind, difficulty, seed)
    tonic, minor = tonic_and_minor(score)
    assert {note.pitch % 12 for note in score.notes} <= scale_of_key(tonic, minor)
    assert verticals(score)[-1][0] % 12 == tonic


@few
@given(difficulties, seeds)
def test_scales_run_through_the_key_and_its_relative(difficulty, seed):
    score = make_etude("scales", difficulty, seed)
    tonic, minor = tonic_and_minor(score)
    relative = (tonic + (3 if minor else -3)) % 12
    allowed = scale_of_key(tonic, minor) | scale_of_key(relative, not minor)
    assert {note.pitch % 12 for note in score.notes} <= allowed
    assert verticals(score)[-1][0] % 12 == tonic


@few
@given(seeds, st.integers(1, 4), st.sampled_from([4, 7]))
def test_progressions_end_with_a_cadence(seed, phrases, length):
    chords = progression(np.random.default_rng(seed), phrases, length)
    roots = [chord.root for chord in chords]
    assert roots[0] == 0
    assert roots[-2:] == [4, 0]
    assert all(end in (0, 4) for end in roots[length - 1 :: length])
    # A dominant goes on to the tonic, or deceives to the sixth degree.
    assert all(b in (0, 5, 4) for a, b in itertools.pairwise(roots) if a == 4)


# Voice leading, told again by plain loops


def perfect_parallels(score: Score) -> list[tuple[list[int], list[int]]]:
    """Pairs of moments between which two voices move in parallel fifths or octaves."""
    faults = []
    for now, then in itertools.pairwise(verticals(score)):
        if len(now) != len(then):
            continue
        for i, j in itertools.combinations(range(len(now)), 2):
            before, after = (now[j] - now[i]) % 12, (then[j] - then[i]) % 12
            if before == after and before in (0, 7) and now[i] != then[i] and now[j] != then[j]:
                faults.append((now, then))
    return faults


@few
@given(difficulties, seeds)
def test_chorales_have_no_parallel_fifths_or_octaves(difficulty, seed):
    score = make_etude("chorale", difficulty, seed)
    chords = verticals(score)
    assert {len(chord) for chord in chords} == {
        2 if difficulty <= 2 else 3 if difficulty <= 4 else 4
    }
    assert perfect_parallels(score) == []
    for chord in chords:
        assert len(set(chord)) == len(chord)
        upper = chord[len(chord) // 2 :]
        assert upper[-1] - upper[0] <= 12  # for one hand


@few
@given(difficulties, seeds)
def test_two_voices_keep_the_rules_of_counterpoint(difficulty, seed):
    score = make_etude("counterpoint", difficulty, seed)
    moments = verticals(score)
    assert all(len(moment) == 2 for moment in moments)
    assert perfect_parallels(score) == []
    tonic, _ = tonic_and_minor(score)
    assert (moments[0][1] - moments[0][0]) % 12 in (0, 7)
    assert [pitch % 12 for pitch in moments[-1]] == [tonic, tonic]
    for k, (low, high) in enumerate(moments):
        if (high - low) % 12 in (0, 3, 4, 7, 8, 9):
            continue
        before, after = moments[k - 1], moments[k + 1]
        faster = 1 if before[0] == low else 0
        assert 0 < abs(moments[k][faster] - before[faster]) <= 2
        assert 0 < abs(after[faster] - moments[k][faster]) <= 2
