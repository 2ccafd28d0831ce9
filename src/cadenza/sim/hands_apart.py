"""Simulations of hands apart: each at a piano of its own, whose keys are combined."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.fingers import SIDES, Side
from cadenza.scene.randomization import KEY_SOUNDING, Factors
from cadenza.scene.scene import HandAlone, Scene, as_ids, hand_alone
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.protocol import HeldControls, Path, State

Array = NDArray[np.float64]


class HandsApart:
    """N pairs of simulations, of either hand; implements `protocol.Simulation`.

    The hands never meet. The position of a key is the deeper one of both pianos, which are equal,
    also if they are randomized.

    Attributes:
        state: both hands, and the keys of both pianos combined.
    """

    def __init__(self, scene: Scene, watch_forearms: bool = False, **options: Any) -> None:
        """Take a scene with both hands, as `MujocoSimulation`; forearms never touch."""
        self.scene = scene
        self._alone = [hand_alone(scene, side) for side in SIDES]
        self._parts = [MujocoSimulation(alone.scene, **options) for alone in self._alone]
        self._rows = [_indices_of(scene, alone) for alone in self._alone]
        self._sounds_from = np.tile(
            scene.keyboard.sounds_from, (len(self._parts[0].state.touch), 1)
        )
        self._sounded = [self._sounding(part) for part in self._parts]  # before the last step
        self._combine()

    def part(self, side: Side) -> State:
        """The state of one hand at its own piano."""
        return self._parts[SIDES.index(side)].state

    def reset(self, env_ids: Sequence[int], hand_qpos: Array) -> None:
        for alone, part in zip(self._alone, self._parts, strict=True):
            part.reset(env_ids, hand_qpos[:, alone.joints])
        self._combine()

    def randomize(self, env_id: int, factors: Factors) -> None:
        for rows, part in zip(self._rows, self._parts, strict=True):
            by_name = {name: factor[rows.get(name, ...)] for name, factor in factors.items()}
            part.randomize(env_id, by_name)
        if KEY_SOUNDING in factors:
            self._sounds_from[env_id] = self.scene.keyboard.sounds_from * factors[KEY_SOUNDING]

    def push(self, env_id: int, force: Array) -> None:
        for rows, part in zip(self._rows, self._parts, strict=True):
            part.push(env_id, force[rows["mass"]])

    def step(
        self,
        ctrl: Array,
        env_ids: Sequence[int] | None = None,
        held: HeldControls | None = None,
        path: Path | None = None,
    ) -> None:
        stepped = slice(None) if env_ids is None else list(env_ids)
        paths = list[Path]()
        for alone, part, sounded in zip(self._alone, self._parts, self._sounded, strict=True):
            sounded[stepped] = self._sounding(part)[stepped]
            before = held and held._replace(ctrl=held.ctrl[:, alone.servos])
            own = Path.still(part.state, path.key_qpos.shape[1]) if path else None
            part.step(ctrl[:, alone.servos], env_ids, before, own)
            if own:
                paths.append(own)
        if path:
            right, left = paths
            path.hand_qpos[stepped] = np.concatenate([right[0], left[0]], axis=2)[stepped]
            path.hand_qvel[stepped] = np.concatenate([right[1], left[1]], axis=2)[stepped]
            path.key_qpos[stepped] = np.maximum(right[2], left[2])[stepped]
            path.touch[stepped] = (right[3] + left[3])[stepped]
        self._combine()

    def save(self, env_id: int) -> Any:
        """Both simulations, and which keys sounded in each before the last step."""
        parts = zip(self._parts, self._sounded, strict=True)
        return [(part.save(env_id), sounded[env_id].copy()) for part, sounded in parts]

    def restore(self, env_id: int, saved: Any) -> None:
        """Put a pair of simulations where `save` found this one or another."""
        for part, sounded, each in zip(self._parts, self._sounded, saved, strict=True):
            part.restore(env_id, each[0])
            sounded[env_id] = each[1]
        self._combine()

    def _combine(self) -> None:
        right, left = (part.state for part in self._parts)
        deeper = right.key_qpos >= left.key_qpos
        by_right, by_left = self._sounded
        events = zip(_audible(right, left, by_left), _audible(left, right, by_right), strict=True)
        (onset, other_onset), (offset, other_offset), (speed, other_speed) = events
        later = (onset >= other_onset) | np.isnan(other_onset)
        self.state = State(
            key_qpos=np.where(deeper, right.key_qpos, left.key_qpos),
            key_xpos=np.where(deeper[..., None], right.key_xpos, left.key_xpos),
            **{
                name: np.concatenate([getattr(right, name), getattr(left, name)], axis=1)
                for name in ("hand_qpos", "hand_qvel", "actuator_force", "actuator_velocity")
            },
            key_onset=np.where(later, onset, other_onset),
            key_offset=np.fmax(offset, other_offset),
            key_speed=np.where(later, speed, other_speed),
            fingertip_xpos=right.fingertip_xpos + left.fingertip_xpos,
            forearm_contact=np.zeros_like(right.forearm_contact),
            touch=right.touch + left.touch,
            unstable=right.unstable | left.unstable,
        )

    def _sounding(self, part: MujocoSimulation) -> NDArray[np.bool_]:
        return np.asarray(part.state.key_qpos >= self._sounds_from)

    def close(self) -> None:
        """Stop the threads."""
        for part in self._parts:
            part.close()


def _audible(own: State, other: State, other_sounded: NDArray[np.bool_]) -> tuple[Array, ...]:
    """Onsets, offsets and speeds of one hand, NaN while the other hand makes the key sound.

    `other_sounded` (N, K) says whether the other hand did so before the step.
    """

    def alone(time: Array) -> NDArray[np.bool_]:
        begun = np.where(other.key_onset < time, other.key_onset, -1.0)
        ended = np.where(other.key_offset <= time, other.key_offset, -1.0)
        unchanged = (begun < 0) & (ended < 0)
        return ~np.where(unchanged, other_sounded, begun > ended)

    starts = alone(own.key_onset)
    return (
        np.where(starts, own.key_onset, np.nan),
        np.where(alone(own.key_offset), own.key_offset, np.nan),
        np.where(starts, own.key_speed, np.nan),
    )


def _indices_of(scene: Scene, alone: HandAlone) -> dict[str, Any]:
    """Name of a factor -> indices of one hand's factors among those of the scene."""
    both, part = scene.model, alone.scene.model
    bodies = as_ids(both.body(part.body(b).name).id for b in range(part.nbody))
    joints = as_ids(both.joint(part.joint(j).name).dofadr[0] for j in range(part.njnt))
    by_joint = dict.fromkeys(("joint_damping", "joint_friction", "armature"), joints)
    by_servo = dict.fromkeys(("servo_gain", "force_limit"), alone.servos)
    hand = scene.sides.index(alone.scene.sides[0])
    by_mount = dict.fromkeys(("mount_offset", "mount_tilt"), slice(hand, hand + 1))
    return {"mass": bodies, **by_servo, **by_joint, **by_mount}
