"""The reward: its terms as pure functions of state and goal over the batch, and their sum.

The terms take arrays of NumPy or of a library like it, whose namespace is `xp`, and all shapes
follow from those of the arguments, so that `jax.jit` can compile them. -1, for none, picks any
value, which a mask then leaves out.

The formulas are those of the paper (Zakka et al., RoboPianist, CoRL 2023, table "reward") as its
published code computes them. The weights are in `cadenza.tasks.config.RewardWeights`.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, quoted
from cadenza.keyboards.keyboard import Keyboard
from cadenza.scene.scene import Scene
from cadenza.sim.protocol import State
from cadenza.tasks.config import WEIGHTS, TaskConfig
from cadenza.tasks.onset_matching import OnsetErrors

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ids = NDArray[np.integer]

# The published code's: within a bound of its target, a value is rewarded in full; at the margin
# beyond the bound, with a tenth.
_LOG_VALUE_AT_MARGIN = math.log(0.1)
_KEY_BOUND, _KEY_MARGIN = 0.05, 0.5  # as fractions of the way down
_FINGER_BOUND = 0.01  # [m]
# From 6 ms on, listeners notice that a note is displaced in a fast sequence (Friberg and Sundberg,
# "Time discrimination in a monotonic, isochronous sequence", JASA 98, 1995), and 50 ms is the usual
# tolerance of note onset F1.
_ONSET_BOUND, _ONSET_MARGIN = 0.006, 0.044  # [s]
# Two people who play a piece differ by 10.8 (299 pairs of recordings in MAESTRO); 25 more are half
# or twice the speed of the hammer (Goebl 2001, see `Action.per_doubling`).
_VELOCITY_BOUND, _VELOCITY_MARGIN = 10.8, 25.0  # in MIDI velocity
_PRESS_AT = np.array((0.35, 0.0, 0.5))  # from the centre of a key's box, in half sizes
_TOTAL = "total"


class Outcome(NamedTuple):
    """The states of N environments after a control step, its goals and actions."""

    state: State
    """The simulations after the step."""
    key_state: Array
    """(N, K) how far the keys are down, 0..1."""
    sounding: Mask
    """(N, K) which keys sound."""
    pedal_down: Mask
    """(N,) whether the pedal is down."""
    goal_keys: Mask
    """(N, K) which keys should sound."""
    goal_sustain: Mask
    """(N,) whether the pedal should be down."""
    fingers: NDArray[np.int8]
    """(N, K) which fingers should press the keys, -1 for none."""
    ctrl: Array
    """(N, A) the action in actuator units, the pedal last."""
    onset_errors: OnsetErrors | None = None
    """How far onsets are from those of the notes that they play, (N, K) each; None without
    `TaskConfig.onset_goals`."""

    def __repr__(self) -> str:
        return f"Outcome({len(self.ctrl)} environments)"


class Transition(NamedTuple):
    """The result of a control step; arrays over the batch (N,)."""

    reward: Array
    terms: dict[str, Array]  # each term of the reward by name; they add up to it
    # Whether a wrong key sounded and that ends the episode, or the simulation is unstable
    terminated: Mask
    truncated: Mask  # whether the score is over
    unstable: Mask  # whether the simulation diverged, or an action was not a number


RewardTerm = Callable[[Outcome], Array]  # a function that returns a term of the reward, (N,)


def press_offset(key_half_size: Array) -> Array:
    """(K, 3) the points on keys that fingers should press, from the centres of their boxes [m]."""
    return _PRESS_AT * key_half_size


def key_state(key_qpos: Array, travel: Array) -> Array:
    """`(..., K)` how far keys at `key_qpos` (..., K) [rad] are down, 0..1.

    `travel` (K,) is from rest to stop [rad].
    """
    xp = key_qpos.__array_namespace__()
    return xp.minimum(xp.maximum(key_qpos / _alike(travel, key_qpos), 0.0), 1.0)


def key_activation(key_qpos: Array, sounds_from: Array) -> Mask:
    """(..., K) which keys sound: those at an angle (K,), near their stop, or beyond it [rad]."""
    return key_qpos >= _alike(sounds_from, key_qpos)


def _alike(constant: Array, values: Array) -> Array:
    """The constant as an array of the library of the values.

    Without a type, JAX would reuse the type that it gave to this array of NumPy at first, even if
    `jax_enable_x64` has changed since, and a keyboard's arrays outlive that.
    """
    xp = values.__array_namespace__()
    return xp.asarray(constant, dtype=xp.result_type(constant, values))


def midi_velocity(key_speed: Array, keyboard: Keyboard) -> Array:
    """(...) the MIDI velocities, as whole numbers, of keys of these speeds at their onsets [rad/s].

    NaN stays NaN.
    """
    return np.rint(keyboard.velocity(key_speed))


def key_press(state: Array, activation: Mask, goal: Mask) -> Array:
    """(N,) reward for goal keys that are down, and for no other key that sounds; arrays (N, K)."""
    xp = state.__array_namespace__()
    down = _tolerance(xp, 1.0 - state - _KEY_BOUND, _KEY_MARGIN)
    wrong = (activation > goal).any(-1)
    return WEIGHTS.key_press * _masked_mean(xp, down, goal) + WEIGHTS.no_wrong_key * ~wrong


def graded_key_press(state: Array, activation: Mask, goal: Mask) -> Array:
    """(N,) graded `key_press`: every touch counts, and a wrong key is not as bad as silence.

    A goal key is worth half of how far it is down, and as much again once it sounds. The part for
    no wrong key falls by the share of wrong keys among goal keys and wrong ones.
    """
    xp = state.__array_namespace__()
    wrong = (activation > goal).sum(-1)
    share = wrong / xp.maximum(goal.sum(-1) + wrong, 1)
    pressed = _masked_mean(xp, 0.5 * (state + activation), goal)
    return WEIGHTS.key_press * pressed + WEIGHTS.no_wrong_key - WEIGHTS.no_wrong_key * share


def score_fingering(
    fingertips: Array,
    key_xpos: Array,
    press: Array,
    fingers: Ids,
    margin: float = TaskConfig.fingering_margin,
) -> Array:
    """(N,) mean nearness of fingers to the keys that the score gives them, 0 if it gives none.

    Args:
        fingertips: (N, F, 3) fingertips [m].
        key_xpos: (N, K, 3) centres of the keys' boxes [m].
        press: (K, 3) points to press, from the centres, see `press_offset` [m].
        fingers: (N, K) fingers for the keys, 0..F-1, -1 for none.
        margin: distance over which nearness falls to a tenth, from 1 cm on [m].
    """
    xp = fingertips.__array_namespace__()
    rows = xp.arange(len(fingers))[:, None]
    offset = fingertips[rows, fingers] - key_xpos - press
    return WEIGHTS.fingering * _masked_mean(xp, _nearness(xp, offset, margin), fingers >= 0)


def transport_fingering(
    fingertips: Array,
    key_xpos: Array,
    press: Array,
    keys: Ids,
    margin: float = TaskConfig.fingering_margin,
) -> Array:
    """(N,) mean nearness of fingers to the keys assigned to them, 1 if none is (RP1M).

    `keys` (N, F) are those of `keys_by_transport`; for the others see `score_fingering`.
    """
    xp = fingertips.__array_namespace__()
    rows = xp.arange(len(keys))[:, None]
    offset = fingertips - key_xpos[rows, keys] - press[keys]
    assigned = keys >= 0
    mean = _masked_mean(xp, _nearness(xp, offset, margin), assigned)
    return WEIGHTS.fingering * xp.where(assigned.any(-1), mean, 1.0)


def keys_by_transport(
    fingertips: Array, key_xpos: Array, press: Array, goal: Mask, there: slice
) -> NDArray[np.intp]:
    """(N, F) the key of each finger, -1 for none, with the least sum of distances.

    This optimal transport is that of RP1M (Zhao et al., 2024). Unlike the reward terms it cannot be
    compiled: SciPy solves one row after the other.

    Args:
        fingertips, key_xpos, press: see `score_fingering`.
        goal: (N, K) the keys to press.
        there: the fingers that the hands have, of the F.
    """
    from scipy.optimize import linear_sum_assignment  # slow, and most tasks do without

    keys = np.full(fingertips.shape[:2], -1)
    for row in np.flatnonzero(goal.any(axis=1)):
        key = np.flatnonzero(goal[row])
        points = key_xpos[row, key] + press[key]
        offsets = fingertips[row, there][:, None] - points
        finger, of_key = linear_sum_assignment(np.linalg.norm(offsets, axis=-1))
        keys[row, there.start + finger] = key[of_key]
    return keys


def energy(force: Array, velocity: Array, coefficient: float) -> Array:
    """(N,) penalty for the power of all actuators, from forces and velocities (N, A)."""
    xp = force.__array_namespace__()
    return -coefficient * xp.vecdot(abs(force), abs(velocity))


def sustain(pedal_down: Mask, goal: Mask) -> Array:
    """(N,) reward for the pedal as the score has it; arrays (N,)."""
    xp = goal.__array_namespace__()
    difference = goal.astype(float) - pedal_down.astype(float)
    beyond = xp.maximum(difference - _KEY_BOUND, -difference)
    return WEIGHTS.sustain * _tolerance(xp, beyond, _KEY_MARGIN)


def forearm(contact: Mask) -> Array:
    """(N,) reward for forearms that do not touch."""
    return contact.__array_namespace__().where(contact, 0.0, WEIGHTS.forearm)


def onset_timing(error: Array, coefficient: float) -> Array:
    """(N,) reward for notes that begin in time, by their errors (N, K) [s], NaN for other keys.

    Each note that is played is worth max(0, abs(error) - 6 ms) on a Gaussian that falls to a tenth
    at 44 ms: 1 up to an error that a listener hardly notices, a tenth at the 50 ms that note onset
    F1 allows. Notes count alike, so those of a chord add up.
    """
    return coefficient * _sum_of_played(error, _ONSET_BOUND, _ONSET_MARGIN)


def loudness(error: Array, coefficient: float) -> Array:
    """(N,) reward for notes as loud as written, by errors (N, K) of MIDI velocities or NaN.

    Each note that is played is worth max(0, abs(error) - 10.8) on a Gaussian that falls to a tenth
    at 25: 1 up to an error by which two people who play the same piece differ, a tenth where the
    hammer is half or twice as fast beyond that. Notes count alike, so those of a chord add up.
    """
    return coefficient * _sum_of_played(error, _VELOCITY_BOUND, _VELOCITY_MARGIN)


def _sum_of_played(error: Array, bound: float, margin: float) -> Array:
    """(N,) sums of how near the errors (N, K) are to 0; NaN does not count."""
    xp = error.__array_namespace__()
    near = _tolerance(xp, abs(error) - bound, margin)
    return xp.where(xp.isnan(error), 0.0, near).sum(-1)


def _tolerance(xp: Any, beyond: Array, margin: float) -> Array:
    """1 up to the bound, then a Gaussian that falls to 0.1 at `margin` beyond it."""
    distance = xp.maximum(beyond, 0.0)
    return xp.exp(distance * distance * (_LOG_VALUE_AT_MARGIN / margin**2))


def _nearness(xp: Any, offset: Array, margin: float) -> Array:
    """(N, P) nearness of fingers whose offsets from their targets are (N, P, 3) [m]."""
    distance = xp.sqrt(xp.vecdot(offset, offset))
    return _tolerance(xp, distance - _FINGER_BOUND, margin)


def _masked_mean(xp: Any, values: Array, mask: Mask) -> Array:
    """(N,) means of the values (N, P) in the mask (N, P), 0 where the mask is empty.

    Values are added up one after the other, which zeros in between do not change. A plain sum adds
    in an order that depends on N and P, and so rounds otherwise.
    """
    total = xp.where(mask, values, 0.0).cumsum(-1)[:, -1]
    return total / xp.maximum(mask.sum(-1), 1)


class Reward:
    """The terms of a task's reward: its own, by its options, and those of the user."""

    def __init__(
        self, config: TaskConfig, scene: Scene, more_terms: Mapping[str, RewardTerm] | None
    ) -> None:
        """Choose the terms by the options of a task.

        `more_terms` are added, or take the place of the task's of the same name. Raises
        CadenzaError if `more_terms` are not functions by name.
        """
        self._config, self._scene = config, scene
        self._press = press_offset(scene.keyboard.half_size)
        self._more_terms = _checked(more_terms or {})

    def transition(self, outcome: Outcome, lost: Mask, over: Mask) -> Transition:
        """The result of a control step.

        Actions of environments that are `lost` (N,) were not numbers; songs that are `over` (N,)
        have ended. Raises CadenzaError if a user's term is not a finite number for each
        environment.
        """
        config, state, keys = self._config, outcome.state, outcome.goal_keys
        press_term = graded_key_press if config.key_press == "graded" else key_press
        terms = {"key_press": press_term(outcome.key_state, outcome.sounding, keys)}
        if self._scene.sides:
            if config.fingering != "off":
                terms["fingering"] = self._fingering(outcome)
            force, velocity = state.actuator_force, state.actuator_velocity
            terms["energy"] = energy(force, velocity, config.energy_coefficient)
        if config.sustain_term:
            terms["sustain"] = sustain(outcome.pedal_down, outcome.goal_sustain)
        if config.forearm_term:
            terms["forearm"] = forearm(state.forearm_contact)
        if (errors := outcome.onset_errors) is not None:
            if config.onset_timing_coefficient:
                coefficient = config.onset_timing_coefficient
                terms["onset_timing"] = onset_timing(errors.time, coefficient)
            if config.loudness_coefficient:
                terms["loudness"] = loudness(errors.velocity, config.loudness_coefficient)
        for name, term in self._more_terms.items():
            terms[name] = _checked_values(name, term(outcome), outcome.ctrl)
        terminated = unstable = state.unstable | lost
        if config.wrong_press_termination:
            terminated = terminated | (outcome.sounding > keys).any(-1)
        nothing = state.unstable.__array_namespace__().zeros(len(outcome.ctrl))
        total = sum(terms.values(), nothing)
        return Transition(total, terms, terminated, over & ~terminated, unstable)

    def _fingering(self, outcome: Outcome) -> Array:
        tips, key_xpos = outcome.state.fingertip_xpos, outcome.state.key_xpos
        press, margin = self._press, self._config.fingering_margin
        if self._config.fingering == "transport":
            there = self._scene.present_fingers
            keys = keys_by_transport(tips, key_xpos, press, outcome.goal_keys, there)
            return transport_fingering(tips, key_xpos, press, keys, margin)
        return score_fingering(tips, key_xpos, press, outcome.fingers, margin)


def _checked_values(name: str, values: Any, ctrl: Array) -> Array:
    """The values of a user's term in the N environments of the controls (N, A + 1).

    Raises CadenzaError if they are not N numbers or not finite; while JAX compiles, only their
    shape is checked.
    """
    what, num_envs = f"reward term {quoted(name)} returned values", len(ctrl)
    demand = f"give a finite number for each environment, ({num_envs},)"
    if isinstance(ctrl, np.ndarray):
        return finite_array(what, values, (num_envs,), demand)
    if np.shape(values) != (num_envs,):
        raise CadenzaError(f"{what} of shape {np.shape(values)}: {demand}")
    return values


def _checked(terms: Mapping[str, RewardTerm]) -> dict[str, RewardTerm]:
    if not isinstance(terms, Mapping):
        raise CadenzaError(f"reward_terms {quoted(terms)}: give a dictionary, name -> function")
    for name, term in terms.items():
        if not isinstance(name, str) or not callable(term):
            raise CadenzaError(f"reward term {quoted(name)}: give a name and a function")
        if name == _TOTAL:
            raise CadenzaError(
                f"reward term {quoted(name)}: recordings call the sum of all terms so; "
                "choose another name"
            )
    return dict(terms)


def finite_array(name: str, given: Any, shape: tuple[int, ...], demand: str) -> Array:
    """The user's numbers `given` as an array of this shape.

    Raises CadenzaError if they are not finite numbers of this shape; the message begins with `name`
    and ends with the `demand`.
    """
    try:
        values = np.asarray(given, float)
    except (TypeError, ValueError) as error:
        raise CadenzaError(f"{name} {quoted(given)}: {demand}") from error
    if values.shape != shape:
        raise CadenzaError(f"{name} of shape {values.shape}: {demand}")
    if not np.isfinite(values).all():
        raise CadenzaError(f"{name} not finite: {demand}")
    return values
