"""The task: N simulations, each with a score to play, stepped together.

The Gymnasium classes, the adapters and the planners all stand on this one class, which speaks in
actuator units and arrays (num_envs, ...).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.model.config import SceneConfig
from cadenza.model.scene import Scene, build_scene
from cadenza.music.metrics import playing_metrics
from cadenza.music.score import NUM_KEYS, Score
from cadenza.sim.simulation import Simulation, State
from cadenza.tasks import music, reward
from cadenza.tasks.config import TaskConfig

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PEDAL_DOWN = 0.5  # the pedal sounds from here on


@dataclass(frozen=True)
class Transition:
    """What came of one control step; arrays over the batch (N,)."""

    reward: Array
    terms: dict[str, Array]
    """Each term of the reward by name; they add up to it."""
    terminated: Mask
    """A wrong key sounded where that ends the episode, or the simulation became unstable."""
    truncated: Mask
    """The score is over."""
    unstable: Mask


class PianoTask:
    """N hands-and-piano simulations with a score to play in each.

    Attributes:
        scene: the scene that is simulated.
        config: the task's configuration.
        simulation: the physics; planners copy its state.
        action_low, action_high: (A,) ranges of an action in actuator units, the pedal last.
        observation_layout: name -> slice of an observation.
        songs: the drawn score of each environment, a list of N.
        steps_done: (N,) control steps since the last reset.
        num_steps: (N,) control steps that the episode has.
        transports_fingers: (N,) whether fingers are assigned to keys by optimal transport.
    """

    def __init__(
        self,
        scores: Sequence[Score],
        config: TaskConfig | None = None,
        scene: SceneConfig | Scene | None = None,
        num_envs: int = 1,
        num_threads: int = 1,
    ) -> None:
        """Args:
            scores: the songs to draw from, one per episode.
            config: the task's options.
            scene: the scene or its options.
            num_envs: N.
            num_threads: threads that share the simulation.

        Raises:
            CadenzaError: a score has no notes, or an option makes no sense.
        """
        self.config = config or TaskConfig()
        self.scene = scene if isinstance(scene, Scene) else build_scene(scene)
        self.num_envs = num_envs
        self._scores = music.prepare(scores, self.config)
        self._offset_joints = self._find_offset_joints()
        self.simulation = Simulation(
            self.scene,
            num_envs,
            self.config.control_timestep,
            num_threads,
            watch_forearms=self.config.forearm_term,
        )
        self.action_low = self.scene.action_low
        self.action_high = self.scene.action_high
        self._lookahead = self._steps_lookahead()
        self.observation_layout = self._lay_out_observation()
        self.songs: list[Score] = [self._scores[0]] * num_envs
        self.steps_done = np.zeros(num_envs, np.intp)
        self.num_steps = np.zeros(num_envs, np.intp)
        self._goal = np.zeros((num_envs, 0, NUM_KEYS + 1), bool)
        self._fingers = np.zeros((num_envs, 0, NUM_KEYS), np.int8)
        self.transports_fingers = np.zeros(num_envs, bool)
        self._played = np.zeros((num_envs, 0, NUM_KEYS + 1), bool)
        self._pedal = np.zeros(num_envs)
        self._env_ids = np.arange(num_envs)
        self._ahead = np.arange(self._lookahead + 1)
        self.state: State = self.simulation.state

    # Shapes and ranges

    @property
    def action_size(self) -> int:
        """A: actuators and the pedal."""
        return len(self.action_low)

    @property
    def observation_size(self) -> int:
        return max(part.stop for part in self.observation_layout.values())

    def scale_action(self, action: Array) -> Array:
        """Actions in [-1, 1] to actuator units, `(..., A)`; what lies outside is clipped."""
        unit = (np.clip(action, -1.0, 1.0) + 1.0) / 2.0
        return self.action_low + unit * (self.action_high - self.action_low)

    def _steps_lookahead(self) -> int:
        seconds = self.config.n_seconds_lookahead
        steps = self.config.n_steps_lookahead
        if seconds is not None:
            steps = math.ceil(round(seconds / self.config.control_timestep, 9))
        if steps < 0:
            raise CadenzaError(f"a lookahead of {steps} steps: choose 0 or more")
        return steps

    def _lay_out_observation(self) -> dict[str, slice]:
        sizes = {"goal": (self._lookahead + 1) * (NUM_KEYS + 1)}
        if self.config.fingering != "off" and self.scene.sides:
            sizes["fingering"] = 10
        sizes |= {"key_state": NUM_KEYS, "pedal": 1}
        if self.scene.sides:
            sizes["joints"] = len(self.scene.hand_qpos)
        ends = np.cumsum(list(sizes.values()))
        return {
            name: slice(int(end) - size, int(end))
            for (name, size), end in zip(sizes.items(), ends, strict=True)
        }

    def _find_offset_joints(self) -> NDArray[np.intp]:
        names = self.scene.hand_joint_names
        slides = [j for j, name in enumerate(names) if name.endswith("forearm_tx")]
        if self.config.random_hand_position and not slides:
            raise CadenzaError("random_hand_position needs the forearm's tx joint: add it")
        return np.array(slides, np.intp)

    # Episodes

    def reset(self, rngs: Sequence[np.random.Generator], env_ids: Sequence[int]) -> None:
        """Starts new episodes in `env_ids`, each with a generator of its own."""
        start = np.zeros((len(env_ids), len(self.scene.hand_qpos)))
        for row, (env, rng) in enumerate(zip(env_ids, rngs, strict=True)):
            self._set_music(env, music.draw(self._scores, self.config, rng))
            if most := self.config.random_hand_position:
                start[row, self._offset_joints] = rng.uniform(-most, most)
        self.simulation.reset(env_ids, start)
        self.steps_done[list(env_ids)] = 0
        self._pedal[list(env_ids)] = 0.0
        self.state = self.simulation.state

    def _set_music(self, env: int, score: Score) -> None:
        goals = music.goals_of(score, self.config)
        length = goals.num_steps
        self._make_room(length)
        self.songs[env] = score
        self.num_steps[env] = length
        self._goal[env] = False
        self._goal[env, :length, :NUM_KEYS] = goals.keys
        self._goal[env, :length, NUM_KEYS] = goals.sustain
        self._fingers[env] = -1
        self._fingers[env, :length] = np.where(
            np.isin(goals.fingers, self.scene.fingers), goals.fingers, -1
        )
        self._played[env] = False
        self.transports_fingers[env] = (
            self.config.fingering == "transport" or not score.has_fingering
        )

    def _make_room(self, length: int) -> None:
        grow = length - self._fingers.shape[1]
        if grow <= 0:
            return
        pad = ((0, 0), (0, grow), (0, 0))
        ahead = self._lookahead + 1 if not self._goal.shape[1] else 0
        self._goal = np.pad(self._goal, ((0, 0), (0, grow + ahead), (0, 0)))
        self._fingers = np.pad(self._fingers, pad, constant_values=-1)
        self._played = np.pad(self._played, pad)

    def step(self, ctrl: Array, env_ids: Sequence[int] | None = None) -> Transition:
        """Takes one control step with actions `ctrl` (N, A) in actuator units, the pedal last.

        Args:
            ctrl: a row for every environment.
            env_ids: the environments that take the step, all by default; the rows of the others
                in the result mean nothing.
        """
        moving = self._env_ids if env_ids is None else np.asarray(env_ids, np.intp)
        now = np.minimum(self.steps_done, self.num_steps - 1)
        goal, fingers = self._goal[self._env_ids, now], self._fingers[self._env_ids, now]
        self.simulation.step(ctrl[:, :-1], env_ids)
        self.state = state = self.simulation.state
        self._pedal[moving] = ctrl[moving, -1]

        activation = reward.key_activation(state.key_qpos)
        pedal_down = self.pedal_down
        self._played[moving, now[moving], :NUM_KEYS] = activation[moving]
        self._played[moving, now[moving], NUM_KEYS] = pedal_down[moving]
        self.steps_done[moving] += 1

        terms = self._reward_terms(state, activation, goal, fingers)
        terminated = state.unstable.copy()
        if self.config.wrong_press_termination:
            terminated |= (activation & ~goal[:, :NUM_KEYS]).any(axis=1)
        return Transition(
            reward=sum(terms.values(), np.zeros(self.num_envs)),
            terms=terms,
            terminated=terminated,
            truncated=(self.steps_done >= self.num_steps) & ~terminated,
            unstable=state.unstable,
        )

    def _reward_terms(
        self, state: State, activation: Mask, goal: Mask, fingers: NDArray[np.int8]
    ) -> dict[str, Array]:
        config, keys = self.config, goal[:, :NUM_KEYS]
        terms = {"key_press": reward.key_press(reward.key_state(state.key_qpos), activation, keys)}
        if self.scene.sides:
            if config.fingering != "off":
                terms["fingering"] = self._fingering_term(state, keys, fingers)
            terms["energy"] = reward.energy(
                state.actuator_force, state.actuator_velocity, config.energy_coefficient
            )
        if config.sustain_term:
            terms["sustain"] = reward.sustain(self.pedal_down, goal[:, NUM_KEYS])
        if config.forearm_term:
            terms["forearm"] = reward.forearm(state.forearm_contact)
        return terms

    def _fingering_term(self, state: State, keys: Mask, fingers: NDArray[np.int8]) -> Array:
        points, n = reward.press_points(state.key_qpos), self.num_envs
        by_score = by_transport = np.zeros(n)
        if not self.transports_fingers.all():
            pairs = reward.finger_distances(state.fingertip_xpos, points, fingers)
            by_score = reward.nearness(*pairs, n, otherwise=0.0)
        if self.transports_fingers.any():
            tips = state.fingertip_xpos[:, self.scene.fingers]
            pairs = reward.transport_distances(
                tips, points, keys & self.transports_fingers[:, None]
            )
            by_transport = reward.nearness(*pairs, n, otherwise=1.0)
        return np.where(self.transports_fingers, by_transport, by_score)

    # What is seen

    @property
    def pedal_down(self) -> Mask:
        """(N,) whether the pedal is down."""
        return self._pedal >= PEDAL_DOWN

    @property
    def sounding(self) -> Mask:
        """(N, 88) which keys sound."""
        return reward.key_activation(self.state.key_qpos)

    def goal_ahead(self, num_rows: int) -> Mask:
        """(N, num_rows, 89) goals of the next steps, keys and pedal; False past the end.

        After the last step, as in the published system, those of the last step once more.
        """
        now = np.minimum(self.steps_done, self.num_steps - 1)
        rows = now[:, None] + np.arange(num_rows)
        inside = rows < self.num_steps[:, None]
        goal = self._goal[self._env_ids[:, None], np.minimum(rows, self._goal.shape[1] - 1)]
        return goal & inside[:, :, None]

    def fingers_ahead(self, num_rows: int) -> NDArray[np.int8]:
        """(N, num_rows, 88) fingers of the next steps, -1 for none, and past the end."""
        now = np.minimum(self.steps_done, self.num_steps - 1)
        rows = now[:, None] + np.arange(num_rows)
        last = self._fingers.shape[1] - 1
        fingers = self._fingers[self._env_ids[:, None], np.minimum(rows, last)]
        return np.where((rows < self.num_steps[:, None])[:, :, None], fingers, np.int8(-1))

    def observation(self) -> NDArray[np.float32]:
        """(N, D) what an agent sees; `observation_layout` names the parts.

        goal: the rows of `goal_ahead`, 0 or 1; fingering: 1 for each finger that has a key to
        press now; key_state: 0 (up) to 1 (down); pedal: 0 to 1; joints: positions [m, rad].
        """
        layout = self.observation_layout
        result = np.empty((self.num_envs, self.observation_size), np.float32)
        now = np.minimum(self.steps_done, self.num_steps - 1)
        rows = self._goal[self._env_ids[:, None], now[:, None] + self._ahead]
        result[:, layout["goal"]] = rows.reshape(self.num_envs, -1)
        if "fingering" in layout:
            result[:, layout["fingering"]] = self._fingers_wanted(now)
        result[:, layout["key_state"]] = reward.key_state(self.state.key_qpos)
        result[:, layout["pedal"]] = self._pedal[:, None]
        if "joints" in layout:
            result[:, layout["joints"]] = self.state.hand_qpos
        return result

    def _fingers_wanted(self, now: NDArray[np.intp]) -> NDArray[np.float32]:
        wanted = np.zeros((self.num_envs, 10), np.float32)
        fingers = self._fingers[self._env_ids, now]
        env, key = np.nonzero(fingers >= 0)
        wanted[env, fingers[env, key]] = 1.0
        return wanted

    def episode_metrics(self, env: int) -> dict[str, float]:
        """How well environment `env` has played its score so far (see `music.metrics`)."""
        done = slice(0, int(self.steps_done[env]))
        played, goal = self._played[env, done], self._goal[env, done]
        return playing_metrics(
            played[:, :NUM_KEYS],
            played[:, NUM_KEYS],
            goal[:, :NUM_KEYS],
            goal[:, NUM_KEYS],
            self.config.control_timestep,
        )

    def close(self) -> None:
        """Stops the threads."""
        self.simulation.close()
