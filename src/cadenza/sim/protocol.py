"""The interface of simulations, whichever engine is behind it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cadenza.scene.randomization import Factors
from cadenza.scene.scene import Scene

Array = NDArray[np.float64]


class State(NamedTuple):
    """State of N simulations after a step, as tasks see it.

    Positions, velocities and contacts belong to the new state; forces to the last physics step that
    led there, as in the published system. There are K keys, J hand joints, A actuators, and F
    fingers of two hands.
    """

    key_qpos: Array
    """(N, K) joint angles of the keys [rad], softly limited to 0..travel."""
    key_xpos: Array
    """(N, K, 3) centres of the keys' boxes in the world [m]."""
    key_onset: Array
    """(N, K) when each key began to sound in the step, from its beginning on [s]; NaN if it did
    not. Between physics steps, keys move linearly."""
    key_offset: Array
    """(N, K) when each key ceased to sound in the step, from its beginning on [s]; NaN if it did
    not. Of several onsets or offsets of a key in a step, the last one counts."""
    key_speed: Array
    """(N, K) the speed of each key at its onset in the step [rad/s]; NaN if there was none."""
    hand_qpos: Array
    """(N, J) joint positions of the hands [m, rad]."""
    hand_qvel: Array
    """(N, J) joint velocities of the hands [m/s, rad/s]."""
    fingertip_xpos: Array
    """(N, F, 3) fingertips in the world [m]; zero for a hand that is not there."""
    actuator_force: Array
    """(N, A) forces of the actuators [N, N m]."""
    actuator_velocity: Array
    """(N, A) velocities of the actuators [m/s, rad/s]."""
    forearm_contact: NDArray[np.bool_]
    """(N,) whether links touch that the reward for forearms keeps apart (`Hand.kept_apart`); False
    unless forearms are watched."""
    touch: Array
    """(N, F) normal forces on the fingertips [N]; zero without touch sensors."""
    unstable: NDArray[np.bool_]
    """(N,) whether the simulation has diverged since its last reset and is of no more use."""

    @classmethod
    def at_rest(cls, scene: Scene, *rows: int) -> State:
        """The state of hands and keys at 0 in `scene`; arrays begin with the dimensions `rows`."""
        joints, actuators = len(scene.hand_joint_names), len(scene.actuator_names)
        keys = scene.keyboard.num_keys
        return cls(
            key_qpos=np.zeros((*rows, keys)),
            key_xpos=np.zeros((*rows, keys, 3)),
            key_onset=np.full((*rows, keys), np.nan),
            key_offset=np.full((*rows, keys), np.nan),
            key_speed=np.full((*rows, keys), np.nan),
            hand_qpos=np.zeros((*rows, joints)),
            hand_qvel=np.zeros((*rows, joints)),
            fingertip_xpos=np.zeros((*rows, scene.fingers.count, 3)),
            actuator_force=np.zeros((*rows, actuators)),
            actuator_velocity=np.zeros((*rows, actuators)),
            forearm_contact=np.zeros(rows, bool),
            touch=np.zeros((*rows, scene.fingers.count)),
            unstable=np.zeros(rows, bool),
        )

    @property
    def key_events(self) -> tuple[Array, Array, Array]:
        """The events of keys in the step: `key_onset`, `key_offset`, `key_speed`."""
        return self.key_onset, self.key_offset, self.key_speed

    def copy(self) -> State:
        """A copy with arrays of its own."""
        return State._make(values.copy() for values in self)

    def with_row(self, env_id: int, row: Sequence[NDArray[Any]]) -> State:
        """A copy in which one simulation has other values, in the order of the fields."""
        changed = self.copy()
        for values, value in zip(changed, row, strict=True):
            values[env_id] = value
        return changed


class HeldControls(NamedTuple):
    """Controls that are held at the beginning of a control step, until its own ones arrive."""

    ctrl: Array  # (N, A) controls in actuator units
    substeps: NDArray[np.intp]  # (N,) number of physics steps, fewer than a control step has


class Path(NamedTuple):
    """The path through a control step: its S + 1 states, before and after each physics step."""

    hand_qpos: Array  # (N, S + 1, J) joint positions of the hands [m, rad]
    hand_qvel: Array  # (N, S + 1, J) joint velocities of the hands [m/s, rad/s]
    key_qpos: Array  # (N, S + 1, K) joint angles of the keys [rad]
    touch: Array  # (N, S + 1, F) normal forces on the fingertips, of a physics step earlier [N]

    @classmethod
    def still(cls, state: State, length: int) -> Path:
        """A path of `length` equal states."""
        xp = state.hand_qpos.__array_namespace__()
        values = state.hand_qpos, state.hand_qvel, state.key_qpos, state.touch
        return cls(*(xp.repeat(v[:, None], length, axis=1) for v in values))


class Simulation(Protocol):
    """N independent simulations of one scene.

    Only domain randomization calls `randomize` and `push`, and gives `held` and `path`.
    """

    @property
    def state(self) -> State:
        """The state after the last step or reset; its arrays must not be changed."""

    def reset(self, env_ids: Sequence[int], hand_qpos: Array) -> None:
        """Reset some simulations: everything is at rest, and the keys are up.

        Args:
            env_ids: the simulations that are reset.
            hand_qpos: (len(env_ids), J) joint positions of the hands to start from [m, rad].
        """

    def randomize(self, env_id: int, factors: Factors) -> None:
        """Scale the nominal model of one simulation, which must be reset next.

        Args:
            env_id: the simulation.
            factors: see `cadenza.scene.randomization.shapes`; the same names every time.
        """

    def push(self, env_id: int, force: Array) -> None:
        """Push bodies of a simulation with these forces (bodies, 3) [N] alone, until its reset."""

    def step(
        self,
        ctrl: Array,
        env_ids: Sequence[int] | None,
        held: HeldControls | None = None,
        path: Path | None = None,
    ) -> None:
        """Take one control step.

        Args:
            ctrl: (N, A) in actuator units, held through the step; one row for every simulation,
                also for those not stepped.
            env_ids: the simulations to step; all if None.
            held: the controls until these arrive, if they are late.
            path: receives the path through the step, of simulations that are stepped.
        """

    def close(self) -> None:
        """Free threads and other resources; a later step starts them again."""


MakeSimulation = Callable[..., Simulation]
"""A function that makes the simulation of a task, with the arguments of `MujocoSimulation`."""
