"""Keyboards of one's own: where their keys lie, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from cadenza.errors import CadenzaError
from cadenza.keyboards.mini import MINI
from cadenza.keyboards.piano import PIANO


@pytest.mark.parametrize(
    "keyboard",
    [PIANO, MINI, replace(PIANO, lowest_pitch=60, num_keys=23)],
    ids=["piano", "mini", "to a black key"],
)
def test_white_keys_lie_on_the_grid(keyboard):
    white = ~keyboard.is_black
    np.testing.assert_allclose(keyboard.grid_y[white], keyboard.centre[white, 1], atol=1e-12)


WHITE, BLACK, BASE = PIANO.white, PIANO.black, PIANO.base


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lowest_pitch": 61, "num_keys": 20}, "lowest_pitch 61, is black; begin with a white one"),
        ({"num_keys": 0}, "has 0 keys from pitch 21 on"),
        ({"lowest_pitch": 60}, "has 88 keys from pitch 60 on; MIDI's pitches are 0 to 127"),
        ({"white": replace(WHITE, mass=0.0)}, r"white: .* > 0\.0 - at .\$\.mass"),
        ({"black": replace(BLACK, mass=np.nan)}, "black: Expected .float., got .null. - at .*mass"),
        ({"black": replace(BLACK, half_size=(0.045, -0.005, 0.009))}, "black: .* > 0.*half_size"),
        ({"white": replace(WHITE, dip=0.0)}, "white: .* > 0.*dip"),
        ({"white": replace(WHITE, half_size=(0.1, 0.1))}, "white: .* length 3 .*half_size"),
        ({"num_keys": 88.0}, "num_keys: Expected .int."),
        ({"gap": -0.1}, "gap: Expected .float. >= 0"),
        ({"gap": np.nan}, "gap: Expected .float., got .null."),
        ({"sound_tolerance": 0.5}, "sound_tolerance is 0.5; give more than 0 and less than"),
        ({"contact_solref": (0.1,)}, "contact_solref: .* length 2"),
        ({"base": replace(BASE, half_depth=0.0)}, "base: .* > 0.*half_depth"),
        ({"base": replace(BASE, density=0.0)}, "base: .* > 0.*density"),
    ],
)
def test_impossible_keyboards_are_refused_in_a_line(changes, message):
    with pytest.raises(CadenzaError, match=rf"^keyboard odd: [^\n]*{message}"):
        replace(PIANO, name="odd", **changes)
