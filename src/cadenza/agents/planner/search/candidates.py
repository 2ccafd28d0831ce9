"""Candidates of a search that are not random: escape motions, crossover, and networks."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Mask, steps_in
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.networks.inputs import Corrections, HandInputs
from cadenza.agents.planner.search.networks.weights import Weights
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import Servos, servos_of
from cadenza.sim.hand_rollouts import HandRollouts

_HAND_LIFTS = (0.05, 0.1)  # [s] for which a hand is lifted from between keys
_LIFTS = (0.1, 0.2, 0.3)  # [s] for which a hand, or some fingers, are lifted
_STRAIGHT_UP = 0.1  # [s] without sideways motion: friction holds down a finger beside a key


class EscapeMotions:
    """Motions that lift a hand, or some of its fingers, off keys that block their way.

    All methods take and return control sequences (H, A). To save rollouts, `hand_lift` and
    `of_one_duration` lift for one duration at a step, and for another at the next step.
    """

    def __init__(self, servos: Servos, dt: float) -> None:
        """Prepare motions of a hand's servos, in control steps of `dt` [s]."""
        self._servos, self._dt = servos, dt

    def hand_lift(self, ctrl: Array, step: int) -> Array:
        """`ctrl` (H, A) with the hand lifted at the beginning."""
        seconds = _HAND_LIFTS[step % len(_HAND_LIFTS)]
        return self._servos.clip(ctrl + self._lift(self._servos.lift, seconds, len(ctrl)))

    def of_one_duration(self, ctrl: Array, caught: Mask, posture: Array, step: int) -> Array:
        """(3, H, A) `ctrl` with the `caught` fingers (F,), these and the hand, or all lifted.

        The hand is in a `posture` (A,).
        """
        return self._lifts(ctrl, caught, posture, 0.0)[step % len(_LIFTS) :: len(_LIFTS)]

    def all(self, ctrl: Array, caught: Mask, posture: Array) -> Array:
        """Such motions (M, H, A) of every duration, at once or first straight up."""
        motions = [self._lifts(ctrl, caught, posture, up) for up in (0.0, _STRAIGHT_UP)]
        return np.concatenate(motions)

    def _lifts(self, ctrl: Array, caught: Mask, posture: Array, straight_up: float) -> Array:
        fingers, hand = np.append(caught, False)[self._servos.finger], self._servos.finger < 0
        motions = []
        for servos in (fingers, fingers | hand, np.ones_like(hand)):
            motion = ctrl.copy()
            motion[: round(straight_up / self._dt), servos] = posture[servos]
            lift = self._servos.lift * servos
            motions += [motion + self._lift(lift, seconds, len(motion)) for seconds in _LIFTS]
        return self._servos.clip(np.array(motions))

    def _lift(self, lift: Array, seconds: float, horizon: int) -> Array:
        """Changes (H, A) of the controls: `lift` (A,) for some time, then nothing."""
        return lift * (np.arange(horizon)[:, None] < steps_in(seconds, self._dt))


_MIN_GAIN = 0.15  # of cost, above which a finger's servos are taken from another candidate
_MIN_STEPS = 3  # simulated steps of a candidate to be compared


def crossover(
    candidates: Array, costs: Sequence[Array], best: int, finger: NDArray[np.intp]
) -> Array:
    """Best candidate (1, H, A), with each finger as in the candidate in which it costs least.

    Different candidates may correct different fingers. While the hand rests, fingers hardly move
    each other. The result is empty, (0, H, A), if no finger is much better in another candidate.

    Args:
        candidates: (N, H, A) controls.
        costs: (L, F) the costs of each candidate by finger, in its L simulated steps.
        best: the number of the cheapest candidate, which was simulated to its end.
        finger: (A,) the finger that each servo moves, -1 for the whole hand.
    """
    until = np.pad(costs[best].cumsum(axis=0), ((1, 0), (0, 0)))
    gains = np.array([until[len(cost)] - cost.sum(axis=0) for cost in costs])
    gains[[len(cost) < min(_MIN_STEPS, len(costs[best])) for cost in costs]] = 0.0
    parent = np.where(gains.max(axis=0) > _MIN_GAIN, gains.argmax(axis=0), best)
    child = candidates[np.append(parent, best)[finger], :, np.arange(len(finger))].T
    return child[None] if (parent != best).any() else candidates[:0]


class NetworkCandidate:
    """Corrections of one hand's plan by networks that were trained on other songs.

    The networks act step by step on the state in the rollout of their own controls.
    """

    def __init__(self, plan: SongPlan, side: Side, weights: Weights, first: int) -> None:
        """Prepare inputs for the steps of a plan from `first` on."""
        alone, servos, _ = hand_alone(plan.scene, side)
        self._inputs = HandInputs(plan, [side], alone, first)
        self._weights, self._corrections = weights, Corrections.of([side], alone)
        self._tracking, self._servos = plan.nominal.tracking.of(servos), servos_of(alone)

    def controls(
        self, simulator: HandRollouts, step: int, planned: Array, previous: Array, key_qpos: Array
    ) -> Iterator[Array]:
        """Yield the controls (A,) of each of H steps, while a rollout takes them.

        They correct the `planned` controls (H, A) from `step` on. The last correction was
        `previous` (A,), and all keys are at `key_qpos` (K,) [rad].
        """
        key_qpos, output = key_qpos.copy(), self._corrections.output(previous[None])
        for row, ctrl in enumerate(planned, step):
            state = simulator.servo_state()
            ctrl = self._servos.clip(ctrl - self._tracking.feedback(row, state))
            key_qpos[simulator.keys] = simulator.key_qpos()
            inputs = self._inputs.at(row, state[None], output, simulator.fingertips(), key_qpos)
            corrected = self._servos.clip(ctrl + self._corrections.ctrl(self._weights(inputs)))
            output = self._corrections.output(corrected - ctrl)
            yield corrected[0]
