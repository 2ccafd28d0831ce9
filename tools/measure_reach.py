"""Measures how far the fingers of a right hand reach along the keyboard.

Run `python tools/measure_reach.py HAND` after changing a hand, and put the `Reach` that it prints
into it. It takes minutes, more with more fingers. HAND is the name of an
installed hand, or `module:NAME`. It also prints where the fingertips are at rest, which should be
over white keys.

The forearm slides where it likes (tx, ty); the joints are those of the reduced action space. A
fingertip presses a white key when it is within 3 mm of the point where the finger presses white
keys, at the height of a pressed key; a finger that does not press stays above the keys. Postures
come from scipy.optimize.least_squares, from several starts. They may pass through each other; so
`least` is never less than between neighbouring keys.
"""

from __future__ import annotations

import argparse
import sys
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from tqdm import tqdm

from cadenza.agents.planner.plan.rest_poses import rest_posture
from cadenza.errors import errors_in_a_line
from cadenza.hands.forearm import ALONG_KEYBOARD
from cadenza.scene.config import SceneConfig
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import build_scene
from cadenza.scene.servos import servos_of

Array = NDArray[np.float64]

ABOVE = 0.003  # [m] that fingers stay above the keys if they do not press
TOLERANCE = 0.003  # [m]
STEP = 0.0025  # [m] between the distances that are tried
STARTS = 6
SIDE_BY_SIDE = 0.0115  # [m] between a white key and the black one beside it


class Hand:
    """The right hand as a function from its servos to its fingertips."""

    def __init__(self, name: str) -> None:
        scene = build_scene(SceneConfig(hand=name, hands="right"))
        self._servos = servos_of(scene)
        self._kinematics = Kinematics(scene)
        self.slide = self._servos.names.index(ALONG_KEYBOARD)
        self._mount = scene.config.hand_spacing / 2
        self.low, self.high = self._servos.low, self._servos.high
        self.rest = rest_posture(self._servos)
        self.ease = np.array([use.ease for use in self._servos.uses])
        fingers, white = scene.hand.fingers, scene.keyboard.white
        self.fingers = range(len(fingers))
        self.names = [finger.name for finger in fingers]
        self.press_x = np.array([finger.on_white for finger in fingers])
        radius = np.array([finger.tip_radius for finger in fingers])
        fall = (white.half_size[0] + self.press_x) * np.tan(white.travel)
        self.press_z = white.top - fall + radius
        self.clear_z = white.top + radius + ABOVE

    def tips(self, q: Array) -> tuple[Array, Array]:
        """(F, 3) fingertips in the world [m], and their Jacobian (F, 3, A)."""
        tips, jacobian = self._kinematics.fingertips(q[None])
        return tips[0], jacobian[0]

    def forearm_y(self, q: Array) -> float:
        """The place of the forearm along the keyboard [m]."""
        return self._mount + float(q[self.slide])


def distance(hand: Hand, q: Array, fingers: tuple[int, ...]) -> float:
    """The distance from the first to the last fingertip; of one, from the forearm [m]."""
    y = hand.tips(q)[0][list(fingers), 1]
    return float(y[-1] - (y[0] if len(fingers) > 1 else hand.forearm_y(q)))


def posture(hand: Hand, fingers: tuple[int, ...], apart: float | None, start: Array) -> Array:
    """Servos with which `fingers` press at a distance if given, in a light posture."""
    pressing = list(fingers)
    others = [f for f in hand.fingers if f not in fingers]
    light = (3e-4 if apart is not None else 3e-3) / hand.ease
    light[hand.slide] = 0.0

    def residual(q: Array) -> Array:
        tips, _ = hand.tips(q)
        parts = [
            tips[pressing, 0] - hand.press_x[pressing],
            tips[pressing, 2] - hand.press_z[pressing],
            np.minimum(tips[others, 2] - hand.clear_z[others], 0),
            light * (q - hand.rest),
        ]
        if apart is not None:
            parts.append([distance(hand, q, fingers) - apart])
        return np.concatenate(parts)

    def slope(q: Array) -> Array:
        tips, jacobian = hand.tips(q)
        below = tips[others, 2] < hand.clear_z[others]
        parts = [
            jacobian[pressing, 0],
            jacobian[pressing, 2],
            jacobian[others, 2] * below[:, None],
            np.diag(light),
        ]
        if apart is not None:
            row = jacobian[pressing[-1], 1].copy()
            if len(pressing) > 1:
                row -= jacobian[pressing[0], 1]
            else:
                row[hand.slide] -= 1.0
            parts.append(row[None])
        return np.concatenate(parts)

    bounds = (hand.low - 1e-9, hand.high + 1e-9)
    return least_squares(residual, start, slope, bounds=bounds).x


def presses(hand: Hand, q: Array, fingers: tuple[int, ...], apart: float | None) -> bool:
    tips, pressing = hand.tips(q)[0], list(fingers)
    errors = [
        tips[pressing, 0] - hand.press_x[pressing],
        tips[pressing, 2] - hand.press_z[pressing],
    ]
    off = 0.0 if apart is None else abs(distance(hand, q, fingers) - apart)
    others = [f for f in hand.fingers if f not in fingers]
    clear = bool((tips[others, 2] > hand.clear_z[others] - TOLERANCE).all())
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


def print_rest(hand: Hand) -> None:
    tips, y = hand.tips(hand.rest)[0], hand.forearm_y(hand.rest)
    print("fingertips at rest:")
    for name, (towards, along, up), aim, clear_z in zip(
        hand.names, tips, hand.press_x, hand.clear_z, strict=True
    ):
        print(
            f"    {name}: {1000 * (along - y):.0f} mm to the right of the forearm, "
            f"{1000 * (up - clear_z + ABOVE):.0f} mm above white keys, "
            f"{1000 * towards:.0f} mm towards the player (presses at {1000 * aim:.0f})"
        )


def misses(hand: Hand, q: Array) -> str:
    """An error that says why the fingers cannot all press at once, with a line for each."""
    tips = hand.tips(q)[0]
    lines = ["the fingers cannot all press at once; change rest, on_white or the joints:"]
    for name, towards, up in zip(
        hand.names, tips[:, 0] - hand.press_x, tips[:, 2] - hand.press_z, strict=True
    ):
        if max(abs(towards), abs(up)) >= TOLERANCE:
            lines.append(
                f"    {name} stays {1000 * abs(up):.0f} mm {'above' if up > 0 else 'below'} a "
                f"pressed key, {1000 * abs(towards):.0f} mm too "
                f"{'near to' if towards > 0 else 'far from'} the player"
            )
    return "\n".join(lines)


def measured(hand: Hand) -> dict[str, Array]:
    """The fields of `Reach`."""
    everyone = tuple(hand.fingers)
    q = posture(hand, everyone, None, hand.rest)
    if not presses(hand, q, everyone, None):
        sys.exit(misses(hand, q))
    count = len(everyone)
    rest = hand.tips(q)[0][:, 1] - hand.forearm_y(q)
    outward, inward, most = np.zeros(count), np.zeros(count), np.zeros((count, count))
    least = SIDE_BY_SIDE * np.maximum(np.arange(count) - np.arange(count)[:, None], 0)
    for fingers in tqdm([*combinations(everyone, 1), *combinations(everyone, 2)]):
        apart = distance(hand, q, fingers)
        start = posture(hand, fingers, apart, q)
        low, high = (extreme(hand, fingers, start, apart, step) for step in (-STEP, STEP))
        if len(fingers) == 1:
            outward[fingers], inward[fingers] = -low, high
        else:
            least[fingers], most[fingers] = max(least[fingers], low), high
    return {"rest": rest, "least": least, "most": most, "outward": outward, "inward": inward}


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("hand", help="its name, or module:NAME")
    sys.path.append("")  # `module:NAME` may lie in the working folder
    hand = Hand(parser.parse_args().hand)
    print_rest(hand)
    reach = measured(hand)
    print("reach=Reach(")
    for name, values in reach.items():
        print(f"    {name}=np.array({(values.round(4) + 0.0).tolist()}),")
    print("    forearm_width=forearm.WIDTH,\n)")


if __name__ == "__main__":
    main()
