"""Dynamics and hairpins."""

from fractions import Fraction as Q

from cadenza.music.signs.loudness import Dynamic, Hairpin, Loudness, Sforzato

P, MF, F_ = 49, 80, 96


def velocities(*marks):
    loudness = Loudness(marks, unmarked=MF)
    return [loudness.at(Q(k)) for k in range(9)]


def test_dynamics_hold_until_the_next():
    assert velocities(Dynamic(Q(2), P), Dynamic(Q(4), F_)) == [MF] * 2 + [P] * 2 + [F_] * 5


def test_a_hairpin_leads_from_one_dynamic_to_the_next():
    got = velocities(Dynamic(Q(0), 40), Hairpin(Q(0), Q(4), 1), Dynamic(Q(4), 80))
    assert got == [40, 50, 60, 70, 80, 80, 80, 80, 80]


def test_a_hairpin_without_goal_changes_by_one_dynamic():
    assert velocities(Hairpin(Q(0), Q(4), -1)) == [80, 76, 72, 68, 64, 64, 64, 64, 64]
    sudden = velocities(Hairpin(Q(0), Q(4), 1), Dynamic(Q(4), P))
    assert sudden == [80, 84, 88, 92, P, P, P, P, P]


def test_a_swell_goes_up_and_down():
    got = velocities(Hairpin(Q(0), Q(2), 1), Hairpin(Q(2), Q(4), -1))
    assert got == [80, 88, 96, 88, 80, 80, 80, 80, 80]


def test_a_crescendo_in_words_goes_on_to_the_next_dynamic():
    got = velocities(Hairpin(Q(0), None, 1), Dynamic(Q(8), 120))
    assert got == [80, 85, 90, 95, 100, 105, 110, 115, 120]


def test_sforzato_and_forte_piano_are_for_their_notes_alone():
    assert velocities(Sforzato(Q(1)))[:3] == [80, 120, 80]
    assert velocities(Dynamic(Q(1), F_, then=P))[:4] == [80, F_, P, P]


def test_velocities_stay_within_midi():
    softest = velocities(Dynamic(Q(0), 2), Hairpin(Q(0), Q(4), -1))
    loudest = velocities(Dynamic(Q(0), 120), Hairpin(Q(0), Q(4), 1), Sforzato(Q(1)))
    assert min(softest) == 1
    assert max(loudest) == 127
