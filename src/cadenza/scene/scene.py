"""The whole scene: a compiled MuJoCo model and the indices that give its numbers a meaning."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.configs import as_config
from cadenza.errors import CadenzaError
from cadenza.scene.cameras import add_cameras
from cadenza.scene.config import SceneConfig, Side
from cadenza.scene.hand import add_hand, prefix
from cadenza.scene.piano import NUM_KEYS, add_piano, key_name
from cadenza.scene.shadow_hand import FINGERS, FOREARM_DOFS

Ids = NDArray[np.intp]

PHYSICS_TIMESTEP = {"published": 0.005, "fast": 0.01}  # [s]
SLEEP_TOLERANCE = 1e-5
"""Keys at rest cost nothing; at this tolerance a recorded song replays to 1e-4 rad."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled scene. Names are resolved to ids here, once.

    J hand joints (right hand's, left hand's), A actuators in the order of actions (right hand's,
    left hand's; with no hands the 88 keys').
    """

    config: SceneConfig
    model: mujoco.MjModel
    sides: tuple[Side, ...]
    key_qpos: slice
    """Where the 88 keys' joints are in qpos."""
    key_geoms: slice
    """Where the 88 keys' boxes are among the geoms."""
    hand_qpos: slice
    """Where the J joints of the hands are in qpos."""
    hand_qvel: slice
    """Where the J joints of the hands are in qvel."""
    hand_joint_names: tuple[str, ...]
    actuator_names: tuple[str, ...]
    fingertip_sites: Ids
    """(5 for each hand,) fingers thumb to little, right hand first."""
    fingers: Ids
    """The same fingers by number, 0..4 right, 5..9 left."""
    forearm_geoms: dict[Side, Ids]
    hand_bodies: Ids
    """(B,) the bodies that move with the hands."""

    @property
    def action_low(self) -> NDArray[np.float64]:
        """(A + 1,) smallest action in actuator units, the pedal last."""
        return np.append(self.model.actuator_ctrlrange[:, 0], 0.0)

    @property
    def action_high(self) -> NDArray[np.float64]:
        """(A + 1,) largest action in actuator units, the pedal last."""
        return np.append(self.model.actuator_ctrlrange[:, 1], 1.0)


def build_scene(config: SceneConfig | None = None) -> Scene:
    """Builds and compiles the scene that `config` describes.

    Raises:
        CadenzaError: the configuration makes no sense.
    """
    config = as_config(config, SceneConfig)
    _check(config)
    spec = mujoco.MjSpec()
    _set_options(spec, config)
    add_cameras(spec)
    sides = _sides(config)
    add_piano(spec, actuated=not sides)
    for side in sides:
        add_hand(spec, side, config)
    model = spec.compile()
    _damp_forearms_critically(model, sides, config)
    return _resolve(config, model, sides)


class HandAlone(NamedTuple):
    """One hand of a scene, in a scene without the other."""

    scene: Scene
    servos: slice
    """Its actuators among those of both."""
    joints: slice
    """Its joints among those of both."""


def hand_alone(scene: Scene, side: Side) -> HandAlone:
    """Takes the hand on one side by itself."""
    alone = build_scene(replace(scene.config, hands=side))
    servos = _place(alone.actuator_names, scene.actuator_names)
    return HandAlone(alone, servos, _place(alone.hand_joint_names, scene.hand_joint_names))


def _place(names: tuple[str, ...], everyone: tuple[str, ...]) -> slice:
    """Where `names` stand one after the other among `everyone`."""
    first = everyone.index(names[0])
    return slice(first, first + len(names))


def _sides(config: SceneConfig) -> tuple[Side, ...]:
    if config.hands == "both":
        return ("right", "left")
    return () if config.hands == "none" else (config.hands,)


def _check(config: SceneConfig) -> None:
    if len(set(config.forearm_dofs)) < len(config.forearm_dofs):
        raise CadenzaError(
            f"forearm_dofs {config.forearm_dofs}: choose each at most once from "
            f"{', '.join(FOREARM_DOFS)}"
        )
    if not 0 <= config.hand_spacing <= 1.2:
        raise CadenzaError(f"hand_spacing {config.hand_spacing} m: choose 0 to 1.2 m")
    if not -180 <= config.attachment_yaw <= 180:
        raise CadenzaError(f"attachment_yaw {config.attachment_yaw} degrees: choose -180 to 180")


def _set_options(spec: mujoco.MjSpec, config: SceneConfig) -> None:
    spec.modelname = "cadenza"
    spec.compiler.degree = False
    spec.option.timestep = PHYSICS_TIMESTEP[config.physics]
    spec.option.impratio = 10
    if config.hands == "none":  # damps the keys' servos without bound on the timestep
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if config.sleeping_keys:
        spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        spec.option.sleep_tolerance = SLEEP_TOLERANCE


def _damp_forearms_critically(
    model: mujoco.MjModel, sides: tuple[Side, ...], config: SceneConfig
) -> None:
    """Damping 2 sqrt(k m) of a servo of stiffness k that moves the mass m of a whole hand."""
    for side in sides:
        for name in config.forearm_dofs:
            dof = model.joint(f"{prefix(side)}forearm_{name}").dofadr[0]
            kp = FOREARM_DOFS[name].kp
            model.dof_damping[dof] = 2.0 * np.sqrt(kp * model.dof_M0[dof])


def _resolve(config: SceneConfig, model: mujoco.MjModel, sides: tuple[Side, ...]) -> Scene:
    prefixes = tuple(prefix(side) for side in sides)
    joints = [j for p in prefixes for j in _ids_with_prefix(model.njnt, model.joint, p)]
    bodies = [b for p in prefixes for b in _ids_with_prefix(model.nbody, model.body, p)]
    hinge = [model.joint(key_name(key)).qposadr[0] for key in range(NUM_KEYS)]
    return Scene(
        config=config,
        model=model,
        sides=sides,
        key_qpos=_as_slice(hinge),
        key_geoms=_as_slice([model.geom(key_name(key)).id for key in range(NUM_KEYS)]),
        hand_qpos=_as_slice(model.jnt_qposadr[joints]),
        hand_qvel=_as_slice(model.jnt_dofadr[joints]),
        hand_joint_names=tuple(model.joint(j).name for j in joints),
        actuator_names=tuple(model.actuator(a).name for a in range(model.nu)),
        fingertip_sites=_array(model.site(f"{p}{f}tip").id for p in prefixes for f in FINGERS),
        fingers=_array(5 * (side == "left") + f for side in sides for f in range(5)),
        forearm_geoms={
            side: np.flatnonzero(model.geom_bodyid == model.body(prefix(side) + "forearm").id)
            for side in sides
        },
        hand_bodies=_array(bodies),
    )


def _ids_with_prefix(count: int, named: Callable[[int], Any], prefix: str) -> list[int]:
    return [i for i in range(count) if named(i).name.startswith(prefix)]


def _as_slice(addresses: Sequence[int]) -> slice:
    """Hinges and slides added one after the other take consecutive addresses."""
    first, count = (int(addresses[0]), len(addresses)) if len(addresses) else (0, 0)
    assert list(addresses) == list(range(first, first + count))
    return slice(first, first + count)


def _array(values: Iterable[int]) -> Ids:
    return np.array(list(values), dtype=np.intp)
