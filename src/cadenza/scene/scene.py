"""The scene: a compiled MuJoCo model and the indices of its keys, joints, servos and fingers."""

from collections.abc import Callable, Container, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.configs import as_config
from cadenza.errors import CadenzaError
from cadenza.fingers import SIDES, Fingers, Side
from cadenza.hands import forearm
from cadenza.hands.body import HandOptions, prefix
from cadenza.hands.hand import Hand
from cadenza.hands.registry import hand_named
from cadenza.keyboards.keyboard import Keyboard
from cadenza.keyboards.registry import keyboard_named
from cadenza.scene.cameras import add_cameras
from cadenza.scene.config import SceneConfig

Ids = NDArray[np.intp]

PHYSICS_TIMESTEP = {"published": 0.005, "fast": 0.01}  # [s]
SLEEP_TOLERANCE = 1e-5
"""The tolerance at which keys at rest cost no time and a recorded song replays to 1e-4 rad."""
_FRICTION_IMPEDANCE = 10  # MuJoCo's impratio of the published scene: keys do not slip
_KEY_BIT = 2  # bit of contype and conaffinity for fingers on keys
_NUM_POSTURES = 400  # more find no other pair of parts that collides
_MAX_SPACING, _MAX_YAW = 1.2, 180.0  # [m], a piano's length; [degree]


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled scene with K keys, whose names are resolved to ids once.

    J is the number of hand joints (right hand's, left hand's), A that of actuators in the order of
    actions (right hand's, left hand's; without hands the keys').
    """

    config: SceneConfig
    keyboard: Keyboard
    hand: Hand  # the kind of both hands
    model: mujoco.MjModel
    sides: tuple[Side, ...]
    key_qpos: slice  # places of the keys' joints in qpos
    key_geoms: slice  # places of the keys' boxes among the geoms
    hand_qpos: slice  # places of the J hand joints in qpos
    hand_qvel: slice  # places of the J hand joints in qvel
    hand_joint_names: tuple[str, ...]
    # (J,) positions of the hand joints when an episode begins [m, rad]
    hand_start: NDArray[np.float64]
    actuator_names: tuple[str, ...]
    # Sites of the fingers that are there, each hand's from the thumb on, right hand first
    fingertip_sites: Ids
    fingers: Fingers  # the numbers of fingers in arrays over the F places of both hands
    present_fingers: slice  # the numbers of the fingers of the hands in the scene
    # (H, G) which geoms of each hand are of links that the reward for forearms keeps apart
    forearm_geoms: NDArray[np.bool_]
    hand_bodies: Ids  # (B,) the bodies that move with the hands
    palm_bodies: Ids  # the bodies that hide keys from above
    slide_joints: Ids  # indices of the J joints that slide the hands along the keyboard

    def __repr__(self) -> str:
        hands, hand, keyboard = self.config.hands, self.config.hand, self.config.keyboard
        return f"Scene(hands={hands!r}, hand={hand!r}, keyboard={keyboard!r})"

    @property
    def action_low(self) -> NDArray[np.float64]:
        """(A + 1,) lower bounds of actions in actuator units, the pedal last."""
        return np.append(self.model.actuator_ctrlrange[:, 0], 0.0)

    @property
    def action_high(self) -> NDArray[np.float64]:
        """(A + 1,) upper bounds of actions in actuator units, the pedal last."""
        return np.append(self.model.actuator_ctrlrange[:, 1], 1.0)

    def servos_on(self, *sides: Side) -> slice:
        """The actuators, of all A, of the hands on these sides."""
        return self._on(sides, len(self.actuator_names))

    def joints_on(self, *sides: Side) -> slice:
        """The joints, of all J, of the hands on these sides."""
        return self._on(sides, len(self.hand_joint_names))

    def fingertips_on(self, *sides: Side) -> slice:
        """The `fingertip_sites` of the hands on these sides."""
        return self._on(sides, len(self.fingertip_sites))

    def _on(self, sides: tuple[Side, ...], count: int) -> slice:
        per_side = count // len(self.sides)
        first = self.sides.index(sides[0]) * per_side
        return slice(first, first + len(sides) * per_side)

    def has_fingers(self, numbers: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Whether each of `numbers` is that of a finger that is there."""
        return (numbers >= self.present_fingers.start) & (numbers < self.present_fingers.stop)


def build_scene(config: SceneConfig | None = None, hand: Hand | None = None) -> Scene:
    """Build and compile the scene that `config` describes, or one with another `hand`.

    Raises CadenzaError if the options contradict each other, or are out of range.
    """
    config = as_config(config, SceneConfig)
    keyboard, hand = keyboard_named(config.keyboard), hand or hand_named(config.hand)
    try:
        spec, sites = scene_spec(config, keyboard, hand)
        model = spec.compile()
    except ValueError as error:  # hand and keyboard may come from other packages
        message, names = " ".join(str(error).split()), f"hand {hand.name}, keyboard {keyboard.name}"
        raise CadenzaError(f"{names}: MuJoCo cannot build them: {message}") from error
    sides = _sides(config)
    _damp_forearms_critically(model, hand, sides, config)
    return _resolve(config, keyboard, hand, model, sides, sites)


def scene_spec(
    config: SceneConfig, keyboard: Keyboard, hand: Hand
) -> tuple[mujoco.MjSpec, list[str]]:
    """The scene that `config` describes, not compiled, and the names of its fingertips' sites.

    Raises CadenzaError if the options contradict each other, or are out of range.
    """
    _check(config, keyboard, hand)
    spec = mujoco.MjSpec()
    _set_options(spec, config, hand)
    add_cameras(spec)
    sides, options = _sides(config), _options(config, keyboard)
    keyboard.add_to(spec, range(keyboard.num_keys), actuated=not sides)
    return spec, [site for side in sides for site in hand.add_to(spec, side, options)]


class HandAlone(NamedTuple):
    """A scene with one hand of another scene only."""

    scene: Scene
    servos: slice  # the actuators of the hand among those of both
    joints: slice  # the joints of the hand among those of both


@lru_cache(maxsize=8)  # shared by all that play a plan, as it takes long to build
def hand_alone(scene: Scene, side: Side) -> HandAlone:
    """The hand on one side in a scene of its own, which must not be changed."""
    alone = shared_scene(replace(scene.config, hands=side))
    return HandAlone(alone, scene.servos_on(side), scene.joints_on(side))


def shared_scene(config: SceneConfig) -> Scene:
    """The scene that `config` describes, shared by all callers, which must not change it."""
    return _described(config, hand_named(config.hand), keyboard_named(config.keyboard))


@lru_cache(maxsize=8)  # scenes of one song after another
def _described(config: SceneConfig, hand: Hand, keyboard: Keyboard) -> Scene:  # noqa: ARG001
    """The scene of `config`, whose `hand` and `keyboard` are what its names mean now."""
    return build_scene(config, hand)


def in_steps_of(scene: Scene, seconds: float) -> Scene:
    """The scene with another physics timestep [s], for coarser rollouts."""
    model = copy(scene.model)
    model.opt.timestep = seconds
    return replace(scene, model=model)


Part = tuple[str, int]  # a geom of a hand: the name of its body, and its index in that body


@lru_cache(maxsize=8)  # it takes long
def colliding_parts(scene: Scene) -> frozenset[Part]:
    """The parts of the hands that collide with each other in any of many random postures."""
    model = scene.model
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    low, high = model.jnt_range[model.dof_jntid[scene.hand_qvel]].T
    parts: set[Part] = set()
    for posture in rng.uniform(low, high, (_NUM_POSTURES, len(low))):
        data.qpos[scene.hand_qpos] = posture
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        bodies = model.geom_bodyid[data.contact.geom]
        for geoms in data.contact.geom[np.isin(bodies, scene.hand_bodies).all(axis=1)]:
            for geom, body in zip(geoms, model.geom_bodyid[geoms], strict=True):
                parts.add((model.body(body).name, int(geom - model.body_geomadr[body])))
    return frozenset(parts)


def reduced_model(
    scene: Scene, keys: range, parts: Container[Part], num_samples: int = 0
) -> mujoco.MjModel:
    """A faster model of a scene with hands, with few keys and few geoms.

    Joints, servos and fingertips are those of the scene, in its order, except for keys that are
    left out. Keys collide only with the last two links of each finger.

    Args:
        scene: a scene with hands.
        keys: the keys that are kept.
        parts: the parts of the hands that are kept beside the ends of the fingers.
        num_samples: the number of physics steps for which MuJoCo keeps the angles of the keys, as
            the histories of sensors, which come before all others.
    """
    spec = mujoco.MjSpec()
    _set_options(spec, scene.config, scene.hand)
    scene.keyboard.add_to(spec, keys, actuated=False)
    for geom in spec.geoms:
        geom.conaffinity = _KEY_BIT
    for joint in spec.joints if num_samples else ():
        spec.add_sensor(
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint.name,
            name=joint.name,
            nsample=num_samples,
        )
    for side in scene.sides:
        scene.hand.add_to(spec, side, _options(scene.config, scene.keyboard))
        ends = {prefix(side) + name for each in scene.hand.fingers for name in each.links[-2:]}
        for body in spec.body(f"{side}_hand").find_all(mujoco.mjtObj.mjOBJ_BODY):
            for i, geom in enumerate(body.geoms):
                if body.name in ends and geom.contype:
                    geom.contype |= _KEY_BIT
                elif (body.name, i) not in parts:
                    spec.delete(geom)
    model = spec.compile()
    _damp_forearms_critically(model, scene.hand, scene.sides, scene.config)
    return model


def _sides(config: SceneConfig) -> tuple[Side, ...]:
    match config.hands:
        case "both" | "apart":
            return SIDES
        case "none":
            return ()
        case side:
            return (side,)


def _options(config: SceneConfig, keyboard: Keyboard) -> HandOptions:
    return HandOptions(
        reduced_action_space=config.reduced_action_space,
        forearm_dofs=config.forearm_dofs,
        hand_spacing=config.hand_spacing,
        attachment_yaw=config.attachment_yaw,
        gravity_compensation=config.gravity_compensation,
        primitive_fingertips=config.primitive_fingertips,
        hand_collisions=config.hand_collisions,
        apart=config.hands == "apart",
        dry_friction=config.physics != "fast",
        touch=config.touch,
        keyboard_half_length=keyboard.half_length,
    )


def _check(config: SceneConfig, keyboard: Keyboard, hand: Hand) -> None:
    if len(set(config.forearm_dofs)) < len(config.forearm_dofs):
        raise CadenzaError(
            f"forearm_dofs {config.forearm_dofs}: choose each at most once from "
            f"{', '.join(forearm.JOINTS)}"
        )
    if not 0 <= config.hand_spacing <= _MAX_SPACING:
        raise CadenzaError(f"hand_spacing {config.hand_spacing} m: choose 0 to {_MAX_SPACING:g} m")
    if not -_MAX_YAW <= config.attachment_yaw <= _MAX_YAW:
        raise CadenzaError(
            f"attachment_yaw {config.attachment_yaw} degrees: choose -{_MAX_YAW:g} to {_MAX_YAW:g}"
        )
    if hand.body.mount:
        for option in "forearm_dofs", "hand_spacing", "attachment_yaw":
            if getattr(config, option) != getattr(SceneConfig, option):
                raise CadenzaError(f"{option}: hand {config.hand} hangs on arms; leave it out")
    elif _sides(config) and config.hand_spacing > 2 * keyboard.half_length:
        raise CadenzaError(
            f"hand_spacing {config.hand_spacing} m: the keyboard {keyboard.name} is only "
            f"{2 * keyboard.half_length:.2f} m long; choose less, for one hand 0"
        )


def _set_options(spec: mujoco.MjSpec, config: SceneConfig, hand: Hand) -> None:
    spec.modelname = "cadenza"
    spec.compiler.degree = False
    spec.option.timestep = PHYSICS_TIMESTEP[config.physics]
    spec.option.impratio = _FRICTION_IMPEDANCE
    # Damps servos without bound on the timestep: those of keys, and of the joints of an arm.
    if config.hands == "none" or hand.body.mount is not None:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if config.sleeping_keys:
        spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        spec.option.sleep_tolerance = SLEEP_TOLERANCE


def _damp_forearms_critically(
    model: mujoco.MjModel, hand: Hand, sides: tuple[Side, ...], config: SceneConfig
) -> None:
    """Set the damping 2 sqrt(k m) of servos of stiffness k that move a hand of mass m."""
    for side in () if hand.body.mount else sides:
        for name in config.forearm_dofs:
            dof = model.joint(f"{prefix(side)}{forearm.FOREARM}_{name}").dofadr[0]
            kp = forearm.JOINTS[name].kp
            model.dof_damping[dof] = 2.0 * np.sqrt(kp * model.dof_M0[dof])


def _resolve(
    config: SceneConfig,
    keyboard: Keyboard,
    hand: Hand,
    model: mujoco.MjModel,
    sides: tuple[Side, ...],
    fingertip_sites: Sequence[str],
) -> Scene:
    prefixes = tuple(prefix(side) for side in sides)
    hand_joints = [(p, j) for p in prefixes for j in _ids_with_prefix(model.njnt, model.joint, p)]
    joints = [j for _, j in hand_joints]
    bodies = [b for p in prefixes for b in _ids_with_prefix(model.nbody, model.body, p)]
    slides = [p + forearm.ALONG_KEYBOARD for p in prefixes]
    fingers = Fingers(len(hand.fingers))
    keys = [keyboard.key_name(key) for key in range(keyboard.num_keys)]
    hinge = [model.joint(key).qposadr[0] for key in keys]
    places = [fingers.of_hand(SIDES.index(side)) for side in sides] or [slice(0, 0)]
    kept_apart = ([model.body(p + link).id for link in hand.kept_apart] for p in prefixes)
    return Scene(
        config=config,
        keyboard=keyboard,
        hand=hand,
        model=model,
        sides=sides,
        key_qpos=_as_slice(hinge),
        key_geoms=_as_slice([model.geom(key).id for key in keys]),
        hand_qpos=_as_slice(model.jnt_qposadr[joints]),
        hand_qvel=_as_slice(model.jnt_dofadr[joints]),
        hand_joint_names=tuple(model.joint(j).name for j in joints),
        hand_start=np.array(
            [hand.start.get(model.joint(j).name.removeprefix(p), 0.0) for p, j in hand_joints]
        ),
        actuator_names=tuple(model.actuator(a).name for a in range(model.nu)),
        fingertip_sites=as_ids(model.site(name).id for name in fingertip_sites),
        fingers=fingers,
        present_fingers=slice(places[0].start, places[-1].stop),
        forearm_geoms=np.array([np.isin(model.geom_bodyid, ids) for ids in kept_apart], bool),
        hand_bodies=as_ids(bodies),
        palm_bodies=as_ids(model.body(p + name).id for p in prefixes for name in hand.palm_links),
        slide_joints=as_ids(row for row, j in enumerate(joints) if model.joint(j).name in slides),
    )


def _ids_with_prefix(count: int, element: Callable[[int], Any], prefix: str) -> list[int]:
    return [i for i in range(count) if element(i).name.startswith(prefix)]


def _as_slice(addresses: Sequence[int]) -> slice:
    """The slice of consecutive addresses, as of hinges and slides that are added together."""
    first, count = (int(addresses[0]), len(addresses)) if len(addresses) else (0, 0)
    assert list(addresses) == list(range(first, first + count))
    return slice(first, first + count)


def as_ids(values: Iterable[int]) -> Ids:
    """`values` as an array of indices."""
    return np.array(list(values), dtype=np.intp)
