"""A keyboard of 25 mini keys, from C to C.

Two thirds of a piano's keys: 15.7 mm from one white key to the next, 110 mm to the octave. That
lies between the 13 mm of the open hardware Kino-Key25 (Kinoshita Laboratory, 2024, MIT; from switch
to switch on its circuit board) and the 23.5 mm of a piano. Black keys are half as long as white
ones, which leaves room for fingers in front of them. The surface is as high as the piano's and the
black keys end at the same place, so that hands find both alike.

The springs are our own figures: 0.16 N at the end of a white key begin to move it and 0.8 N hold it
down, where this model of a piano takes 0.23 N and 1.1 N. Inertia and damping are in proportion.
"""

from dataclasses import replace

import numpy as np

from cadenza.keyboards.keyboard import Keyboard, KeyServo, KeyShape, KeySpring
from cadenza.keyboards.loudness import PianoAction
from cadenza.keyboards.piano import PIANO

_LENGTH_RATIO = 1.5  # lengths of a piano's keys to those of these

MINI = Keyboard(
    name="mini",
    lowest_pitch=48,  # C3
    num_keys=25,
    white=KeyShape(
        half_size=(0.05, 0.0075, 0.0075),
        centre_x=0.015,
        centre_z=0.015,
        mass=0.012,
        dip=0.007,
        rgba=PIANO.white.rgba,
    ),
    black=KeyShape(
        half_size=(0.025, 0.0035, 0.006),
        centre_x=-0.01,
        centre_z=0.0245,
        mass=0.006,
        dip=0.0045,
        rgba=PIANO.black.rgba,
    ),
    gap=0.0007,
    spring=KeySpring(
        stiffness=0.9, reference=float(-np.deg2rad(1.0)), damping=0.0225, armature=0.00045
    ),
    servo=KeyServo(stiffness=13.5, damping=0.135),
    base=replace(PIANO.base, pos=(-0.067, 0.0, 0.02), half_depth=0.03),
    sound_tolerance=PIANO.sound_tolerance,
    contact_solref=PIANO.contact_solref,
    # It measures how fast keys turn: as fast as a piano's for the same loudness.
    action=PianoAction(hammer_ratio=PIANO.action.hammer_ratio * _LENGTH_RATIO),
)
