"""Pictures of the scene, where this machine can draw."""

import pytest

from cadenza.errors import CadenzaError
from cadenza.sim.render import Picture


@pytest.mark.parametrize(
    ("picture", "problem"),
    [
        ({"camera": "front"}, "no camera 'front': choose from closeup"),
        ({"width": 0}, "0 x 360: choose up to 1920 x 1080"),
        ({"height": 1081}, "640 x 1081: choose up to 1920 x 1080"),
    ],
)
def test_pictures_that_make_no_sense_are_refused(picture, problem):
    with pytest.raises(CadenzaError, match=problem):
        Picture(**picture)
