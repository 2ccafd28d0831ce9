"""Measures how far the fingers of the right Shadow Hand reach along the keyboard.

Run `python tools/measure_reach.py` (two minutes) after changing the hand, and put what it prints
into src/cadenza/fingering/reach.py.

The forearm slides where it likes (tx, ty), the joints are those of the reduced action space, with
J1 = J2 in the fingers whose tendon couples them. A fingertip presses a white key when its site is
within 3 mm of the point 4 cm towards the player from the key's centre, at the height of a pressed
key; a finger that does not press stays above the keys. Postures come from
scipy.optimize.least_squares, from several starts.
"""

from __future__ import annotations

from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from cadenza.scene.config import SceneConfig
from cadenza.scene.piano import WHITE
from cadenza.scene.scene import build_scene
from cadenza.scene.shadow_hand import COUPLED_FINGERS

Array = NDArray[np.float64]

PRESS_X = 0.04  # [m] from the key's centre towards the player
FINGERTIP_RADIUS = 0.0067  # [m]
PRESSED_Z = (
    2 * WHITE.half_size[2] - (WHITE.half_size[0] + PRESS_X) * np.tan(WHITE.travel)
) + FINGERTIP_RADIUS
CLEAR_Z = 2 * WHITE.half_size[2] + FINGERTIP_RADIUS + 0.003
TOLERANCE = 0.003  # [m]
STEP = 0.0025  # [m] between the distances that are tried
STARTS = 6
ALL = range(5)


class Hand:
    """The right hand as a function from free joints to fingertips."""

    def __init__(self) -> None:
        scene = build_scene(SceneConfig(hands="right"))
        self._model, self._sites = scene.model, scene.fingertip_sites
        self._data = mujoco.MjData(self._model)
        names = [name.removeprefix("rh_") for name in scene.hand_joint_names]
        followers = [f"{finger}J1" for finger in COUPLED_FINGERS]
        self.free = [name for name in names if name not in followers]
        columns = [self.free.index(n.replace("J1", "J2") if n in followers else n) for n in names]
        self._spread = np.array(columns)
        self._qpos = scene.hand_qpos
        joints = [self._model.joint(f"rh_{name}") for name in self.free]
        self.low, self.high = np.array([joint.range for joint in joints]).T
        self._forearm = self._model.body("rh_forearm").id

    def tips(self, q: Array) -> Array:
        """(5, 3) fingertips in the world [m]."""
        self._data.qpos[self._qpos] = q[self._spread]
        mujoco.mj_kinematics(self._model, self._data)
        return self._data.site_xpos[self._sites].copy()

    def forearm_y(self) -> float:
        """Where the forearm was when `tips` was called last [m]."""
        return float(self._data.xpos[self._forearm, 1])


def distance(hand: Hand, pressing: Array) -> float:
    """Between the first and the last of the pressing fingertips; of one, from the forearm [m]."""
    first = pressing[0, 1] if len(pressing) > 1 else hand.forearm_y()
    return float(pressing[-1, 1] - first)


def posture(hand: Hand, fingers: tuple[int, ...], apart: float | None, start: Array) -> Array:
    """Joints with which `fingers` press at a `distance` if given, in a light posture."""
    rest = (hand.low + hand.high) / 2
    rest[hand.free.index("WRJ2")] = rest[hand.free.index("WRJ1")] = 0.0
    for i, name in enumerate(hand.free):
        if name.endswith("J4") and name != "THJ4":
            rest[i] = 0.0
    scale = hand.high - hand.low
    light = 3e-4 if apart is not None else 3e-3
    slide = hand.free.index("forearm_tx")
    others = [f for f in ALL if f not in fingers]

    def residual(q: Array) -> Array:
        tips = hand.tips(q)
        pressing = tips[list(fingers)]
        parts = [
            pressing[:, 0] - PRESS_X,
            pressing[:, 2] - PRESSED_Z,
            np.minimum(tips[others, 2] - CLEAR_Z, 0),
            light * np.delete((q - rest) / scale, slide),
        ]
        if apart is not None:
            parts.append([distance(hand, pressing) - apart])
        return np.concatenate(parts)

    solution = least_squares(residual, start, bounds=(hand.low - 1e-9, hand.high + 1e-9))
    return solution.x


def presses(hand: Hand, q: Array, fingers: tuple[int, ...], apart: float | None) -> bool:
    tips = hand.tips(q)
    pressing = tips[list(fingers)]
    errors = np.stack([pressing[:, 0] - PRESS_X, pressing[:, 2] - PRESSED_Z])
    off = 0.0 if apart is None else abs(distance(hand, pressing) - apart)
    clear = all(tips[f, 2] > CLEAR_Z - TOLERANCE for f in ALL if f not in fingers)
    return bool(np.abs(errors).max() < TOLERANCE and off < TOLERANCE and clear)


def extreme(hand: Hand, fingers: tuple[int, ...], q: Array, apart: float, step: float) -> float:
    """The last distance from `apart` on, in steps, at which `fingers` press."""
    rng = np.random.default_rng(0)
    while True:
        for attempt in range(STARTS):
            start = q if not attempt else rng.uniform(hand.low, hand.high)
            found = posture(hand, fingers, apart + step, start)
            if presses(hand, found, fingers, apart + step):
                q, apart = found, apart + step
                break
        else:
            return apart


def main() -> None:
    hand = Hand()
    middle = (hand.low + hand.high) / 2
    q = posture(hand, tuple(ALL), None, middle)
    assert presses(hand, q, tuple(ALL), None)
    tips = hand.tips(q)
    offsets = tips[:, 1] - hand.forearm_y()
    print("all five press in a light posture, from the forearm:", offsets.round(4).tolist())
    print("distances of two fingers, or of one from the forearm [m]:")
    for fingers in [*combinations(ALL, 1), *combinations(ALL, 2)]:
        hand.tips(q)
        apart = distance(hand, tips[list(fingers)])
        start = posture(hand, fingers, apart, q)
        least, most = (extreme(hand, fingers, start, apart, step) for step in (-STEP, STEP))
        print(fingers, f"least {least:.3f}  at rest {apart:.3f}  most {most:.3f}", flush=True)


if __name__ == "__main__":
    main()
