"""Plays any score by its plan and what it has learnt about plans: nothing is searched or tried out.

The plan is inverse kinematics of the song, with feedback. What goes wrong with such plans is much
the same in all music: a finger is caught, a thumb comes late. What corrects them, the same for both
hands, has been learnt from the planner's search over many songs.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cadenza.agents.agent import Array, PlannerPerEnv
from cadenza.agents.generalist.config import GeneralistConfig
from cadenza.agents.generalist.inputs import FAR, About, Corrections, HandInputs
from cadenza.agents.generalist.weights import Floats, Weights, weights_of
from cadenza.agents.planning.song_plan import SongPlan, song_plans
from cadenza.agents.planning.tracking import Follower
from cadenza.errors import CadenzaError
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.sim.protocol import State
from cadenza.tasks.view import View


class Generalist(PlannerPerEnv["GeneralistSong"]):
    """Corrects the plan of a song by what it has learnt from many others.

    Its progress is that of "fingers" and "postures".
    """

    def __init__(self, config: GeneralistConfig | None = None) -> None:
        super().__init__()
        self.config = config or GeneralistConfig()

    def begin(self, view: View, rng: np.random.Generator) -> GeneralistSong:
        """Raises:
        CadenzaError: there are no hands in the scene, it has not learnt to play with them, or what
            it has learnt is damaged.
        """
        (track,) = view.tracks
        start = view.state.hand_qpos[0]
        plans = song_plans(track.with_found_fingers(), start, self.progress)
        own = self.config.weights
        weights = weights_of(view.task.scene) if own is None else Weights.load(Path(own))
        return GeneralistSong(plans, weights)


class GeneralistSong:
    """Plays one song.

    Attributes:
        plan: without corrections, as far as it goes; all of it when the song is over.
    """

    def __init__(self, plans: Iterator[SongPlan], weights: Weights) -> None:
        """Args:
        plans: of the song, each longer than the one before.
        weights: what corrects them.

        Raises:
            CadenzaError: it has learnt with other servos.
        """
        self._plans, self._weights = plans, weights
        self.plan = next(plans)
        self._hands = [CorrectedHand(self.plan, side) for side in self.plan.scene.sides]
        for hand in self._hands:
            if hand.sizes != weights.sizes:
                raise CadenzaError(
                    f"generalist: has learnt with hands of {weights.sizes[1]} servos, but here "
                    f"they have {hand.sizes[1]}: leave out options that change the hands"
                )

    def act(self, view: View) -> Array:
        step = int(view.steps[0])
        self._plan_ahead(step)
        action = np.zeros(view.task.action_size)
        action[-1] = self.plan.goals.sustain[step]
        for hand in self._hands:
            action[hand.servos] = hand.act(step, view.state, self._weights)
        return action

    def _plan_ahead(self, step: int) -> None:
        """Plans another window before what is shown of the plan ends."""
        while not self.plan.complete and self.plan.nominal.num_steps <= step + FAR:
            self.plan = next(self._plans)
            for hand in self._hands:
                hand.follow(self.plan, step)


class CorrectedHand:
    """One hand, and what is corrected of its plan.

    Attributes:
        servos: which of all the scene's are this hand's.
        corrections: how answers are read.
        about: what it is told.
    """

    def __init__(self, plan: SongPlan, side: Side) -> None:
        self._side = side
        self._alone, self.servos, self._joints = hand_alone(plan.scene, side)
        self.corrections = Corrections.of(side, self._alone)
        self.about = About.of(self._alone)
        self._answer = np.zeros(len(self.corrections.scale))
        self.follow(plan, 0)

    @property
    def sizes(self) -> tuple[int, int]:
        """Of what is told of it, and of the answer."""
        return len(self.about.finger), len(self._answer)

    def follow(self, plan: SongPlan, step: int) -> None:
        """From that step on, by a plan that goes further than the one before."""
        self._inputs = HandInputs(plan, self._side, self._alone, self.servos, step)
        self._follower = Follower(self._alone, plan.nominal.tracking.of(self.servos))

    def see(self, step: int, state: State) -> tuple[Floats, Array]:
        """(D,) what is told before a step, and (A,) the controls that it corrects."""
        qpos, qvel = state.hand_qpos[:1, self._joints], state.hand_qvel[:1, self._joints]
        alone = state._replace(hand_qpos=qpos, hand_qvel=qvel)
        planned = self._follower.ctrl(np.array([step]), alone)
        (posture,) = self._follower.posture(qpos, qvel)
        return self._inputs.at(step, posture, self._answer, state), planned[0]

    def act(self, step: int, state: State, weights: Weights) -> Array:
        """(A,) the next controls."""
        inputs, planned = self.see(step, state)
        ctrl = self._follower.clip(planned + self.corrections.ctrl(weights(inputs)))
        self.played(ctrl, planned)
        return ctrl

    def played(self, ctrl: Array, planned: Array) -> None:
        """Keeps how the controls (A,) of a step differ from those that were planned (A,)."""
        self._answer = self.corrections.answer(ctrl - planned)
