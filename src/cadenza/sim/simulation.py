"""A batch of N independent simulations of one scene, stepped by a pool of threads."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.configs import whole_number
from cadenza.errors import CadenzaError
from cadenza.scene.piano import NUM_KEYS
from cadenza.scene.scene import Scene
from cadenza.sim.lock import Lock, one_at_a_time

Array = NDArray[np.float64]

PHYSICS_STATE = mujoco.mjtState.mjSTATE_INTEGRATION

MOST_ENVS = 10_000
"""Each takes about a megabyte."""
_MOST_THREADS = 1024
_LOG = logging.getLogger(__name__)
# Bad positions, velocities, accelerations and controls are neighbours among MuJoCo's warnings.
_UNSTABLE = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADCTRL) + 1)

# MuJoCo would otherwise print to the terminal and leave MUJOCO_LOG.TXT wherever it runs.
mujoco.set_mju_user_warning(lambda message: _LOG.info("MuJoCo: %s", message))


class State(NamedTuple):
    """What the task may know about N simulations after a step.

    Positions, velocities and contacts belong to the new state; actuator forces to the last physics
    step that led there, as in the published system. J hand joints, A actuators.
    """

    key_qpos: Array
    """(N, 88) joint angles of the keys [rad], softly limited to 0..travel."""
    key_xpos: Array
    """(N, 88, 3) centres of the keys' boxes in the world [m]."""
    hand_qpos: Array
    """(N, J) joint positions of the hands [m, rad]."""
    hand_qvel: Array
    """(N, J) their velocities [m/s, rad/s]."""
    fingertip_xpos: Array
    """(N, 10, 3) fingertips in the world [m]; zero for a hand that is not there."""
    actuator_force: Array
    """(N, A) [N, N m]."""
    actuator_velocity: Array
    """(N, A) [m/s, rad/s]."""
    forearm_contact: NDArray[np.bool_]
    """(N,) whether the two forearms touch; always False unless it was asked for."""
    unstable: NDArray[np.bool_]
    """(N,) whether the simulation has diverged since its last reset and is of no more use."""


class Simulation:
    """N simulations, each with its own `MjData`.

    Every simulation is stepped by one thread at a time and shares nothing with the others, so the
    results are the same bits for any number of threads. Threads that call its methods wait for each
    other.

    Attributes:
        state: the state after the last step; its arrays are never written to again.
        num_unstable: how many simulations have become unstable so far.
    """

    def __init__(
        self,
        scene: Scene,
        num_envs: int = 1,
        control_timestep: float = 0.05,
        num_threads: int = 1,
        watch_forearms: bool = False,
    ) -> None:
        """Args:
            scene: what to simulate.
            num_envs: N.
            control_timestep: time that a step takes [s], a multiple of the physics step.
            num_threads: how many threads share the work.
            watch_forearms: whether `State.forearm_contact` is wanted.

        Raises:
            CadenzaError: a number is not positive or the timesteps do not divide.
        """
        self.scene = scene
        self.num_envs = whole_number(num_envs, "num_envs", 1, MOST_ENVS)
        self.control_timestep = control_timestep
        self.num_substeps = _divide(control_timestep, scene.model.opt.timestep)
        self.num_unstable = 0
        self._lock = Lock()
        self._data = [mujoco.MjData(scene.model) for _ in range(num_envs)]
        self._pool: ThreadPoolExecutor | None = None  # started when it is first needed
        self._pool_of = os.getpid()  # a forked child has none of its threads
        self._num_threads = whole_number(num_threads, "num_threads", 1, _MOST_THREADS)
        self._watch_forearms = watch_forearms and len(scene.sides) == 2
        self._is_forearm = np.zeros((2, scene.model.ngeom), bool)
        for row, geoms in zip(self._is_forearm, scene.forearm_geoms.values(), strict=False):
            row[geoms] = True
        self._counted = np.zeros(num_envs, bool)  # as unstable, since the last reset
        self.state = self._blank(num_envs)
        self.reset()

    def _blank(self, *rows: int) -> State:
        """A state of zeros with leading dimensions `rows`."""
        joints, actuators = len(self.scene.hand_joint_names), self.scene.model.nu
        return State(
            key_qpos=np.zeros((*rows, NUM_KEYS)),
            key_xpos=np.zeros((*rows, NUM_KEYS, 3)),
            hand_qpos=np.zeros((*rows, joints)),
            hand_qvel=np.zeros((*rows, joints)),
            fingertip_xpos=np.zeros((*rows, 10, 3)),
            actuator_force=np.zeros((*rows, actuators)),
            actuator_velocity=np.zeros((*rows, actuators)),
            forearm_contact=np.zeros(rows, bool),
            unstable=np.zeros(rows, bool),
        )

    def _copy(self) -> State:
        return State._make(values.copy() for values in self.state)

    @one_at_a_time
    def reset(self, env_ids: Sequence[int] | None = None, hand_qpos: Array | None = None) -> None:
        """Puts simulations back to the start.

        Args:
            env_ids: which; all by default.
            hand_qpos: (len(env_ids), J) joint positions to start from; zero by default.
        """
        ids = range(self.num_envs) if env_ids is None else env_ids
        self.state = self._copy()
        for row, i in enumerate(ids):
            data = self._data[i]
            mujoco.mj_resetData(self.scene.model, data)
            if hand_qpos is not None:
                data.qpos[self.scene.hand_qpos] = hand_qpos[row]
            mujoco.mj_step1(self.scene.model, data)
            self._counted[i] = False
            self._read(i, self.state, i)

    @one_at_a_time
    def step(self, ctrl: Array, env_ids: Sequence[int] | None = None) -> None:
        """Applies `ctrl` (N, A) in actuator units for one control step.

        Args:
            ctrl: one row for every simulation, also for those not stepped.
            env_ids: which simulations to step; all by default.
        """

        out = self._blank(self.num_envs) if env_ids is None else self._copy()

        def advance(i: int) -> None:
            self._advance(i, ctrl[i])
            self._read(i, out, i)

        self._for_each(range(self.num_envs) if env_ids is None else env_ids, advance)
        self._count_unstable(out.unstable)
        self.state = out

    @one_at_a_time
    def rollout(self, ctrl: Array) -> State:
        """Takes K control steps in every simulation and returns all states on the way.

        The same as K times `step`, but no simulation waits for another in between.

        Args:
            ctrl: (N, K, A) in actuator units.

        Returns:
            A state whose arrays have leading dimensions (N, K) instead of (N,).
        """
        states = self._blank(*ctrl.shape[:2])

        def advance(i: int) -> None:
            for k in range(ctrl.shape[1]):
                self._advance(i, ctrl[i, k])
                self._read(i, states, (i, k))

        self._for_each(range(self.num_envs), advance)
        self.state = State._make(values[:, -1] for values in states)
        self._count_unstable(self.state.unstable)
        return states

    def _for_each(self, env_ids: Sequence[int], advance: Callable[[int], None]) -> None:
        workers = min(self._num_threads, len(env_ids))
        if workers <= 1:
            for i in env_ids:
                advance(i)
            return
        if self._pool is None or self._pool_of != os.getpid():
            self._pool, self._pool_of = ThreadPoolExecutor(self._num_threads), os.getpid()
        shared = iter(list(env_ids))  # each thread takes the next simulation that nobody has taken

        def work() -> None:
            for i in shared:
                advance(i)

        for future in [self._pool.submit(work) for _ in range(workers)]:
            future.result()

    def _advance(self, i: int, ctrl: Array) -> None:
        # Ends on mj_step1, so that what is read afterwards belongs to the new state. This order
        # also reproduces the published recordings, which were made by the same engine.
        model, data = self.scene.model, self._data[i]
        data.ctrl = ctrl
        mujoco.mj_step2(model, data)
        if self.num_substeps > 1:
            mujoco.mj_step(model, data, self.num_substeps - 1)
        mujoco.mj_step1(model, data)

    def _read(self, i: int, out: State, row: int | tuple[int, int]) -> None:
        """Copies the state of simulation `i` into `out` at `row`."""
        data, scene = self._data[i], self.scene
        qpos, qvel = data.qpos, data.qvel
        out.key_qpos[row] = qpos[scene.key_qpos]
        out.key_xpos[row] = data.geom_xpos[scene.key_geoms]
        out.hand_qpos[row] = qpos[scene.hand_qpos]
        out.hand_qvel[row] = qvel[scene.hand_qvel]
        out.fingertip_xpos[row][scene.fingers] = data.site_xpos[scene.fingertip_sites]
        out.actuator_force[row] = data.actuator_force
        out.actuator_velocity[row] = data.actuator_velocity
        if self._watch_forearms:
            touched = self._is_forearm[:, data.contact.geom].any(axis=2)  # (2, contacts)
            out.forearm_contact[row] = touched.all(axis=0).any()
        out.unstable[row] = data.warning.number[_UNSTABLE].any()

    def _count_unstable(self, unstable: NDArray[np.bool_]) -> None:
        for i in np.flatnonzero(unstable & ~self._counted):
            self._counted[i] = True
            self.num_unstable += 1
            _LOG.warning("simulation %d became unstable", i)

    @one_at_a_time
    def copy_from(self, other: Simulation, env_id: int) -> None:
        """Puts every simulation of this batch into the physical state of `other`'s `env_id`."""
        self.state = self._blank(self.num_envs)
        with other._lock:
            for i, data in enumerate(self._data):
                mujoco.mj_copyData(data, self.scene.model, other._data[env_id])
                self._counted[i] = other._counted[env_id]
                self._read(i, self.state, i)

    @one_at_a_time
    def place(self, hand_qpos: Array, hand_qvel: Array, key_qpos: Array) -> None:
        """Puts the joints of every simulation of this batch here, with the keys at rest.

        Args:
            hand_qpos: (J,) [m, rad].
            hand_qvel: (J,) [m/s, rad/s].
            key_qpos: (88,) [rad].
        """
        self.state = self._blank(self.num_envs)
        for i, data in enumerate(self._data):
            mujoco.mj_resetData(self.scene.model, data)
            data.qpos[self.scene.hand_qpos] = hand_qpos
            data.qvel[self.scene.hand_qvel] = hand_qvel
            data.qpos[self.scene.key_qpos] = key_qpos
            mujoco.mj_step1(self.scene.model, data)
            self._counted[i] = False
            self._read(i, self.state, i)

    @one_at_a_time
    def displace(self, hand_qpos: Array, hand_qvel: Array) -> None:
        """Moves the hands of each simulation and leaves the keys as they are.

        Args:
            hand_qpos: (N, J) to add to their positions [m, rad].
            hand_qvel: (N, J) to add to their speeds [m/s, rad/s].
        """
        self.state = self._blank(self.num_envs)
        for i, data in enumerate(self._data):
            data.qpos[self.scene.hand_qpos] += hand_qpos[i]
            data.qvel[self.scene.hand_qvel] += hand_qvel[i]
            mujoco.mj_step1(self.scene.model, data)
            self._read(i, self.state, i)

    @one_at_a_time
    def physics_state(self, env_id: int) -> Array:
        """(S,) what decides how simulation `env_id` goes on, except which keys sleep."""
        model = self.scene.model
        state = np.empty(mujoco.mj_stateSize(model, PHYSICS_STATE))
        mujoco.mj_getState(model, self._data[env_id], state, PHYSICS_STATE)
        return state

    @one_at_a_time
    def set_physics_state(self, state: Array) -> None:
        """Puts every simulation of this batch into a state (S,) that `physics_state` returned.

        That state may be of another scene, which differs from this one in sleeping keys only.
        """
        self.state = self._blank(self.num_envs)
        for i, data in enumerate(self._data):
            mujoco.mj_resetData(self.scene.model, data)
            mujoco.mj_setState(self.scene.model, data, state, PHYSICS_STATE)
            mujoco.mj_step1(self.scene.model, data)
            self._counted[i] = False
            self._read(i, self.state, i)

    @one_at_a_time
    def coordinates(self) -> Array:
        """(N, 2 V) positions and velocities of all V joints, keys and hands, in MuJoCo's order."""
        return np.array([np.concatenate([data.qpos, data.qvel]) for data in self._data])

    @one_at_a_time
    def close(self) -> None:
        """Stops the threads."""
        if self._pool is not None and self._pool_of == os.getpid():
            self._pool.shutdown()
        self._pool = None

    @one_at_a_time
    def __getstate__(self) -> dict[str, Any]:
        # Threads cannot be copied, nor what another thread is stepping once this has returned.
        return {**self.__dict__, "_pool": None, "_data": [copy(data) for data in self._data]}


def _divide(control_timestep: float, physics_timestep: float) -> int:
    substeps = round(control_timestep / physics_timestep)
    if substeps < 1 or abs(substeps * physics_timestep - control_timestep) > 1e-9:
        raise CadenzaError(
            f"control_timestep {control_timestep} s is not a multiple of the physics step "
            f"{physics_timestep} s"
        )
    return substeps


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
