"""Measurement of a hand from a file: how it sits over the keys, and how far its fingers reach.

Postures are found by `scipy.optimize.least_squares`, with forearms free to slide. As fingers may
pass through each other there, `least` is bounded by the distance of neighbouring keys.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cadenza.agents.planner.plan.rest_poses import rest_posture
from cadenza.errors import CadenzaError
from cadenza.hands.body import Quaternion, prefix
from cadenza.hands.forearm import ALONG_KEYBOARD, FOREARM, FORWARDS, SERVOS
from cadenza.hands.hand import Hand
from cadenza.hands.mjcf import HandFile, Measurement, ReachField
from cadenza.scene.config import SceneConfig
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import build_scene

Array = NDArray[np.float64]

_ABOVE = 0.003  # [m] from the keys to fingers that do not press
_TOLERANCE = 0.003  # [m]
_QUICK = 0.05  # [s] the same of a servo that strikes in time
_MIN_DAMPING_RATIO = 0.7  # below which servos overshoot
_SLOW = 0.07  # [s] damping by stiffness, above which the planner does not time strikes
_STEP = 0.0025  # [m] between the distances to try
_STARTS = 3
_LIGHT, _LIGHTEST = 3e-3, 3e-4  # [m] residual of a servo that is as far from rest as its ease
_SIDE_BY_SIDE = 0.0115  # [m] between a white key and the black one beside it

# Of a hand over the keys; lengths in [m], angles in [rad]. Each is followed by the error of cost 1.
_HOVER, _HOVER_OFF = 0.01, 0.0005  # of fingertips above white keys
_PRESSES_AT, _AT_OFF = 0.047, 0.02  # from the middle of white keys
_CLEAR_OF_BLACK, _FARTHEST, _BEYOND_OFF = 0.017, 0.071, 0.001  # edges of tips, and their middles
_KEY, _GAP, _APART_OFF = 0.0235, 0.0015, 0.004  # from a white key to the next; between fingers
_ALONG_OFF = 0.003  # along and across the key, from above it to where the finger presses
_ROOM, _ROOM_OFF = 0.024, 0.003  # of all else above white keys, so that it is over black ones
_STEEP, _STEEP_THUMB, _STEEP_OFF = 0.85, 0.3, 0.3  # how far last links point down, of 1
_ASIDE_OFF = 0.6  # how far they point to a side
_MARGIN, _MARGIN_OFF = 0.1, 0.03  # margin at both ends of a joint's range, as a share of it
# Of the palm, and of joints from where the search begins: steep knuckles would hardly spread.
_TILT_OFF, _BENT_OFF = 5.0, 2.0
_LIFT, _MAX_LIFT = 0.02, 0.6  # by the servo that lifts a finger: of its tip, and of its joint
_TURN = 0.002  # of a servo, to see how it moves its fingertip
_PALM_AT = np.array([0.0, 0.0, 0.2])  # in the forearm's frame, where the search begins
_MAX_SHIFT = np.array([0.06, 0.12, 0.25, 0.7])  # of place and tilt from there
_TO_WORLD = np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])  # from the forearm's frame


def place(path: Path) -> tuple[HandFile, Measurement]:
    """Find how a hand from a file sits on its forearm, all fingertips just above white keys.

    Least squares over the place and the tilt of the palm, and over all servos above the keys and
    pressing them, from several starts.
    Raises CadenzaError if a file is wrong, or there is no such posture.
    """
    file = HandFile(path)
    hand = file.hand(Measurement(_vector(_PALM_AT), _quat(file.flat)))
    problem = _HoverProblem(hand)
    rng, best = np.random.default_rng(0), None
    for attempt in range(2 * _STARTS):
        start = problem.middle.copy()
        if attempt:
            start[:4] = rng.uniform(-_MAX_SHIFT, _MAX_SHIFT) / 2
            start[4:] = np.tile(rng.uniform(*problem.ranges), 2)
        solution = least_squares(
            problem.residual, start, bounds=(problem.low, problem.high), max_nfev=200
        )
        best = solution if best is None or solution.cost < best.cost else best
    assert best is not None
    above, pressing = problem.halves(best.x)
    tips, pressed = problem.points(above)[:, -1], problem.points(pressing)[:, -1]
    if not (np.diff(tips[:, 1]) > 0).all():
        raise CadenzaError(
            f"{path}: the fingers do not lie from left to right; give a right hand, thumb first"
        )
    for finger, error in zip(hand.fingers, problem.errors(best.x), strict=True):
        if error > _TOLERANCE:
            raise CadenzaError(
                f"{path}: finger {finger.name} does not come to white keys with the others: it "
                f"stays {1000 * error:.0f} mm off; see the order of fingers, and along"
            )
    palm, tilt, angles = above[:3], above[3], above[4:].round(4).tolist()
    return file, Measurement(
        pos=_vector(_PALM_AT + palm),
        quat=_quat(_tilted(tilt) @ file.flat),
        rest=dict(zip(problem.names, angles, strict=True)),
        lift=problem.lifts(above),
        on_white={
            finger.name: round(float(tip[0]), 4)
            for finger, tip in zip(hand.fingers, pressed, strict=True)
        },
        sha256=file.sha256,
    )


class _HoverProblem:
    """Least squares for a right hand with S servos that hovers over white keys, and presses them.

    The variables u (4 + 2 S,) are place and tilt of the palm, the servos while all fingers hover,
    and the servos while all press.
    """

    def __init__(self, hand: Hand) -> None:
        scene = build_scene(SceneConfig(hands="right"), hand)
        self._kinematics = Kinematics(scene)
        servos, white = self._kinematics.servos, scene.keyboard.white
        self._top, self._half_length, self._travel = white.top, white.half_size[0], white.travel
        self._of_hand = np.array([name in hand.servos for name in servos.names])
        self.names = [name for name in servos.names if name in hand.servos]
        self.ranges = low, high = servos.low[self._of_hand], servos.high[self._of_hand]
        self.low = np.array([*-_MAX_SHIFT, *low, *low])
        self.high = np.array([*_MAX_SHIFT, *high, *high])
        third = (high - low) / 3  # of a finger that is neither straight nor a fist
        bent = np.clip(0.0, low + third, high - third)
        self.middle = np.array([0.0, 0.0, 0.0, 0.0, *bent, *bent])
        self._rest = rest_posture(servos)
        self._finger = servos.finger[self._of_hand]
        mount = scene.model.body(prefix("right") + FOREARM).pos
        forwards = SERVOS[FORWARDS].rest
        self._palm = mount + _TO_WORLD @ (_PALM_AT + np.array([0.0, 0.0, forwards]))
        self._radii = np.array([finger.tip_radius for finger in hand.fingers])
        self._nearest = _CLEAR_OF_BLACK + self._radii
        wide = np.array([max(finger.radii) for finger in hand.fingers])
        self._apart = np.maximum(_KEY, wide[1:] + wide[:-1] + _GAP)

    def halves(self, u: Array) -> tuple[Array, Array]:
        """(4 + S,) each: place, tilt and servos while all fingers hover, and while all press."""
        count = len(self.names)
        return u[: 4 + count], np.concatenate([u[:4], u[4 + count :]])

    def points(self, u: Array) -> Array:
        """(F, P, 3) the points of the fingers in the world [m], of one half of the variables."""
        self._rest[self._of_hand] = u[4:]
        flat = self._kinematics.links(self._rest[None]).points[0, 0] - self._palm
        turn = _TO_WORLD @ _tilted(u[3]) @ _TO_WORLD.T
        turned: Array = flat @ turn.T + self._palm + _TO_WORLD @ u[:3]
        return turned

    def errors(self, u: Array) -> Array:
        """(F,) distances of fingertips from where they should hover and press [m]."""
        tips, pressed = (self.points(half)[:, -1] for half in self.halves(u))
        off = (
            tips[:, 2] - self._top - self._radii - _HOVER,
            self._height_error(pressed),
            _beyond(pressed[:, 0], self._nearest, _FARTHEST),
        )
        return np.abs(off).max(axis=0)

    def _height_error(self, tips: Array) -> Array:
        """(F,) heights of tips (F, 3) above those of pressed white keys [m]."""
        fall = (self._half_length + tips[:, 0]) * np.tan(self._travel)
        above: Array = tips[:, 2] - self._top - self._radii + fall
        return above

    def residual(self, u: Array) -> Array:
        above, pressing = self.halves(u)
        chains, pressed = self.points(above), self.points(pressing)[:, -1]
        tips, joints = chains[:, -1], chains[:, :-1]
        down = tips - joints[:, -1]
        down /= np.linalg.norm(down, axis=1, keepdims=True)
        share = (u - self.low)[4:] / (self.high - self.low)[4:]
        return np.concatenate([
            (tips[:, 2] - self._top - self._radii - _HOVER) / _HOVER_OFF,
            (tips[:, 0] - _PRESSES_AT) / _AT_OFF,
            self._height_error(pressed) / _HOVER_OFF,
            _beyond(pressed[:, 0], self._nearest, _FARTHEST) / _BEYOND_OFF,
            (pressed - tips)[:, :2].ravel() / _ALONG_OFF,
            (np.diff(tips[:, 1]) - self._apart) / _APART_OFF,
            [tips[:, 1].mean() - self._palm[1]],
            np.maximum(self._top + _ROOM - joints[..., 2], 0).ravel() / _ROOM_OFF,
            (down[1:, 2] + _STEEP) / _STEEP_OFF,
            np.maximum(down[:1, 2] + _STEEP_THUMB, 0) / _STEEP_OFF,
            down[:, 1] / _ASIDE_OFF,
            _beyond(share, _MARGIN, 1 - _MARGIN) / _MARGIN_OFF,
            u[3:4] / _TILT_OFF,
            (u - self.middle)[4:] / _BENT_OFF,
        ])  # fmt: skip

    def lifts(self, u: Array) -> dict[str, float]:
        """Servo that lifts each fingertip fastest -> the turn that lifts it by `_LIFT`."""
        at_rest, lifts = self.points(u)[:, -1, 2], dict[str, float]()
        for finger in range(len(at_rest)):
            servos = np.flatnonzero(self._finger == finger)
            moved = np.tile(u, (len(servos), 1))
            moved[np.arange(len(servos)), 4 + servos] += _TURN
            rates = [self.points(moved_u)[finger, -1, 2] - at_rest[finger] for moved_u in moved]
            if not rates:
                continue
            best = int(np.argmax(np.abs(rates)))
            turn = _LIFT * _TURN / rates[best]
            lifts[self.names[servos[best]]] = round(float(np.clip(turn, -_MAX_LIFT, _MAX_LIFT)), 3)
        return lifts


def _some(names: Sequence[str]) -> str:
    """The first of some names, and how many more there are."""
    return names[0] + (f" and {len(names) - 1} more" if names[1:] else "")


class ReachMeasurement:
    """The right hand as a function from its servos to its fingertips, and how far they reach.

    A fingertip presses a white key when it is within 3 mm of where the finger presses them, at the
    height of a pressed key; a finger that does not press stays above the keys.
    """

    def __init__(self, hand: Hand) -> None:
        scene = build_scene(SceneConfig(hands="right"), hand)
        self._name, self._kinematics = hand.name, Kinematics(scene)
        servos, white = self._kinematics.servos, scene.keyboard.white
        self._slide = servos.names.index(ALONG_KEYBOARD)
        self._mount = scene.config.hand_spacing / 2
        self._low, self._high = servos.low, servos.high
        self._rest = rest_posture(servos)
        self._ease = np.array([use.ease for use in servos.uses])
        self._fingers = range(len(hand.fingers))
        self._names = [finger.name for finger in hand.fingers]
        self._press_x = np.array([finger.on_white for finger in hand.fingers])
        radius = np.array([finger.tip_radius for finger in hand.fingers])
        fall = (white.half_size[0] + self._press_x) * np.tan(white.travel)
        self._press_z = white.top - fall + radius
        self._clear_z = white.top + radius + _ABOVE

    def at_rest(self) -> Iterator[str]:
        """Yield a line for each finger: where its tip is at rest."""
        tips, y = self._tips(self._rest)[0], self._forearm_y(self._rest)
        for name, (towards, along, up), aim, clear_z in zip(
            self._names, tips, self._press_x, self._clear_z, strict=True
        ):
            yield (
                f"{name}: {1000 * (along - y):.0f} mm to the right of the forearm, "
                f"{1000 * (up - clear_z + _ABOVE):.0f} mm above white keys, "
                f"{1000 * towards:.0f} mm towards the player (presses at {1000 * aim:.0f})"
            )

    def slow(self) -> Iterator[str]:
        """Yield a line on the servos of fingers that strike late, for each lag."""
        servos, late = self._kinematics.servos, defaultdict[int, list[str]](list)
        lags = servos.damping / servos.stiffness
        for name, finger, lag in zip(servos.names, servos.finger, lags, strict=True):
            if finger >= 0 and lag > _SLOW:
                late[round(1000 * lag)].append(name)
        for ms, names in sorted(late.items(), reverse=True):
            yield f"servos that strike late, by {ms} ms: {_some(names)}; see damping and kp"

    def swinging(self) -> Iterator[str]:
        """Yield a line on the servos of fingers that overshoot, with gains at which none would."""
        servos = self._kinematics.servos
        critical = 2 * np.sqrt(servos.stiffness * servos.inertia)
        is_swinging = (servos.finger >= 0) & (servos.damping < _MIN_DAMPING_RATIO * critical)
        if is_swinging.any():
            heaviest = int(np.argmax(np.where(is_swinging, servos.inertia, 0.0)))
            inertia, least = servos.inertia[heaviest], 4 * servos.inertia[heaviest] / _QUICK**2
            stiffness = max(servos.stiffness[heaviest], least)
            names = [servos.names[i] for i in np.flatnonzero(is_swinging)]
            yield (
                f"servos that overshoot and strike wrong keys, as what they move is heavy: "
                f"{_some(names)}; try kp = {stiffness:.2g} and damping = "
                f"{2 * np.sqrt(stiffness * inertia):.2g}"
            )

    def measure(self, advance: Callable[[int, int], None]) -> dict[ReachField, Array]:
        """The measured fields of `Reach`.

        `advance` receives the number of fingers and pairs done, and in all. Raises CadenzaError if
        not all fingers can press at once, or no two of them reach two keys.
        """
        all_fingers = tuple(self._fingers)
        q = self._rest
        for weight in (_LIGHT, _LIGHTEST):
            q = self._posture(all_fingers, None, q, weight)
            if self._presses(q, all_fingers, None):
                break
        else:
            raise CadenzaError(self._misses(q))
        count = len(all_fingers)
        rest = self._tips(q)[0][:, 1] - self._forearm_y(q)
        outward, inward, most = np.zeros(count), np.zeros(count), np.zeros((count, count))
        least = _SIDE_BY_SIDE * np.maximum(np.arange(count) - np.arange(count)[:, None], 0)
        groups = [*combinations(all_fingers, 1), *combinations(all_fingers, 2)]
        for number, fingers in enumerate(groups):
            advance(number, len(groups))
            apart = self._distance(q, fingers)
            start = self._posture(fingers, apart, q, _LIGHTEST)
            last = least[fingers] if len(fingers) > 1 else -np.inf
            low = self._extreme(fingers, start, apart, -_STEP, last)
            high = self._extreme(fingers, start, apart, _STEP, np.inf)
            if len(fingers) == 1:
                outward[fingers], inward[fingers] = -low, high
            else:
                least[fingers], most[fingers] = max(least[fingers], low), high
        if count > 1 and most.max() < _KEY:
            raise CadenzaError(f"hand {self._name}: no two fingers reach two white keys")
        fields: dict[ReachField, Array] = {
            "rest": rest, "least": least, "most": most, "outward": outward, "inward": inward
        }  # fmt: skip
        return {name: values.round(4) + 0.0 for name, values in fields.items()}

    def _tips(self, q: Array) -> tuple[Array, Array]:
        """(F, 3) fingertips in the world [m], and their Jacobian (F, 3, A)."""
        tips, jacobian = self._kinematics.fingertips(q[None])
        return tips[0], jacobian[0]

    def _forearm_y(self, q: Array) -> float:
        """The place of the forearm along the keyboard [m]."""
        return self._mount + float(q[self._slide])

    def _distance(self, q: Array, fingers: tuple[int, ...]) -> float:
        """Distance from the first to the last fingertip; of one finger, from the forearm [m]."""
        y = self._tips(q)[0][list(fingers), 1]
        return float(y[-1] - (y[0] if len(fingers) > 1 else self._forearm_y(q)))

    def _posture(
        self, fingers: tuple[int, ...], apart: float | None, start: Array, weight: float
    ) -> Array:
        """Servos with which `fingers` press, `apart` [m] if given; `weight` pulls them to rest."""
        pressing = list(fingers)
        others = [f for f in self._fingers if f not in fingers]
        light = weight / self._ease
        light[self._slide] = 0.0

        def residual(q: Array) -> Array:
            tips, _ = self._tips(q)
            parts = [
                tips[pressing, 0] - self._press_x[pressing],
                tips[pressing, 2] - self._press_z[pressing],
                np.minimum(tips[others, 2] - self._clear_z[others], 0),
                light * (q - self._rest),
            ]
            if apart is not None:
                parts.append([self._distance(q, fingers) - apart])
            return np.concatenate(parts)

        def derivatives(q: Array) -> Array:
            tips, jacobian = self._tips(q)
            below = tips[others, 2] < self._clear_z[others]
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
                    row[self._slide] -= 1.0
                parts.append(row[None])
            return np.concatenate(parts)

        bounds = (self._low - 1e-9, self._high + 1e-9)
        solution: Array = least_squares(residual, start, derivatives, bounds=bounds).x
        return solution

    def _presses(self, q: Array, fingers: tuple[int, ...], apart: float | None) -> bool:
        tips, pressing = self._tips(q)[0], list(fingers)
        errors = [
            tips[pressing, 0] - self._press_x[pressing],
            tips[pressing, 2] - self._press_z[pressing],
        ]
        off = 0.0 if apart is None else abs(self._distance(q, fingers) - apart)
        others = [f for f in self._fingers if f not in fingers]
        clear = bool((tips[others, 2] > self._clear_z[others] - _TOLERANCE).all())
        return bool(np.abs(errors).max() < _TOLERANCE and off < _TOLERANCE and clear)

    def _extreme(
        self, fingers: tuple[int, ...], q: Array, apart: float, step: float, last: float
    ) -> float:
        """Extreme distance at which `fingers` press, from `apart` in steps until past `last`."""
        rng = np.random.default_rng(0)
        while step * (last - apart) > 0:
            for attempt in range(_STARTS):
                start = q if not attempt else rng.uniform(self._low, self._high)
                posture = self._posture(fingers, apart + step, start, _LIGHTEST)
                if self._presses(posture, fingers, apart + step):
                    q, apart = posture, apart + step
                    break
            else:
                break
        return apart

    def _misses(self, q: Array) -> str:
        """Message on the fingers that do not press in a posture of all."""
        tips = self._tips(q)[0]
        off = [
            f"{name} stays {1000 * up:.0f} mm above a pressed key, "
            f"{1000 * towards:.0f} mm too far towards the player"
            for name, towards, up in zip(
                self._names, tips[:, 0] - self._press_x, tips[:, 2] - self._press_z, strict=True
            )
            if max(abs(towards), abs(up)) >= _TOLERANCE
        ]
        return f"hand {self._name}: the fingers cannot all press at once: {'; '.join(off)}"


def _beyond(values: Array, low: Array | float, high: float) -> Array:
    """Excess of values beyond a range, negative under its lower end."""
    return values - np.clip(values, low, high)


def _tilted(angle: float) -> Array:
    """(3, 3) the rotation that bends a palm down, about x of the forearm."""
    rotation: Array = Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()
    return rotation


def _quat(rotation: Array) -> Quaternion:
    w, x, y, z = Rotation.from_matrix(rotation).as_quat(scalar_first=True).round(6).tolist()
    return w, x, y, z


def _vector(values: Array) -> tuple[float, float, float]:
    x, y, z = values.round(4).tolist()
    return x, y, z
