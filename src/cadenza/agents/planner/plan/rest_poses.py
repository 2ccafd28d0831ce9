"""Hands at rest, all fingers over neighbouring white keys, anywhere along the keyboard."""

import numpy as np

from cadenza.agents.agent import Array
from cadenza.fingers import Side
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.servos import Servos

# Inverse kinematics of arms.
_SPACING = 0.03  # [m] between places for which a posture is computed
_ITERATIONS = 6
_NEAR_BEFORE = 1e-4  # [m^2/rad^2] weight of the distance from the posture beside it


def rest_posture(servos: Servos) -> Array:
    """Posture (A,) with all fingers over neighbouring white keys, forearms at their mounts."""
    return servos.clip(np.array([use.rest for use in servos.uses]))


def forearm_places(kinematics: Kinematics) -> Array:
    """Positions (K, F) of a forearm, from its mount, when a finger presses a key at rest [m].

    Fingers that are not in the scene count as being at 0.
    """
    scene, rest_y = kinematics.scene, np.zeros(kinematics.scene.fingers.count)
    tips, _ = kinematics.fingertips(rest_posture(kinematics.servos)[None])
    rest_y[scene.present_fingers] = tips[0, :, 1]
    return scene.keyboard.centre[:, 1, None] - rest_y


class RestPoses:
    """The hands of a scene at rest.

    Places of a hand are counted from that of its rest posture, to the player's right [m].
    """

    def __init__(self, kinematics: Kinematics) -> None:
        """Find the postures of arms along the keyboard; forearms that slide need none."""
        scene, servos = kinematics.scene, kinematics.servos
        self._scene, self._kinematics, self._servos = scene, kinematics, servos
        self._rest = rest_posture(servos)
        self._points = kinematics.points(self._rest[None])[0]
        slides = servos.along_keyboard
        self._slides = dict(zip(scene.sides, slides, strict=bool(slides)))
        self._arm_postures_of = {} if scene.hand.body.mount is None else self._arm_postures()

    def at(self, places: dict[Side, Array], num_states: int) -> Array:
        """Postures (S, A) of hands at places (S,); hands without places are at their mounts."""
        servos, postures = self._servos, np.tile(self._rest, (num_states, 1))
        for side, place in places.items():
            if side in self._arm_postures_of:
                knots, knot_postures = self._arm_postures_of[side]
                for servo in np.flatnonzero(np.ptp(knot_postures, axis=0)):
                    postures[:, servo] = np.interp(place, knots, knot_postures[:, servo])
            elif side in self._slides:
                slide = self._slides[side]
                postures[:, slide] = np.clip(place, servos.low[slide], servos.high[slide])
        return postures

    def place(self, posture: Array, side: Side) -> float:
        """Approximate place of the hand on one side in a posture (A,)."""
        if side in self._slides:
            return float(posture[self._slides[side]])
        moved = self._kinematics.points(posture[None])[0] - self._points
        return float(moved[self._scene.fingertips_on(side), 0, 1].mean())

    def _arm_postures(self) -> dict[Side, tuple[Array, Array]]:
        """Side -> places (N,) of the hand that an arm brings it to, and postures (N, A)."""
        mount = self._scene.hand.body.mount
        assert mount is not None
        postures = {}
        for side in self._scene.sides:
            sign = 1.0 if side == "right" else -1.0
            ends = sorted(sign * (end - mount.home) for end in (mount.low, mount.high))
            down, up = (self._postures_towards(side, end) for end in ends)
            places = [-_SPACING * i for i in range(len(down) - 1, 0, -1)]
            places += [_SPACING * i for i in range(len(up))]
            postures[side] = np.array(places), np.stack([*down[:0:-1], *up])
        return postures

    def _postures_towards(self, side: Side, end: float) -> list[Array]:
        """Postures from rest to the place `end`, `_SPACING` apart."""
        steps = int(np.ceil(abs(end) / _SPACING))
        postures = [self._rest]
        for i in range(1, steps + 1):
            postures.append(self._posture_at(side, np.copysign(_SPACING * i, end), postures[-1]))
        return postures

    def _posture_at(self, side: Side, place: float, before: Array) -> Array:
        """Posture nearest to `before`, by Gauss-Newton over the arm, with a hand at a place."""
        scene, servos = self._scene, self._servos
        tips = scene.fingertips_on(side)
        hand_servos = range(len(servos.names))[scene.servos_on(side)]
        arm = [a for a in hand_servos if servos.finger[a] < 0]
        finger, link, axis = np.indices(self._points[tips].shape).reshape(3, -1)
        finger += tips.start
        goal, posture = self._points[finger, link], before.copy()
        goal[:, 1] += place
        directions = np.eye(3)[axis]
        for _ in range(_ITERATIONS):
            links = self._kinematics.links(posture[None])
            points = links.points.reshape(self._points.shape)[finger, link]
            residual = ((goal - points) * directions).sum(axis=1)
            jacobian = links.along(np.zeros_like(finger), finger, link, points, directions)
            jacobian = jacobian[:, np.array(arm) - hand_servos.start]
            normal = jacobian.T @ jacobian + _NEAR_BEFORE * np.eye(len(arm))
            gradient = jacobian.T @ residual + _NEAR_BEFORE * (before - posture)[arm]
            posture[arm] += np.linalg.solve(normal, gradient)
            posture = servos.clip(posture)
        return posture
