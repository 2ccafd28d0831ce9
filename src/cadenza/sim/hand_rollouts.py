"""Fast rollouts of one hand, with only the keys near it and the links that touch them."""

from collections.abc import Iterable, Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.scene.scene import Part, Scene, colliding_parts, reduced_model
from cadenza.scene.servos import servos_of
from cadenza.sim.mujoco_simulation import UNSTABLE, MujocoSimulation

Array = NDArray[np.float64]

_MARGIN = 0.05  # [m] of keys to each side of where fingertips should go
_MAX_MODELS = 16  # cached models, 2 MB each; memory must not grow with the length of a song
_GRID = 6  # keys; models that begin and end at every sixth key are few in a song
_READY_TO_SLEEP = -1  # `tree_asleep` of a tree that is awake, and has been at rest long enough


class HandRollouts:
    """Rollouts of one hand, all from the same state, one after the other.

    Arrays that methods return are valid until the next step of a rollout.

    The hand moves as in the whole scene, to a few micrometres, unless it touches keys with more
    than the last two links of its fingers.

    Attributes:
        keys: the keys that are simulated.
    """

    keys: slice

    def __init__(
        self, scene: Scene, control_timestep: float, full_scene: Scene | None = None
    ) -> None:
        """Prepare rollouts of the hand of a scene, which begin after a call of `start_from`.

        They start in states of simulations of the `full_scene`, by default this one.
        """
        self._scene, self._full_scene = scene, full_scene or scene
        self._servos = servos_of(scene)
        self._substeps = round(control_timestep / scene.model.opt.timestep)
        self._parts = colliding_parts(scene)
        self._state = mujoco.MjData(self._full_scene.model)
        self._models: dict[range, _HandOnKeys] = {}

    def start_from(self, simulation: MujocoSimulation, low: float, high: float) -> None:
        """Let rollouts start in the present state of the first simulation of a whole scene.

        Fingertips stay between `low` and `high` y, along the keyboard [m].
        """
        keys = self._keys_between(low - _MARGIN, high + _MARGIN)
        self.keys = slice(keys.start, keys.stop)
        model = self._models.pop(keys, None)
        self._model = model or _HandOnKeys(
            self._scene, keys, self._parts, self._full_scene, self._substeps
        )
        self._models[keys] = self._model
        if len(self._models) > _MAX_MODELS:
            del self._models[next(iter(self._models))]  # the least recently used
        simulation.copy_to([self._state], 0)
        self._model.start_from(self._state)

    def run(
        self, ctrl: Iterable[Array], first: int = 0, snapshots: Sequence[int] = ()
    ) -> Iterator[tuple[Array, Array]]:
        """Simulate a rollout: one control step for each row of `ctrl` (H, A).

        Rows may depend on the state reached so far. The states before the steps `snapshots` are
        saved, and a later rollout with the same `snapshots` may begin at one of them, `first`.

        Yields:
            (S + 1, K) angles of `keys` before the step and after each of its S physics steps [rad],
            and (F, 3) fingertips after it [m].
        """
        hand = self._model
        model, data = hand.model, hand.data
        states = dict(zip(snapshots, hand.room_for(len(snapshots)), strict=True))
        mujoco.mj_copyData(data, model, states[first] if first else hand.start)
        for step, row in enumerate(ctrl, first):
            if step in states:
                mujoco.mj_copyData(states[step], model, data)
            data.ctrl = row
            mujoco.mj_step(model, data, self._substeps)
            mujoco.mj_kinematics(model, data)
            yield hand.key_path(data), data.site_xpos[hand.fingertips]

    def hand_joints(self) -> tuple[Array, Array]:
        """(J,) positions [m, rad] and velocities [m/s, rad/s] of the hand's joints."""
        data, first = self._model.data, self._model.keys.stop
        return data.qpos[first:], data.qvel[first:]

    def servo_state(self) -> Array:
        """(A, 2) positions [m, rad] and velocities [m/s, rad/s] of the servos."""
        return self._servos.of_joints.T @ np.stack(self.hand_joints(), axis=1)

    def key_qpos(self) -> Array:
        """(K,) angles of `keys` [rad]."""
        return self._model.data.qpos[self._model.keys]

    def key_qvel(self) -> Array:
        """(K,) velocities of `keys` [rad/s]."""
        return self._model.data.qvel[self._model.keys]

    def fingertips(self) -> Array:
        """(F, 3) fingertips [m]."""
        return self._model.data.site_xpos[self._model.fingertips]

    def unstable(self) -> bool:
        """Whether the rollout has diverged."""
        return bool(self._model.data.warning.number[UNSTABLE].any())

    def fingertip_jacobian(self, hand_qpos: Array) -> Array:
        """(N, F, 3, A) derivatives of fingertips by servos, at joint positions (N, J)."""
        hand = self._model
        model, data, first = hand.model, hand.posed, hand.keys.stop
        by_joints = np.zeros((len(hand_qpos), len(hand.fingertips), 3, model.nv))
        for qpos, jacobians in zip(hand_qpos, by_joints, strict=True):
            data.qpos[first:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for jacobian, site in zip(jacobians, hand.fingertips, strict=True):
                mujoco.mj_jacSite(model, data, jacobian, None, site)
        return by_joints[..., first:] @ self._servos.joints.T

    def _keys_between(self, low: float, high: float) -> range:
        """The keys whose middle is between `low` and `high` [m], extended to the grid."""
        y = self._scene.keyboard.centre[:, 1]
        first, last = np.searchsorted(y, [low, high])
        first = min(first // _GRID, (len(y) - 1) // _GRID) * _GRID
        return range(int(first), min(int(max(-(-last // _GRID) * _GRID, first + 1)), len(y)))


class _HandOnKeys:
    """The model of a hand on some of the keys of a scene, and its states.

    Attributes:
        model: see `reduced_model`.
        start: the state in which rollouts start.
        data: the state of the rollout.
        posed: a state for kinematics; only its posture is used.
        keys: the places of the keys in qpos.
        fingertips: the sites of the fingertips.
    """

    def __init__(
        self, scene: Scene, keys: range, parts: frozenset[Part], full_scene: Scene, substeps: int
    ) -> None:
        self.model = reduced_model(scene, keys, parts, substeps)
        self._substeps = substeps
        self.start = mujoco.MjData(self.model)
        self.data = mujoco.MjData(self.model)
        self.posed, self._room = mujoco.MjData(self.model), list[mujoco.MjData]()
        joints = [full_scene.model.joint(self.model.joint(j).name) for j in range(self.model.njnt)]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self.keys = slice(0, len(keys))
        self._size = len(keys) * (2 + 2 * substeps)  # of the histories of all keys
        sites = [scene.model.site(site).name for site in scene.fingertip_sites]
        self.fingertips = [self.model.site(name).id for name in sites]

    def start_from(self, data: mujoco.MjData) -> None:
        """Take over the state of the full scene, and which keys sleep."""
        start = self.start
        mujoco.mj_resetData(self.model, start)
        start.qpos, start.qvel = data.qpos[self._qpos], data.qvel[self._dofs]
        start.qacc_warmstart = data.qacc_warmstart[self._dofs]
        asleep = data.tree_asleep[data.model.dof_treeid[self._dofs]]
        start.tree_asleep[self.model.dof_treeid] = np.where(asleep >= 0, _READY_TO_SLEEP, asleep)
        mujoco.mj_kinematics(self.model, start)  # where fingertips are

    def room_for(self, count: int) -> list[mujoco.MjData]:
        """Room for `count` states, always the same: to make one takes as long as to simulate."""
        self._room += [mujoco.MjData(self.model) for _ in range(count - len(self._room))]
        return self._room[:count]

    def key_path(self, data: mujoco.MjData) -> Array:
        """(S + 1, K) the angles of the keys before and after each of the last S physics steps.

        MuJoCo keeps them, which is faster than to stop after each physics step.
        """
        # Of each key: two numbers, then times and angles before each step. A control step replaces
        # all of them, so that the oldest is always the first.
        kept = data.history[: self._size].reshape(self.keys.stop, -1)[:, -self._substeps :]
        return np.concatenate([kept.T, data.qpos[None, self.keys]])
