"""The task as pure functions of JAX's arrays, all on one device, for thousands of worlds.

It shares the terms of the reward, the layout of observations and the metrics with `PianoTask`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any, NamedTuple

import numpy as np

from cadenza.configs import as_config
from cadenza.errors import CadenzaError, extra_packages
from cadenza.music.goals import Goals
from cadenza.music.metrics import STEP_METRICS, step_metrics
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.protocol import State
from cadenza.tasks.augmentation import draw_track, draws_variation, prepare_tracks
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.device_randomization import DeviceRandomization
from cadenza.tasks.goal_track import GoalTrack, UpcomingOnsets, onset_steps
from cadenza.tasks.onset_matching import matched_onsets, no_notes_played
from cadenza.tasks.piano_task import PEDAL_DOWN, offset_joints
from cadenza.tasks.reward import Outcome, Reward, RewardTerm, Transition, key_activation, key_state
from cadenza.tasks.view import task_spec

with extra_packages("gpu", "the engine warp"):
    import jax
    import jax.numpy as jnp

    from cadenza.sim.rows import where

Array = Any  # of JAX


VARIATIONS = 64
"""Number of variations in tempo and pitch that episodes draw from, of all songs together. Their
fingers are found on the host before the first step."""
_MIN_VARIATIONS = 8  # variations of each song, at least


class SongGoals(NamedTuple):
    """The goals of S songs or variations, padded to the T control steps of the longest."""

    goal: Array  # (S, T + L, K + 1) bool, keys and pedal; nothing past the end of a song
    fingers: Array  # (S, T, K) int8, fingers for the keys, -1 for none
    active_fingers: Array  # (S, T, F) bool, which fingers have a key to press
    num_steps: Array  # (S,) int32, control steps of each song
    # (S, T + W, K) when notes begin, from the beginnings of their steps on [s]; row 1 is the first
    # step, and W those of `UpcomingOnsets` around a step. No rows without onset goals.
    onset_time: Array
    # (S, T + W, K) uint8, the MIDI velocities of the notes, 0 where none begins
    onset_velocity: Array


class Episodes(NamedTuple):
    """The progress of N environments in their episodes."""

    song: Array  # (N,) int32, which of `SongGoals` each plays
    steps_done: Array  # (N,) int32, control steps since its reset
    pedal: Array  # (N,) the pedal, 0 to 1
    lost: Array  # (N,) bool, whether the pedal was not a number since its reset
    # (N, 3, K) bool, which of the notes near have been played, see `matched_onsets`
    notes_played: Array
    sounding: Array  # (N, K) bool, the keys that sound
    sums: Array  # (N, 3) sums over its steps of precision, recall and F1
    draws: Any  # what domain randomization has drawn, `Draws`; None if it is off


class PianoState(NamedTuple):
    """N environments after a step, with the fields that users of MuJoCo Playground expect.

    Where an episode has ended, the next one has begun: `obs` is its first observation.
    """

    data: Any  # the physical state of all worlds, see `cadenza.sim.warp.Physics`
    episodes: Episodes  # the progress of the environments
    key: Array  # the random key
    obs: Array  # (N, D) float32, observations
    reward: Array  # (N,) rewards of the step
    done: Array  # (N,) bool, whether the episode ended with the step
    # Name -> (N,): "reward/<term>"; and precision, recall and f1 of the episode so far, or of the
    # one that has just ended, as the mean over its steps
    metrics: dict[str, Array]
    # Name -> array: `state`, the simulations after the step, see `State`; `final_obs` (N, D), the
    # observations after the step, before any episode began; (N,) `truncation`, whether the song was
    # over; `unstable`, whether the simulation diverged or lost contacts; `overflow`, see `Physics`;
    # `song`, the song that `obs` is of; and `randomization/seed`, from which its models and
    # latencies follow. And () `unstable_count` and `overflow_count`, how many episodes have become
    # unstable since `reset`, and how many of them by lost contacts.
    info: dict[str, Array]


class FunctionalPianoTask:
    """N environments of the task, whose state is passed in and returned.

    `reset` and `step` are compiled, and move nothing to the host. The constructor refuses songs and
    options of `PianoTask` that are missing here. Domain randomization draws from
    `cadenza.tasks.device_randomization.VARIANTS` seeds, random tempo and pitch from `VARIATIONS`.
    """

    def __init__(
        self,
        scores: Sequence[Score],
        config: TaskConfig | None = None,
        scene: SceneConfig | Scene | None = None,
        num_envs: int = 1,
        make_physics: Any = None,
        reward_terms: Mapping[str, RewardTerm] | None = None,
    ) -> None:
        """Make a task of songs; each of N episodes plays one of them.

        `make_physics` makes the simulation, by default `cadenza.sim.warp.WarpPhysics`. The
        `reward_terms` are as of `PianoTask`, of functions that JAX can compile. Raises CadenzaError
        if a song cannot be played, or an option makes no sense or is missing here.
        """
        self.config = as_config(config, TaskConfig)
        self.scene = scene if isinstance(scene, Scene) else build_scene(scene)
        _check(self.config, self.scene)
        self.tracks = prepare_tracks(scores, self.config, self.scene)
        played = _variations(self.tracks)
        self._per_song = len(played) // len(self.tracks)
        self.songs = _padded([track.goals for track in played], self.config)
        self.spec = task_spec(self.config, self.scene)
        self._offset_joints = offset_joints(self.config, self.scene)
        self._reward = Reward(self.config, self.scene, reward_terms)
        self._make_physics = make_physics
        self._allocate(num_envs)

    def resized(self, num_envs: int) -> FunctionalPianoTask:
        """The same task of the same songs for N environments, with a simulation of its own."""
        other = copy(self)
        other._allocate(num_envs)
        return other

    def _allocate(self, num_envs: int) -> None:
        self.num_envs, make_physics = num_envs, self._make_physics
        timestep, options = self.config.control_timestep, dict[str, Any]()
        self._randomization = None
        if self.config.randomization.is_on:
            drawing = self.config.randomization, self.scene, timestep, num_envs
            self._randomization = DeviceRandomization(*drawing)
            options = self._randomization.physics
        if make_physics is None:
            from cadenza.sim.warp import WarpPhysics  # needs more packages than the rest

            make_physics = WarpPhysics
        self.physics = make_physics(
            self.scene, num_envs, timestep, self.config.forearm_term, **options
        )
        self.reset, self.step = jax.jit(self._reset), jax.jit(self._step)

    def _reset(self, key: Array) -> PianoState:
        key, drawn = jax.random.split(key)
        episodes, start = self.begin(drawn)
        data = self.physics.start(start)
        state = self._resting(start)
        observation = self.observation(episodes, state)
        nothing = jnp.zeros(self.num_envs)
        no_action = jnp.zeros((self.num_envs, self.spec.action_size))
        _, result = jax.eval_shape(self.advance, episodes, state, no_action)
        names = [*(f"reward/{name}" for name in result.terms), *STEP_METRICS]
        no, none = jnp.zeros(self.num_envs, bool), jnp.zeros((), jnp.int32)
        info = {"state": state, "final_obs": observation, "truncation": no, "unstable": no}
        info |= {"overflow": data.overflow, "unstable_count": none, "overflow_count": none}
        info |= self._about(episodes)
        metrics = dict.fromkeys(names, nothing)
        return PianoState(data, episodes, key, observation, nothing, no, metrics, info)

    def _step(self, state: PianoState, action: Array) -> PianoState:
        """Take a control step with actions (N, A + 1) in [-1, 1], the pedal last."""
        key, of_begin, of_actions, of_sensors = jax.random.split(state.key, 4)
        ctrl = arrived = self.spec.scale_action(action)
        episodes, others = state.episodes, dict[str, Any]()
        if self._randomization is not None:
            draws, arrived, others = self._randomization.send(episodes.draws, ctrl, of_actions)
            episodes = episodes._replace(draws=draws)
        data, simulated = self.physics.step(state.data, arrived[:, :-1], **others)
        if self._randomization is not None:
            draws = self._randomization.sense(episodes.draws, simulated, data.path, of_sensors)
            episodes = episodes._replace(draws=draws)
        episodes, result = self.advance(episodes, simulated, ctrl, arrived)
        final = self.observation(episodes, simulated)
        done = result.terminated | result.truncated
        means = (episodes.sums / episodes.steps_done[:, None]).T
        metrics = {f"reward/{name}": values for name, values in result.terms.items()}
        metrics |= dict(zip(STEP_METRICS, means, strict=True))
        overflow = data.overflow

        fresh, start = self.begin(of_begin)
        first = self.observation(fresh, self._resting(start))
        data = where(done, self.physics.start(start), data)
        episodes = where(done, fresh, episodes)
        observation = where(done, first, final)
        info = {"state": simulated, "final_obs": final, "truncation": result.truncated}
        info |= {"unstable": result.unstable, "overflow": overflow, **self._about(episodes)}
        lost = {"unstable_count": result.unstable, "overflow_count": overflow != 0}
        info |= {name: state.info[name] + worlds.sum() for name, worlds in lost.items()}
        return PianoState(data, episodes, key, observation, result.reward, done, metrics, info)

    def begin(self, key: Array) -> tuple[Episodes, Array]:
        """Draw episodes of all environments.

        Returns the episodes, and the joint positions (N, J) at which the hands start [m, rad].
        """
        of_song, of_hands, of_draws = jax.random.split(key, 3)
        shape, limit = (self.num_envs,), self.config.random_hand_position
        start = jnp.tile(jnp.asarray(self.scene.hand_start), (self.num_envs, 1))
        if limit:
            offset = jax.random.uniform(of_hands, shape, minval=-limit, maxval=limit)
            start = start.at[:, self._offset_joints].set(offset[:, None])
        zeros = jnp.zeros(shape, jnp.int32)
        song = jax.random.randint(of_song, shape, 0, len(self.songs.num_steps), jnp.int32)
        sums = jnp.zeros((*shape, len(STEP_METRICS)))
        random = self._randomization
        draws = None if random is None else random.begin(of_draws, self._resting(start))
        keys = self.scene.keyboard.num_keys
        nothing = jnp.zeros((self.num_envs, keys), bool)
        notes = jnp.asarray(no_notes_played(self.num_envs, keys))
        pedal, lost = jnp.zeros(shape), jnp.zeros(shape, bool)
        return Episodes(song, zeros, pedal, lost, notes, nothing, sums, draws), start

    def _resting(self, start: Array) -> State:
        """The observed parts of the state of worlds after a reset."""
        zeros = State.at_rest(self.scene, self.num_envs)
        return jax.tree.map(jnp.asarray, zeros)._replace(hand_qpos=start)

    def _row(self, episodes: Episodes) -> Array:
        """(N,) the step that comes next; after the last, the last."""
        return jnp.minimum(episodes.steps_done, self.songs.num_steps[episodes.song] - 1)

    def advance(
        self, episodes: Episodes, state: State, ctrl: Array, arrived: Array | None = None
    ) -> tuple[Episodes, Transition]:
        """The result of a control step, as of `PianoTask.step`.

        Args:
            episodes: before the step.
            state: the simulations after it.
            ctrl: (N, A + 1) the actions in actuator units, the pedal last.
            arrived: the actions that hold at the end of the step, if they differ.
        """
        pressed: Any = (ctrl if arrived is None else arrived)[:, -1]
        song, row = episodes.song, self._row(episodes)
        goal, fingers = self.songs.goal[song, row], self.songs.fingers[song, row]
        lost = episodes.lost | ~jnp.isfinite(pressed)
        pedal: Any = jnp.fmin(jnp.fmax(pressed, 0.0), 1.0)
        keyboard = self.scene.keyboard
        sounds_from = keyboard.sounds_from
        if self._randomization is not None:
            sounds_from = sounds_from * self._randomization.sounding_depth(episodes.draws)
        sounding = key_activation(state.key_qpos, sounds_from)
        errors, notes = None, episodes.notes_played
        if self.config.onset_goals:
            due, dt = self._onsets(song, row), self.config.control_timestep
            errors, notes = matched_onsets(due, notes, state, episodes.sounding, keyboard, dt)
        outcome = Outcome(
            state=state,
            key_state=key_state(state.key_qpos, keyboard.travel),
            sounding=sounding,
            pedal_down=pedal >= PEDAL_DOWN,
            goal_keys=goal[:, :-1],
            goal_sustain=goal[:, -1],
            fingers=fingers,
            ctrl=ctrl,
            onset_errors=errors,
        )
        done = episodes.steps_done + 1
        over = done >= self.songs.num_steps[song]
        sums = episodes.sums + jnp.stack(step_metrics(sounding, goal[:, :-1]), axis=1)
        after = Episodes(song, done, pedal, lost, notes, sounding, sums, episodes.draws)
        return after, self._reward.transition(outcome, lost, over)

    def observation(self, episodes: Episodes, state: State) -> Array:
        """(N, D) observations, see `PianoTask.observation`."""
        song, row = episodes.song, self._row(episodes)
        ahead = row[:, None] + jnp.arange(self.config.lookahead_steps + 1)
        if self._randomization is not None:
            state = self._randomization.sensed(episodes.draws, state)
        keys = key_state(state.key_qpos, self.scene.keyboard.travel)
        goal = self.songs.goal[song[:, None], ahead]
        fingering = self.songs.active_fingers[song, row]
        due = self._onsets(song, row) if self.config.onset_goals else None
        return self.spec.observation(goal, fingering, keys, episodes.pedal, state, due)

    def _onsets(self, song: Array, row: Array) -> UpcomingOnsets:
        """The notes that begin around the steps `row` (N,) of songs (N,)."""
        around = row[:, None] + jnp.arange(onset_steps(self.config))
        songs, onsets = song[:, None], (self.songs.onset_time, self.songs.onset_velocity)
        return UpcomingOnsets._make(values[songs, around] for values in onsets)

    def _about(self, episodes: Episodes) -> dict[str, Array]:
        """Infos on the episodes that environments are in."""
        drawn = {} if episodes.draws is None else {"randomization/seed": episodes.draws.seed}
        return {"song": episodes.song // self._per_song, **drawn}


def _variations(tracks: Sequence[GoalTrack]) -> Sequence[GoalTrack]:
    """The tracks that episodes draw from: variations of each if tempo or pitch is random."""
    if not draws_variation(tracks[0].config):
        return tracks
    count = max(VARIATIONS // len(tracks), _MIN_VARIATIONS)
    return [
        draw_track(tracks, np.random.default_rng([song, i]), song)
        for song in range(len(tracks))
        for i in range(count)
    ]


def _padded(goals: Sequence[Goals], config: TaskConfig) -> SongGoals:
    longest, lookahead = max(each.num_steps for each in goals), config.lookahead_steps
    rows = longest + onset_steps(config) if config.onset_goals else 0
    shape = len(goals), rows, goals[0].keys.shape[1]
    time, velocity = np.zeros(shape), np.zeros(shape, np.uint8)
    for song, each in enumerate(goals if config.onset_goals else ()):
        onsets = each.onsets.delayed(1)
        time[song, onsets.step, onsets.key] = onsets.time
        velocity[song, onsets.step, onsets.key] = onsets.velocity

    def stacked(arrays: Sequence[np.ndarray], more: int, filled_with: int) -> Array:
        padded = [
            np.pad(a, ((0, longest + more - len(a)), (0, 0)), constant_values=filled_with)
            for a in arrays
        ]
        return jnp.asarray(np.stack(padded))

    tracks = [np.column_stack([each.keys, each.sustain]) for each in goals]
    return SongGoals(
        stacked(tracks, lookahead, 0),
        stacked([each.fingers for each in goals], 0, -1),
        stacked([each.active_fingers for each in goals], 0, 0),
        jnp.asarray([each.num_steps for each in goals], jnp.int32),
        jnp.asarray(time),
        jnp.asarray(velocity),
    )


def _check(config: TaskConfig, scene: Scene) -> None:
    """Check that the device has all options of the task."""
    for option, is_on in (
        ("hands apart", scene.config.hands == "apart"),
        ("fingering transport", config.fingering == "transport"),
    ):
        if is_on:
            raise CadenzaError(f"the engine warp has no {option}: leave it out, or use the CPU's")
