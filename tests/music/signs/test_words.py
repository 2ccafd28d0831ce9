"""Words that change tempo, loudness or rhythm."""

import pytest

from cadenza.music.signs.tempo_map import TempoChange
from cadenza.music.signs.words import loudness_step, swing, tempo_change


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("rit.", TempoChange.RITARDANDO),
        ("poco rit.", TempoChange.RITARDANDO),
        ("Rallentando", TempoChange.RITARDANDO),
        ("molto allargando", TempoChange.RITARDANDO),
        ("accel.", TempoChange.ACCELERANDO),
        ("stringendo", TempoChange.ACCELERANDO),
        ("a tempo", TempoChange.A_TEMPO),
        ("A  Tempo", TempoChange.A_TEMPO),
        ("Tempo I", TempoChange.TEMPO_PRIMO),
        ("Tempo I°", TempoChange.TEMPO_PRIMO),
        ("Tempo primo", TempoChange.TEMPO_PRIMO),
        ("ritenuto", TempoChange.MENO_MOSSO),
        ("Più mosso", TempoChange.PIU_MOSSO),
        ("meno mosso", TempoChange.MENO_MOSSO),
        ("con spirito", None),
        ("tempo giusto", None),
        ("Tempo di valse", None),
        ("Allegro ma non troppo", None),
    ],
)
def test_words_change_the_tempo(text, change):
    assert tempo_change(text) is change


@pytest.mark.parametrize(
    ("text", "step"),
    [("cresc.", 1), ("poco a poco crescendo", 1), ("decresc.", -1), ("dim.", -1), ("dolce", None)],
)
def test_words_change_the_loudness(text, step):
    assert loudness_step(text) == step


def test_words_say_whether_eighths_swing():
    assert swing("Medium Swing") == (2, 1)
    assert swing("straight 8ths") == (1, 1)
    assert swing("Andante") is None
