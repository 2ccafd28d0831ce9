"""N simulations on a GPU, by MuJoCo Warp; on the CPU too, slowly, for tests.

`WarpPhysics` is a pair of pure functions of JAX's arrays, for `jax.jit`. `WarpSimulation` has the
interface of `protocol.Simulation`, and arrays of NumPy.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from inspect import Parameter, Signature
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.configs import whole_number
from cadenza.errors import extra_packages, quoted
from cadenza.scene.randomization import KEY_SOUNDING, Factors, affected_fields, scaled_fields
from cadenza.scene.scene import Scene
from cadenza.sim.key_crossings import dense_key_events
from cadenza.sim.mujoco_simulation import MujocoSimulation, physics_steps
from cadenza.sim.protocol import HeldControls, Path, State

with extra_packages("gpu", "the engine warp"):
    import jax
    import jax.numpy as jnp
    import warp as wp

    from cadenza.sim.rows import rows_of, where

    wp.config.log_level = wp.LOG_WARNING  # or the next import greets on standard output
    import mujoco_warp as mjw

_LOG = logging.getLogger(__name__)

MAX_WORLDS = 65_536
_LOST = mjw.OverflowType.ALL & ~(mjw.OverflowType.ITERATIONS | mjw.OverflowType.LS_ITERATIONS)
"""Overflows by which contacts or constraints are left out."""
_DIVERGED = 1e10
"""The position or velocity from which on MuJoCo takes a simulation for diverged (mjMAXVAL)."""
_CONTACTS = "contact_geoms", "contact_worlds", "num_contacts"


@dataclass(frozen=True)
class Buffers:
    """How many contacts and constraints a world has room for.

    Replays of two performances, and random actions of four worlds, have needed no more.
    """

    contacts: int = 64
    """Contacts, on average over all worlds."""
    rows: int = 352
    """Rows of constraints in any world: joints with dry friction, limits, and four a contact."""
    convex: int = 16
    """Pairs of geoms, on average over all worlds, which only the general algorithm for convex
    bodies can collide."""


class Physics(NamedTuple):
    """The full physical state of N worlds."""

    qpos: Any  # (N, nq) positions of all joints [m, rad]
    qvel: Any  # (N, nv) their velocities [m/s, rad/s]
    warmstart: Any  # (N, nv) accelerations from which the solver starts [m/s^2, rad/s^2]
    unstable: Any  # (N,) bool, whether a world has diverged, or lost contacts, since it was reset
    # (N,) int32, buffers that had no room for contacts since the reset, as bits of
    # `mujoco_warp.OverflowType`
    overflow: Any
    # The path through the last step, a `Path` without the state before it; None if it is not kept
    path: Any = None


class WarpPhysics:
    """The physics of N worlds of a scene, as pure functions that `jax.jit` compiles.

    Keys never sleep here, as on a GPU a world at rest costs the same as any other. They
    differ from keys of `MujocoSimulation`, which sleep, by up to 1e-4 rad.

    A world that has diverged, or for whose contacts there was no room, is unstable, and rests in
    its start until it is reset, so that it does not take room from others.
    """

    def __init__(
        self,
        scene: Scene,
        num_envs: int,
        control_timestep: float = 0.05,
        watch_forearms: bool = False,
        buffers: Buffers | None = None,
        scaled: Collection[str] = (),
        pushed: bool = False,
        keeps_path: bool = False,
    ) -> None:
        """Allocate N worlds on JAX's device. The first step compiles for up to a minute or two.

        Args:
            scene: the scene.
            num_envs: N.
            control_timestep: time of a control step [s].
            watch_forearms: whether states have `State.forearm_contact`.
            buffers: room for contacts.
            scaled: each world has the quantities of these names scaled by factors of its own, see
                `cadenza.scene.randomization.shapes`.
            pushed: whether bodies are pushed.
            keeps_path: whether states have the path through the last step.

        Raises CadenzaError if a number makes no sense.
        """
        self.scene = scene
        self.num_envs = whole_number(num_envs, "num_envs", 1, MAX_WORLDS)
        self.num_substeps = physics_steps(control_timestep, scene.model.opt.timestep)
        self._substep = control_timestep / self.num_substeps
        self._buffers = buffers or Buffers()
        self._watch_forearms = watch_forearms and len(scene.sides) == 2
        self._velocities = _servo_velocities(scene.model)
        self._on_gpu = jax.default_backend() == "gpu"
        self._fields = affected_fields(scaled)
        self._pushed, self._keeps_path = pushed, keeps_path
        self._simulate = self._make_simulate()

    def start(self, hand_qpos: Any) -> Physics:
        """The state of worlds at rest, with hands (N, J) [m, rad] and with all keys up."""
        nv = self.scene.model.nv
        rest = jnp.asarray(self.scene.model.qpos0, jnp.float32)
        qpos = jnp.tile(rest, (self.num_envs, 1)).at[:, self.scene.hand_qpos].set(hand_qpos)
        still = jnp.zeros((self.num_envs, nv), jnp.float32)
        none = jnp.zeros(self.num_envs, jnp.int32)
        at_rest = Physics(qpos, still, still, jnp.zeros(self.num_envs, bool), none)
        if not self._keeps_path:
            return at_rest
        sensors = jnp.zeros((self.num_envs, self.scene.model.nsensordata), jnp.float32)
        throughout = (jnp.repeat(v[:, None], self.num_substeps, 1) for v in (qpos, still, sensors))
        return at_rest._replace(path=self._path(*throughout))

    def _path(self, qpos: Any, qvel: Any, sensors: Any) -> Path:
        """The path of hands and keys in worlds (N, S, ...) after each of S physics steps."""
        hands = qpos[..., self.scene.hand_qpos], qvel[..., self.scene.hand_qvel]
        return Path(*hands, qpos[..., self.scene.key_qpos], self._touch(sensors))

    def _touch(self, sensors: Any) -> Any:
        """(..., F) normal forces on the fingertips by the model's sensors, if it has some [N]."""
        touch: Any = jnp.zeros((*sensors.shape[:-1], self.scene.fingers.count))
        if not self.scene.config.touch:
            return touch
        return touch.at[..., self.scene.present_fingers].set(sensors)

    def step(
        self,
        physics: Physics,
        ctrl: Any,
        held: HeldControls | None = None,
        models: Mapping[str, Any] | None = None,
        force: Any = None,
        depth: Any = 1.0,
    ) -> tuple[Physics, State]:
        """The worlds after a control step with controls (N, A), in actuator units.

        Args:
            physics: the worlds before the step.
            ctrl: the controls.
            held: the controls until these arrive, if they are late.
            models: name of a field of `mujoco.MjModel` -> (N, ...), its values in each world; all
                of `affected_fields(scaled)`.
            force: (N, bodies, 3) forces that push bodies throughout the step, if any may [N].
            depth: (N, K) the part of the nominal way after which each key sounds.
        """
        ctrl = jnp.asarray(ctrl, jnp.float32)
        path: Any = jnp.broadcast_to(ctrl, (self.num_substeps, *ctrl.shape))
        if held is not None:
            before = jnp.asarray(held.ctrl, jnp.float32)
            late = jnp.arange(self.num_substeps)[:, None] < held.substeps
            path = jnp.where(late[..., None], before, path)
        inputs = [jnp.asarray((models or {})[name], jnp.float32) for name in self._fields]
        if self._pushed:
            num_bodies = self.scene.model.nbody
            pushes: Any = jnp.zeros((self.num_envs, num_bodies, 3)) if force is None else force
            inputs.append(jnp.pad(pushes, ((0, 0), (0, 0), (0, 3))).astype(jnp.float32))
        begin = physics.qpos, physics.qvel, physics.warmstart
        result = dict(zip(self._outputs, self._simulate(*begin, path, *inputs), strict=True))
        qpos, qvel = result["qpos"], result["qvel"]
        overflow = physics.overflow | (result["overflow"] & int(_LOST))
        sound = (abs(qpos) < _DIVERGED).all(-1) & (abs(qvel) < _DIVERGED).all(-1)
        sound &= jnp.isfinite(path).all((0, -1))
        unstable = physics.unstable | ~sound | (overflow != 0)
        rest = self.start(jnp.asarray(self.scene.hand_start, jnp.float32))
        reached = Physics(qpos, qvel, result["warmstart"], unstable, overflow)
        if self._keeps_path:
            ways = result["qpos_path"], result["qvel_path"]
            sensors = result.get("sensor_path", ways[0][..., :0])  # of a model without any
            reached = reached._replace(path=self._path(*ways, sensors))
        kept = where(unstable, rest, reached)._replace(unstable=unstable, overflow=overflow)
        keys = self.scene.key_qpos
        key_path: Any = jnp.concatenate([physics.qpos[:, None, keys], result["key_path"]], axis=1)
        sounds_from = (self.scene.keyboard.sounds_from * jnp.asarray(depth))[..., None, :]
        onset, offset, speed = dense_key_events(key_path, sounds_from, self._substep)
        num_fingers, there = self.scene.fingers.count, self.scene.present_fingers
        tips: Any = jnp.zeros((self.num_envs, num_fingers, 3))
        state = State(
            key_qpos=kept.qpos[:, keys],
            key_xpos=result["geoms"][:, self.scene.key_geoms],
            key_onset=onset,
            key_offset=offset,
            key_speed=speed,
            hand_qpos=kept.qpos[:, self.scene.hand_qpos],
            hand_qvel=kept.qvel[:, self.scene.hand_qvel],
            fingertip_xpos=tips.at[:, there].set(result["sites"][:, self.scene.fingertip_sites]),
            actuator_force=result["force"],
            actuator_velocity=kept.qvel @ self._velocities,
            forearm_contact=self._forearms_touch(*(result[n] for n in _CONTACTS if n in result)),
            touch=self._touch(result["sensors"]),
            unstable=unstable,
        )
        numbers: dict[str, Any] = {
            name: jnp.where(rows_of(unstable, values), 0.0, values)
            for name, values in state._asdict().items()
            if name in ("key_xpos", "fingertip_xpos", "actuator_force", "touch")
        }
        return kept, state._replace(**numbers)

    def _forearms_touch(self, geom: Any = None, world: Any = None, count: Any = None) -> Any:
        """(N,) whether contacts (C, 2) of geoms in worlds (C,), the first `count`, are theirs."""
        nowhere = jnp.zeros(self.num_envs, bool)
        if geom is None:
            return nowhere
        touched = jnp.asarray(self.scene.forearm_geoms)[:, geom].any(-1)  # (2, C)
        both = touched.all(0) & (jnp.arange(len(geom)) < count)
        return nowhere.at[world].max(both)

    def _make_simulate(self) -> Any:
        """The function from states and controls to simulated arrays, which JAX can call."""
        num_envs, model = self.num_envs, _awake(self.scene.model)
        keys, num_substeps = self.scene.key_qpos, self.num_substeps
        watched, buffers = self._watch_forearms, self._buffers
        device = wp.get_device("cuda:0" if self._on_gpu else "cpu")
        with wp.ScopedDevice(device):
            m = mjw.put_model(model)
            m.opt.warn_overflow = 0  # it is in `Physics.overflow`
            d = mjw.make_data(
                model,
                nworld=num_envs,
                nconmax=buffers.contacts,
                njmax=buffers.rows,
                nccdmax=buffers.convex,
            )

        num_inputs, pushed = len(self._fields) + self._pushed, self._pushed

        def simulate(qpos, qvel, warmstart, ctrl, *others):
            given, out = others[:num_inputs], dict(zip(shapes, others[num_inputs:], strict=True))
            for name, values in zip(self._fields, given, strict=False):
                setattr(m, name, values)
            if pushed:
                wp.copy(d.xfrc_applied, given[-1])
            wp.copy(d.qpos, qpos)
            wp.copy(d.qvel, qvel)
            wp.copy(d.qacc_warmstart, warmstart)
            d.overflow.zero_()
            paths = {"key_path": d.qpos[:, keys], "qpos_path": d.qpos, "qvel_path": d.qvel}
            paths |= {"sensor_path": d.sensordata}
            for substep in range(num_substeps):
                wp.copy(d.ctrl, ctrl[substep])
                mjw.step(m, d)
                for name in out.keys() & paths.keys():
                    wp.copy(out[name][:, substep], paths[name])
            # Positions belong to the new state, forces to the step that led there.
            mjw.kinematics(m, d)
            reached = {"qpos": d.qpos, "qvel": d.qvel, "warmstart": d.qacc_warmstart}
            reached |= {"overflow": d.overflow, "geoms": d.geom_xpos, "sites": d.site_xpos}
            reached |= {"force": d.actuator_force, "sensors": d.sensordata}
            if watched:
                mjw.collision(m, d)
                contacts = d.contact.geom, d.contact.worldid, d.nacon
                reached |= dict(zip(_CONTACTS, contacts, strict=True))
            for name, values in reached.items():
                wp.copy(out[name], values)

        states = "qpos", "qvel", "warmstart"
        kinds: dict[str, Any] = {f"{name}_before": wp.array2d(dtype=float) for name in states}
        kinds |= {"ctrl": wp.array3d(dtype=float)}
        kinds |= {name: wp.array2d(dtype=getattr(m, name).dtype) for name in self._fields}
        if pushed:
            kinds["push"] = wp.array2d(dtype=wp.spatial_vector)
        sizes = {"qpos": model.nq, "qvel": model.nv, "warmstart": model.nv}
        sizes |= {"force": model.nu, "sensors": model.nsensordata}
        shapes: dict[str, tuple[Any, tuple[int, ...]]] = {
            name: (wp.array2d(dtype=float), (num_envs, size)) for name, size in sizes.items()
        }
        shapes |= {
            "overflow": (wp.array(dtype=int), (num_envs,)),
            "geoms": (wp.array2d(dtype=wp.vec3), (num_envs, model.ngeom)),
            "sites": (wp.array2d(dtype=wp.vec3), (num_envs, model.nsite)),
        }
        path_sizes = {"key_path": keys.stop - keys.start}
        if self._keeps_path:
            path_sizes |= {"qpos_path": model.nq, "qvel_path": model.nv}
            path_sizes |= {"sensor_path": model.nsensordata} if model.nsensordata else {}
        for name, size in path_sizes.items():
            shapes[name] = wp.array3d(dtype=float), (num_envs, num_substeps, size)
        if watched:
            geoms, worlds, count = _CONTACTS
            shapes[geoms] = (wp.array(dtype=wp.vec2i), (d.naconmax,))
            shapes[worlds] = (wp.array(dtype=int), (d.naconmax,))
            shapes[count] = (wp.array(dtype=int), (1,))
        self._outputs = tuple(shapes)
        return _callable(simulate, kinds, shapes, self._on_gpu)


def _callable(
    simulate: Any,
    inputs: dict[str, Any],
    outputs: dict[str, tuple[Any, tuple[int, ...]]],
    on_gpu: bool,
) -> Any:
    """Let JAX call `simulate`, a function of arrays: inputs of these types, and outputs of these.

    Warp reads the number and the types of arguments off a function's signature.
    """
    kinds = inputs | {name: kind for name, (kind, _) in outputs.items()}

    def named(*arrays: Any) -> None:
        simulate(*arrays)

    named.__annotations__ = kinds
    kind_of_argument = Parameter.POSITIONAL_OR_KEYWORD
    named.__signature__ = Signature(  # type: ignore[attr-defined]
        [Parameter(name, kind_of_argument, annotation=kind) for name, kind in kinds.items()]
    )
    # Staged, because JAX may give other buffers in each call and a graph remembers addresses.
    mode = wp.JaxCallableGraphMode.WARP_STAGED if on_gpu else wp.JaxCallableGraphMode.NONE
    dims = {name: shape for name, (_, shape) in outputs.items()}
    return wp.jax_callable(named, num_outputs=len(outputs), graph_mode=mode, output_dims=dims)


def _awake(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of the model in which nothing sleeps."""
    awake = copy(model)
    awake.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    return awake


def _servo_velocities(model: mujoco.MjModel) -> NDArray[np.float32]:
    """(nv, A) the derivatives of the actuators' lengths by joints, which all are constant."""
    data, moment = mujoco.MjData(model), np.zeros((model.nu, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mju_sparse2dense(
        moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    return moment.T.astype(np.float32)


class WarpSimulation:
    """N simulations on JAX's device; implements `protocol.Simulation` with NumPy.

    Each step copies its state to the host; `WarpPhysics` stays on the device.

    Attributes:
        state: the state after the last step.
    """

    def __init__(
        self,
        scene: Scene,
        num_envs: int = 1,
        control_timestep: float = 0.05,
        num_threads: int = 1,
        watch_forearms: bool = False,
    ) -> None:
        """Take the arguments of `MujocoSimulation`, but for threads; or raise CadenzaError."""
        self.scene = scene
        self._make = partial(WarpPhysics, scene, num_envs, control_timestep, watch_forearms)
        self._use(self._make())
        self._at_start = MujocoSimulation(scene, 1, control_timestep, 1, watch_forearms)
        self._models: dict[str, NDArray[np.float32]] = {}
        self._others: dict[str, NDArray[np.float64]] = {}  # pushes, and depths of keys
        self._physics = self.physics.start(np.zeros(len(scene.hand_joint_names)))
        self.state = State.at_rest(scene, num_envs)
        self.reset(range(num_envs), np.zeros((num_envs, len(scene.hand_joint_names))))

    def _use(self, physics: WarpPhysics) -> None:
        self.physics, self._step = physics, jax.jit(physics.step)

    def _use_also(self, **options: Any) -> None:
        """Compile the physics anew, with more options of `WarpPhysics`."""
        self._make = partial(self._make, **options)
        self._use(self._make())
        path = self.physics.start(self.state.hand_qpos).path
        self._physics = self._physics._replace(path=path)

    def reset(self, env_ids: Sequence[int], hand_qpos: NDArray[np.float64]) -> None:
        start, chosen = np.array(self._physics.qpos[:, self.scene.hand_qpos]), list(env_ids)
        start[chosen] = hand_qpos
        mask = np.zeros(len(start), bool)
        mask[chosen] = True
        self._physics = where(mask, self.physics.start(start), self._physics)
        state = self.state.copy()
        for env, qpos in zip(chosen, hand_qpos, strict=True):
            self._at_start.reset([0], qpos[None])
            for values, start_values in zip(state, self._at_start.state, strict=True):
                values[env] = start_values[0]
        self.state = state

    def randomize(self, env_id: int, factors: Factors) -> None:
        model, num_envs = scaled_fields(self.scene, [factors]), self.physics.num_envs
        if model and not self._models:  # all are randomized before they are stepped
            self._use_also(scaled=factors)
            self._models = {name: v.repeat(num_envs, axis=0) for name, v in model.items()}
        for name, (values,) in model.items():
            self._models[name][env_id] = values
        if KEY_SOUNDING in factors:
            nominal = np.ones((num_envs, self.scene.keyboard.num_keys))
            self._others.setdefault("depth", nominal)[env_id] = factors[KEY_SOUNDING]

    def push(self, env_id: int, force: NDArray[np.float64]) -> None:
        if "force" not in self._others:
            self._use_also(pushed=True)
            self._others["force"] = np.zeros((self.physics.num_envs, *force.shape))
        self._others["force"][env_id] = force

    def step(
        self,
        ctrl: NDArray[np.float64],
        env_ids: Sequence[int] | None = None,
        held: HeldControls | None = None,
        path: Path | None = None,
    ) -> None:
        if path is not None and self._physics.path is None:
            self._use_also(keeps_path=True)
        physics, state = self._step(self._physics, ctrl, held, self._models, **self._others)
        if path is not None:
            before = Path.still(self.state, 1)
            for way, first, others in zip(path, before, physics.path, strict=True):
                way[:] = np.concatenate([first, others], axis=1)
        mask = np.ones(len(ctrl), bool)
        if env_ids is not None:
            mask[:] = False
            mask[list(env_ids)] = True
        self._physics = where(mask, physics, self._physics)
        new = State._make(
            np.where(rows_of(mask, after), np.asarray(after, before.dtype), before)
            for after, before in zip(state, self.state, strict=True)
        )
        for env in np.flatnonzero(new.unstable & ~self.state.unstable).tolist():
            lost = mjw.OverflowType(int(self._physics.overflow[env]))
            why = f": no room for contacts ({quoted(lost)}); give it more, see Buffers"
            _LOG.warning("simulation %d became unstable%s", env, why if lost else "")
        self.state = new

    def close(self) -> None:
        self._at_start.close()
