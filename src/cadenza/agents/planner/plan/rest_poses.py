"""Postures of hands at rest, anywhere along the keyboard: where inverse kinematics begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.fingers import Side
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import Scene
from cadenza.scene.servos import Servos

Array = NDArray[np.float64]

_SPACING = 0.03  # [m] between places for which an arm's posture is computed
_ITERATIONS = 6
_NEAR = 1e-4  # what a radian from the posture beside it weighs, against a metre of a point's way


class RestPoses:
    """The hands of a scene, all fingers over neighbouring white keys.

    Places of a hand are counted from that of its rest posture, to the player's right [m].
    """

    def __init__(self, scene: Scene, kinematics: Kinematics, servos: Servos, rest: Array) -> None:
        """Args:
        scene: with one hand or two.
        kinematics: of the scene.
        servos: of the scene.
        rest: (A,) the rest posture.
        """
        self._scene, self._kinematics, self._servos, self._rest = scene, kinematics, servos, rest
        self._points = kinematics.points(rest[None])[0]
        slides = servos.along_keyboard
        self._slides = dict(zip(scene.sides, slides, strict=bool(slides)))
        self._of_arms = {} if scene.hand.body.mount is None else self._computed()

    def stand(self, postures: Array, side: Side, places: Array) -> None:
        """Puts the hand of one side at `places` (S,) into its rows of `postures` (S, A)."""
        servos = self._servos
        if side in self._of_arms:
            known, there = self._of_arms[side]
            for servo in np.flatnonzero(np.ptp(there, axis=0)):
                postures[:, servo] = np.interp(places, known, there[:, servo])
        elif side in self._slides:
            slide = self._slides[side]
            postures[:, slide] = np.clip(places, servos.low[slide], servos.high[slide])

    def place(self, posture: Array, side: Side) -> float:
        """About where the hand of one side is in a posture (A,)."""
        if side in self._slides:
            return float(posture[self._slides[side]])
        moved = self._kinematics.points(posture[None])[0] - self._points
        return float(moved[self._scene.fingertips_on(side), 0, 1].mean())

    def _computed(self) -> dict[Side, tuple[Array, Array]]:
        """Side -> places (N,) of the hand that an arm brings it to, and postures (N, A)."""
        mount = self._scene.hand.body.mount
        assert mount is not None
        found = {}
        for side in self._scene.sides:
            sign = 1.0 if side == "right" else -1.0
            ends = sorted(sign * (end - mount.home) for end in (mount.low, mount.high))
            down, up = (self._on_the_way(side, end) for end in ends)
            places = [-_SPACING * i for i in range(len(down) - 1, 0, -1)]
            places += [_SPACING * i for i in range(len(up))]
            found[side] = np.array(places), np.stack([*down[:0:-1], *up])
        return found

    def _on_the_way(self, side: Side, end: float) -> list[Array]:
        """Postures from rest on, `_SPACING` apart, as far as the arm reaches."""
        steps = int(np.ceil(abs(end) / _SPACING))
        postures = [self._rest]
        for i in range(1, steps + 1):
            postures.append(self._moved(side, postures[-1], np.copysign(_SPACING * i, end)))
        return postures

    def _moved(self, side: Side, near: Array, place: float) -> Array:
        """The posture nearest to `near` in which all points of a hand have moved by `place`."""
        scene, servos = self._scene, self._servos
        mine = scene.fingertips_on(side)
        own = range(len(servos.names))[scene.servos_on(side)]
        arm = [a for a in own if servos.finger[a] < 0]
        finger, link, axis = np.indices(self._points[mine].shape).reshape(3, -1)
        finger += mine.start
        goal, posture = self._points[finger, link], near.copy()
        goal[:, 1] += place
        directions = np.eye(3)[axis]
        for _ in range(_ITERATIONS):
            links = self._kinematics.links(posture[None])
            points = links.points.reshape(self._points.shape)[finger, link]
            error = ((goal - points) * directions).sum(axis=1)
            slope = links.along(np.zeros_like(finger), finger, link, points, directions)
            slope = slope[:, np.array(arm) - own.start]
            normal = slope.T @ slope + _NEAR * np.eye(len(arm))
            pull = slope.T @ error + _NEAR * (near - posture)[arm]
            posture[arm] += np.linalg.solve(normal, pull)
            posture = servos.clip(posture)
        return posture
