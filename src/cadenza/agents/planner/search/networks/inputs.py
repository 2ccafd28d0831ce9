"""Inputs and outputs of the networks that correct a hand's plan.

The inputs of a hand with A servos and F fingers are D numbers, in this order. All are relative to
the hand and its plan, and a left hand is mirrored, so that networks serve both hands everywhere on
the keyboard.

- (4, A) planned postures 1, 2, 3 and 5 steps ahead, and (A,) the nominal controls, from the planned
  posture now
- (A,) the planned posture now, without the position along the keyboard
- (A,) planned velocities of the servos
- (F, 15) the current or next press of each finger, see `HandInputs._presses_ahead`
- (A,) errors of position, and (A,) of velocity, of the servos from the plan
- (A,) the output of the step before
- (F, 6) depths of each finger's key and of two keys on either side, and whether its key is a goal
- (F, 3) errors of fingertips from the plan now, and (F, 3) from the plan after the step
- (F, 53) products of these errors with the cases in which they need correction, see `_cases`
- (F, 5) the strike of each finger, if it comes soon, see `HandInputs._strikes_ahead`

The outputs (A,) are corrections of the controls, see `Corrections`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.presses import Press
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.fingers import SIDES, Side
from cadenza.scene.scene import Scene, hand_alone
from cadenza.scene.servos import clip, servos_of

Floats = NDArray[np.float32]

FAR = 8  # control steps ahead that inputs depend on
_POSTURE_STEPS = (1, 2, 3, 5)  # steps ahead of the planned postures
_HELD_STEPS = 6  # steps ahead for which an input says whether a finger holds a key
_PRESS_INPUTS = 9 + _HELD_STEPS  # per finger, of its press
_CASE_INPUTS = 53  # per finger, see `_cases`
_STRIKE_INPUTS = 5  # per finger, of its strike
_STRIKE_STEPS = 3  # in which a strike counts as soon: this step and the next two
_NEIGHBOURS = np.array([-2, -1, 0, 1, 2])  # keys, from that of a finger
_MAX_OUTPUT = 1.5  # in units of `Servos.correction`
_MAX_ERROR = 4.0  # scaled errors are clipped here
_MAX_KEY_OFFSET = 2.0  # scaled offsets to keys are clipped here

# Scales by which inputs are divided.
_POSTURE_SCALE = 0.1  # [m, rad] of planned postures
_VELOCITY_SCALE = 2.0  # [m/s, rad/s] of planned velocities
_POSITION_ERROR_SCALE, _VELOCITY_ERROR_SCALE = 0.05, 1.0  # [m, rad], [m/s, rad/s] of servos
_TIP_ERROR_SCALE = 0.01  # [m] of fingertips
_KEY_OFFSET_SCALE = 0.03  # [m] from a planned fingertip to the middle of its key
_HEIGHT_SCALE = 0.01  # [m] of a fingertip above its key

# Limits of the cases of `_cases`: fingertip errors are in units of _TIP_ERROR_SCALE, depths of the
# key's travel.
_OFF_TARGET, _OVER_ITS_KEY, _HALF_DOWN, _LOW = 1.2, 0.5, 0.5, 0.3


class Mirror(NamedTuple):
    """Signs, 1 or -1, that map H hands to right hands; their forearms must not roll."""

    y: Array  # (H,) signs of positions along the keyboard
    servos: Array  # (H, A) signs of coordinates of servos

    @classmethod
    def of(cls, sides: Sequence[Side], alone: Scene) -> Mirror:
        """The signs for hands on these sides; `alone` is a scene with one of them."""
        y, servos = np.array([1.0 if side == "right" else -1.0 for side in sides]), servos_of(alone)
        sign = np.ones((len(sides), len(servos.names)))
        sign[:, servos.along_keyboard] = y[:, None]
        return cls(y, sign)


class InputLayout(NamedTuple):
    """The finger of each of the D inputs of a hand, and which fingers need it."""

    finger: NDArray[np.intp]  # (D,) 0 for the thumb, or -1 for the whole hand
    private: NDArray[np.bool_]  # (D,) whether only this finger needs it
    previous: NDArray[np.bool_]  # (D,) whether it is an output of the step before
    # (F,) the inputs that are 1 if a finger strikes in the step, and otherwise 0
    striking: NDArray[np.intp]

    @classmethod
    def of(cls, alone: Scene) -> InputLayout:
        """Layout for the hand that is `alone` in a scene."""
        servos, fingers = servos_of(alone).finger, np.arange(alone.fingers.per_hand)
        parts = [(servos, 1, True)] * (len(_POSTURE_STEPS) + 3) + [(fingers, _PRESS_INPUTS, False)]
        parts += [(servos, 1, True)] * 3
        correction = len(parts) - 1
        parts += [(fingers, count, False) for count in (len(_NEIGHBOURS) + 1, 3, 3)]
        parts += [(fingers, count, True) for count in (_CASE_INPUTS, _STRIKE_INPUTS)]
        finger = [np.repeat(of, count) for of, count, _ in parts]
        private = [np.full(len(of) * count, is_private) for of, count, is_private in parts]
        previous = [np.full(len(of), i == correction) for i, of in enumerate(finger)]
        size = sum(map(len, finger))
        striking = np.arange(size - len(fingers) * _STRIKE_INPUTS, size, _STRIKE_INPUTS)
        joined = np.concatenate
        return cls(joined(finger), joined(private), joined(previous), striking)


def sizes_of(scene: Scene) -> tuple[int, int]:
    """D and A: numbers of inputs and outputs of each hand of a scene."""
    alone = hand_alone(scene, scene.sides[0]).scene
    return len(InputLayout.of(alone).finger), len(servos_of(alone).low)


class HandInputs:
    """The inputs of H hands at each step of a plan, from `first` on."""

    def __init__(self, plan: SongPlan, sides: Sequence[Side], alone: Scene, first: int) -> None:
        """Compute the inputs that depend on the plan only, for all hands of its scene or one.

        `alone` is a scene with one of these hands.
        """
        self._mirror, self._first, scene = Mirror.of(sides, alone), first, plan.scene
        self._hands, self._keyboard = len(sides), alone.keyboard
        tracking = plan.nominal.tracking.of(scene.servos_on(*sides))
        self._tracking = tracking.by_hand(self._hands)
        self._tips = plan.nominal.fingertips[:, scene.fingertips_on(*sides)]
        self._sign = np.ones(self._tips.shape[1:])  # for positions of fingertips
        self._sign[:, 1] = np.repeat(self._mirror.y, scene.fingers.per_hand)
        self._goal_keys = plan.goals.keys
        fingers = alone.hand.fingers * self._hands
        self._radius = np.array([finger.tip_radius for finger in fingers])
        steps = np.arange(first, plan.nominal.num_steps)
        thumb = scene.fingers.of_hand(SIDES.index(sides[0])).start
        presses = [press for press in plan.nominal.presses if press.side in sides]
        dt = plan.track.config.control_timestep
        # (S, H F), (S, H F, 15); (S, H F, 4), (S, H F)
        self._key, self._presses = self._presses_ahead(presses, thumb, steps)
        self._strikes, self._on_key = self._strikes_ahead(presses, thumb, steps, dt)
        press_inputs = self._presses.reshape(len(steps), self._hands, -1)
        parts = [self._postures(alone, steps), press_inputs]
        self._planned = np.concatenate(parts, axis=2, dtype=np.float32)

    def _postures(self, alone: Scene, steps: NDArray[np.intp]) -> Array:
        """(S, H, 7 A) inputs about the planned posture of the hand."""
        ctrl, _, expected = self._tracking
        sign, posture = self._mirror.servos, expected[steps, :, :, 0]
        last = len(ctrl)
        ahead = [expected[np.minimum(steps + far, last), :, :, 0] for far in _POSTURE_STEPS]
        targets = (*ahead, ctrl[steps])
        relative = [(target - posture) * sign / _POSTURE_SCALE for target in targets]
        in_place = posture.copy()
        in_place[..., servos_of(alone).along_keyboard] = 0.0  # the same everywhere
        velocities = expected[steps, :, :, 1] * sign / _VELOCITY_SCALE
        return np.concatenate([*relative, in_place, velocities], axis=2)

    def _presses_ahead(
        self, presses: list[Press], thumb: int, steps: NDArray[np.intp]
    ) -> tuple[NDArray[np.intp], Array]:
        """The current or next press of each finger: its key (S, H F), -1 for none, and its inputs.

        The inputs (S, H F, 15) are the steps until it begins, and until it ends; whether its key is
        black, and whether the hand jumps; whether the finger holds a key 1, 2, ... 6 steps ahead;
        whether there is no press; the offset from the planned fingertip to the middle of its key in
        x, y and z; and how near the press is in time. `thumb` is the number of the first finger.
        """
        fingers = np.arange(len(self._sign))
        never = max([len(self._goal_keys) + _HELD_STEPS, *(p.last for p in presses)]) + 1
        rows = [
            (p.finger - thumb, p.first, p.last, p.key, p.jumps_to or p.jumps_off) for p in presses
        ]
        rows += [(finger, never, never, 0, False) for finger in range(len(fingers))]  # sentinels
        finger, first, last, keys, jumps = np.array(sorted(rows)).T
        # On one time line, a finger's presses come long after those of the finger before it.
        apart = never + 1 - min(0, first.min(), last.min())  # some began before the plan
        begins, ends = finger * apart + first, finger * apart + last
        now = fingers * apart + steps[:, None]
        soon = now[..., None] + np.arange(1, _HELD_STEPS + 1)
        row, held_row = ends.searchsorted(now, "right"), begins.searchsorted(soon, "right") - 1
        inputs = np.zeros((*row.shape, _PRESS_INPUTS))
        inputs[..., 4 : 4 + _HELD_STEPS] = (held_row >= 0) & (soon < ends[held_row])
        key, has_none = keys[row], first[row] == never
        to_begin = first[row] - steps[:, None]
        inputs[..., 0] = clip(to_begin, -FAR, FAR) / FAR
        inputs[..., 1] = clip(last[row] - steps[:, None], 0, FAR) / FAR
        inputs[..., 2], inputs[..., 3] = self._keyboard.is_black[key], jumps[row]
        near = clip(1 - to_begin / FAR, 0, 1)
        offset = (self._keyboard.centre[key] - self._tips[steps]) * self._sign / _KEY_OFFSET_SCALE
        inputs[..., 5 + _HELD_STEPS : 8 + _HELD_STEPS] = (
            clip(offset, -_MAX_KEY_OFFSET, _MAX_KEY_OFFSET) * (near > 0)[..., None]
        )
        inputs[..., 8 + _HELD_STEPS] = near
        inputs[has_none] = 0.0
        inputs[has_none, :2], inputs[has_none, 4 + _HELD_STEPS] = 1.0, 1.0
        return np.where(has_none, -1, key), inputs

    def _strikes_ahead(
        self, presses: list[Press], thumb: int, steps: NDArray[np.intp], dt: float
    ) -> tuple[Array, Array]:
        """Inputs (S, H F, 4) of strikes in this step and the next two, and heights (S, H F).

        The inputs are whether the strike is in this step, and whether in the next; its time within
        the step, from -1 to 1; and log2 of the angular speed of the key. All are 0 for a finger
        that does not strike so soon. The heights are those of fingertips on the keys that they
        strike [m].
        """
        inputs = np.zeros((len(steps), len(self._sign), _STRIKE_INPUTS - 1))
        on_key = np.zeros(inputs.shape[:2])
        strikes = [(p.first - 1, p.finger - thumb, p.key, *p.strike) for p in presses if p.strike]
        if not strikes:
            return inputs, on_key
        columns, keyboard = np.array(strikes).T, self._keyboard
        step, finger, key = columns[:3].astype(np.intp)
        time_and_speed = np.stack([2 * columns[3] / dt - 1, np.log2(columns[4])], axis=1)
        top = keyboard.centre[key, 2] + keyboard.half_size[key, 2] + self._radius[finger]
        for ahead in range(_STRIKE_STEPS)[::-1]:
            row = step - ahead - self._first
            inside = (row >= 0) & (row < len(steps))
            is_soon = np.tile([ahead == 0, ahead == 1], (len(step), 1))
            places = row[inside], finger[inside]
            inputs[places] = np.concatenate([is_soon, time_and_speed], axis=1)[inside]
            on_key[places] = top[inside]
        return inputs, on_key

    def at(
        self, step: int, posture: Array, previous: Array, tips: Array, key_qpos: Array
    ) -> Floats:
        """Inputs (H, D) at a step of the song.

        Servos are in a `posture` (H, A, 2), fingertips at `tips` (H F, 3) [m] and keys at
        `key_qpos` (K,) [rad]; `previous` (H, A) are the outputs of the step before.
        """
        row, sign = step - self._first, self._sign
        error = (posture - self._tracking.expected[step]) * self._mirror.servos[..., None]
        next_tips = self._tips[min(step + 1, len(self._tips) - 1)]
        depths = self._depths(row, step, key_qpos)
        error_now = _scaled((tips - self._tips[step]) * sign, _TIP_ERROR_SCALE)
        error_next = _scaled((tips - next_tips) * sign, _TIP_ERROR_SCALE)
        cases = _cases(self._presses[row], depths, error_now, error_next)
        by_finger = depths, error_now, error_next, cases, self._strikes_at(row, tips)
        parts = (
            self._planned[row],
            _scaled(error[..., 0], _POSITION_ERROR_SCALE),
            _scaled(error[..., 1], _VELOCITY_ERROR_SCALE),
            previous,
            *(values.reshape(self._hands, -1) for values in by_finger),
        )
        return np.concatenate(parts, axis=1, dtype=np.float32)

    def _strikes_at(self, row: int, tips: Array) -> Array:
        """(H F, 5) inputs of strikes, with the heights of fingertips above their keys."""
        on_key = self._on_key[row]
        height = _scaled(tips[:, 2] - on_key, _HEIGHT_SCALE) * (on_key > 0)
        return np.concatenate([self._strikes[row], height[:, None]], axis=1)

    def _depths(self, row: int, step: int, key_qpos: Array) -> Array:
        """(H F, 6) depths of a finger's key and of four beside it, and whether it is a goal."""
        key = self._key[row][:, None]
        beside = key + (_NEIGHBOURS * self._sign[:, 1:2]).astype(np.intp)
        exists = (key >= 0) & (beside >= 0) & (beside < len(key_qpos))
        depths = np.where(exists, (key_qpos / self._keyboard.travel)[beside * exists], 0.0)
        goal = self._goal_keys[step, np.maximum(key, 0)] & (key >= 0)
        return np.concatenate([depths, goal], axis=1)


def _cases(presses: Array, depths: Array, error_now: Array, error_next: Array) -> Array:
    """Products (F, 53) of errors and of the cases in which they need correction.

    They are functions of several other inputs: that a key is not quite down matters if it is a
    goal; that a fingertip is off matters most in front of a black key.

    Args:
        presses: (F, 15) inputs about the presses.
        depths: (F, 6) inputs about the keys.
        error_now: (F, 3) scaled errors of fingertips from the plan.
        error_next: (F, 3) scaled errors of fingertips from the plan after the step.
    """
    black, soon, near = presses[:, 2], presses[:, 4], presses[:, 8 + _HELD_STEPS]
    goal, lacking = depths[:, -1], clip(1 - depths[:, len(_NEIGHBOURS) // 2], 0, 1)
    beside, beside_next = (np.hypot(error[:, 0], error[:, 1]) for error in (error_now, error_next))
    low, is_off = clip(-error_now[:, 2], 0, _MAX_ERROR), beside > _OFF_TARGET
    too_high = goal * lacking
    cases_too_high = (1.0, beside < _OVER_ITS_KEY, black, lacking < _HALF_DOWN)
    depth = [too_high * case for case in cases_too_high] + [soon * (1 - goal) * lacking]
    of_black = near * black
    pressing = (near, of_black, near * is_off, of_black * is_off, goal, goal * black)
    cases = np.stack([*pressing, 1 - near, is_off * (low > _LOW)], axis=1)
    errors = np.column_stack([np.ones(len(low)), error_next, low, beside_next])
    products = (cases[:, :, None] * errors[:, None]).reshape(len(low), -1)
    return np.concatenate([np.stack(depth, axis=1), products], axis=1)


def _scaled(error: Array, scale: float) -> Array:
    """Errors in units of `scale`, clipped."""
    return clip(error / scale, -_MAX_ERROR, _MAX_ERROR)


class Corrections(NamedTuple):
    """The map from outputs of networks to corrections of the controls of H hands, and back."""

    sign: Array  # (H, A) 1, or -1 where a left hand is mirrored
    scale: Array  # (A,) corrections with an output of 1 [m, rad]

    @classmethod
    def of(cls, sides: Sequence[Side], alone: Scene) -> Corrections:
        """Corrections of hands on these sides; `alone` is a scene with one of them."""
        return cls(Mirror.of(sides, alone).servos, servos_of(alone).correction)

    def ctrl(self, output: Floats) -> Array:
        """(H, A) the changes of the controls with outputs (H, A) [m, rad]."""
        return clip(output, -_MAX_OUTPUT, _MAX_OUTPUT) * self.sign * self.scale

    def output(self, ctrl: Array) -> Array:
        """(H, A) the outputs that add `ctrl` (H, A) to the controls: the inverse of `ctrl`."""
        return clip(ctrl * self.sign / self.scale, -_MAX_OUTPUT, _MAX_OUTPUT)
