"""How the hands would play the whole song if everything went as modelled.

Presses, fingertips, postures, controls: inverse kinematics of the song, and what makes the servos
follow. No simulation is needed for it; `refinement` makes up for what is not modelled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from cadenza.agents.agent import Progress, silent
from cadenza.agents.planning.inverse_kinematics import rest_posture, solve_postures
from cadenza.agents.planning.presses import Press, let_go_in_time, presses_of
from cadenza.agents.planning.targets import Targets, targets_of
from cadenza.agents.planning.tracking import Tracking, track
from cadenza.model.kinematics import TIP, Kinematics
from cadenza.model.piano import KEY_CENTRE
from cadenza.model.scene import Scene
from cadenza.model.servos import Servos, reaction, servos_of

Array = NDArray[np.float64]

_LEAD = 3  # steps before a press in which the first guess has the hand there


class Nominal(NamedTuple):
    """A plan for T steps of a scene with A servos and F fingers."""

    presses: list[Press]
    postures: Array
    """(T + 1, A) in the servos' coordinates."""
    fingertips: Array
    """(T + 1, F, 3) [m]"""
    tracking: Tracking


def nominal_plan(
    scene: Scene,
    keys: NDArray[np.bool_],
    fingers: NDArray[np.int8],
    hand_qpos: Array,
    dt: float,
    progress: Progress = silent,
) -> Nominal:
    """Plans how to play `keys` (T, 88) with `fingers` (T, 88).

    Args:
        scene: with one hand or two.
        keys: that should be down after each step.
        fingers: that should press them, -1 for none.
        hand_qpos: (J,) where the joints of the hands are.
        dt: control step [s].
        progress: is told of "postures".
    """
    servos = servos_of(scene)
    kinematics = Kinematics(scene, servos)
    rest = rest_posture(servos)
    rest_y = np.zeros(10)
    rest_y[scene.fingers] = kinematics.fingers(rest[None])[0][0, :, TIP, 1]
    wanted = presses_of(keys, np.where(np.isin(fingers, scene.fingers), fingers, -1))
    presses = let_go_in_time(wanted, rest_y, dt)
    states = len(keys) + 1
    targets = targets_of(presses, states)
    guess = _guess(scene, servos, rest, presses, rest_y, states)
    guess[0] = hand_qpos @ np.linalg.pinv(servos.joints)
    apart = scene.config.hand_spacing
    postures = solve_postures(kinematics, servos, scene.fingers, targets, guess, apart, progress)
    points, jacobian = kinematics.fingers(postures)
    force = _pressing(jacobian[:, :, TIP, 2], targets, scene.fingers)
    force += reaction(scene, servos, postures, dt)
    tracking = track(servos, postures, force / servos.stiffness, dt)
    return Nominal(presses, postures, points[:, :, TIP], tracking)


def _guess(
    scene: Scene,
    servos: Servos,
    rest: Array,
    presses: list[Press],
    rest_y: Array,
    states: int,
) -> Array:
    """(S, A) hands at rest over the keys that they press or will press next."""
    guess = np.tile(rest, (states, 1))
    slides = servos.along_keyboard
    for side, slide in zip(scene.sides, slides, strict=bool(slides)):
        place, count = np.zeros(states), np.zeros(states)
        for press in presses:
            if press.side == side:
                there = slice(max(press.first - _LEAD, 0), press.last)
                place[there] += KEY_CENTRE[press.key, 1] - rest_y[press.finger]
                count[there] += 1
        if count.any():
            known = np.flatnonzero(count)
            path = np.interp(np.arange(states), known, place[known] / count[known])
            smooth = gaussian_filter1d(path, 2.0, mode="nearest")
            guess[:, slide] = np.clip(smooth, servos.low[slide], servos.high[slide])
    return guess


def _pressing(sinking: Array, targets: Targets, fingers: NDArray[np.intp]) -> Array:
    """(T, A) the force along each servo's coordinate that presses keys as `targets` wants.

    Args:
        sinking: (T + 1, F, A) how the fingertips' heights change with the coordinates.
        targets: of all ten fingers.
        fingers: (F,) those that are there.
    """
    return -np.einsum("sfa,sf->sa", sinking, targets.force[:, fingers])[1:]
