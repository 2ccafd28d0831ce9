"""Profiles of real robots and pianos for domain randomization; each is a setup, too."""

from typing import Literal

from cadenza.tasks.config import DomainRandomization

Profile = Literal["gentle", "realistic", "harsh"]

# Where figures come from:
# [S] Robotis e-manual, servos of the size of fingers: XH430-W350, play 0.25 degrees (0.0044 rad),
#     4096 counts a turn (0.0015 rad), 30 turns a minute without load (3.1 rad/s); XC330-M288 81
#     turns (8.5 rad/s); XC330-T181 113 turns (11.8 rad/s). Shadow's tendons close a finger in
#     0.2 s (8 rad/s of each joint).
# [F] Franka's arms: limits of 1.7 m/s (Emika Robot) and 3 m/s (Research 3); data sheet: poses
#     repeat within 0.1 mm.
# [O] OpenAI, Learning Dexterous In-Hand Manipulation (2018), table of randomizations for a Shadow
#     hand: masses 0.5 to 1.5, friction 0.7 to 1.3, damping 0.3 to 3, gains 0.75 to 1.5, and a
#     standard deviation of gravity of 0.4 m/s^2 along each axis, or 0.04 rad.
# [K] Key dip: makers ask for 10 mm within 0.2 mm, and among them for 9.5 to 11 mm.
# [M] Schultz, The Schultz MIDI Benchmarking Toolbox (2019): a few ms from a key to the computer.
# [J] Judgement, for want of published figures: rulers and levels are wrong by a few millimetres and
#     half a degree, buses and drivers take two to eight control steps of a
#     servo of 100 to 200 Hz, and zeros of joints are set by eye.
GENTLE = DomainRandomization(
    mass=(0.9, 1.1),  # [O], a fifth of it
    friction=(0.9, 1.1),  # [O], a third
    joint_damping=(0.8, 1.25),  # [O], a fifth
    servo_gain=(0.95, 1.05),  # [O], a fifth
    key_spring=(0.95, 1.05),  # [J]
    key_travel=(0.98, 1.02),  # [K]
    key_sounding=(0.98, 1.0),  # [J]
    force_limit=(0.9, 1.0),  # [J]
    keyboard_offset=0.001,  # [J]
    keyboard_tilt=0.001,  # [J]
    mount_offset=0.0005,  # [J]
    mount_tilt=0.001,  # [J]
    gravity_tilt=0.01,  # [J]
    joint_backlash=(0.0, 0.002),  # [S], half
    slide_backlash=(0.0, 0.0001),  # [F]
    latency=(0.005, 0.015),  # [J]
    observation_latency=(0.0, 0.005),  # [M]
    joint_noise=0.0008,  # [S], half a count
    slide_noise=0.0001,  # [J]
    touch_noise=0.02,  # [J]
    joint_bias=0.003,  # [J]
    slide_bias=0.0003,  # [J]
    touch_bias=0.05,  # [J]
)
REALISTIC = DomainRandomization(
    mass=(0.75, 1.25),  # [O], half of it
    friction=(0.7, 1.3),  # [O]
    joint_damping=(0.5, 2.0),  # [O], somewhat less
    servo_gain=(0.85, 1.2),  # [O], half
    key_spring=(0.85, 1.15),  # [J]
    key_travel=(0.95, 1.05),  # [K]
    key_sounding=(0.95, 1.0),  # [J]
    force_limit=(0.8, 1.0),  # [J]
    keyboard_offset=0.002,  # [J]
    keyboard_tilt=0.004,  # [J]
    mount_offset=0.001,  # [J]
    mount_tilt=0.004,  # [J]
    gravity_tilt=0.04,  # [O]
    push=2.0,  # [J], a cable that drags
    joint_speed=(8.5, 11.8),  # [S], the faster
    slide_speed=(1.7, 3.0),  # [F]
    joint_dead_band=(0.0, 0.002),  # [S], a count
    slide_dead_band=(0.0, 0.0001),  # [F]
    joint_backlash=(0.002, 0.006),  # [S]
    slide_backlash=(0.0, 0.0002),  # [F], twice
    latency=(0.015, 0.035),  # [J]
    observation_latency=(0.005, 0.015),  # [J], [M]
    joint_noise=0.0015,  # [S], a count
    slide_noise=0.0002,  # [J]
    touch_noise=0.05,  # [J]
    joint_control_noise=0.0015,  # [S], a count
    slide_control_noise=0.0001,  # [F]
    joint_bias=0.01,  # [J]
    slide_bias=0.001,  # [J]
    touch_bias=0.1,  # [J]
    drift=0.2,  # [J]
)
HARSH = DomainRandomization(
    mass=(0.5, 1.5),  # [O]
    friction=(0.5, 1.5),  # [O], more
    joint_damping=(0.3, 3.0),  # [O]
    joint_friction=(0.5, 2.0),  # [J]
    servo_gain=(0.75, 1.5),  # [O]
    key_spring=(0.7, 1.3),  # [J]
    key_travel=(0.95, 1.1),  # [K]
    key_sounding=(0.9, 1.0),  # [J]
    force_limit=(0.6, 1.0),  # [J]
    keyboard_offset=0.004,  # [J]
    keyboard_tilt=0.009,  # [J]
    mount_offset=0.002,  # [J]
    mount_tilt=0.009,  # [J]
    gravity_tilt=0.08,  # [O], twice
    push=5.0,  # [J]
    joint_speed=(3.1, 8.5),  # [S], the slower
    slide_speed=(1.0, 1.7),  # [F], the slower and below
    joint_dead_band=(0.002, 0.005),  # [S], two counts
    slide_dead_band=(0.0001, 0.0003),  # [J]
    joint_backlash=(0.005, 0.015),  # [S], worn
    slide_backlash=(0.0002, 0.001),  # [J], worn
    latency=(0.03, 0.07),  # [J]
    observation_latency=(0.01, 0.03),  # [J]
    joint_noise=0.004,  # [J]
    slide_noise=0.0005,  # [J]
    key_noise=0.02,  # [J]
    touch_noise=0.1,  # [J]
    joint_control_noise=0.004,  # [J]
    slide_control_noise=0.0003,  # [J]
    joint_bias=0.02,  # [J]
    slide_bias=0.002,  # [J]
    touch_bias=0.2,  # [J]
    drift=0.5,  # [J]
)
PROFILES: dict[Profile, DomainRandomization] = {
    "gentle": GENTLE,
    "realistic": REALISTIC,
    "harsh": HARSH,
}
"""The profiles by their names."""
