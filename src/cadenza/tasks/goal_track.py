"""What is to be played in an episode: made once, and passed on to all who need it."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from cadenza.fingering.players import Forearm, Players, players_at
from cadenza.fingering.search import Dropped, find_fingering
from cadenza.fingers import NO_FINGER
from cadenza.music.goals import Goals, score_to_goals
from cadenza.music.score import Note, Score
from cadenza.scene.scene import Scene
from cadenza.tasks.config import TaskConfig


@dataclass(frozen=True, eq=False)
class GoalTrack:
    """A score as a task plays it: its fingers, its silence, and its goals per control step."""

    score: Score
    """Trimmed, stretched and transposed, without the silence before it."""
    dropped: tuple[Dropped, ...] | None
    """Notes that no finger is there for, and why; None where fingers have not been looked for."""
    config: TaskConfig
    """Of the task."""
    scene: Scene
    """The hands and the keys."""
    found: bool = False
    """Whether all its fingers were found for these hands: the song gives none."""
    _made: list[weakref.ref[Goals]] = field(default_factory=list, init=False, repr=False)

    def __repr__(self) -> str:
        return f"GoalTrack({self.score!r}, {self.scene!r})"

    @property
    def rewarded_fingers(self) -> Literal["score", "found", "transport", "off"]:
        """Whose fingers the task rewards.

        score: those of the song, and of a search for notes that have none; found: those of a
        search for all notes; transport: whichever are nearest to the keys; off: none.
        """
        chosen = self.config.fingering
        if chosen == "off" or not self.scene.sides:
            return "off"
        if chosen == "transport":
            return chosen
        return "found" if self.found else "score"

    @property
    def silent_steps(self) -> int:
        """Control steps before the score begins."""
        return round(self.config.initial_buffer_time / self.config.control_timestep)

    @property
    def on_the_clock(self) -> Score:
        """The score as late as the episode has it, after the silence."""
        silence = self.silent_steps * self.config.control_timestep
        return self.score.with_initial_silence(silence) if silence else self.score

    def first_step(self, note: Note) -> int:
        """On which `note` of the score begins."""
        return self.silent_steps + int(note.start * (1 / self.config.control_timestep))

    @property
    def goals(self) -> Goals:
        """Goals per control step of the episode, all of it; a finger that is not there is none.

        They are made when they are first asked for, and kept as long as anybody has them.
        """
        goals = self._made[0]() if self._made else None
        if goals is None:
            goals = self._make()
            self._made[:] = [weakref.ref(goals)]
        return goals

    def _make(self) -> Goals:
        config, silent = self.config, self.silent_steps
        shorten = config.repeats == "shortened"
        scene, dt = self.scene, config.control_timestep
        goals = score_to_goals(self.score, dt, shorten, scene.keyboard.pitches, scene.fingers)
        fingers = np.where(scene.has_fingers(goals.fingers), goals.fingers, np.int8(NO_FINGER))
        goals = replace(goals, fingers=fingers)
        if not silent:
            return goals
        return replace(
            goals,
            keys=np.pad(goals.keys, ((silent, 0), (0, 0))),
            fingers=np.pad(fingers, ((silent, 0), (0, 0)), constant_values=NO_FINGER),
            sustain=np.pad(goals.sustain, (silent, 0)),
        )

    def __getstate__(self) -> dict[str, object]:
        return {**vars(self), "_made": []}  # weak references cannot be pickled

    def of(self, score: Score) -> GoalTrack:
        """The same for another score, for which fingers have not been looked for."""
        return replace(self, score=score, dropped=None, found=False)

    def fingered(self, progress: Callable[[int, int], None] | None = None) -> GoalTrack:
        """With a finger on every note that the hands can play; as it is where that was done.

        `progress` is that of `find_fingering`.
        """
        if self.dropped is not None:
            return self
        score, dropped = find_fingering(self.score, players_of(self.scene), progress)
        return replace(self, score=score, dropped=dropped, found=not self.score.has_fingering)

    def with_found_fingers(self) -> GoalTrack:
        """Without the fingers that the song gives, if it gives any."""
        return self if self.found else self.of(self.score.without_fingers())


def players_of(scene: Scene) -> Players:
    """The hands of a scene at its keyboard."""
    slides = len(scene.slide_joints) > 0
    spacing, mount = scene.config.hand_spacing, scene.hand.body.mount
    arm = Forearm(mount.home, mount.low, mount.high) if mount else None
    return players_at(scene.hand.reach, scene.keyboard, scene.sides, spacing, slides, arm)
