"""The task: N simulations, each with a score to play, stepped together.

The Gymnasium classes, the adapters and the planners all stand on this one class, which speaks in
actuator units and arrays (num_envs, ...).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.configs import as_config, whole_number
from cadenza.errors import CadenzaError
from cadenza.music.metrics import playing_metrics
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.hands_apart import HandsApart
from cadenza.sim.mujoco_simulation import MOST_ENVS, MujocoSimulation
from cadenza.sim.protocol import MakeSimulation
from cadenza.tasks import music, reward
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.optimal_transport import keys_by_transport_on_host
from cadenza.tasks.randomization import Randomization
from cadenza.tasks.view import TaskSpec, View

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PEDAL_DOWN = 0.5  # the pedal sounds from here on
_TOTAL = "total"
TOUCH_RANGE = 5.0
"""Greatest force that is observed [N]; a key is held down with about one."""


class Transition(NamedTuple):
    """What came of one control step; arrays over the batch (N,)."""

    reward: Array
    terms: dict[str, Array]
    """Each term of the reward by name; they add up to it."""
    terminated: Mask
    """A wrong key sounded where that ends the episode, or it is unstable."""
    truncated: Mask
    """The score is over."""
    unstable: Mask
    """The simulation became so, or a control of it or of the pedal was not a number."""


def _checked_terms(terms: Mapping[str, reward.RewardTerm]) -> dict[str, reward.RewardTerm]:
    if not isinstance(terms, Mapping):
        raise CadenzaError(f"reward_terms {terms!r:.100}: give a dictionary, name -> function")
    for name, term in terms.items():
        if not isinstance(name, str) or not callable(term):
            raise CadenzaError(f"reward term {name!r:.100}: give a name and a function")
        if name == _TOTAL:
            raise CadenzaError(
                f"reward term {name!r}: recordings call the sum of all terms so; "
                "choose another name"
            )
    return dict(terms)


class PianoTask:
    """N hands-and-piano simulations with a score to play in each.

    Attributes:
        spec: what is the same in all environments and episodes.
        scene: the nominal scene, which simulations may differ from, see `DomainRandomization`.
        config: the task's configuration.
        simulation: the physics.
        action_low, action_high: (A,) ranges of an action in actuator units, the pedal last.
        observation_layout: name -> slice of an observation.
        observation_size: D.
        sheets: the music that each environment plays and how far it has got.
        state: what the simulation was like after the last step, or reset.
        key_state: (N, K) how far the keys are down, 0..1.
        sounding: (N, K) which keys sound.
        wanted: (N, K) which keys should have sounded in the last step, none after reset.
        reward: (N,) of the last step, 0 after reset.
        tracks: what is drawn from, as it is played.
    """

    def __init__(
        self,
        scores: Sequence[Score],
        config: TaskConfig | None = None,
        scene: SceneConfig | Scene | None = None,
        num_envs: int = 1,
        num_threads: int = 1,
        reward_terms: Mapping[str, reward.RewardTerm] | None = None,
        progress: Callable[[int, int], None] | None = None,
        make_simulation: MakeSimulation | None = None,
    ) -> None:
        """Args:
            scores: the songs to draw from, one per episode.
            config: the task's options.
            scene: the scene or its options.
            num_envs: N.
            num_threads: threads that share the simulation.
            reward_terms: name -> function of a `reward.Outcome` that returns (N,); they are added
                to the reward, and one of the same name takes the place of the task's own.
            progress: is told of how many notes the fingers have been looked for, and of all.
            make_simulation: what moves hands and keys; MuJoCo if nothing else is given, one for
                each hand if they play apart.

        Raises:
            CadenzaError: a score has no notes, or an option makes no sense.
        """
        self.config = as_config(config, TaskConfig)
        self.scene = scene if isinstance(scene, Scene) else build_scene(scene)
        self.num_envs = num_envs = whole_number(num_envs, "num_envs", 1, MOST_ENVS)
        self.draw_from(scores, progress)
        self._offset_joints = self._find_offset_joints()
        if make_simulation is None:
            apart = self.scene.config.hands == "apart"
            make_simulation = HandsApart if apart else MujocoSimulation
        self.simulation = make_simulation(
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
        keyboard = self.scene.keyboard
        self._travel, self._sounds_from = keyboard.travel, keyboard.sounds_from
        self._press = reward.press_offset(keyboard.half_size)
        lookahead = self._steps_lookahead()
        self.sheets = music.Sheets(num_envs, lookahead, self.config, self.scene)
        self.spec = TaskSpec(
            config=self.config,
            scene=self.scene,
            action_low=self.scene.action_low,
            action_high=self.scene.action_high,
            observation_layout=self._lay_out_observation(lookahead),
        )
        self.action_low, self.action_high = self.spec.action_low, self.spec.action_high
        self.observation_layout = self.spec.observation_layout
        self.observation_size = self.spec.observation_size
        self._played = np.zeros((num_envs, 0, keyboard.num_keys + 1), bool)
        self.wanted = np.zeros((num_envs, keyboard.num_keys), bool)
        self._more_terms = _checked_terms(reward_terms or {})
        self._pedal, self._lost = np.zeros(num_envs), np.zeros(num_envs, bool)
        self._env_ids = np.arange(num_envs)
        self.reward = np.zeros(num_envs)
        self._look()

    # Shapes and ranges

    @property
    def action_size(self) -> int:
        """A: actuators and the pedal."""
        return self.spec.action_size

    def scale_action(self, action: NDArray[Any]) -> Array:
        """See `TaskSpec.scale_action`."""
        return self.spec.scale_action(action)

    def unscale_action(self, ctrl: NDArray[Any]) -> Array:
        """See `TaskSpec.unscale_action`."""
        return self.spec.unscale_action(ctrl)

    def _steps_lookahead(self) -> int:
        seconds = self.config.n_seconds_lookahead
        steps = self.config.n_steps_lookahead
        if seconds is not None:
            steps = math.ceil(round(seconds / self.config.control_timestep, 9))
        return steps

    def _lay_out_observation(self, lookahead: int) -> dict[str, slice]:
        keys = self.scene.keyboard.num_keys
        sizes = {"goal": (lookahead + 1) * (keys + 1)}
        if self.config.fingering != "off" and self.scene.sides:
            sizes["fingering"] = self.scene.fingers.count
        sizes |= {"key_state": keys, "pedal": 1}
        if self.scene.sides:
            sizes["joints"] = len(self.scene.hand_joint_names)
        if self.scene.sides and self.scene.config.touch:
            sizes["touch"] = len(self.scene.fingertip_sites)
        ends = np.cumsum(list(sizes.values()))
        return {
            name: slice(int(end) - size, int(end))
            for (name, size), end in zip(sizes.items(), ends, strict=True)
        }

    def _find_offset_joints(self) -> NDArray[np.intp]:
        names, most = self.scene.hand_joint_names, self.config.random_hand_position
        slides = self.scene.slide_joints
        if most and not len(slides):
            raise CadenzaError(
                "random_hand_position needs hands that slide along the keyboard, with tx among "
                "their forearm_dofs; choose such hands, or random_hand_position 0"
            )
        reach = min((abs(self.scene.model.joint(names[j]).range).min() for j in slides), default=0)
        if most > reach:
            raise CadenzaError(
                f"random_hand_position {most} m: the hands reach the keyboard's end after "
                f"{reach:.2f} m; choose less"
            )
        return slides

    # Episodes

    @property
    def scores(self) -> tuple[Score, ...]:
        """The scores that are drawn from, as they are played."""
        return tuple(track.score for track in self.tracks)

    @property
    def drawn(self) -> Mapping[str, NDArray[Any]]:
        """Name -> (N, ...) what was drawn for the episodes, see `Randomization.drawn`."""
        return self._randomization.drawn

    def draw_from(
        self, scores: Sequence[Score], progress: Callable[[int, int], None] | None = None
    ) -> None:
        """From the next reset on, what is played is drawn from these; see the constructor."""
        self.tracks = music.prepare(scores, self.config, self.scene, progress)

    def find_song(self, song: int | str) -> int:
        """The index among `scores` of a song, given by index or title.

        Raises:
            CadenzaError: that is none of them, or several.
        """
        return music.find_song(self.scores, song)

    def reset(
        self,
        rngs: Sequence[np.random.Generator],
        env_ids: Sequence[int],
        songs: Sequence[int | GoalTrack | None] | None = None,
        starts: Sequence[Array | None] | None = None,
        seeds: Sequence[int | None] | None = None,
    ) -> None:
        """Starts new episodes.

        Args:
            rngs: a generator for each of `env_ids`.
            env_ids: which environments.
            songs: the index of each one's song among `scores`, None where it is drawn, or what is
                played as it is, see `as_written`; all are drawn by default.
            starts: (J,) where each one's hands begin [m, rad], None where that is as the task has
                it, as are all by default.
            seeds: the number from which each one's `DomainRandomization` follows, None where it is
                drawn, as are all by default.
        """
        start = np.tile(self.scene.hand_start, (len(env_ids), 1))
        songs = [None] * len(env_ids) if songs is None else songs
        starts = [None] * len(env_ids) if starts is None else starts
        for row, (env, rng, song, given) in enumerate(
            zip(env_ids, rngs, songs, starts, strict=True)
        ):
            self.sheets.put(env, self._track(song, rng))
            if given is not None:
                start[row] = given
            elif most := self.config.random_hand_position:
                start[row, self._offset_joints] = rng.uniform(-most, most)
        if (missing := int(self.sheets.num_steps.max()) - self._played.shape[1]) > 0:
            self._played = np.pad(self._played, ((0, 0), (0, missing), (0, 0)))
        self.wanted[list(env_ids)] = False
        seeds = [None] * len(env_ids) if seeds is None else seeds
        self._randomization.begin(env_ids, rngs, start, seeds)
        self.simulation.reset(env_ids, start)
        self._pedal[list(env_ids)], self._lost[list(env_ids)] = 0.0, False
        self.reward[list(env_ids)] = 0.0
        self._look()

    def _track(self, song: int | GoalTrack | None, rng: np.random.Generator) -> GoalTrack:
        if isinstance(song, GoalTrack):
            return song
        return music.draw(self.tracks, self.config, self.scene.keyboard.pitches, rng, song)

    def as_written(self, score: Score) -> GoalTrack:
        """What is played of a score to which nothing is done, see `music.as_written`."""
        return music.as_written(score, self.config, self.scene)

    def _look(self) -> None:
        self.state = self.simulation.state
        self.key_state = reward.key_state(self.state.key_qpos, self._travel)
        self.sounding = reward.key_activation(self.state.key_qpos, self._sounds_from)

    def step(self, ctrl: Array, env_ids: Sequence[int] | None = None) -> Transition:
        """Takes one control step with actions `ctrl` (N, A) in actuator units, the pedal last.

        Args:
            ctrl: a row for every environment.
            env_ids: the environments that take the step, all by default; the rows of the others
                in the result mean nothing.
        """
        sheets = self.sheets
        goal, fingers, row = sheets.goal, sheets.fingers, sheets.row
        moving = slice(None) if env_ids is None else np.asarray(env_ids, np.intp)
        arrived = self._randomization.step(ctrl, moving)
        self._look()
        pedal = arrived[moving, -1]
        self._lost[moving] |= ~np.isfinite(pedal)
        self._pedal[moving] = np.fmin(np.fmax(pedal, 0.0), 1.0)  # up where it is not a number
        self.wanted[moving] = goal[moving, :-1]
        within = self._env_ids[moving][(sheets.steps_done < sheets.num_steps)[moving]]
        here = within, row[within]
        self._played[*here, :-1] = self.sounding[within]
        self._played[*here, -1] = self.pedal_down[within]
        sheets.advance(moving)

        terms = self._reward_terms(goal, fingers) | self._terms_given(goal, fingers, ctrl)
        terminated = unstable = self.state.unstable | self._lost
        if self.config.wrong_press_termination:
            terminated = terminated | (self.sounding > goal[:, :-1]).any(axis=1)
        total = sum(terms.values(), np.zeros(self.num_envs))
        self.reward[moving] = total[moving]
        return Transition(
            reward=total,
            terms=terms,
            terminated=terminated,
            truncated=(sheets.steps_done >= sheets.num_steps) > terminated,
            unstable=unstable,
        )

    def _reward_terms(self, goal: Mask, fingers: NDArray[np.int8]) -> dict[str, Array]:
        config, state, keys = self.config, self.state, goal[:, :-1]
        graded = config.key_press == "graded"
        key_press = reward.graded_key_press if graded else reward.key_press
        terms = {"key_press": key_press(self.key_state, self.sounding, keys)}
        if self.scene.sides:
            if config.fingering != "off":
                terms["fingering"] = self._fingering_term(keys, fingers)
            terms["energy"] = reward.energy(
                state.actuator_force, state.actuator_velocity, config.energy_coefficient
            )
        if config.sustain_term:
            terms["sustain"] = reward.sustain(self.pedal_down, goal[:, -1])
        if config.forearm_term:
            terms["forearm"] = reward.forearm(state.forearm_contact)
        return terms

    def _terms_given(self, goal: Mask, fingers: NDArray[np.int8], ctrl: Array) -> dict[str, Array]:
        if not self._more_terms:
            return {}
        outcome = reward.Outcome(
            state=self.state,
            key_state=self.key_state,
            sounding=self.sounding,
            pedal_down=self.pedal_down,
            goal_keys=goal[:, :-1],
            goal_sustain=goal[:, -1],
            fingers=fingers,
            ctrl=ctrl,
        )
        return {n: self._reward_of(n, term(outcome)) for n, term in self._more_terms.items()}

    def _reward_of(self, term: str, given: Any) -> Array:
        """(N,) what a term of somebody else's has returned.

        Raises:
            CadenzaError: that is no reward.
        """
        wanted = f"give a finite number for each environment, ({self.num_envs},)"
        try:
            values = np.asarray(given, float)
        except (TypeError, ValueError) as error:
            kind = type(given).__name__
            raise CadenzaError(f"reward term {term!r} returned {kind}: {wanted}") from error
        if values.shape != (self.num_envs,):
            raise CadenzaError(f"reward term {term!r} returned shape {values.shape}: {wanted}")
        if not np.isfinite(values).all():
            raise CadenzaError(f"reward term {term!r} returned {values}: {wanted}")
        return values

    def _fingering_term(self, keys: Mask, fingers: NDArray[np.int8]) -> Array:
        tips, key_xpos, press = self.state.fingertip_xpos, self.state.key_xpos, self._press
        margin = self.config.fingering_margin
        if self.config.fingering == "transport":
            there = self.scene.fingers_there
            assigned = keys_by_transport_on_host(tips, key_xpos, press, keys, there)
            return reward.transport_fingering(tips, key_xpos, press, assigned, margin)
        return reward.score_fingering(tips, key_xpos, press, fingers, margin)

    # What is seen

    @property
    def pedal_down(self) -> Mask:
        """(N,) whether the pedal is down."""
        return self._pedal >= PEDAL_DOWN

    def observation(self) -> NDArray[np.float32]:
        """(N, D) what an agent sees; `observation_layout` names the parts.

        goal: keys and pedal of the next step and of those after it, 0 or 1; fingering: 1 for each
        finger that has a key to press next; key_state: 0 (up) to 1 (down); pedal: 0 to 1; joints:
        positions [m, rad]; touch: normal forces on the fingertips that are there, from 0 to 1
        where the sensors saturate, at `TOUCH_RANGE`. Joints and key states have the noise of
        `DomainRandomization`.
        """
        layout = self.observation_layout
        result = np.empty((self.num_envs, self.observation_size), np.float32)
        result[:, layout["goal"]] = self.sheets.lookahead
        if "fingering" in layout:
            result[:, layout["fingering"]] = self.sheets.fingers_wanted
        result[:, layout["key_state"]] = self._randomization.observed_keys(self.key_state)
        result[:, layout["pedal"]] = self._pedal[:, None]
        if "joints" in layout:
            joints = self._randomization.observed_joints(self.state.hand_qpos)
            result[:, layout["joints"]] = joints
        if "touch" in layout:
            result[:, layout["touch"]] = np.minimum(
                self.state.touch[:, self.scene.fingers_there] / TOUCH_RANGE, 1.0
            )
        return result

    def view(self, playing: Mask | None = None) -> View:
        """What an agent sees before the next step, which the environments take that are `playing`.

        `playing` is (N,), all by default.
        """
        sheets = self.sheets
        return View(
            task=self.spec,
            env_ids=self._env_ids,
            tracks=tuple(sheets.tracks),
            num_steps=sheets.num_steps.copy(),
            steps=sheets.steps_done.copy(),
            playing=np.ones(self.num_envs, bool) if playing is None else playing,
            state=self.state,
            observation=self.observation(),
            fingers=sheets.fingers,
            reward=self.reward.copy(),
            simulation=self.simulation,
        )

    def score(self, env: int) -> Score:
        """What environment `env` is to play, on the clock of its episode."""
        return self.sheets.tracks[env].on_the_clock

    def episode_metrics(self, env: int) -> dict[str, float]:
        """How well environment `env` has played its score so far (see `music.metrics`)."""
        done = int(min(self.sheets.steps_done[env], self.sheets.num_steps[env]))
        played, (goal, _) = self._played[env, :done], self.sheets.part(env, 0, done)
        return playing_metrics(
            played[:, :-1],
            played[:, -1],
            goal[:, :-1],
            goal[:, -1],
            self.config.control_timestep,
            self.score(env),
            self.scene.keyboard.lowest_pitch,
        )

    def close(self) -> None:
        """Stops the threads."""
        self.simulation.close()
