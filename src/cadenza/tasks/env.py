"""The task as Gymnasium's `Env` and `VectorEnv`."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from cadenza.configs import MAX_COUNT, MAX_SEED, whole_number
from cadenza.errors import CadenzaError, quoted
from cadenza.files import checked
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.sim.render import Picture, Renderer
from cadenza.tasks.augmentation import find_song, unchanged_track
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.piano_task import EpisodeStart, PianoTask
from cadenza.tasks.reward import RewardTerm, Transition, finite_array
from cadenza.tasks.setups import configure
from cadenza.tasks.view import TaskSpec, layout_of

Song = str | Path | Score | Mapping[str, Any]
Observation = Any  # an array, or with pixels a dictionary of two

_EPISODE_OPTIONS = ("song", "score", "step", "start", "randomization")
_RESET_OPTIONS = {"reset_mask", *_EPISODE_OPTIONS}


def scores_of(song: Any) -> list[Score]:
    """The scores of a song, or of several, that are given as `PianoVectorEnv` takes them.

    Raises CadenzaError if there is none, or one cannot be read.
    """
    if song is None:
        raise CadenzaError(
            "no song to play: give song='OdeToJoy', the path of a MIDI file, a Score, or several"
        )
    songs = song if isinstance(song, list | tuple) else [song]
    return [as_score(each) or load_score(each) for each in songs]


def as_score(song: Any) -> Score | None:
    """The score, if `song` is one, also as JSON (`WrittenScore`); None if it only names one."""
    if isinstance(song, Mapping):
        return checked(song, WrittenScore, "the score").score
    return song if isinstance(song, Score) else None


def state_space(spec: TaskSpec) -> spaces.Box:
    """The space of observations without pixels."""
    low, high = np.zeros(spec.observation_size, np.float32), np.ones(spec.observation_size)
    for name in ("joints", "joint_velocities"):  # joint limits are soft
        part = spec.observation_layout.get(name, slice(0, 0))
        low[part], high[part] = -np.inf, np.inf
    return spaces.Box(low, high.astype(np.float32), dtype=np.float32)


class PianoVectorEnv(VectorEnv):
    """N environments of the task, stepped together on a pool of threads.

    Actions are in [-1, 1], scaled to the actuators' ranges, the pedal last. Observations are
    float32 arrays whose parts `observation_layout` names; with `pixels` a dictionary of them,
    "state", and of pictures, "pixels". `infos` holds the title of the song that each environment
    plays as "song", the reward terms as "reward/<term>", in the last step of an episode its scores
    as "metrics/<name>", and in the first the draws of `DomainRandomization` as
    "randomization/<name>". "_metrics/<name>" and so on say which environments have a value: a
    metric without one, such as the timing error of an episode without any hit, is left out.

    The score's end truncates an episode (the published environment gives it a discount of 1); a
    wrong key that ends it, or a simulation that became unstable, terminates it.
    """

    def __init__(
        self,
        song: Song | Sequence[Song] | None = None,
        num_envs: int = 1,
        num_threads: int = 1,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        picture: Picture | None = None,
        pixels: bool = False,
        privileged: bool = False,
        task: TaskConfig | PianoTask | None = None,
        scene: SceneConfig | None = None,
        reward_terms: Mapping[str, RewardTerm] | None = None,
        **options: Any,
    ) -> None:
        """Make N environments of a song, or of songs that episodes are drawn from.

        Raises CadenzaError if a song cannot be played or an option makes no sense.

        Args:
            song: a bundled song's name, the path of a MIDI or MusicXML file, a `Score`, what JSON
                makes of a `WrittenScore`, or several; each episode draws one.
            num_envs: N.
            num_threads: threads that share the simulation.
            autoreset_mode: when finished environments are reset.
            render_mode: "rgb_array" to draw.
            picture: size and camera of pictures.
            pixels: observe pictures too.
            privileged: have infos["privileged"] (N, P), the true state for critics;
                `privileged_layout` names the parts, see `PianoTask.privileged`.
            task: the task's configuration, or a whole task, which has a song already.
            scene: the scene's configuration.
            reward_terms: name -> function of a `tasks.reward.Outcome` that returns (N,); added to
                the reward, or in place of the term that has this name.
            options: fields of `TaskConfig` and `SceneConfig`, which change `task` and `scene`; or
                setup="allegro", the name of several of them, see `cadenza.tasks.setups`.
        """
        self.closed = True  # Gymnasium before 1.3 closes even what could not be made
        if render_mode not in (None, "rgb_array"):
            raise CadenzaError(f"render_mode {render_mode!r}: choose 'rgb_array' or None")
        if not isinstance(picture, Picture | None):
            raise CadenzaError(f"picture {quoted(picture)}: give a cadenza.sim.render.Picture")
        self._given: list[Any] = list(song) if isinstance(song, list | tuple) else [song]
        if not isinstance(task, PianoTask):
            # First the options, as `song` may be the misspelt one.
            task, scene = configure(options, task, scene)
            scores = scores_of(song)
            task = PianoTask(scores, task, scene, num_envs, num_threads, reward_terms)
        elif song is not None or scene is not None or reward_terms is not None or options:
            raise CadenzaError(
                "a PianoTask already has its songs, scene, reward and options: pass nothing else, "
                "or a TaskConfig instead"
            )
        elif num_envs != task.num_envs:
            raise CadenzaError(f"num_envs {num_envs}: the task has {task.num_envs}; give the same")
        self.task, self.num_envs = task, task.num_envs
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": round(1 / self.task.config.control_timestep),
            "autoreset_mode": AutoresetMode(autoreset_mode),
        }
        self._picture = picture or Picture()
        self._pixels, self._privileged = pixels, privileged
        self._renderer: Renderer | None = None  # made when it is first needed
        self._rngs: list[np.random.Generator] = []
        self._finished = np.zeros(self.num_envs, bool)
        self.single_action_space = spaces.Box(-1.0, 1.0, (self.task.spec.action_size,), np.float32)
        self.single_observation_space = self._observation_space()
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.closed = False

    @property
    def observation_layout(self) -> dict[str, slice]:
        """Name -> slice of an observation (see `PianoTask.observation`)."""
        return self.task.spec.observation_layout

    @property
    def privileged_layout(self) -> dict[str, slice]:
        """Name -> slice of infos["privileged"]."""
        return layout_of({n: values.shape[1] for n, values in self.task.privileged().items()})

    def _observation_space(self) -> spaces.Space:
        state = state_space(self.task.spec)
        if not self._pixels:
            return state
        shape = (self._picture.height, self._picture.width, 3)
        return spaces.Dict({"state": state, "pixels": spaces.Box(0, 255, shape, np.uint8)})

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start new episodes.

        Raises CadenzaError if a seed or an option makes no sense, or the environment is closed.

        Args:
            seed: the seed of the first environment, and each of the others has the next; or a list
                of seeds, None where the random generator stays.
            options: "reset_mask", (N,) bool, resets some of the environments only, but not at
                first. Other options hold for all environments, or are lists with one for each; None
                is drawn. "song": one of the songs by index, by title or as it was given. "score": a
                `Score`, or a `WrittenScore` as JSON, which is played exactly as it is. "step": the
                control step of the song to begin with. "start": (J,) joint positions of the hands
                [m, rad]. "randomization": the seed of `DomainRandomization`, as in infos.
        """
        self._check_open()
        options = _known(options)
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, bool)), bool)
        if mask.shape != (self.num_envs,):
            raise CadenzaError(f"reset_mask of shape {mask.shape}: give ({self.num_envs},)")
        if not (self._rngs or mask.all()):
            raise CadenzaError("reset_mask: the first reset is of all environments; leave it out")
        starts = self._starts(options)
        self._seed(seed, mask)
        self._restart(np.flatnonzero(mask), starts)
        self._finished = self._finished & ~mask
        return self._observe(), self._songs(mask) | self._drawn(mask) | self._true_state()

    def get_state(self) -> list[Any]:
        """(N,) the full state of each environment: physics, song, step, generators.

        Raises CadenzaError if no episode has started, or the simulation cannot be saved.
        """
        if not self._rngs:
            raise CadenzaError("no episode has started: call reset() before get_state()")
        own = zip(deepcopy(self._rngs), self._finished.tolist(), strict=True)
        return [(self.task.save(env), *each) for env, each in enumerate(own)]

    def set_state(self, states: Sequence[Any]) -> Observation:
        """Put environments in states (N,) of `get_state`, None where they stay, and observe all.

        Raises CadenzaError if a state is of other options, or missing before the first reset.
        """
        self._check_open()
        states = self._each("state", list(states))
        if not self._rngs and None in states:
            raise CadenzaError("no episode has started: give a state for each environment")
        self._rngs = self._rngs or [np.random.default_rng() for _ in states]
        for env, state in enumerate(states):
            if state is not None:
                self.task.restore(env, state[0])
                self._rngs[env], self._finished[env] = deepcopy(state[1]), state[2]
        return self._observe()

    def _starts(self, options: Mapping[str, Any]) -> list[EpisodeStart]:
        """(N,) starts of the episodes, as far as the options of a reset fix them."""
        values = (self._each(name, options.get(name)) for name in _EPISODE_OPTIONS)
        shape = self.task.scene.hand_start.shape
        demand = f"give a finite number for each of the hands' joints, {shape}"
        return [
            EpisodeStart(
                self._song(song, score),
                None if start is None else finite_array("start", start, shape, demand),
                0 if step is None else whole_number(step, "step", 0, MAX_COUNT),
                None if drawn is None else whole_number(drawn, "randomization", 0, MAX_COUNT),
            )
            for song, score, step, start, drawn in zip(*values, strict=True)
        ]

    def _song(self, song: Any, score: Any) -> int | GoalTrack | None:
        """The index of a song or the track of a score; None if neither is given."""
        if score is None:
            return None if song is None else self._index(song)
        if song is not None:
            raise CadenzaError("song and score: give one of them, as an episode plays one")
        if (played := as_score(score)) is None:
            raise CadenzaError(f"score {quoted(score)}: give a Score; a song is named by song")
        return unchanged_track(played, self.task.config, self.task.scene)

    def _index(self, song: Any) -> int:
        as_given = isinstance(song, str | Path) and song in self._given
        return self._given.index(song) if as_given else find_song(self.task.scores, song)

    def _each(self, name: str, given: Any) -> list[Any]:
        """(N,) the option of each environment, given for all of them or as a list."""
        is_list = isinstance(given, list | tuple | np.ndarray)
        if name == "start":  # a start for all is a list, too, but of numbers
            is_list = is_list and any(each is None or np.ndim(each) for each in given)
        values = list(given) if is_list else [given] * self.num_envs
        if len(values) != self.num_envs:
            raise CadenzaError(
                f"{len(values)} {name}s for {self.num_envs} environments: give one for each"
            )
        return values

    def _songs(self, known: NDArray[np.bool_]) -> dict[str, Any]:
        titles = np.array([score.title for score in self.task.goals.scores], object)
        return _infos({"song": titles}, known)

    def _drawn(self, fresh: NDArray[np.bool_]) -> dict[str, Any]:
        """Infos on the draws of domain randomization for the episodes that begin."""
        drawn = {f"randomization/{name}": v.copy() for name, v in self.task.drawn.items()}
        return _infos(drawn, fresh)

    def _true_state(self) -> dict[str, Any]:
        if not self._privileged:
            return {}
        parts = np.concatenate(list(self.task.privileged().values()), axis=1)
        return _infos({"privileged": parts.astype(np.float32)}, np.ones(self.num_envs, bool))

    def _metrics(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        for env in np.flatnonzero(ended).tolist():
            metrics = self.task.episode_metrics(env).items()
            # Undefined values are left out, so that means stay right.
            values = {f"metrics/{name}": value for name, value in metrics if not np.isnan(value)}
            infos = self._add_info(infos, values, env)
        return infos

    def _seed(self, seed: int | Sequence[int | None] | None, mask: NDArray[np.bool_]) -> None:
        """Seed environments of the mask (N,); those without a seed keep their generators."""
        if seed is None and self._rngs:
            return
        if isinstance(seed, Sequence | np.ndarray):
            seeds = [checked_seed(each) for each in self._each("seed", list(seed))]
        else:
            first = checked_seed(seed)
            self._np_random, self._np_random_seed = seeding.np_random(first)
            seeds = [None if first is None else first + i for i in range(self.num_envs)]
        self._rngs = [
            self._rngs[i]
            if self._rngs and (each is None or not mask[i])
            else seeding.np_random(each)[0]
            for i, each in enumerate(seeds)
        ]

    def _restart(
        self, env_ids: NDArray[np.intp], starts: Sequence[EpisodeStart] | None = None
    ) -> None:
        """Begin episodes in these environments, with their `starts` (N,) if any."""
        if len(env_ids):
            rngs, fixed = [self._rngs[i] for i in env_ids], starts and [starts[i] for i in env_ids]
            self.task.reset(rngs, env_ids.tolist(), fixed)

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Take a control step in every environment, as `gymnasium.vector.VectorEnv.step`."""
        self._check_open()
        mode = self.metadata["autoreset_mode"]
        if not self._rngs:
            raise CadenzaError("no episode has started: call reset() before step()")
        _check_shape("actions", actions, self.action_space)
        if mode == AutoresetMode.DISABLED and self._finished.any():
            over = np.flatnonzero(self._finished).tolist()
            raise CadenzaError(f"episodes {over} have ended: reset them before the next step")
        fresh, moving = self._finished, None
        if fresh.any():
            self._restart(np.flatnonzero(fresh))
            moving = np.flatnonzero(~fresh).tolist()
        result = self.task.step(self.task.spec.scale_action(actions), moving)
        if moving is not None:
            result = _blanked(result, fresh)
        everywhere = np.ones(self.num_envs, bool)
        terms = {f"reward/{name}": values for name, values in result.terms.items()}
        infos = self._songs(everywhere) | _infos({"unstable": result.unstable, **terms}, ~fresh)
        infos |= self._true_state()
        if moving is not None:
            infos |= self._drawn(fresh)
        ended = result.terminated | result.truncated
        any_ended = bool(ended.any())
        if any_ended:
            infos |= self._metrics(ended)
        observation = self._observe()
        self._finished = ended
        if any_ended and mode == AutoresetMode.SAME_STEP:
            infos |= {"final_info": infos.copy(), "_final_info": ended}
            infos |= {"final_obs": _rows(observation, ended), "_final_obs": ended}
            self._restart(np.flatnonzero(ended))
            infos |= self._songs(everywhere) | self._drawn(ended) | self._true_state()
            self._finished = np.zeros_like(ended)
            observation = self._observe()
        return observation, result.reward, result.terminated, result.truncated, infos

    def _observe(self) -> Observation:
        state = self.task.observation()
        return {"state": state, "pixels": self._draw()} if self._pixels else state

    def _draw(self) -> NDArray[np.uint8]:
        state, task = self.task.state, self.task
        self._renderer = renderer = self._renderer or Renderer(task.scene, self._picture)
        drawn = zip(state.hand_qpos, state.key_qpos, task.sounding, task.goal_keys, strict=True)
        return np.stack([renderer.frame(*each) for each in drawn])

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture (height, width, 3) of each environment, if `render_mode` asks for it."""
        self._check_open()
        return tuple(self._draw()) if self.render_mode == "rgb_array" else None

    def _check_open(self) -> None:
        if self.closed:
            raise CadenzaError("the environment is closed: make another")

    def close_extras(self, **kwargs: Any) -> None:
        """Free threads and graphics."""
        self.task.close()
        if self._renderer:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_renderer": None}  # each copy draws with graphics of its own


class PianoEnv(gymnasium.Env):
    """A single environment: a `PianoVectorEnv` with N = 1."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(
        self,
        song: Song | Sequence[Song] | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        """Take the arguments of `PianoVectorEnv`, without `num_envs` and `autoreset_mode`."""
        if of_several := sorted(options.keys() & {"num_envs", "autoreset_mode"}):
            raise CadenzaError(
                f"{' and '.join(of_several)}: this is one environment; make several with "
                "gymnasium.make_vec"
            )
        self._batch = PianoVectorEnv(
            song, autoreset_mode=AutoresetMode.DISABLED, render_mode=render_mode, **options
        )
        self.task = self._batch.task
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": self._batch.metadata["render_fps"]}
        self.observation_space = self._batch.single_observation_space
        self.action_space = self._batch.single_action_space

    @property
    def observation_layout(self) -> dict[str, slice]:
        """Name -> slice of an observation (see `PianoTask.observation`)."""
        return self.task.spec.observation_layout

    @property
    def privileged_layout(self) -> dict[str, slice]:
        """Name -> slice of info["privileged"]."""
        return self._batch.privileged_layout

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new episode.

        Raises CadenzaError if a seed or an option makes no sense, or the environment is closed.

        Args:
            seed: the seed of everything random.
            options: "song", "score", "step", "start" and "randomization", see
                `PianoVectorEnv.reset`.
        """
        super().reset(seed=checked_seed(seed))
        self._batch._rngs = [self.np_random]
        options = {n: value for n, value in _known(options).items() if n != "reset_mask"}
        observation, infos = self._batch.reset(options=options)
        return _row(observation, 0), _first(infos)

    def get_state(self) -> Any:
        """The full state of the environment, see `PianoVectorEnv.get_state`."""
        return self._batch.get_state()[0]

    def set_state(self, state: Any) -> Observation:
        """Go on from a state, and observe it, see `PianoVectorEnv.set_state`."""
        observation = self._batch.set_state([state])
        self.np_random = self._batch._rngs[0]
        return _row(observation, 0)

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take a control step, as `gymnasium.Env.step`."""
        _check_shape("action", action, self.action_space)
        observation, reward, *ended, infos = self._batch.step(np.asarray(action)[None])
        terminated, truncated = (bool(each[0]) for each in ended)
        return _row(observation, 0), float(reward[0]), terminated, truncated, _first(infos)

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (height, width, 3), if `render_mode` asks for it."""
        frames = self._batch.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Free graphics."""
        self._batch.close()


def _known(options: dict[str, Any] | None) -> dict[str, Any]:
    """The options of a reset, none by default.

    Raises CadenzaError if they are no dictionary, or there is no such option, which would otherwise
    silently draw songs.
    """
    if not isinstance(options, Mapping | None):
        raise CadenzaError(
            f"options {quoted(options)} of reset: give a dictionary, whose values may be lists of "
            "one for each environment"
        )
    if unknown := sorted(set(options or ()) - _RESET_OPTIONS):
        raise CadenzaError(
            f"no option {quoted(unknown[0])} of reset: choose from "
            f"{', '.join(sorted(_RESET_OPTIONS))}"
        )
    return options or {}


def checked_seed(seed: Any) -> int | None:
    """The seed as Python's int, or None. Raises CadenzaError if it is none."""
    return None if seed is None else whole_number(seed, "seed", 0, MAX_SEED)


def _infos(values: Mapping[str, Any], known: NDArray[np.bool_]) -> dict[str, Any]:
    """Infos of a vector environment: values (N,) by name, and which environments have one."""
    return {**values, **{f"_{name}": known for name in values}}


def _check_shape(name: str, values: Any, space: spaces.Space) -> None:
    if np.shape(values) != space.shape:
        raise CadenzaError(f"{name} of shape {np.shape(values)}: give {space.shape}")


def _first(infos: dict[str, Any]) -> dict[str, Any]:
    return {
        name: values[0] if values.ndim > 1 else values[:1].tolist()[0]
        for name, values in infos.items()
        if name[0] != "_" and infos[f"_{name}"][0]
    }


def _row(observation: Observation, env: int) -> Observation:
    if isinstance(observation, dict):
        return {name: part[env] for name, part in observation.items()}
    return observation[env]


def _blanked(result: Transition, fresh: NDArray[np.bool_]) -> Transition:
    """Zero the rows of environments that were reset instead of stepped."""
    return Transition(
        reward=np.where(fresh, 0.0, result.reward),
        terms={name: np.where(fresh, 0.0, values) for name, values in result.terms.items()},
        terminated=result.terminated & ~fresh,
        truncated=result.truncated & ~fresh,
        unstable=result.unstable & ~fresh,
    )


def _rows(observation: Observation, ended: NDArray[np.bool_]) -> NDArray[Any]:
    """The observations of ended episodes as Gymnasium's vector environments give them."""
    rows = np.full(len(ended), None, dtype=object)
    for env in np.flatnonzero(ended).tolist():
        rows[env] = _row(observation, env)
    return rows
