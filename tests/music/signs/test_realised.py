"""Signs of single notes: what is played for them, worked out by hand from rules of editions."""

from fractions import Fraction as Q
from itertools import pairwise

import pytest

from cadenza.music.signs import NOTES_A_SECOND
from cadenza.music.signs.notes import (
    Arpeggio,
    Grace,
    Mark,
    Ornament,
    OrnamentKind,
    Role,
    SignedNote,
    SlurEnd,
    Tremolo,
)
from cadenza.music.signs.realising import realised
from cadenza.music.signs.tempo_map import Caesura, Swing, Tempo, TempoMap

FAST = 1 / NOTES_A_SECOND  # [s] of the notes of ornaments
C4, D4, E4, F4, G4, B3 = 60, 62, 64, 65, 67, 59


def played(*notes, seconds=1.0, swings=()):
    """(start, end, pitch) of what sounds; a quarter lasts `seconds`."""
    sounding = realised(notes, TempoMap.of([Tempo(Q(0), seconds)]), swings)
    return [(round(n.start, 9), round(n.end, 9), n.pitch) for n in sounding]


def note(onset, duration, pitch=C4, **signs):
    return SignedNote(Q(onset), Q(duration), pitch, 80, **signs)


def fast(start, pitches, length=FAST):
    """Notes of so many seconds, one after the other."""
    times = [round(start + k * length, 9) for k in range(len(pitches) + 1)]
    return [(*pair, pitch) for pair, pitch in zip(pairwise(times), pitches, strict=True)]


def ornament(kind, **more):
    return {"ornament": Ornament(OrnamentKind[kind], **more)}


def test_a_trill_begins_above_and_ends_on_its_note():
    assert played(note(1, 1, **ornament("TRILL"))) == fast(1, [D4, C4] * 6)


def test_the_key_or_an_accidental_says_how_high_the_neighbour_of_a_trill_is():
    in_e_major = played(note(0, 1, E4, fifths=4, **ornament("TRILL")))
    assert {pitch for *_, pitch in in_e_major} == {E4, 66}
    with_natural = played(note(0, 1, E4, fifths=4, **ornament("TRILL", above=0)))
    assert {pitch for *_, pitch in with_natural} == {E4, F4}
    on_b_flat = played(note(0, 1, 70, alter=-1, fifths=-2, **ornament("TRILL")))
    assert {pitch for *_, pitch in on_b_flat} == {70, 72}


def test_a_trill_may_begin_on_its_note():
    got = played(note(0, 1, **ornament("TRILL", begins=0)))
    assert got == fast(0, [*[C4, D4] * 5, C4], length=1 / 11)


def test_grace_notes_after_a_trill_end_it():
    ending = [note(1, Q(1, 4), B3, grace=Grace(0)), note(1, Q(1, 4), C4, grace=Grace(1))]
    got = played(note(0, 1, **ornament("TRILL")), *ending, note(1, 1, D4))
    assert got == [*fast(0, [D4, C4] * 5 + [B3, C4]), (1, 2, D4)]


@pytest.mark.parametrize(
    ("kind", "pitches"),
    [
        ("MORDENT", [C4, B3, C4]),
        ("INVERTED_MORDENT", [C4, D4, C4]),
        ("TURN", [D4, C4, B3, C4]),
        ("INVERTED_TURN", [B3, C4, D4, C4]),
        ("SLIDE", [57, B3, C4]),
    ],
)
def test_short_ornaments_are_fast_and_their_last_note_is_held(kind, pitches):
    *first, (last, _, _) = fast(0, pitches)
    assert played(note(0, 2, **ornament(kind))) == [*first, (last, 2, C4)]


def test_a_long_mordent_has_two_beats_and_a_short_note_a_fast_one():
    got = played(note(0, 2, **ornament("MORDENT", long=True)))
    assert [pitch for *_, pitch in got] == [C4, B3, C4, B3, C4]
    short = played(note(0, Q(3, 16), **ornament("MORDENT")))
    assert short == [(0, 0.0625, C4), (0.0625, 0.125, B3), (0.125, 0.1875, C4)]


def test_a_turn_after_a_note_comes_just_before_the_next():
    got = played(note(0, 2, **ornament("TURN", delayed=True, below=1)))
    turn = fast(2 - 4 * FAST, [D4, C4, C4, C4])
    assert got == [(0, turn[0][0], C4), *turn]


@pytest.mark.parametrize(
    ("duration", "marks", "count"),
    [
        (1, 1, 2),  # a quarter as eighths
        (1, 2, 4),
        (Q(3, 2), 1, 3),  # dotted
        (Q(1, 2), 1, 2),  # an eighth with one stroke has sixteenths
        (Q(2, 3), 1, 2),  # a quarter of a triplet
        (4, 2, 16),
    ],
)
def test_tremolos_are_measured_by_their_marks(duration, marks, count):
    got = played(note(0, duration, tremolo=Tremolo(marks)), seconds=1)
    assert len(got) == count
    assert {round(end - start, 6) for start, end, _ in got} == {round(float(duration / count), 6)}


def test_a_tremolo_is_no_faster_than_an_ornament():
    assert len(played(note(0, 1, tremolo=Tremolo(3)), seconds=0.5)) == 6


def test_a_tremolo_of_two_alternates():
    got = played(
        note(0, 1, C4, tremolo=Tremolo(2, Role.FIRST)),
        note(0, 1, E4, tremolo=Tremolo(2, Role.FIRST)),
        note(1, 1, G4, tremolo=Tremolo(2, Role.SECOND)),
    )
    assert [(start, pitch) for start, _, pitch in got] == [
        (k / 4, pitch) for k in range(8) for pitch in ([C4, E4] if k % 2 == 0 else [G4])
    ]


def chord(*pitches, onset=0, duration=2, staff=1, **sign):
    arpeggio = Arpeggio(**sign)
    return [note(onset, duration, p, staff=staff, arpeggio=arpeggio) for p in pitches]


def test_arpeggios_go_up_or_down_from_the_beat():
    up = played(*chord(C4, E4, G4))
    assert up == [(0, 2, C4), (0.04, 2, E4), (0.08, 2, G4)]
    down = played(*chord(C4, E4, G4, step=-1))
    assert [pitch for *_, pitch in down] == [G4, E4, C4]
    assert played(*chord(C4, E4, step=0)) == [(0, 2, C4), (0, 2, E4)]


def test_arpeggios_cross_staves_by_their_number():
    one = played(*chord(36, 48, staff=2, number=1), *chord(C4, E4, number=1))
    assert [start for start, *_ in one] == [0, 0.04, 0.08, 0.12]
    two = played(*chord(36, 48, staff=2), *chord(C4, E4))
    assert [start for start, *_ in two] == [0, 0, 0.04, 0.04]


def test_short_grace_notes_come_before_the_beat_and_chords_of_them_together():
    graces = [
        note(1, Q(1, 2), D4, grace=Grace(0, slash=True)),
        note(1, Q(1, 2), F4, grace=Grace(0, slash=True)),
        note(1, Q(1, 2), E4, grace=Grace(1, slash=True)),
    ]
    got = played(note(0, 1), *graces, note(1, 1, C4))
    assert got == [(0, 1, C4), (0.8, 0.9, D4), (0.8, 0.9, F4), (0.9, 1, E4), (1, 2, C4)]


@pytest.mark.parametrize(
    ("shown", "main", "takes"), [(Q(1, 2), 1, 0.5), (1, 1, 0.5), (2, 3, 2), (Q(1, 4), 1, 0.25)]
)
def test_an_appoggiatura_takes_half_of_its_note_or_two_thirds_of_a_dotted_one(shown, main, takes):
    got = played(note(1, shown, D4, grace=Grace(0)), note(1, main), note(1, main, 48))
    end = 1 + main
    assert got == [(1, end, 48), (1, 1 + takes, D4), (1 + takes, end, C4)]


def test_grace_notes_take_time_from_the_neighbour_that_the_file_names():
    previous = Grace(0, of_previous=0.25)
    got = played(note(0, 1, E4), note(1, Q(1, 4), D4, grace=previous), note(1, 1))
    assert got == [(0, 0.75, E4), (0.75, 1, D4), (1, 2, C4)]
    following = Grace(0, of_following=0.25)
    got = played(note(0, 1, E4), note(1, Q(1, 4), D4, grace=following), note(1, 1))
    assert got == [(0, 1, E4), (1, 1.25, D4), (1.25, 2, C4)]


def test_grace_notes_at_the_end_of_a_bar_come_before_it():
    got = played(note(0, 4), note(4, Q(1, 4), D4, grace=Grace(0, after=True)))
    assert got == [(0, 4, C4), (3.9, 4, D4)]


def test_grace_notes_leave_half_of_a_short_note_before_them():
    graces = [note(1, Q(1, 8), D4 + k, grace=Grace(k)) for k in range(4)]
    got = played(note(Q(3, 4), Q(1, 4), E4), *graces, note(1, 1))
    assert got[0] == (0.75, 1, E4)
    assert min(start for start, *_ in got[1:]) == 0.875


@pytest.mark.parametrize(
    ("marks", "end"),
    [
        ({Mark.STACCATO}, 0.5),
        ({Mark.STACCATISSIMO}, 0.33),
        ({Mark.PORTATO}, 0.67),
        ({Mark.STACCATO, Mark.TENUTO}, 0.67),
        ({Mark.TENUTO}, 1),
        ({Mark.STRONG_ACCENT}, 0.67),
        ({Mark.BREATH}, 0.85),
        (set(), 1),
    ],
)
def test_articulation_says_how_long_a_note_is(marks, end):
    assert played(note(0, 1, marks=frozenset(marks)), note(1, 1)) == [(0, end, C4), (1, 2, C4)]


def test_accents_are_louder():
    tempo = TempoMap.of([])
    marks = [frozenset(), {Mark.ACCENT}, {Mark.STRONG_ACCENT}]
    notes = [note(k, 1, marks=frozenset(each)) for k, each in enumerate(marks)]
    assert [n.velocity for n in realised(notes, tempo)] == [80, 92, 96]


def test_under_a_slur_notes_last_to_the_next_and_the_last_is_lifted():
    slur = {"slurs": (SlurEnd(True),)}
    end = {"slurs": (SlurEnd(False),)}
    late = chord(E4, G4, onset=1, duration=1)
    got = played(note(0, 1, **slur), *late, note(2, 1, **end), note(3, 1))
    assert got == [(0, 1, C4), (1, 2, E4), (1.04, 2, G4), (2, 2.95, C4), (3, 4, C4)]
    dotted = {"marks": frozenset({Mark.STACCATO})}
    got = played(note(0, 1, **slur, **dotted), note(1, 1, **end, **dotted))
    assert got == [(0, 0.67, C4), (1, 1.67, C4)]


def test_signs_at_one_note_are_for_its_chord():
    marked = note(0, 1, E4, marks=frozenset({Mark.STACCATO}))
    assert played(note(0, 1), marked) == [(0, 0.5, C4), (0, 0.5, E4)]
    other_voice = note(0, 1, voice="2")
    assert played(other_voice, marked) == [(0, 1, C4), (0, 0.5, E4)]
    repeated = played(note(0, 1, tremolo=Tremolo(1)), note(0, 1, E4))
    assert repeated == [(0, 0.5, C4), (0, 0.5, E4), (0.5, 1, C4), (0.5, 1, E4)]
    broken = played(note(0, 1), note(0, 1, E4, arpeggio=Arpeggio()))
    assert broken == [(0, 1, C4), (0.04, 1, E4)]


def test_an_ornament_of_a_chord_is_for_its_highest_note_and_a_double_trill_for_both():
    lowest = note(0, 1, **ornament("MORDENT"))
    single = played(lowest, note(0, 1, G4))
    first, second, (last, _, _) = fast(0, [G4, F4, G4])
    assert single == [(0, 1, C4), first, second, (last, 1, G4)]
    double = played(note(0, 1, **ornament("TRILL")), note(0, 1, E4, **ornament("TRILL")))
    assert [pitch for start, _, pitch in double if start == 0] == [D4, F4]


def test_swing_moves_the_middle_of_a_beat():
    halves = [note(Q(k, 2), Q(1, 2), C4 + k) for k in range(4)]
    got = played(*halves, swings=[Swing(Q(0))])
    assert [start for start, *_ in got] == pytest.approx([0, 2 / 3, 1, 5 / 3])
    assert [end for _, end, _ in got] == pytest.approx([2 / 3, 1, 5 / 3, 2])


def test_swing_leaves_sixteenths_and_triplets_and_ends_where_it_is_straight():
    sixteenths = [note(Q(k, 4), Q(1, 4)) for k in range(4)]
    assert [start for start, *_ in played(*sixteenths, swings=[Swing(Q(0))])] == [
        0,
        0.25,
        0.5,
        0.75,
    ]
    halves = [note(Q(k, 2), Q(1, 2)) for k in range(4)]
    got = played(*halves, swings=[Swing(Q(0)), Swing(Q(1), 1, 1)])
    assert [start for start, *_ in got] == [0, round(2 / 3, 9), 1, 1.5]


def test_an_upbeat_of_an_eighth_swings_with_the_beats():
    got = played(note(0, Q(1, 2)), note(Q(1, 2), 1), swings=[Swing(Q(0), beat=Q(1, 2))])
    assert got == [(round(1 / 6, 9), 0.5, C4), (0.5, 1.5, C4)]


def test_the_file_may_move_beginnings_and_ends():
    assert played(note(1, 1, attack=Q(1, 8), release=Q(-1, 4))) == [(1.125, 1.75, C4)]


def test_plain_plays_every_note_as_it_stands():
    signs = [
        note(0, 1, **ornament("TRILL"), marks=frozenset({Mark.STACCATO, Mark.ACCENT})),
        *chord(C4, E4, onset=1, duration=1),
        note(2, Q(1, 2), tremolo=Tremolo(3), slurs=(SlurEnd(True),)),
        note(Q(5, 2), Q(1, 2), marks=frozenset({Mark.BREATH}), slurs=(SlurEnd(False),)),
        note(4, Q(1, 2), D4, grace=Grace(0)),
        note(4, 1),
    ]
    *got, grace, main = played(*(each.plain for each in signs))
    assert got == [(0, 1, C4), (1, 2, C4), (1, 2, E4), (2, 2.5, C4), (2.5, 3, C4)]
    assert [grace, main] == [(3.9, 4, D4), (4, 5, C4)]  # and not on the beat


def test_a_grace_note_without_a_note_sounds_before_a_silence_at_the_beginning():
    grace = SignedNote(Q(0), Q(1, 12), 60, 64, grace=Grace(0, takes=Q(1, 8)))
    [note] = realised([grace], TempoMap.of([Caesura(Q(0))], Q(4)))
    assert (note.start, note.end) == (-0.0625, 0.0)
