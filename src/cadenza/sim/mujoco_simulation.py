"""A batch of N independent MuJoCo simulations of one scene, stepped by a pool of threads."""

import logging
from collections.abc import Callable, Sequence
from copy import copy
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.configs import whole_number
from cadenza.errors import CadenzaError
from cadenza.scene.randomization import KEY_SOUNDING, Factors, scale
from cadenza.scene.scene import Scene
from cadenza.sim.key_crossings import last_key_events
from cadenza.sim.protocol import HeldControls, Path, State
from cadenza.sim.threads import Threads

Array = NDArray[np.float64]

PHYSICS_STATE = mujoco.mjtState.mjSTATE_INTEGRATION

MAX_ENVS = 10_000
"""The most simulations of a batch. Each takes about 1 MB, or 1.5 MB with a model of its own."""
_LOG = logging.getLogger(__name__)
_AWAKE = "nbody_awake", "nparent_awake", "nv_awake", "ntree_awake"  # MuJoCo does not pickle these
UNSTABLE = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADCTRL) + 1)
"""Warnings of bad positions, velocities, accelerations and controls, neighbours in MuJoCo."""

# MuJoCo would otherwise print to the terminal and leave MUJOCO_LOG.TXT wherever it runs.
mujoco.set_mju_user_warning(lambda message: _LOG.info("MuJoCo: %s", message))


class MujocoSimulation:
    """N simulations, each with its own `MjData`; implements `protocol.Simulation`.

    Every simulation is stepped by one thread at a time and shares nothing with the others, so the
    results are the same bits for any number of threads.

    Attributes:
        state: the state after the last step; its arrays are never written to again.
    """

    def __init__(
        self,
        scene: Scene,
        num_envs: int = 1,
        control_timestep: float = 0.05,
        num_threads: int = 1,
        watch_forearms: bool = False,
    ) -> None:
        """Allocate N simulations of a scene, which threads share, and reset them.

        `State.forearm_contact` is there if `watch_forearms`. Raises CadenzaError if a number is not
        positive or the timesteps [s] do not divide.
        """
        self.scene = scene
        self.num_envs = whole_number(num_envs, "num_envs", 1, MAX_ENVS)
        self.control_timestep = control_timestep
        self.num_substeps = physics_steps(control_timestep, scene.model.opt.timestep)
        self._substep = control_timestep / self.num_substeps
        self._threads = Threads(num_threads)
        self._data = [mujoco.MjData(scene.model) for _ in range(num_envs)]
        self._models = [scene.model] * num_envs  # the nominal one until it is randomized
        self._factors: dict[int, Factors] = {}
        self._sounding_depth: dict[int, Array] = {}
        self._watch_forearms = watch_forearms and len(scene.sides) == 2
        self.state = State.at_rest(scene, num_envs)
        self.reset()

    def reset(self, env_ids: Sequence[int] | None = None, hand_qpos: Array | None = None) -> None:
        """Put simulations, all by default, back to the start at joint positions (N, J) or 0."""

        ids = self._ids(env_ids)

        def change(row: int, data: mujoco.MjData) -> None:
            mujoco.mj_resetData(self._models[ids[row]], data)  # which places what never moves
            if hand_qpos is not None:
                data.qpos[self.scene.hand_qpos] = hand_qpos[row]

        self._change(change, env_ids)

    def randomize(self, env_id: int, factors: Factors) -> None:
        """Scale the model of one simulation, see `protocol.Simulation.randomize`."""
        if self._models[env_id] is self.scene.model:
            self._models[env_id] = copy(self.scene.model)
        scale(self._models[env_id], self.scene, factors, self._data[env_id])
        self._factors[env_id] = factors
        if KEY_SOUNDING in factors:
            self._sounding_depth[env_id] = factors[KEY_SOUNDING]

    def push(self, env_id: int, force: Array) -> None:
        """Push bodies of one simulation, as `protocol.Simulation.push`."""
        self._data[env_id].xfrc_applied[:, :3] = force

    def _change(
        self, change: Callable[[int, mujoco.MjData], None], env_ids: Sequence[int] | None = None
    ) -> None:
        """Have `change(row, data)` change simulations, all by default, and read their states."""
        state = self.state.copy()
        for row, i in enumerate(self._ids(env_ids)):
            change(row, self._data[i])
            mujoco.mj_step1(self._models[i], self._data[i])
            self._read(i, state, i)
            for values in state.key_events:
                values[i] = np.nan
        self.state = state

    def step(
        self,
        ctrl: Array,
        env_ids: Sequence[int] | None = None,
        held: HeldControls | None = None,
        path: Path | None = None,
    ) -> None:
        """Apply `ctrl` (N, A) in actuator units for one control step.

        Args:
            ctrl: one row for every simulation, also for those not stepped.
            env_ids: the simulations to step; all by default.
            held: the controls until these arrive, if they are late.
            path: receives the path through the step.
        """
        out, stepped = self.state.copy(), self._ids(env_ids)
        paths = np.empty((len(stepped), self.num_substeps + 1, self.scene.keyboard.num_keys))

        def advance(row: int) -> None:
            i = stepped[row]
            self._advance(i, ctrl[i], held, paths[row], path)
            self._read(i, out, i)

        self._threads.for_each(range(len(stepped)), advance)
        if path is not None:
            path.key_qpos[stepped] = paths
        self._read_key_events(out, slice(None) if env_ids is None else env_ids, paths)
        self._set_state(out)

    def _ids(self, env_ids: Sequence[int] | None) -> Sequence[int]:
        return range(self.num_envs) if env_ids is None else env_ids

    def _advance(
        self,
        i: int,
        ctrl: Array,
        held: HeldControls | None,
        key_path: Array,
        path: Path | None = None,
    ) -> None:
        """Take a step of simulation `i`, and write the paths of its keys and hands.

        `key_path` (S + 1, K) receives the angles of keys before the step and after each physics
        step [rad], `path` the hands' joints and touch.
        """
        # Ends on mj_step1, so that all derived quantities belong to the new state. This order also
        # reproduces the published recordings, which were made by the same engine.
        model, data, keys = self._models[i], self._data[i], self.scene.key_qpos
        key_qpos = data.qpos[keys]  # a view, which moves with the simulation
        late = 0 if held is None else int(held.substeps[i])
        data.ctrl = held.ctrl[i] if held and late else ctrl
        key_path[0] = key_qpos
        self._note(i, path, 0)
        mujoco.mj_step2(model, data)
        key_path[1] = key_qpos
        self._note(i, path, 1)
        for substep in range(1, self.num_substeps):
            if substep == late:
                data.ctrl = ctrl
            mujoco.mj_step(model, data)
            key_path[substep + 1] = key_qpos
            self._note(i, path, substep + 1)
        mujoco.mj_step1(model, data)

    def _note(self, i: int, path: Path | None, at: int) -> None:
        """Write the joints and the touch of the hands of simulation `i` to a path, if given."""
        if path is not None:
            data, scene = self._data[i], self.scene
            path.hand_qpos[i, at] = data.qpos[scene.hand_qpos]
            path.hand_qvel[i, at] = data.qvel[scene.hand_qvel]
            if scene.config.touch:
                path.touch[i, at, scene.present_fingers] = data.sensordata

    def _read(self, i: int, out: State, row: int | tuple[int, int]) -> None:
        """Copy the state of simulation `i` into `out` at `row`."""
        data, scene = self._data[i], self.scene
        qpos, qvel = data.qpos, data.qvel
        out.key_qpos[row] = qpos[scene.key_qpos]
        out.key_xpos[row] = data.geom_xpos[scene.key_geoms]
        out.hand_qpos[row] = qpos[scene.hand_qpos]
        out.hand_qvel[row] = qvel[scene.hand_qvel]
        out.fingertip_xpos[row][scene.present_fingers] = data.site_xpos[scene.fingertip_sites]
        out.actuator_force[row] = data.actuator_force
        out.actuator_velocity[row] = data.actuator_velocity
        if self._watch_forearms:
            touched = scene.forearm_geoms[:, data.contact.geom].any(axis=2)  # (2, contacts)
            out.forearm_contact[row] = touched.all(axis=0).any()
        if scene.config.touch:
            out.touch[row][scene.present_fingers] = data.sensordata
        out.unstable[row] = data.warning.number[UNSTABLE].any()

    def _read_key_events(self, out: State, rows: Any, key_paths: Array) -> None:
        """Write the events of keys on their paths (..., S + 1, K) into rows of `out`."""
        substep, sounds_from = self._substep, self.scene.keyboard.sounds_from
        events = last_key_events(key_paths, sounds_from, substep)
        for values, new in zip(out.key_events, events, strict=True):
            values[rows] = new
        for i, depth in self._sounding_depth.items():
            if isinstance(rows, slice) or i in rows:
                path = key_paths[i if isinstance(rows, slice) else list(rows).index(i)]
                events = last_key_events(path, sounds_from * depth, substep)
                for values, new in zip(out.key_events, events, strict=True):
                    values[i] = new

    def _set_state(self, state: State) -> None:
        """Take the state after a step, and log which simulations have become unstable."""
        if state.unstable.any():
            for i in (state.unstable & ~self.state.unstable).nonzero()[0]:
                _LOG.warning("simulation %d became unstable", i)
        self.state = state

    def copy_to(self, data: Sequence[mujoco.MjData], env_id: int) -> None:
        """Put all of `data`, of the nominal model, into the physical state of `env_id`."""
        for each in data:
            if self._models[env_id] is self.scene.model:
                mujoco.mj_copyData(each, self.scene.model, self._data[env_id])
            else:  # derived quantities by the nominal model
                mujoco.mj_resetData(self.scene.model, each)
                state = self.physics_state(env_id)
                mujoco.mj_setState(self.scene.model, each, state, PHYSICS_STATE)
                mujoco.mj_step1(self.scene.model, each)

    def physics_state(self, env_id: int) -> Array:
        """(S,) the full state of simulation `env_id`, except for which keys sleep."""
        model = self.scene.model
        state = np.empty(mujoco.mj_stateSize(model, PHYSICS_STATE))
        mujoco.mj_getState(model, self._data[env_id], state, PHYSICS_STATE)
        return state

    def save(self, env_id: int) -> Any:
        """The full state of a simulation, for `restore` to the bit, and for pickles."""
        data = copy(self._data[env_id])
        awake = [getattr(data, name) for name in _AWAKE]
        return data, awake, self._factors.get(env_id), [v[env_id].copy() for v in self.state]

    def restore(self, env_id: int, saved: Any) -> None:
        """Put a simulation where `save` found this one, or another of the same scene."""
        data, awake, factors, state = saved
        for name, count in zip(_AWAKE, awake, strict=True):
            setattr(data, name, count)
        if factors is not None:  # models are scaled anew
            self.randomize(env_id, factors)
        mujoco.mj_copyData(self._data[env_id], self._models[env_id], data)
        self.state = self.state.with_row(env_id, state)

    def close(self) -> None:
        """Stop the threads."""
        self._threads.close()

    def __getstate__(self) -> dict[str, Any]:
        saved = [self.save(i) for i in range(self.num_envs)]
        return {**vars(self), "_data": None, "_models": None, "_factors": {}, "_saved": saved}

    def __setstate__(self, state: dict[str, Any]) -> None:
        saved = state.pop("_saved")
        vars(self).update(state)
        self._data = [mujoco.MjData(self.scene.model) for _ in saved]
        self._models = [self.scene.model] * self.num_envs
        for env_id, each in enumerate(saved):
            self.restore(env_id, each)


def physics_steps(control_timestep: float, physics_timestep: float) -> int:
    """The number of physics steps in a control step, see `steps_of`."""
    return steps_of(control_timestep, physics_timestep, "control_timestep", "the physics step")


def steps_of(duration: float, part: float, name: str, part_name: str) -> int:
    """The number of steps of length `part` in a time [s]; raises CadenzaError if not whole."""
    steps = round(duration / part)
    if steps < 1 or abs(steps * part - duration) > 1e-9:
        raise CadenzaError(f"{name} {duration} s is not a multiple of {part_name} {part} s")
    return steps
