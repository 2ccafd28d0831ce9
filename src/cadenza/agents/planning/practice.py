"""Both hands practise a song, each by itself, and rehearse together what they have practised.

Effort is counted in simulated control steps, so that the same effort comes to the same on every
machine, by however many threads it is made. Now and then both hands rehearse: what they have
practised is played in the whole scene, and kept if it is better than before.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from threading import Event, Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.planning.config import ScorePlannerConfig
from cadenza.agents.planning.hand_practice import HandPractice
from cadenza.agents.planning.losses import ONSETS
from cadenza.agents.planning.refinement import HandOfTwo
from cadenza.agents.planning.song_plan import SongPlan, plan_song
from cadenza.agents.planning.tracking import Follower, Tracking
from cadenza.errors import CadenzaError
from cadenza.files import FLOATS, TEXT, ArrayOf, Expected
from cadenza.fingers import Side
from cadenza.music.metrics import playing_metrics
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.threads import Threads
from cadenza.tasks import reward
from cadenza.tasks.view import View

EFFORT = 100  # control steps that a hand simulates for each one of the song: effort 1
MOST_EFFORT = 1e6
_MOST_AT_ONCE = 2.0  # effort between two rehearsals
_LOOK = 0.2  # [s] between looks at what the hands do
_APART = 0.5  # [s] between passages


class Rehearsal(NamedTuple):
    """How both hands have played a song of T steps in the whole scene."""

    tracking: Tracking
    """What they did, and the feedback that leads them back to it."""
    f1: float
    note_onset_f1: float

    @property
    def worth(self) -> float:
        """The more, the better."""
        return self.f1 + ONSETS * self.note_onset_f1


def _better(new: Rehearsal, old: Rehearsal | None) -> Rehearsal:
    return new if old is None or new.worth > old.worth else old


class Practice:
    """How far a song has been practised.

    Attributes:
        plan: of the whole song, before practice.
        hands: their practice.
        best: rehearsal; before the first one None.
        history: effort, F1 and F1 of note onsets of all rehearsals.
    """

    def __init__(
        self,
        view: View,
        rng: np.random.Generator,
        config: ScorePlannerConfig,
        num_threads: int,
        progress: Progress = silent,
    ) -> None:
        """Args:
            view: of the first step, of one environment.
            rng: what is random.
            config: how to plan.
            num_threads: that share the work.
            progress: is told of "fingers" and "postures".

        Raises:
            CadenzaError: there are no hands in the scene.
        """
        (track,), self._start = view.tracks, view.state.hand_qpos[0]
        if config.fingering == "found":
            track = track.with_found_fingers()
        self.plan = plan_song(track, self._start, progress)
        self._num_threads, seed = num_threads, int(rng.integers(2**63))
        self._about = repr((seed, config)).encode()
        sides = self.plan.scene.sides
        self.hands = {
            side: HandPractice(self.plan, self._start, side, config, seed) for side in sides
        }
        self._locks = {side: Lock() for side in sides}  # held while a hand does a unit
        self.best: Rehearsal | None = None
        self.history: list[tuple[float, float, float]] = []

    def share_made(self, effort: float) -> float:
        """Of that effort, 0 to 1; hands that have nothing left to mend have made theirs."""
        most = max(self._steps_of_a_hand(effort), 1.0)
        shares = [
            min(hand.simulated / most, 1.0) if hand.has_work(most) else 1.0
            for hand in self.hands.values()
        ]
        return sum(shares) / len(shares)

    def _steps_of_a_hand(self, effort: float) -> float:
        return effort * EFFORT * self.plan.goals.num_steps

    def passages(self) -> list[float]:
        """When passages begin that lose something [s]."""
        loss = np.sum([hand.take.loss for hand in self.hands.values()], axis=0)
        times = np.flatnonzero(loss) * self.plan.track.config.control_timestep
        return list(times[np.diff(times, prepend=-np.inf) > _APART])

    def run(self, effort: float, goes_on: Callable[[], bool] = lambda: True) -> bool:
        """Practises until `effort` has been made, as long as `goes_on`, which is often asked.

        Whether there is nothing more to do.
        """
        most, left = self.history[-1][0] if self.history else 0.0, True
        while not self.history or (most < effort and left):
            if self.history:
                most = min(most + min(max(most, 1.0), _MOST_AT_ONCE), effort)
            if not self._practise(self._steps_of_a_hand(most), goes_on):
                return False
            rehearsal = self.rehearse()
            self.history.append((most, rehearsal.f1, rehearsal.note_onset_f1))
            self.best = _better(rehearsal, self.best)
            left = any(hand.take.loss.any() for hand in self.hands.values())
        return True

    def _practise(self, most: float, goes_on: Callable[[], bool]) -> bool:
        """Whether each hand has simulated so many control steps, without being stopped."""
        stopped = Event()

        def work(*sides: Side) -> None:
            """One unit of each hand in turn, until nothing is left to do."""
            left = list(sides)
            while left and not stopped.is_set():
                for side in left:
                    with self._locks[side]:
                        self.hands[side].practise(most)
                left = [side for side in left if self.hands[side].has_work(most)]

        busy = [side for side, hand in self.hands.items() if hand.has_work(most)]
        parts = [[side] for side in busy] if self._num_threads > 1 else [busy]
        with ThreadPoolExecutor(len(self.hands)) as pool:
            working = {pool.submit(work, *part) for part in parts}
            try:
                while working:
                    done, working = wait(working, _LOOK)
                    for each in done:
                        each.result()
                    if not goes_on():
                        stopped.set()
            finally:
                stopped.set()
        return not any(hand.has_work(most) for hand in self.hands.values())

    # Together

    def rehearse(self) -> Rehearsal:
        """Plays what both hands have practised, with feedback, in the whole scene."""
        scene, goals, track = self.plan.scene, self.plan.goals, self.plan.track
        dt, whole = track.config.control_timestep, self.plan.nominal.tracking
        practised = Tracking(*map(np.copy, whole))
        for hand in self.hands.values():
            practised.ctrl[:, hand.servos] = hand.take.ctrl
            practised.expected[:-1, hand.servos] = hand.take.expected
        follower, played = Follower(scene, practised), Tracking(*map(np.copy, practised))
        simulation = PlanningSimulation(scene, 1, dt)
        simulation.reset(None, self._start[None])
        sounding = np.zeros_like(goals.keys)
        for row in range(goals.num_steps):
            state = simulation.state
            played.expected[row] = follower.posture(state.hand_qpos, state.hand_qvel)[0]
            ctrl = follower.ctrl(np.array([row]), state)
            played.ctrl[row] = ctrl[0]
            simulation.step(ctrl)
            key_qpos = simulation.state.key_qpos[0]
            sounding[row] = reward.key_activation(key_qpos, scene.keyboard.sounds_from)
        state = simulation.state
        played.expected[-1] = follower.posture(state.hand_qpos, state.hand_qvel)[0]
        pedal, lowest = goals.sustain, scene.keyboard.lowest_pitch
        metrics = playing_metrics(
            sounding, pedal, goals.keys, pedal, dt, track.on_the_clock, lowest
        )
        return Rehearsal(played, metrics["f1"], metrics["note_onset_f1"])

    def best_so_far(self) -> Rehearsal:
        """The best rehearsal, or one that is held now."""
        return _better(self.rehearse(), self.best)

    # To go on later

    def state(self) -> dict[str, NDArray[Any]]:
        """All that decides how it goes on, as arrays by name; see `restore`."""
        arrays: dict[str, NDArray[Any]] = {
            "of": np.array(self._digest()),
            "history": np.array(self.history).reshape(-1, 3),
        }
        if self.best is not None:
            ctrl, _, expected = self.best.tracking
            scores = np.array([self.best.f1, self.best.note_onset_f1])
            arrays |= {"best/ctrl": ctrl, "best/expected": expected, "best/scores": scores}
        for side, hand in self.hands.items():
            with self._locks[side]:
                arrays |= {f"{side}/{name}": values for name, values in hand.state.items()}
        return arrays

    def expected(self) -> Expected:
        """What `state` holds, for whoever reads it from a file."""
        best = self.plan.nominal.tracking
        return {
            "of": ArrayOf(TEXT, needed=True),
            "history": ArrayOf(FLOATS, ("rehearsals", 3), needed=True, finite=True),
            "best/ctrl": ArrayOf(FLOATS, best.ctrl.shape, finite=True),
            "best/expected": ArrayOf(FLOATS, best.expected.shape, finite=True),
            "best/scores": ArrayOf(FLOATS, (2,), finite=True),
        } | {
            f"{side}/{name}": form
            for side, hand in self.hands.items()
            for name, form in hand.expected.items()
        }

    def restore(self, arrays: Mapping[str, NDArray[Any]], where: object) -> None:
        """Goes on from the `state` of the same practice, as `expected`.

        Raises:
            CadenzaError: it is of another song, or was planned in another way; `where` is named.
        """
        if str(arrays["of"]) != self._digest():
            raise CadenzaError(
                f"{where}: is the practice of another song, or with other options or another "
                "version of Cadenza; choose another folder with --output"
            )
        self.history = [tuple(row) for row in arrays["history"].tolist()]
        if self.history:
            ctrl, expected, scores = (
                arrays[f"best/{name}"] for name in ("ctrl", "expected", "scores")
            )
            gain = self.plan.nominal.tracking.gain
            self.best = Rehearsal(Tracking(ctrl, gain, expected), *scores.tolist())
        for side, hand in self.hands.items():
            of_hand = {name.partition("/"): values for name, values in arrays.items()}
            hand.restore({name: v for (part, _, name), v in of_hand.items() if part == side})

    def _digest(self) -> str:
        """Of all that practice begins with."""
        nominal, keys = self.plan.nominal, self.plan.goals.keys
        digest = hashlib.sha256(self._about)
        for values in (*nominal.tracking, keys, self._start):
            digest.update(values.tobytes())
        return digest.hexdigest()


class PractisedPlanner:
    """Plays one song as it was practised.

    From the first step on before which the hands are not where they were in the rehearsal, it
    searches as the planner does, around what was practised.

    Attributes:
        plan: before practice.
    """

    def __init__(
        self,
        plan: SongPlan,
        rehearsal: Rehearsal,
        config: ScorePlannerConfig,
        rng: np.random.Generator,
        num_threads: int,
    ) -> None:
        """Args:
        plan: before practice.
        rehearsal: what is played.
        config: how to search.
        rng: what is random in it.
        num_threads: that share it.
        """
        self.plan, self._tracking = plan, rehearsal.tracking
        self._posture = Follower(plan.scene, rehearsal.tracking).posture
        self._config, self._rng, self._threads = config, rng, Threads(num_threads)
        self._hands: list[HandOfTwo] = []

    def act(self, view: View) -> Array:
        """(A,) the next action."""
        state, step = view.state, int(view.steps[0])
        ctrl = self._tracking.ctrl[step].copy()
        if not self._hands:
            here = self._posture(state.hand_qpos[0], state.hand_qvel[0])
            if not (here == self._tracking.expected[step]).all():
                self._hands = [self._searching(side, step) for side in self.plan.scene.sides]
        for hand in self._hands:
            ctrl[hand.servos] = hand.act(state)
        return np.append(ctrl, self.plan.goals.sustain[step])

    def _searching(self, side: Side, step: int) -> HandOfTwo:
        (rng,) = self._rng.spawn(1)
        hand = HandOfTwo.of(self.plan, side, self._tracking, self._config, rng, self._threads)
        hand.refinement.skip_to(step)
        return hand
