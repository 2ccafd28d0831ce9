"""The piano of 88 keys.

Figures from the model of RoboPianist (Zakka et al., CoRL 2023; PyPI robopianist 1.0.10).
"""

import numpy as np

from cadenza.keyboards.keyboard import Base, Keyboard, KeyServo, KeyShape, KeySpring

PIANO = Keyboard(
    name="piano",
    lowest_pitch=21,  # A0
    num_keys=88,
    white=KeyShape(
        half_size=(0.075, 0.01125, 0.01125),
        centre_x=0.0,
        centre_z=0.01125,
        mass=0.04,
        dip=0.01,
        rgba=(0.93, 0.92, 0.89, 1.0),
    ),
    black=KeyShape(
        half_size=(0.045, 0.005, 0.009),
        centre_x=-0.15 / 2 + 0.09 / 2,
        centre_z=0.0225 + 0.0125 - 0.018 / 2,
        mass=0.02,
        dip=0.008,
        rgba=(0.08, 0.08, 0.09, 1.0),
    ),
    gap=0.001,
    spring=KeySpring(
        stiffness=2.0, reference=float(-np.deg2rad(1.0)), damping=0.05, armature=0.001
    ),
    servo=KeyServo(stiffness=30.0, damping=0.3),
    base=Base(
        pos=(-0.127, 0.0, 0.02),
        half_depth=0.05,
        half_height=0.02,
        density=1000,
        rgba=(0.16, 0.14, 0.15, 1.0),
    ),
    sound_tolerance=0.00872665,  # half a degree
    contact_solref=(0.01, 1.0),
)
