"""Extra and missed notes have the kinds that a listener would give them."""

import mir_eval
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.music.metrics import note_errors
from cadenza.music.score import Note

RIGHT = Note(2.0, 3.0, 60)


def kinds(written, played):
    """The kinds of errors, and the pitches of their notes."""
    _, *errors = note_errors(written, played)
    return {
        kind: [note.pitch for note in notes]
        for group in errors
        for kind, notes in group._asdict().items()
        if notes
    }


@pytest.mark.parametrize(
    ("played", "expected"),
    [
        ([Note(2.05, 3, 60)], {}),
        ([], {"silent": [60]}),
        ([Note(1.5, 2.5, 60)], {"held": [60], "other": [60]}),
        ([Note(1.0, 1.9, 60)], {"silent": [60], "other": [60]}),
        ([RIGHT, Note(2.5, 2.9, 60)], {"again": [60]}),
        ([RIGHT, Note(3.1, 3.2, 60)], {"again": [60]}),
        ([RIGHT, Note(3.3, 3.4, 60)], {"other": [60]}),
        ([RIGHT, Note(1.9, 1.94, 62)], {"neighbour": [62]}),
        ([RIGHT, Note(2.5, 2.54, 59)], {"neighbour": [59]}),
        ([RIGHT, Note(2.0, 2.04, 63)], {"other": [63]}),
        ([RIGHT, Note(3.2, 3.24, 61)], {"other": [61]}),
        ([Note(2.0, 3, 61)], {"silent": [60], "neighbour": [61]}),
    ],
)
def test_kinds_of_errors_by_hand(played, expected):
    assert kinds([RIGHT], played) == expected


def test_a_late_note_is_missed_and_extra():
    errors = note_errors([RIGHT], [late := Note(2.06, 3, 60)])
    assert (errors.missed.off_time, errors.extra.off_time, errors.pairs) == ([RIGHT], [late], [])


def test_a_late_repetition_is_not_taken_for_the_note_before():
    written = [Note(1.0, 1.2, 60), Note(1.3, 1.5, 60)]
    assert kinds(written, [Note(1.02, 1.2, 60), Note(1.4, 1.5, 60)]) == {"off_time": [60]}


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_notes_are_right_as_in_mir_eval_and_all_others_have_one_kind(seed):
    rng = np.random.default_rng(seed)

    def notes(count):
        starts = rng.integers(0, 100, count) / 25  # never 50 ms apart, which rounding decides
        return [Note(start, start + 0.1, 60 + int(rng.integers(5))) for start in starts]

    written, played = notes(20), notes(25)
    arrays = (
        array
        for side in (written, played)
        for array in (
            np.array([(note.start, note.end) for note in side]),
            440 * 2 ** ((np.array([note.pitch for note in side]) - 69) / 12),
        )
    )
    matches = mir_eval.transcription.match_notes(*arrays, onset_tolerance=0.05, offset_ratio=None)
    errors = note_errors(written, played)
    assert len(errors.pairs) == len(matches)
    for group, side, place in ((errors.missed, written, 0), (errors.extra, played, 1)):
        others = [id(note) for notes in group for note in notes]
        assert sorted(others + [id(pair[place]) for pair in errors.pairs]) == sorted(map(id, side))
