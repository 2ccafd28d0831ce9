"""Tries out controls of one hand, quickly: with the keys near it, and the links that touch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.scene.scene import Part, Scene, colliding_parts, reduced_model
from cadenza.sim.mujoco_simulation import UNSTABLE, MujocoSimulation

Array = NDArray[np.float64]

PLACES = 2
"""Trials that can be under way at once."""
_BESIDE = 0.05  # [m] of keys to each side of where fingertips should go
_MODELS = 16  # of about 2 MB that are kept: memory must not grow with the length of a song
_GRID = 6  # keys; a song needs few models where they begin and end at every sixth
_SOON_ASLEEP = -1  # of a tree that is awake and has been at rest for long enough


class HandRollouts:
    """Trials of one hand, all from the same state, each in one of `PLACES` places.

    Trials in different places may run in different threads. Arrays that tell where a trial has come
    to are valid until its next step.

    The hand moves as in the whole scene, to a few micrometres, unless it touches keys with more
    than the last two links of its fingers.

    Attributes:
        keys: which are there.
    """

    keys: slice

    def __init__(self, scene: Scene, control_timestep: float, whole: Scene | None = None) -> None:
        """Args:
        scene: with one hand.
        control_timestep: time that a step takes [s].
        whole: what is simulated, where trials begin; `scene` by default.
        """
        self._scene, self._simulated = scene, whole or scene
        self._substeps = round(control_timestep / scene.model.opt.timestep)
        self._parts = colliding_parts(scene)
        self._whole = mujoco.MjData(self._simulated.model)
        self._on_keys: dict[range, _HandOnKeys] = {}

    def begin_from(self, simulation: MujocoSimulation, low: float, high: float) -> None:
        """Trials begin in the state that the first simulation is in now.

        Args:
            simulation: of the whole scene.
            low: where fingertips go along the keyboard, at least [m].
            high: at most [m].
        """
        keys = self._keys_between(low - _BESIDE, high + _BESIDE)
        self.keys = slice(keys.start, keys.stop)
        hand = self._on_keys.pop(keys, None)
        hand = hand or _HandOnKeys(self._scene, keys, self._parts, self._simulated)
        self._hand = self._on_keys[keys] = hand
        if len(self._on_keys) > _MODELS:
            del self._on_keys[next(iter(self._on_keys))]  # the one not used for longest
        simulation.copy_to([self._whole], 0)
        self._hand.begin_from(self._whole)

    def run(self, ctrl: Iterable[Array], place: int = 0) -> Iterator[tuple[Array, Array]]:
        """Takes a control step with each row of `ctrl` (H, A), one trial.

        Rows may depend on where the hand has come to, see `hand_joints`.

        Yields:
            (K,) angles of `keys` [rad] and (F, 3) fingertips [m].
        """
        hand = self._hand
        model, data, start = hand.model, hand.data[place], hand.start
        mujoco.mj_copyData(data, model, start)
        for row in ctrl:
            data.ctrl = row
            mujoco.mj_step(model, data, self._substeps)
            mujoco.mj_kinematics(model, data)
            yield data.qpos[hand.keys], data.site_xpos[hand.fingertips]

    def hand_joints(self, place: int = 0) -> tuple[Array, Array]:
        """(J,) positions and velocities of the hand's joints in the trial there."""
        data, first = self._hand.data[place], self._hand.keys.stop
        return data.qpos[first:], data.qvel[first:]

    def key_qpos(self, place: int = 0) -> Array:
        """(K,) angles of `keys` in the trial there [rad]."""
        hand = self._hand
        return hand.data[place].qpos[hand.keys]

    def key_qvel(self, place: int = 0) -> Array:
        """(K,) velocities of `keys` in the trial there [rad/s]."""
        hand = self._hand
        return hand.data[place].qvel[hand.keys]

    def fingertips(self, place: int = 0) -> Array:
        """(F, 3) those in the trial there [m]."""
        hand = self._hand
        return hand.data[place].site_xpos[hand.fingertips]

    def fingertip_motion(self, hand_qpos: Array) -> Array:
        """(N, F, 3, J) how fingertips move with the hand's joints, in positions (N, J) of these."""
        hand = self._hand
        model, data, first = hand.model, hand.posed, hand.keys.stop
        motion = np.zeros((len(hand_qpos), len(hand.fingertips), 3, model.nv))
        for qpos, columns in zip(hand_qpos, motion, strict=True):
            data.qpos[first:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for column, site in zip(columns, hand.fingertips, strict=True):
                mujoco.mj_jacSite(model, data, column, None, site)
        return motion[..., first:]

    def unstable(self, place: int = 0) -> bool:
        """Whether the last trial there has diverged."""
        return bool(self._hand.data[place].warning.number[UNSTABLE].any())

    def _keys_between(self, low: float, high: float) -> range:
        y = self._scene.keyboard.centre[:, 1]
        first, last = np.searchsorted(y, [low, high])
        first = min(first // _GRID, (len(y) - 1) // _GRID) * _GRID
        return range(int(first), min(int(max(-(-last // _GRID) * _GRID, first + 1)), len(y)))


class _HandOnKeys:
    """A hand on some of the keys of a scene.

    Attributes:
        model: see `reduced_model`.
        start: the state that trials begin in.
        data: the states that trials are in, one for each place.
        posed: a state of which only the posture counts.
        keys: where the keys are in qpos.
        fingertips: the sites of the fingertips.
    """

    def __init__(self, scene: Scene, keys: range, parts: set[Part], whole: Scene) -> None:
        self.model = reduced_model(scene, keys, parts)
        self.start = mujoco.MjData(self.model)
        self.data = [mujoco.MjData(self.model) for _ in range(PLACES)]
        self.posed = mujoco.MjData(self.model)
        joints = [whole.model.joint(self.model.joint(j).name) for j in range(self.model.njnt)]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self.keys = slice(0, len(keys))
        sites = [scene.model.site(site).name for site in scene.fingertip_sites]
        self.fingertips = [self.model.site(name).id for name in sites]

    def begin_from(self, whole: mujoco.MjData) -> None:
        """The state of this hand is that of the `whole` scene."""
        start = self.start
        mujoco.mj_resetData(self.model, start)
        start.qpos, start.qvel = whole.qpos[self._qpos], whole.qvel[self._dofs]
        start.qacc_warmstart = whole.qacc_warmstart[self._dofs]
        asleep = whole.tree_asleep[whole.model.dof_treeid[self._dofs]]
        start.tree_asleep[self.model.dof_treeid] = np.where(asleep >= 0, _SOON_ASLEEP, asleep)
        mujoco.mj_kinematics(self.model, start)  # where fingertips are
