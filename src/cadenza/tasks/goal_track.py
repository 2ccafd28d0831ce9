"""Goals of episodes: a score as a task plays it, and the goals of N environments step by step."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.fingering.pianist import pianist_fingering
from cadenza.fingering.players import Forearm, Players, players_at
from cadenza.fingering.search import Dropped, find_fingering
from cadenza.fingers import NO_FINGER
from cadenza.music.goals import Goals, score_to_goals, silence
from cadenza.music.score import Note, Score
from cadenza.scene.scene import Scene
from cadenza.tasks.config import TaskConfig


@dataclass(frozen=True, eq=False)
class GoalTrack:
    """A score as a task plays it: its fingers, its initial silence, its goals per control step."""

    score: Score  # the score, trimmed, stretched and transposed, without the initial silence
    # The notes that no finger can play, and why; None before a search for fingers
    dropped: tuple[Dropped, ...] | None
    config: TaskConfig  # the task's options
    scene: Scene  # the hands and the keys
    searched: bool = False  # whether a search found all fingers, because the song gives none
    _cached: list[weakref.ref[Goals]] = field(default_factory=list, init=False, repr=False)

    def __repr__(self) -> str:
        return f"GoalTrack({self.score!r}, {self.scene!r})"

    @property
    def rewarded_fingers(self) -> Literal["score", "search", "transport", "off"]:
        """The source of the fingers that the task rewards.

        score: the song, and a search for notes without fingers; search: a search for all notes;
        transport: optimal transport from fingertips to keys; off: no fingers are rewarded.
        """
        chosen = self.config.fingering
        if chosen == "off" or not self.scene.sides:
            return "off"
        if chosen == "transport":
            return chosen
        return "search" if self.searched else "score"

    @property
    def silent_steps(self) -> int:
        """Number of control steps before the score begins."""
        return round(self.config.initial_buffer_time / self.config.control_timestep)

    @property
    def delayed_score(self) -> Score:
        """The score with the initial silence of the episode before it."""
        silence = self.silent_steps * self.config.control_timestep
        return self.score.with_initial_silence(silence) if silence else self.score

    def first_step(self, note: Note) -> int:
        """The control step in which a `note` of the score begins."""
        return self.silent_steps + int(note.start * (1 / self.config.control_timestep))

    @property
    def goals(self) -> Goals:
        """The goals of every control step of the episode, without fingers that the hands lack.

        They are computed on demand, and cached as long as they are referenced.
        """
        goals = self._cached[0]() if self._cached else None
        if goals is None:
            goals = self._compute_goals()
            self._cached[:] = [weakref.ref(goals)]
        return goals

    def _compute_goals(self) -> Goals:
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
            onsets=goals.onsets.delayed(silent),
        )

    def __getstate__(self) -> dict[str, object]:
        return {**vars(self), "_cached": []}  # weak references cannot be pickled

    def __deepcopy__(self, memo: dict[int, object]) -> GoalTrack:
        return self  # never changes

    def with_score(self, score: Score) -> GoalTrack:
        """The track with another score, whose fingers have not been searched for."""
        return replace(self, score=score, dropped=None, searched=False)

    def fingered(self, progress: Callable[[int, int], None] | None = None) -> GoalTrack:
        """Find a finger for every note that the hands can play, unless that was done before.

        `progress` is called as by `find_fingering`. Raises CadenzaError if each hand is to play its
        own notes, but the score does not tell them apart; or if hands with more than a pianist's
        fingers are to use a pianist's fingering.
        """
        if self.dropped is not None:
            return self
        score, players = self.score, players_of(self.scene)
        check_written_hands(self.config, score, score.title or "the score")
        if self.config.fingering in ("robot", "human"):
            score = score.without_fingers()
        if self.config.fingering == "human":
            fingered, dropped = pianist_fingering(score, players, progress)
        else:
            as_written = self.config.hands_as_written
            fingered, dropped = find_fingering(score, players, progress, as_written=as_written)
        return replace(self, score=fingered, dropped=dropped, searched=not score.has_fingering)

    def with_found_fingers(self) -> GoalTrack:
        """The track without the fingers that the song gives, if it gives any."""
        return self if self.searched else self.with_score(self.score.without_fingers())


def check_written_hands(config: TaskConfig, score: Score, name: str) -> None:
    """Check that a score says which hand plays what, if hands are to play as written.

    Raises CadenzaError if it does not; the message begins with the `name` of the song.
    """
    if config.hands_as_written and not score.has_written_hands:
        raise CadenzaError(
            f"{name}: nothing says which hand plays what (two staves, tracks named right and left, "
            "fingers); leave out --hands-as-written"
        )


def players_of(scene: Scene) -> Players:
    """The hands of a scene at its keyboard."""
    slides = len(scene.slide_joints) > 0
    spacing, mount = scene.config.hand_spacing, scene.hand.body.mount
    arm = Forearm(mount.home, mount.low, mount.high) if mount else None
    return players_at(scene.hand.reach, scene.keyboard, scene.sides, spacing, slides, arm)


class UpcomingGoals(NamedTuple):
    """The goals of the next control steps of N environments."""

    # (N, L + 1, K + 1) keys and pedal; past the end of an episode nothing is to be played
    goal: NDArray[np.bool_]
    fingers: NDArray[np.int8]  # (N, K) fingers for the keys of the next step, -1 for none
    active_fingers: NDArray[np.bool_]  # (N, F) which fingers have a key to press in the next step


class UpcomingOnsets(NamedTuple):
    """The notes that begin in W control steps (`onset_steps`) of N environments; 0 for none."""

    # (N, W, K) when notes begin, from the beginnings of their steps on [s]
    time: NDArray[np.float64]
    velocity: NDArray[np.intp]  # (N, W, K) the MIDI velocities of the notes, which are at least 1


def onset_steps(config: TaskConfig) -> int:
    """The number W of steps whose onsets count.

    They are the one before the next, the next one and those after it: at least one, as far as the
    lookahead.
    """
    return max(config.lookahead_steps, 1) + 2


class EpisodeGoals:
    """The goals of N environments, each at its own step of its own track.

    Attributes:
        tracks: what each environment plays.
        num_steps: (N,) control steps of its episode.
        first_step: (N,) the step that the episode began with.
        steps_done: (N,) control steps since the beginning of the song.
        row: (N,) the step that comes next; after the last, as in the published system, the last.
    """

    def __init__(self, num_envs: int, config: TaskConfig, scene: Scene) -> None:
        """Allocate the goals of N environments, which begin with a reset."""
        self.tracks = [GoalTrack(Score(()), None, config, scene)] * num_envs
        self.num_steps = np.ones(num_envs, np.intp)
        self.first_step = np.zeros(num_envs, np.intp)
        self.steps_done = np.zeros(num_envs, np.intp)
        self.row = np.zeros(num_envs, np.intp)
        self._steps_seen = config.lookahead_steps + 1
        self._onset_steps = onset_steps(config)
        self._num_keys, self._num_fingers = scene.keyboard.num_keys, scene.fingers.count
        self._goals = [silence(self._num_keys, self._num_fingers)] * num_envs
        self._cached: UpcomingGoals | None = None
        self._cached_onsets: UpcomingOnsets | None = None

    def begin(self, env: int, track: GoalTrack, first_step: int = 0) -> None:
        """Begin an episode of environment `env`, in which it plays `track` from a step on.

        Raises CadenzaError if the song has no such step.
        """
        goals = track.goals
        if first_step >= goals.num_steps:
            raise CadenzaError(
                f"step {first_step}: the song has {goals.num_steps}; choose one from 0 to "
                f"{goals.num_steps - 1}"
            )
        self.tracks[env], self._goals[env] = track, goals
        self.num_steps[env] = goals.num_steps
        self.first_step[env] = self.steps_done[env] = self.row[env] = first_step
        self._cached = self._cached_onsets = None

    def advance(self, env_ids: NDArray[np.intp] | slice, steps: int = 1) -> None:
        """Count steps of these environments."""
        self.steps_done[env_ids] += steps
        self.row = np.minimum(self.steps_done, self.num_steps - 1)
        self._cached = self._cached_onsets = None

    @property
    def scores(self) -> tuple[Score, ...]:
        """The score of each environment."""
        return tuple(track.score for track in self.tracks)

    @property
    def upcoming(self) -> UpcomingGoals:
        """The goals of the next steps, which are gathered once a step."""
        if self._cached is None:
            num_envs = len(self.row)
            goal = np.zeros((num_envs, self._steps_seen, self._num_keys + 1), bool)
            fingers = np.empty((num_envs, self._num_keys), np.int8)
            active_fingers = np.empty((num_envs, self._num_fingers), bool)
            for env, (goals, row) in enumerate(zip(self._goals, self.row.tolist(), strict=True)):
                keys = goals.keys[row : row + self._steps_seen]
                goal[env, : len(keys), :-1] = keys
                goal[env, : len(keys), -1] = goals.sustain[row : row + self._steps_seen]
                fingers[env] = goals.fingers[row]
                active_fingers[env] = goals.active_fingers[row]
            self._cached = UpcomingGoals(goal, fingers, active_fingers)
        return self._cached

    @property
    def upcoming_onsets(self) -> UpcomingOnsets:
        """The notes that begin in the next steps, which are gathered once a step."""
        if self._cached_onsets is None:
            shape = len(self.row), self._onset_steps, self._num_keys
            time, velocity = np.zeros(shape), np.zeros(shape, np.intp)
            for env, (goals, row) in enumerate(zip(self._goals, self.row.tolist(), strict=True)):
                onsets = goals.onsets.between(row - 1, row - 1 + shape[1])
                time[env, onsets.step, onsets.key] = onsets.time
                velocity[env, onsets.step, onsets.key] = onsets.velocity
            self._cached_onsets = UpcomingOnsets(time, velocity)
        return self._cached_onsets

    def between(
        self, env: int, first: int, last: int
    ) -> tuple[NDArray[np.bool_], NDArray[np.int8]]:
        """Goals of one environment in the steps from `first` to before `last`.

        Returns (last - first, K + 1) keys and pedal, nothing past the end; (last - first, K)
        fingers.
        """
        steps, goals = np.arange(first, last), self._goals[env]
        keys, fingers = goals.at(steps)
        inside = steps < goals.num_steps
        sustain = goals.sustain[np.minimum(steps, goals.num_steps - 1)] & inside
        return np.column_stack([keys, sustain]), fingers
