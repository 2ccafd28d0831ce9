"""Plays a plan in a simulation, and changes it by how far fingertips were astray.

It is iterative learning control, a second of the plan at a time: what went wrong in a take says how
the next one is played, nothing is drawn. Of the takes, each hand keeps the one that it played best,
and the next second goes on from where that has led.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.agents.generalist.corrected_hand import CorrectedHand
from cadenza.agents.generalist.inputs import FAR
from cadenza.agents.generalist.weights import Weights
from cadenza.agents.planning.control_steps import steps_in
from cadenza.agents.planning.correction import no_further
from cadenza.agents.planning.hand_part import ASTRAY, HandPart
from cadenza.agents.planning.learning_control import changes
from cadenza.agents.planning.losses import Heard, Losses
from cadenza.agents.planning.song_plan import SongPlan
from cadenza.fingers import SIDES, Side
from cadenza.scene.kinematics import TIP, Kinematics
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State

_FIRST, _WINDOW = 0.5, 1.0  # [s] rehearsed at once: less before the first action
_DEEPER = 0.006  # [m] that a fingertip should be whose key should sound and does not
_THERE = 0.006  # [m] beside where it should be, it is not too high but astray
_HIGHER = 0.01  # [m] that a fingertip should be whose key should not sound and does
_OVER = 0.015  # [m] from the middle of that key, it is not this fingertip that presses it
_SHARE = 0.7  # of the changes that should be enough: nothing is as simple as they take it to be

Mask = NDArray[np.bool_]


class Take(NamedTuple):
    """What came of a window of the plan, and of what follows it, S steps in all."""

    ctrl: Array
    """(S, A) of the plan, for the servos of both hands."""
    changes: Array
    """(S, A) to them, which would have been better."""
    cost: Array
    """(H,) of each hand, see `Losses`."""
    faultless: Mask
    """(H,) whether it did all that the plan has it do, and nothing else."""
    end: PlanningSimulation
    """Where the window ends."""
    heard: Heard
    """Then."""
    answers: list[Array]
    """(A,) by how much each hand was corrected just before."""


class Rehearsal:
    """Both hands in a simulation of their own.

    Attributes:
        steps: how many have been rehearsed.
        here: the simulation after them.
    """

    def __init__(self, plan: SongPlan, start: State, weights: Weights) -> None:
        """Args:
        plan: of the song, as far as it goes.
        start: the first of its states is where the hands begin.
        weights: what corrects the plan as it is played.
        """
        dt = plan.track.config.control_timestep
        self._first, self._more = steps_in(_FIRST, dt), steps_in(_WINDOW, dt)
        self._weights, self.steps = weights, 0
        self.here = PlanningSimulation(plan.scene, 1, dt)
        self.here.place(start.hand_qpos[0], start.hand_qvel[0], start.key_qpos[0])
        silent = np.zeros(plan.scene.keyboard.num_keys, bool)
        self._heard, self._keys = Heard(silent, silent), plan.scene.keyboard.centre[:, 1]
        self._hands = [RehearsedHand(plan, side) for side in plan.scene.sides]
        self._answers = [hand.corrected.answer for hand in self._hands]
        self._plan, self._ctrl = plan, plan.nominal.tracking.ctrl.copy()

    @property
    def needed(self) -> int:
        """How many steps a plan has to have for `further`, if the song does."""
        return self._until + FAR

    @property
    def _until(self) -> int:
        """Where the next window ends, if the song goes on."""
        return self.steps + self._more if self.steps else self._first

    def further(self, plan: SongPlan, times: int) -> SongPlan:
        """What is to be played in the next window: the plan with other controls, from there on.

        Args:
            plan: of the song, as far as it goes.
            times: that the window is changed and played again, unless there is nothing to change.
        """
        if plan is not self._plan:
            self._take_over(plan)
        first = self.steps
        self.steps = min(self._until, plan.nominal.num_steps)
        if times:
            takes = [self._play(first, self._ctrl[first : self.steps + FAR])]
            while len(takes) <= times and not takes[-1].faultless.all():
                takes.append(self._play(first, self._changed(takes[-1])))
            best = min([*takes, *self._joined(first, takes)], key=lambda take: take.cost.sum())
            self._ctrl[first : self.steps + FAR] = best.ctrl
            self.here, self._heard, self._answers = best.end, best.heard, best.answers
        return self._part(first, self._ctrl[first : self.steps + FAR])

    def _take_over(self, plan: SongPlan) -> None:
        """Goes on with a plan that goes further."""
        ctrl = plan.nominal.tracking.ctrl.copy()
        ctrl[: len(self._ctrl)] = self._ctrl
        self._plan, self._ctrl = plan, ctrl
        for hand in self._hands:
            hand.follow(plan)

    def _part(self, first: int, ctrl: Array) -> SongPlan:
        """The plan up to where controls (S, A) end that begin with step `first`."""
        nominal = self._plan.nominal
        part = nominal.part(0, first + len(ctrl))
        before = part.tracking.ctrl[:first]
        tracking = part.tracking._replace(ctrl=np.concatenate([before, ctrl]))
        presses = [press for press in nominal.presses if press.last > first]
        return self._plan._replace(nominal=part._replace(tracking=tracking, presses=presses))

    def _changed(self, take: Take) -> Array:
        """(S, A) controls that should be better, of the hands that had anything wrong."""
        ctrl = take.ctrl.copy()
        for i, hand in enumerate(self._hands):
            if not take.faultless[i]:
                there = ctrl[:, hand.servos] + _SHARE * take.changes[:, hand.servos]
                ctrl[:, hand.servos] = hand.corrected.clip(there)
        return ctrl

    def _joined(self, first: int, takes: list[Take]) -> list[Take]:
        """What comes of either hand's best take together, if these are not the same."""
        own = [min(takes, key=lambda take: take.cost[i]) for i in range(len(self._hands))]
        if all(take is own[0] for take in own):
            return []
        ctrl = own[0].ctrl.copy()
        for hand, take in zip(self._hands, own, strict=True):
            ctrl[:, hand.servos] = take.ctrl[:, hand.servos]
        return [self._play(first, ctrl)]

    def _play(self, first: int, ctrl: Array) -> Take:
        """What comes of controls (S, A) of the plan from where the hands are, before `first`."""
        part, here, heard = self._part(first, ctrl), copy(self.here), self._heard
        for hand, answer in zip(self._hands, self._answers, strict=True):
            hand.begin(part, first, answer)
        action = np.zeros((1, ctrl.shape[1]))
        for step in range(first, first + len(ctrl)):
            for hand in self._hands:
                action[0, hand.servos] = hand.act(step, here.state, self._weights)
            here.step(action)
            heard = self._note(step, here.state, heard)
            if step + 1 == self.steps:
                end, heard_then = copy(here), heard
                answers = [hand.corrected.answer for hand in self._hands]
        changed = np.concatenate([hand.changes() for hand in self._hands], axis=1)
        cost, faults = np.transpose([hand.judged for hand in self._hands])
        return Take(ctrl, changed, cost, faults == 0, end, heard_then, answers)

    def _note(self, step: int, state: State, before: Heard) -> Heard:
        """What is heard after a step; the hand that is nearer to a key is to blame for it."""
        places = [state.fingertip_xpos[0, hand.fingers, 1].mean() for hand in self._hands]
        nearest = np.argmin([np.abs(self._keys - place) for place in places], axis=0)
        for i, hand in enumerate(self._hands):
            heard = hand.note(step, state, before, nearest == i)
        return heard


class RehearsedHand:
    """One hand as it rehearses.

    Attributes:
        corrected: it.
        servos: which of all the scene's are this hand's.
        fingers: their numbers.
        judged: (2,) what it has lost since `begin`, and how many faults it has made.
    """

    def __init__(self, plan: SongPlan, side: Side) -> None:
        self._side, self._dt = side, plan.track.config.control_timestep
        self.corrected = CorrectedHand(plan, side)
        self.servos = self.corrected.servos
        self.fingers = plan.scene.fingers.of_hand(SIDES.index(side))
        alone = hand_alone(plan.scene, side).scene
        self._of_servos = servos_of(alone)
        self._kinematics = Kinematics(alone, self._of_servos)
        self._sigma = np.array([alone.hand.servo(name).noise for name in self._of_servos.names])
        self.follow(plan)

    def follow(self, plan: SongPlan) -> None:
        """Goes on with a plan that goes further."""
        self._part = HandPart(plan, self._side)
        self._losses = Losses(plan, self._part)
        self._gain = plan.nominal.tracking.of(self.servos).gain
        self._keyboard, self._asked = plan.scene.keyboard, plan.goals.fingers

    def begin(self, part: SongPlan, step: int, answer: Array) -> None:
        """Plays a part of the plan from that step on, after the correction (A,) before it."""
        self.corrected.follow(part, step)
        self.corrected.answer = answer
        self._first, self.judged = step, np.zeros(2)
        self._states: list[tuple[Array, Array, Mask]] = []

    def act(self, step: int, state: State, weights: Weights) -> Array:
        """(A,) the next controls."""
        return self.corrected.act(step, state, weights)

    def note(self, step: int, state: State, before: Heard, near: Mask) -> Heard:
        """What is heard after a step; keeps what the hand did.

        Args:
            step: of the song.
            state: after it.
            before: heard before it.
            near: (K,) keys for which the hand is to blame if they sound and should not.
        """
        posture = self.corrected.posture(state)[:, 0]
        key_qpos, tips = state.key_qpos[0], state.fingertip_xpos[0, self.fingers].copy()
        _, cost, heard = self._losses.after(step, key_qpos, tips, before, near=near)
        part, silent = self._part, ~heard.sounding
        missing = (part.mine | part.due)[step] & part.planned[step] & silent
        wrong = part.wrong[step] & heard.sounding | part.unwelcome[step] & heard.begins
        self.judged += np.array([cost, np.count_nonzero(missing | (wrong & near))])
        self._states.append((posture, tips, heard.sounding))
        return heard

    def changes(self) -> Array:
        """(S, A) to the controls since `begin`, which would have been better."""
        postures, tips, sounding = (np.array(some) for some in zip(*self._states, strict=True))
        off, weight = self._better(tips, sounding)
        off = no_further(off)
        motion = self._kinematics.fingers(postures)[1][:, :, TIP]
        gain = self._gain[self._first : self._first + len(off)]
        return changes(off, weight, motion, gain, self._of_servos, self._sigma, self._dt)

    def _better(self, tips: Array, sounding: Mask) -> tuple[Array, Array]:
        """(S, F, 3) ways to where fingertips should have been, and (S, F) how much they count.

        Args:
            tips: (S, F, 3) where they were after each step since `begin` [m].
            sounding: (S, K) keys.
        """
        part, first, keyboard = self._part, self._first, self._keyboard
        steps, after = (slice(first + late, first + late + len(tips)) for late in (0, 1))
        off = part.fingertips[after] - tips
        weight = part.weight[after] / ASTRAY
        step, key = np.nonzero(part.mine[steps] & part.planned[steps] & ~sounding)
        finger = self._asked[first + step, key] - self.fingers.start
        there = np.hypot(*off[step, finger, :2].T) < _THERE
        off[step[there], finger[there], 2] -= _DEEPER
        step, key = np.nonzero(part.wrong[steps] & sounding)
        beside = np.abs(tips[step, :, :2] - keyboard.centre[key, None, :2])
        beside[..., 0] = np.maximum(beside[..., 0] - keyboard.half_size[key, None, 0], 0.0)
        away = beside.sum(axis=2)
        finger, over = away.argmin(axis=1), away.min(axis=1) < _OVER
        high = np.zeros(weight.shape, bool)
        for then in (step, np.maximum(step - 1, 0)):  # it comes too low before
            high[then[over], finger[over]] = True
        off[high, 2] += _HIGHER
        weight[high] = 1.0
        return off, weight
