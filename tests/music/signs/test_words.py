"""Words that change tempo, loudness or rhythm."""

import pytest

from cadenza.music.signs.tempo_map import Change
from cadenza.music.signs.words import loudness_step, swing, tempo_change


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("rit.", Change.RITARDANDO),
        ("poco rit.", Change.RITARDANDO),
        ("Rallentando", Change.RITARDANDO),
        ("molto allargando", Change.RITARDANDO),
        ("accel.", Change.ACCELERANDO),
        ("stringendo", Change.ACCELERANDO),
        ("a tempo", Change.A_TEMPO),
        ("A  Tempo", Change.A_TEMPO),
        ("Tempo I", Change.TEMPO_PRIMO),
        ("Tempo I°", Change.TEMPO_PRIMO),
        ("Tempo primo", Change.TEMPO_PRIMO),
        ("ritenuto", Change.MENO_MOSSO),
        ("Più mosso", Change.PIU_MOSSO),
        ("meno mosso", Change.MENO_MOSSO),
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
