"""Bars are played in the order that musicians would take."""

from itertools import islice

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cadenza.music.formats.musicxml.bars import Signs, played_order, without_goal


def bars(text):
    """Bars as words: A name, and what stands in the bar, as in "|:A B[1:| C[2"."""
    return [bar(word) for word in text.split()]


def bar(word):
    name, *signs = word.removeprefix("|:").removesuffix(":|").split("/")
    _, _, numbers = name.partition("[")
    given = dict(sign.split("=") if "=" in sign else (sign, True) for sign in signs)
    return Signs(
        begins_repeat=word.startswith("|:"),
        times=int(given.pop("times", 2 if word.endswith(":|") else 1)),
        ending=frozenset(int(number) for number in numbers),
        **given,
    )


def played(text):
    names = [word.removeprefix("|:")[0] for word in text.split()]
    return "".join(names[at] for at, _ in played_order(bars(text)))


@pytest.mark.parametrize(
    ("written", "order"),
    [
        ("", ""),
        ("A B C", "ABC"),
        ("A B:| C", "ABABC"),
        ("A |:B C:| D", "ABCBCD"),
        ("A:| B:| C", "AABBC"),
        ("|:A:| |:B:|", "AABB"),
        ("|:A/times=4 B", "AAAAB"),
        ("|:A B[1:| C[2 D", "ABACD"),
        ("|:A B[1:| C[2:| D", "ABACD"),
        ("|:A B[12:| C[3 D", "ABABACD"),
        ("|:A B[1 C[1:| D[2 E[2", "ABCADE"),
        ("|:A B[1:| C D", "ABACD"),
        ("|:A B[1 C[2 D", "ABACD"),  # without a repeat sign at the first ending
        ("|:A B[1:| C[2 |:D E[1:| F[2", "ABACDEDF"),
        ("A B/fine C/da_capo", "ABCAB"),
        ("|:A B/fine:| C/da_capo", "ABABCAB"),
        ("|:A B:| C/fine |:D E/da_capo:|", "ABABCDEDEABC"),
        ("|:A B[1:| C[2/fine D/da_capo", "ABACDAC"),
        ("A B/segno=s C/dal_segno=s D", "ABCBCD"),
        ("A B/segno=s C/to_coda=c D/dal_segno=s E/coda=c", "ABCDBCE"),
        ("A B/segno=s C/to_coda=c D/dal_segno=s E F/coda=c", "ABCDBCF"),
        ("A B/to_coda=c C/da_capo D/coda=c |:E:|", "ABCABDEE"),
        ("A/segno=1 B/segno=2 C/dal_segno=2 D/dal_segno=1 E", "ABCBCDABCDE"),
        ("A B/segno=x C/dal_segno=y D", "ABCBCD"),
        ("A B/dal_segno=x C", "ABC"),
        ("A B/to_coda=c C/da_capo D", "ABCABCD"),
        ("A/segno=s B/to_coda=c/dal_segno=s C D/coda=c", "ABABD"),
        ("A/da_capo B/da_capo C", "AABABC"),
    ],
)
def test_order(written, order):
    assert played(written) == order


def test_signs_without_a_goal_are_counted():
    assert without_goal(bars("A/to_coda=c B/dal_segno=s C/da_capo D/fine")) == 2
    assert without_goal(bars("A/segno=s/to_coda=c B/dal_segno=s C/coda=c")) == 0


LABELS = st.none() | st.sampled_from("ab")
SIGNS = st.builds(
    Signs,
    begins_repeat=st.booleans(),
    times=st.integers(1, 3),
    ending=st.frozensets(st.integers(1, 3), max_size=2),
    segno=LABELS,
    coda=LABELS,
    dal_segno=LABELS,
    to_coda=LABELS,
    da_capo=st.booleans(),
    fine=st.booleans(),
)


@given(st.lists(SIGNS, max_size=12))
def test_any_signs_come_to_an_end(signs):
    order = [at for at, _ in islice(played_order(signs), 10_000)]
    assert len(order) < 10_000
    assert set(order) <= set(range(len(signs)))
