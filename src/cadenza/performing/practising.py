"""Practice of a song that is kept in a folder, in one go or in several."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from cadenza.agents.agent import Progress, silent
from cadenza.agents.planner.context import PlanningContext
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.planner import Planner
from cadenza.agents.planner.practice.practice import Practice
from cadenza.agents.planner.practice.practised_planner import PractisedHands, PractisedPlan
from cadenza.agents.registry import PRACTISED, options_name
from cadenza.agents.rollout import begin_episodes
from cadenza.errors import CadenzaError
from cadenza.performing.performance import Performance, perform
from cadenza.performing.planning import plan_of
from cadenza.performing.setup import PRACTICE, PRACTICE_SETTINGS, Setup
from cadenza.resumable import RateLimited, ResumableFolder
from cadenza.scene.servos import servos_of
from cadenza.sim.threads import Threads

_MIN_SAVE_INTERVAL = 20.0  # [s] between two saves of practice, or of its plan
_MAX_SAVING = 0.05  # share of the time that is spent on saving


def practice_folder(path: Path) -> ResumableFolder:
    """The folder of practice, whose manifest has the song, the task and the scene."""
    locked_out = "somebody practises there; choose another folder with --output"
    return ResumableFolder(path, "cadenza practice", locked_out, PRACTICE_SETTINGS)


def check_is_practice(folder: Path) -> None:
    """Check that practice may go on; raises CadenzaError if a folder holds another plan."""
    if (folder / PRACTISED).exists() and not (folder / PRACTICE).exists():
        raise CadenzaError(
            f"{folder}: holds {PRACTISED} from something else; choose another folder with --output"
        )


class Practising:
    """Practice of a setup, resumed from its folder.

    Attributes:
        practice: the practice itself.
        performance: the performance of the last plan that was saved, or ended early.
        save_if_due: saves as `save` does, for at most a small share of the time.
        save_plan_if_due: the same for `save_plan`, which takes much longer, as it plays the song.
    """

    def __init__(self, setup: Setup, folder: ResumableFolder, progress: Progress = silent) -> None:
        """Restore the practice in the folder, and write its settings.

        The caller must hold the folder's lock; `progress` gets "fingers" and "postures". Raises
        CadenzaError if the folder holds practice of something else, or it cannot be read.
        """
        assert isinstance(setup.agent, Planner)
        self._setup, self._agent, self._path = setup, setup.agent, folder.path / PRACTICE
        self.performance: Performance | None = None
        self.save_if_due = RateLimited(self.save, _MIN_SAVE_INTERVAL, _MAX_SAVING)
        self.save_plan_if_due = RateLimited(self.save_plan, _MIN_SAVE_INTERVAL, _MAX_SAVING)
        (rng,) = begin_episodes(setup.task, [setup.seed])
        config, threads = replace(setup.agent.config, effort=0.0), Threads(setup.agent.threads)
        context = PlanningContext(config, threads, progress)
        self.practice = Practice(setup.task.view(), rng, context)
        if self._path.exists():
            self.practice.restore(self._path)
        settings, song = setup.settings, setup.settings["song"]
        if os.path.isfile(song):  # it goes on from anywhere
            settings = settings | {"song": os.path.abspath(song)}
        folder.write_manifest(settings)

    def save(self) -> None:
        """Save the state of practice in the folder."""
        self.practice.save(self._path)

    def save_plan(self) -> None:
        """Perform the best plan so far, and save it in the folder for `cadenza play`.

        Nothing is saved if the performance ended early, because of a wrong key, or if the task is
        not played on the nominal model.
        """
        if self._setup.task.config.randomization.is_on:
            return
        practised = self.practice.best().practised
        setup = self._setup_with(practised)
        self.performance = performance = perform(setup)
        if performance.episode.num_steps == setup.num_steps:
            played = practised._replace(tracking=_played(practised.tracking, performance))
            plan = replace(plan_of(setup, performance), practised=played)
            plan.save(self._path.with_name(PRACTISED))

    def best(self) -> Setup:
        """The setup that plays the best plan so far, with its fingers."""
        return self._setup_with(self.practice.best().practised)

    def _setup_with(self, practised: PractisedPlan) -> Setup:
        hands = PractisedHands(practised, self._agent.config, self.practice.plan)
        hands.num_threads = self._agent.num_threads
        notes = self.practice.plan.track.score.notes  # the song's, in the same order
        score = self._setup.score.with_fingers(note.finger for note in notes)
        self._setup.task.draw_from([score])
        settings, agent = self._setup.settings, options_name(self._setup.settings["agent"])
        settings_made = {agent: settings[agent] | {"effort": round(self.practice.effort, 2)}}
        return replace(self._setup, agent=hands, score=score, settings=settings | settings_made)


def _played(tracking: Tracking, performance: Performance) -> Tracking:
    """The tracking as it was performed, which differs from practice where hands play apart."""
    episode, beginning = performance.episode, tracking.expected[:1]
    servos = servos_of(performance.scene)
    states = zip(episode["hand_qpos"], episode["hand_qvel"], strict=True)
    # One by one, as they are compared: many at once may differ in the last bit.
    expected = np.array([*beginning, *(servos.state(*state) for state in states)])
    return Tracking(episode["action"][:, :-1], tracking.gain, expected)
