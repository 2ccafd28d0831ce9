"""What networks are told of a hand: its plan for half a second, and how far off it is.

All of it is relative to the hand and its plan, and a left hand is shown as its mirror image, so
that what is learnt serves both hands and every place on the keyboard.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.plan.presses import Press
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.fingers import SIDES, Side
from cadenza.scene.scene import Scene, hand_alone
from cadenza.scene.servos import servos_of, within

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

FAR = 8
"""Control steps ahead; what is further off looks the same."""
_POSTURES = (1, 2, 3, 5)  # steps ahead at which the planned posture is shown
_HELD = 6  # steps ahead for which is shown whether a finger holds a key
_OF_A_PRESS = 9 + _HELD  # numbers that are told of a finger's press
_OF_A_CASE = 53  # and of how it goes, see `_cases`
_NEIGHBOURS = np.array([-2, -1, 0, 1, 2])  # keys beside that of a finger
_MOST = 1.5  # corrections, of what a servo's `correction` is

# What counts as one.
_POSTURE = 0.1  # [m, rad] of planned postures
_SPEED = 2.0  # [m/s, rad/s] of planned speeds
_OFF, _TOO_FAST = 0.05, 1.0  # [m, rad], [m/s, rad/s] by which a servo is off its plan
_TIP_OFF = 0.01  # [m] by which a fingertip is
_ASTRAY = 1.2  # of that, beside where it should be
_KEY_OFF = 0.03  # [m] from a planned fingertip to the middle of its key


class Mirror(NamedTuple):
    """Makes right hands of H hands, whose forearms do not roll."""

    y: Array
    """(H,) what turns positions along the keyboard, 1 or -1."""
    servos: Array
    """(H, A) what turns the coordinates of servos."""

    @classmethod
    def of(cls, sides: Sequence[Side], alone: Scene) -> Mirror:
        """For the hands on these sides; each is as the one that is `alone` in a scene."""
        y, servos = np.array([1.0 if side == "right" else -1.0 for side in sides]), servos_of(alone)
        turned = np.ones((len(sides), len(servos.names)))
        turned[:, servos.along_keyboard] = y[:, None]
        return cls(y, turned)


class About(NamedTuple):
    """What each of the D numbers that are told of a hand is about."""

    finger: NDArray[np.intp]
    """(D,) a finger, 0 for the thumb, or -1 for the whole hand."""
    private: NDArray[np.bool_]
    """(D,) whether it says nothing to the fingers beside that one."""
    previous: NDArray[np.bool_]
    """(D,) whether it is the correction of the step before."""

    @classmethod
    def of(cls, alone: Scene) -> About:
        """For the hand which is `alone` in a scene."""
        servos, fingers = servos_of(alone).finger, np.arange(alone.fingers.per_hand)
        parts = [(servos, 1, True)] * (len(_POSTURES) + 3) + [(fingers, _OF_A_PRESS, False)]
        parts += [(servos, 1, True)] * 3
        correction = len(parts) - 1
        parts += [(fingers, count, False) for count in (len(_NEIGHBOURS) + 1, 3, 3)]
        parts += [(fingers, _OF_A_CASE, True)]
        finger = [np.repeat(of, count) for of, count, _ in parts]
        private = [np.full(len(of) * count, own) for of, count, own in parts]
        previous = [np.full(len(of), i == correction) for i, of in enumerate(finger)]
        return cls(*(np.concatenate(arrays) for arrays in (finger, private, previous)))


def sizes_of(scene: Scene) -> tuple[int, int]:
    """Of what is told of each hand of a scene, and of the answer."""
    alone = hand_alone(scene, scene.sides[0]).scene
    return len(About.of(alone).finger), len(servos_of(alone).low)


class HandInputs:
    """What is told of H hands, before each of the steps that a plan has from some on."""

    def __init__(self, plan: SongPlan, sides: Sequence[Side], alone: Scene, first: int) -> None:
        """Args:
        plan: as far as it goes.
        sides: of the hands, those of the scene or one of them.
        alone: a scene with one of them only.
        first: the step before which something is told for the first time.
        """
        self._mirror, self._first, scene = Mirror.of(sides, alone), first, plan.scene
        self._hands, self._keyboard = len(sides), alone.keyboard
        tracking = plan.nominal.tracking.of(scene.servos_on(*sides))
        self._tracking = tracking.by_hand(self._hands)
        self._tips = plan.nominal.fingertips[:, scene.fingertips_on(*sides)]
        self._place = np.ones(self._tips.shape[1:])  # what turns positions of fingertips
        self._place[:, 1] = np.repeat(self._mirror.y, scene.fingers.per_hand)
        self._wanted = plan.goals.keys
        steps = np.arange(first, plan.nominal.num_steps)
        thumb = scene.fingers.of_hand(SIDES.index(sides[0])).start
        mine = [press for press in plan.nominal.presses if press.side in sides]
        self._key, self._presses = self._coming(mine, thumb, steps)  # (S, H F), (S, H F, 15)
        presses = self._presses.reshape(len(steps), self._hands, -1)
        planned = [self._postures(alone, steps), presses]
        self._planned = np.concatenate(planned, axis=2, dtype=np.float32)  # as they are told

    def _postures(self, alone: Scene, steps: NDArray[np.intp]) -> Array:
        """(S, H, 7 A) what the plan does with the servos."""
        ctrl, _, expected = self._tracking
        turned, here = self._mirror.servos, expected[steps, :, :, 0]
        last = len(ctrl)
        ahead = [expected[np.minimum(steps + far, last), :, :, 0] for far in _POSTURES]
        relative = [(there - here) * turned / _POSTURE for there in (*ahead, ctrl[steps])]
        still = here.copy()
        still[..., servos_of(alone).along_keyboard] = 0.0  # wherever on the keyboard
        speeds = expected[steps, :, :, 1] * turned / _SPEED
        return np.concatenate([*relative, still, speeds], axis=2)

    def _coming(
        self, presses: list[Press], thumb: int, steps: NDArray[np.intp]
    ) -> tuple[NDArray[np.intp], Array]:
        """(S, H F) the keys that fingers press or will press next, and (S, H F, 15) what is told.

        Keys are -1 for none. `thumb` is the number of the first of these fingers.
        """
        fingers = np.arange(len(self._place))
        never = max([len(self._wanted) + _HELD, *(p.last for p in presses)]) + 1
        rows = [
            (p.finger - thumb, p.first, p.last, p.key, p.flies_to or p.flies_off) for p in presses
        ]
        rows += [(finger, never, never, 0, False) for finger in range(len(fingers))]  # their ends
        of, first, last, keys, jumps = np.array(sorted(rows)).T
        # On one time line, a finger's presses come long after those of the finger before it.
        apart = never + 1 - min(0, first.min(), last.min())  # in sight, some are of the past
        begins, ends = of * apart + first, of * apart + last
        now = fingers * apart + steps[:, None]
        soon = now[..., None] + np.arange(1, _HELD + 1)
        which, at = ends.searchsorted(now, "right"), begins.searchsorted(soon, "right") - 1
        shown = np.zeros((*which.shape, _OF_A_PRESS))
        shown[..., 4 : 4 + _HELD] = (at >= 0) & (soon < ends[at])
        key, over = keys[which], first[which] == never
        to_begin = first[which] - steps[:, None]
        shown[..., 0] = within(to_begin, -FAR, FAR) / FAR
        shown[..., 1] = within(last[which] - steps[:, None], 0, FAR) / FAR
        shown[..., 2], shown[..., 3] = self._keyboard.is_black[key], jumps[which]
        near = within(1 - to_begin / FAR, 0, 1)
        way = (self._keyboard.centre[key] - self._tips[steps]) * self._place / _KEY_OFF
        shown[..., 5 + _HELD : 8 + _HELD] = within(way, -2, 2) * (near > 0)[..., None]
        shown[..., 8 + _HELD] = near
        shown[over] = 0.0
        shown[over, :2], shown[over, 4 + _HELD] = 1.0, 1.0
        return np.where(over, -1, key), shown

    def at(
        self, step: int, posture: Array, correction: Array, tips: Array, key_qpos: Array
    ) -> Floats:
        """(H, D) what is told before a step.

        Args:
            step: of the song.
            posture: (H, A, 2) position and speed of the servos.
            correction: (H, A) what was answered before the step before.
            tips: (H F, 3) where fingertips are [m].
            key_qpos: (K,) [rad]
        """
        row, place = step - self._first, self._place
        off = (posture - self._tracking.expected[step]) * self._mirror.servos[..., None]
        following = self._tips[min(step + 1, len(self._tips) - 1)]
        depths = self._depths(row, step, key_qpos)
        from_now = within((tips - self._tips[step]) * place / _TIP_OFF, -4, 4)
        from_next = within((tips - following) * place / _TIP_OFF, -4, 4)
        cases = _cases(self._presses[row], depths, from_now, from_next)
        of_fingers = depths, from_now, from_next, cases
        parts = (
            self._planned[row],
            within(off[..., 0] / _OFF, -4, 4),
            within(off[..., 1] / _TOO_FAST, -4, 4),
            correction,
            *(values.reshape(self._hands, -1) for values in of_fingers),
        )
        return np.concatenate(parts, axis=1, dtype=np.float32)

    def _depths(self, row: int, step: int, key_qpos: Array) -> Array:
        """(H F, 6) how far down a finger's key and those beside it are, and if it should be."""
        key = self._key[row][:, None]
        beside = key + (_NEIGHBOURS * self._place[:, 1:2]).astype(np.intp)
        there = (key >= 0) & (beside >= 0) & (beside < len(key_qpos))
        depths = np.where(there, (key_qpos / self._keyboard.travel)[beside * there], 0.0)
        wanted = self._wanted[step, np.maximum(key, 0)] & (key >= 0)
        return np.concatenate([depths, wanted], axis=1)


def _cases(presses: Array, depths: Array, from_now: Array, from_next: Array) -> Array:
    """(F, 53) what is amiss with each finger, apart for cases that are not put right alike.

    It follows from what else is told, but only from several numbers at once: that a key is not
    quite down matters if it should be; that a fingertip is astray, in front of a black key.

    Args:
        presses: (F, 15) what is told of its press.
        depths: (F, 6) of its key and those beside it.
        from_now: (F, 3) how far its tip is from where it should be.
        from_next: (F, 3) and from where it should be after the step.
    """
    black, soon, near = presses[:, 2], presses[:, 4], presses[:, 8 + _HELD]
    wanted, lacks = depths[:, -1], within(1 - depths[:, len(_NEIGHBOURS) // 2], 0, 1)
    off, off_next = (np.hypot(some[:, 0], some[:, 1]) for some in (from_now, from_next))
    low, astray = within(-from_now[:, 2], 0, 4), off > _ASTRAY
    missing = wanted * lacks
    shallow = (1.0, off < 0.5, black, lacks < 0.5)
    lacking = [missing * case for case in shallow] + [soon * (1 - wanted) * lacks]
    of_black = near * black
    pressing = (near, of_black, near * astray, of_black * astray, wanted, wanted * black)
    cases = np.stack([*pressing, 1 - near, astray * (low > 0.3)], axis=1)
    amiss = np.column_stack([np.ones(len(off)), from_next, low, off_next])
    apart = cases[:, :, None] * amiss[:, None]
    return np.concatenate([np.stack(lacking, axis=1), apart.reshape(len(off), -1)], axis=1)


class Corrections(NamedTuple):
    """Answers as controls of H hands."""

    sign: Array
    """(H, A)"""
    scale: Array
    """(A,) what counts as one [m, rad]."""

    @classmethod
    def of(cls, sides: Sequence[Side], alone: Scene) -> Corrections:
        """For the hands on these sides; each is as the one that is `alone` in a scene."""
        return cls(Mirror.of(sides, alone).servos, servos_of(alone).correction)

    def ctrl(self, answer: Floats) -> Array:
        """(H, A) what is added to the controls, by the answer (H, A)."""
        return within(answer, -_MOST, _MOST) * self.sign * self.scale

    def output(self, ctrl: Array) -> Array:
        """The inverse of `ctrl`, of what was added."""
        return within(ctrl * self.sign / self.scale, -_MOST, _MOST)
