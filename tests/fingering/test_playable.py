"""Which notes can be played, against every way to play them written out."""

import time
from collections.abc import Callable

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.fingering.playable import playable
from cadenza.fingering.players import Forearm, Players, players_at
from cadenza.fingering.search import solve
from cadenza.fingering.strokes import Stroke, onsets, outer_first
from cadenza.fingers import Finger
from cadenza.hands.shadow import SHADOW
from cadenza.keyboards.piano import PIANO
from cadenza.music.score import RELEASE_TIME, Note, Score
from music_strategies import monophonic_per_key, scores
from players import FOUR_FINGERS, TWO_OCTAVES, shadow_hands

REACH = SHADOW.reach


def in_one_hand(
    way: dict[Stroke, Finger], hand: int, players: Players
) -> tuple[float, float] | None:
    """From where to where the forearm can be along the keyboard while its fingers do this.

    Seen from the right hand, the left one mirrored; None where it cannot be anywhere.
    """
    reach, forearm = players.reach, players.forearm(hand)
    assert forearm
    low, high = forearm.low, forearm.high
    y = {stroke: players.key_y(hand)[stroke.key] for stroke in way}
    for stroke, finger in way.items():
        low = max(low, y[stroke] - reach.inward[finger.index])
        high = min(high, y[stroke] + reach.outward[finger.index])
        for other, beyond in way.items():
            if y[other] > y[stroke]:
                pair = finger.index, beyond.index
                if pair[0] >= pair[1]:
                    return None
                if not reach.least[pair] <= y[other] - y[stroke] <= reach.most[pair]:
                    return None
    return (low, high) if low <= high else None


def possible(way: dict[Stroke, Finger], players: Players) -> bool:
    """Whether keys can be pressed by fingers at once."""
    highs = [stroke.key for stroke, finger in way.items() if finger.hand == 0]
    lows = [stroke.key for stroke, finger in way.items() if finger.hand == 1]
    if highs and lows and min(highs) <= max(lows):
        return False
    ends = []
    for hand in range(2):
        if players.forearm(hand):
            own = {stroke: finger for stroke, finger in way.items() if finger.hand == hand}
            place = in_one_hand(own, hand, players)
            if place is None:
                return False
            ends.append(place[1])
    room = sum(arm.high for arm in map(players.forearm, range(2)) if arm)
    return len(ends) < 2 or sum(ends) >= min(players.reach.forearm_width, room)


def written_out(score: Score, players: Players) -> set[int]:
    """The indices of the notes that are played."""
    ways: list[dict[Stroke, Finger]] = [{}]
    played: set[int] = set()
    for moment, begin in onsets(score, players.keyboard.lowest_pitch):
        struck = [stroke.key for stroke in begin]
        held = [p for p in ways[0] if p.end > moment + RELEASE_TIME and p.key not in struck]
        ways = [dict(w) for w in {tuple((p, way[p]) for p in held) for way in ways}]
        for stroke in outer_first(begin, held):
            if not 0 <= stroke.key < players.keyboard.num_keys:
                continue
            able = {f for f in players.fingers if players.forearms[f.hand]}
            able &= {stroke.finger} if stroke.finger else able
            sounding = sorted(ways[0], key=lambda p: p.start)
            for other in (None, *(p for p in sounding if p.start < stroke.start)):
                without = [{p: f for p, f in way.items() if p is not other} for way in ways]
                more = [way | {stroke: finger} for way in without for finger in able]
                if more := [way for way in more if possible(way, players)]:
                    ways = more
                    played |= set(stroke.notes)
                    break
    return played


crowded = st.builds(
    lambda notes: monophonic_per_key(
        Score(tuple(Note(t / 8, (t + d) / 8, p) for t, d, p in notes))
    ),
    st.lists(
        st.tuples(st.integers(0, 16), st.integers(1, 16), st.integers(50, 75)),
        min_size=1,
        max_size=12,
    ),
)
sides = st.sampled_from([("right", "left"), ("right",), ("left",)])
everyone = st.builds(
    players_at,
    reach=st.sampled_from([REACH, FOUR_FINGERS]),
    keyboard=st.sampled_from([PIANO, TWO_OCTAVES]),
    sides=sides,
    hand_spacing=st.sampled_from([0.0, 0.16, 0.3]),
    slides=st.booleans(),
) | st.builds(
    Players,
    reach=st.just(REACH),
    keyboard=st.just(PIANO),
    forearms=st.tuples(
        st.sampled_from([Forearm(0.1, 0.0, 0.2), Forearm(0.3, 0.3, 0.6)]),
        st.sampled_from([Forearm(-0.1, -0.3, 0.05), None]),
    ),
)


@settings(deadline=None)
@given(score=st.one_of(crowded, scores()), players=everyone)
def test_the_same_notes_as_written_out(score, players):
    notes = playable(score, players)
    played = {i for i in range(len(score.notes)) if i not in notes.reasons | notes.ignored}
    assert played == written_out(score, players)


@settings(deadline=None)
@given(score=st.one_of(crowded, scores()), players=everyone)
def test_what_can_be_played_is_played(score, players):
    """By one of the fingers that there are, and without breaking a limit."""
    notes = solve(score, players)
    there = {f for f in players.fingers if players.forearms[f.hand]}
    reasons = playable(score, players).reasons
    for i, note in enumerate(notes.score.notes):
        assert (
            note.finger is None if i in reasons else note.finger in there or note in notes.ignored
        )
    assert 0 <= notes.cost < 1e6


@settings(deadline=None)
@given(score=crowded, sides=sides)
def test_what_begins_is_pressed_until_it_ends_or_is_let_go_of(score, sides):
    notes = playable(score, shadow_hands(sides))
    begins = {note.start for i, note in enumerate(score.notes) if i not in notes.reasons}
    for i, until in notes.released.items():
        assert score.notes[i].start < until < score.notes[i].end
        assert until in begins
    assert [moment.num_notes for moment in notes.moments][-1] == len(score.notes)
    for moment in notes.moments:
        keys = [stroke.key for stroke in moment.strokes]
        assert keys == sorted(set(keys))
        sounding = {
            i
            for i, note in enumerate(notes.held(score).notes)
            if i not in notes.reasons
            and note.start <= moment.time
            and (note.start == moment.time or note.end > moment.time + RELEASE_TIME)
        }
        assert {i for stroke in moment.strokes for i in stroke.notes} == sounding


def test_notes_that_have_begun_are_counted():
    """Also where a key is struck twice at once, for which the last note is of a lower key."""
    score = Score((Note(0, 1, 60), Note(0, 1, 64), Note(0.01, 1, 60), Note(1, 2, 62)))
    assert [moment.num_notes for moment in playable(score, shadow_hands()).moments] == [3, 4]


def test_deciding_takes_little_of_the_time_of_fingering():
    """Also where hardly anything can be played: notes all over the keyboard."""
    rng = np.random.default_rng(0)
    starts, pitches = rng.uniform(0, 40, 500), rng.integers(21, 109, 500)
    score = monophonic_per_key(
        Score(
            tuple(
                Note(float(t), float(t) + 0.6, int(p)) for t, p in zip(starts, pitches, strict=True)
            )
        )
    )
    players = shadow_hands()

    def seconds(what: Callable[[Score, Players], object]) -> float:
        begin = time.process_time()
        what(score, players)
        return time.process_time() - begin

    assert len(playable(score, players).reasons) > 100
    assert min(seconds(playable) for _ in range(5)) < seconds(solve) / 3
