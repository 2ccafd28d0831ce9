"""The task: N simulations, each with a score to play, stepped together.

The Gymnasium classes, the adapters and the planners use this class. Its actions are in actuator
units, and its arrays are (num_envs, ...).
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.configs import as_config, whole_number
from cadenza.errors import CadenzaError
from cadenza.music.metrics import playing_metrics
from cadenza.music.performance import KeyEvent, performed_score
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.randomization import KEY_SOUNDING
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.hands_apart import HandsApart
from cadenza.sim.mujoco_simulation import MAX_ENVS, MujocoSimulation
from cadenza.sim.protocol import MakeSimulation
from cadenza.tasks import augmentation
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.draw_ranges import SEED
from cadenza.tasks.goal_track import EpisodeGoals, GoalTrack
from cadenza.tasks.onset_matching import matched_onsets, no_notes_played
from cadenza.tasks.randomization import Randomization
from cadenza.tasks.reward import (
    Outcome,
    Reward,
    RewardTerm,
    Transition,
    key_activation,
    key_state,
    midi_velocity,
)
from cadenza.tasks.view import View, task_spec

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PEDAL_DOWN = 0.5  # fraction of its range from which on the pedal sustains


class EpisodeStart(NamedTuple):
    """The start of an episode of one environment; fields that are None are drawn."""

    # The index of a song among the task's, or a track that is played as it is
    song: int | GoalTrack | None = None
    hand_qpos: Array | None = None  # (J,) joint positions of the hands [m, rad]
    step: int = 0  # the control step of the song that the episode begins with
    randomization: int | None = None  # the seed of everything that `DomainRandomization` draws


class PianoTask:
    """N hands-and-piano simulations with a score to play in each.

    Attributes:
        spec: the constants of the task.
        scene: the nominal scene, which simulations may differ from, see `DomainRandomization`.
        config: the task's configuration.
        simulation: the physics.
        goals: what each environment has to play and how far it has got.
        state: the state of the simulations after the last step or reset.
        sensed: the same as sensors measure it, see `DomainRandomization`.
        key_state: (N, K) how far the keys are down, 0..1.
        sounding: (N, K) which keys sound.
        goal_keys: (N, K) which keys should have sounded in the last step, none after reset.
        reward: (N,) of the last step, 0 after reset.
        tracks: the tracks of the songs that episodes draw from.
    """

    def __init__(
        self,
        scores: Sequence[Score | GoalTrack],
        config: TaskConfig | None = None,
        scene: SceneConfig | Scene | None = None,
        num_envs: int = 1,
        num_threads: int = 1,
        reward_terms: Mapping[str, RewardTerm] | None = None,
        make_simulation: MakeSimulation | None = None,
    ) -> None:
        """Make a task of songs, with N simulations to play them in.

        Raises CadenzaError if a score has no notes, or an option makes no sense.

        Args:
            scores: the songs to draw from, one per episode; or tracks of this task and scene.
            num_threads: threads that share the simulation.
            reward_terms: name -> function of a `cadenza.Outcome` that returns (N,); they are added
                to the reward, and one of the same name takes the place of the task's own.
            make_simulation: makes the physics; by default the scene's engine, with one simulation
                for each hand if they play apart.
        """
        self.config = as_config(config, TaskConfig)
        self.scene = scene if isinstance(scene, Scene) else build_scene(scene)
        self.num_envs = num_envs = whole_number(num_envs, "num_envs", 1, MAX_ENVS)
        self.draw_from(scores)
        self._offset_joints = offset_joints(self.config, self.scene)
        self.simulation = (make_simulation or _engine(self.scene.config))(
            scene=self.scene,
            num_envs=num_envs,
            control_timestep=self.config.control_timestep,
            num_threads=num_threads,
            watch_forearms=self.config.forearm_term,
        )
        self._randomization = Randomization(
            self.config.randomization,
            self.scene,
            self.config.control_timestep,
            num_envs,
            self.simulation,
        )
        self.goals = EpisodeGoals(num_envs, self.config, self.scene)
        self.spec = task_spec(self.config, self.scene)
        num_keys = self.scene.keyboard.num_keys
        self._played = np.zeros((num_envs, 0, num_keys + 1), bool)
        self._key_events: list[list[KeyEvent]] = [[] for _ in range(num_envs)]
        self.goal_keys = np.zeros((num_envs, num_keys), bool)
        self._notes_played = no_notes_played(num_envs, num_keys)
        self._reward = Reward(self.config, self.scene, reward_terms)
        self._pedal, self._lost = np.zeros(num_envs), np.zeros(num_envs, bool)
        self._env_ids = np.arange(num_envs)
        self.reward = np.zeros(num_envs)
        self._read_state()

    # Episodes

    @property
    def scores(self) -> tuple[Score, ...]:
        """The scores that episodes draw from, as the task has changed them."""
        return tuple(track.score for track in self.tracks)

    @property
    def drawn(self) -> Mapping[str, NDArray[Any]]:
        """Name -> (N, ...) draws of domain randomization, see `Randomization.drawn`."""
        return self._randomization.drawn

    def draw_from(self, scores: Sequence[Score | GoalTrack]) -> None:
        """Draw from these scores from the next reset on; see the constructor."""
        self.tracks = augmentation.prepare_tracks(scores, self.config, self.scene)

    def reset(
        self,
        rngs: Sequence[np.random.Generator],
        env_ids: Sequence[int],
        starts: Sequence[EpisodeStart] | None = None,
    ) -> None:
        """Begin new episodes in environments, with a generator for each.

        `starts` fix parts of the episodes; by default all is drawn.
        """
        starts = [EpisodeStart()] * len(env_ids) if starts is None else starts
        hand_qpos = np.tile(self.scene.hand_start, (len(env_ids), 1))
        for row, (env, rng, start) in enumerate(zip(env_ids, rngs, starts, strict=True)):
            self._begin(env, self._track(start.song, rng), start.step)
            if start.hand_qpos is not None:
                hand_qpos[row] = start.hand_qpos
            elif limit := self.config.random_hand_position:
                hand_qpos[row, self._offset_joints] = rng.uniform(-limit, limit)
        reset = list(env_ids)
        self._randomization.begin(env_ids, rngs, hand_qpos, [s.randomization for s in starts])
        self.simulation.reset(env_ids, hand_qpos)
        self._randomization.start_sensing(reset, self.simulation.state)
        self.goal_keys[reset], self._lost[reset] = False, False
        self._pedal[reset], self.reward[reset] = 0.0, 0.0
        self._read_state()

    def _begin(self, env: int, track: GoalTrack, first_step: int) -> None:
        """Begin an episode of environment `env`, in which nothing has been played."""
        self.goals.begin(env, track, first_step)
        if (missing := int(self.goals.num_steps.max()) - self._played.shape[1]) > 0:
            self._played = np.pad(self._played, ((0, 0), (0, missing), (0, 0)))
        self._played[env, :first_step] = False
        self._key_events[env] = []
        self._notes_played[env] = False

    def save(self, env: int) -> Any:
        """The episode of environment `env` and its physics, for `restore` and for pickles.

        Raises CadenzaError if the simulation cannot be saved.
        """
        if not hasattr(self.simulation, "save"):
            raise CadenzaError("only simulations of the engine c have a state to get and to set")
        goals, played = self.goals, self._played[env, : self._num_played(env)]
        steps, own = (goals.first_step[env], goals.steps_done[env]), [v[env] for v in self._per_env]
        return goals.tracks[env], *deepcopy((steps, played, own)), self.simulation.save(env)

    def restore(self, env: int, saved: Any) -> None:
        """Put environment `env`, to the bit, where itself or another was at `save`.

        Raises CadenzaError if it had another task or another scene.
        """
        track, (first, done), played, own, physics = saved
        if (track.config, track.scene.config) != (self.config, self.scene.config):
            raise CadenzaError("this state is of an environment with other options: make it alike")
        self._begin(env, track, first)
        self.goals.advance(np.array([env]), done - first)
        self._played[env, : len(played)] = played
        for values, value in zip(self._per_env, deepcopy(own), strict=True):
            values[env] = value
        self.simulation.restore(env, physics)  # type: ignore[attr-defined]
        self._read_state()

    @property
    def _per_env(self) -> list[Any]:
        """Arrays and lists by environment, except for goals and physics."""
        own = [self._key_events, self.goal_keys, self._pedal, self._lost, self.reward]
        return [*own, self._notes_played, *self._randomization.per_env]

    def _track(self, song: int | GoalTrack | None, rng: np.random.Generator) -> GoalTrack:
        if isinstance(song, GoalTrack):
            return song
        return augmentation.draw_track(self.tracks, rng, song)

    def _read_state(self) -> None:
        self.state = self.simulation.state
        keyboard, key_qpos = self.scene.keyboard, self.state.key_qpos
        self.key_state = key_state(key_qpos, keyboard.travel)
        sounds_from = keyboard.sounds_from * self.drawn.get(KEY_SOUNDING, 1.0)
        self.sounding = key_activation(key_qpos, sounds_from)
        self.sensed = self._randomization.sensed(self.state)

    def step(self, ctrl: Array, env_ids: Sequence[int] | None = None) -> Transition:
        """Take one control step with actions `ctrl` (N, A) in actuator units, the pedal last.

        By default all environments take it; rows of others than `env_ids` have no meaning. Raises
        CadenzaError if a reward term of the user's is not a finite number for each environment.
        """
        goals = self.goals
        goal, fingers, row = goals.upcoming.goal[:, 0], goals.upcoming.fingers, goals.row
        moving = slice(None) if env_ids is None else np.asarray(env_ids, np.intp)
        arrived = self._randomization.step(ctrl, moving)
        sounded = self.sounding
        self._read_state()
        onset_errors = None
        if self.config.onset_goals:
            onset_errors, played = matched_onsets(
                goals.upcoming_onsets,
                self._notes_played,
                self.state,
                sounded,
                self.scene.keyboard,
                self.config.control_timestep,
            )
            self._notes_played[moving] = played[moving]
        pedal = arrived[moving, -1]
        self._lost[moving] |= ~np.isfinite(pedal)
        self._pedal[moving] = np.fmin(np.fmax(pedal, 0.0), 1.0)  # up where it is not a number
        self.goal_keys[moving] = goal[moving, :-1]
        within = self._env_ids[moving][(goals.steps_done < goals.num_steps)[moving]]
        here = within, row[within]
        self._played[*here, :-1] = self.sounding[within]
        self._played[*here, -1] = self.pedal_down[within]
        self._keep_key_events(*here)
        goals.advance(moving)

        outcome = Outcome(
            state=self.state,
            key_state=self.key_state,
            sounding=self.sounding,
            pedal_down=self.pedal_down,
            goal_keys=goal[:, :-1],
            goal_sustain=goal[:, -1],
            fingers=fingers,
            ctrl=ctrl,
            onset_errors=onset_errors,
        )
        over = goals.steps_done >= goals.num_steps
        transition = self._reward.transition(outcome, self._lost, over)
        self.reward[moving] = transition.reward[moving]
        return transition

    def _keep_key_events(self, env_ids: NDArray[np.intp], steps: NDArray[np.intp]) -> None:
        """Keep the events of keys in the `steps` (n,) that environments (n,) have taken."""
        onset, offset, speed = (values[env_ids] for values in self.state.key_events)
        here = np.nonzero(~(np.isnan(onset) & np.isnan(offset)))
        if not len(here[0]):
            return
        velocity = midi_velocity(speed[here], self.scene.keyboard)
        events = np.stack([onset[here], offset[here], velocity], axis=1).tolist()
        for row, key, event in zip(*(ids.tolist() for ids in here), events, strict=True):
            self._key_events[env_ids[row]].append(KeyEvent(int(steps[row]), key, *event))

    # Observations

    @property
    def pedal_down(self) -> Mask:
        """(N,) whether the pedal is down."""
        return self._pedal >= PEDAL_DOWN

    def observation(self) -> NDArray[np.float32]:
        """(N, D) observations; `TaskSpec.observation_layout` names the parts.

        goal: keys and pedal of the next step and of those after it, 0 or 1; fingering: 1 for each
        finger that has a key to press next; key_state: 0 (up) to 1 (down); pedal: 0 to 1; joints:
        positions [m, rad]; joint_velocities [m/s, rad/s], without noise, if they are asked for;
        touch: normal forces on the fingertips that are there, from 0 to 1 where the sensors
        saturate, see `observed_touch`. All but goals and pedal are `sensed`.

        With `TaskConfig.onset_goals`, goal_onset and goal_velocity (L + 2, K): when notes begin and
        how loud they are, in the last step, in the next one and in those after it, see
        `observed_onsets`; key_onset and key_velocity (K,): when keys began to sound in the last
        step, and how loud. From both follows which notes may still be played (`matched_onsets`),
        and so what the next step can earn.
        """
        goals, state = self.goals.upcoming, self.sensed
        due = self.goals.upcoming_onsets if self.config.onset_goals else None
        keys = key_state(state.key_qpos, self.scene.keyboard.travel)
        seen = goals.goal, goals.active_fingers, keys, self._pedal
        return self.spec.observation(*seen, state, due)

    def privileged(self) -> dict[str, Array]:
        """Name -> (N, size) the true state, for critics.

        Joints [m, rad] and their velocities, key states, fingertips [m], forces of the actuators
        [N, N m], normal forces on the fingertips [N], and the draws of domain randomization.
        """
        state, drawn = self.state, {n: v for n, v in self.drawn.items() if n != SEED}
        parts = {"joints": state.hand_qpos, "joint_velocities": state.hand_qvel}
        parts |= {"key_state": self.key_state, "fingertips": state.fingertip_xpos}
        parts |= {"actuator_force": state.actuator_force, "touch": state.touch, **drawn}
        return {name: values.reshape(self.num_envs, -1) for name, values in parts.items()}

    def view(self, playing: Mask | None = None) -> View:
        """The view of an agent before the next step of the environments `playing` (N,) bool.

        All are playing by default.
        """
        goals = self.goals
        return View(
            task=self.spec,
            env_ids=self._env_ids,
            tracks=tuple(goals.tracks),
            num_steps=goals.num_steps.copy(),
            steps=goals.steps_done.copy(),
            playing=np.ones(self.num_envs, bool) if playing is None else playing,
            state=self.sensed,
            observation=self.observation(),
            fingers=goals.upcoming.fingers,
            reward=self.reward.copy(),
            simulation=self.simulation,
        )

    def score(self, env: int) -> Score:
        """The score of environment `env`, after the initial silence of its episode."""
        return self.goals.tracks[env].delayed_score

    def played(self, env: int) -> Score:
        """The notes and the pedal that have sounded in the episode of environment `env` so far."""
        played = self._played[env, : self._num_played(env)]
        return performed_score(
            played[:, :-1],
            played[:, -1],
            self.config.control_timestep,
            self._key_events[env],
            self.scene.keyboard.lowest_pitch,
        )

    def _num_played(self, env: int) -> int:
        return int(min(self.goals.steps_done[env], self.goals.num_steps[env]))

    def episode_metrics(self, env: int) -> dict[str, float]:
        """The metrics of the episode of environment `env` so far (see `music.metrics`)."""
        done, first = self._num_played(env), int(self.goals.first_step[env])
        played, (goal, _) = self._played[env, first:done], self.goals.between(env, first, done)
        began = first * self.config.control_timestep
        return playing_metrics(
            played[:, :-1],
            played[:, -1],
            goal[:, :-1],
            goal[:, -1],
            self.config.control_timestep,
            self.score(env).since(began),
            self.scene.keyboard.lowest_pitch,
            self.played(env).since(began),
        )

    def close(self) -> None:
        """Stop the threads."""
        self.simulation.close()


def _engine(config: SceneConfig) -> MakeSimulation:
    """The class of simulations of a scene with these options."""
    apart = config.hands == "apart"
    if config.engine == "c":
        return HandsApart if apart else MujocoSimulation
    if apart:
        raise CadenzaError("the engine warp has no hands apart: choose the engine c")
    from cadenza.sim.warp import WarpSimulation  # needs more packages than the rest

    return WarpSimulation


def offset_joints(config: TaskConfig, scene: Scene) -> NDArray[np.intp]:
    """The joints that `TaskConfig.random_hand_position` moves.

    Raises CadenzaError if the hands do not slide, or not as far.
    """
    names, offset = scene.hand_joint_names, config.random_hand_position
    slides = scene.slide_joints
    if offset and not len(slides):
        raise CadenzaError(
            "random_hand_position needs hands that slide along the keyboard, with tx among "
            "their forearm_dofs; choose such hands, or random_hand_position 0"
        )
    reach = min((abs(scene.model.joint(names[j]).range).min() for j in slides), default=0)
    if offset > reach:
        raise CadenzaError(
            f"random_hand_position {offset} m: the hands reach the keyboard's end after "
            f"{reach:.2f} m; choose less"
        )
    return slides
