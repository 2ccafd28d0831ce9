"""Random perturbations of the trajectory of one hand."""

import numpy as np

from cadenza.agents.agent import Array, Ids, Mask, steps_in
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of

_LENGTHS = (0.1, 0.8)  # [s] from a single stroke to a short passage
_MAX_SHIFT = 0.15  # [s] by which servos may be early or late
_NOISE_EXPONENTS = (-0.7, 0.5)  # powers of ten, times a servo's own noise: 0.2 to 3 times
_SHARES = (0.2, 1.2)  # of the distance to another posture
_ALL_SERVOS, _ONE_FINGER = 0.25, 0.35  # how often all servos change, or those of one finger
_SPARSE = 0.3  # share of the servos that change otherwise


class Perturbations:
    """Random offsets to the target positions of the servos of one hand."""

    def __init__(self, scene: Scene, planned: Array, dt: float) -> None:
        """Prepare perturbations of the hand that is alone in a scene.

        `planned` (T + 1, A) are the positions of its servos by the plan, `dt` [s] apart.
        """
        servos = servos_of(scene)
        self._sigma, self._finger, self._lift = servos.noise, servos.finger, servos.lift
        self._planned = planned
        self._lengths = [steps_in(seconds, dt) for seconds in _LENGTHS]
        self._shift = steps_in(_MAX_SHIFT, dt)

    def length(self, rng: np.random.Generator) -> int:
        """Draw the number of steps of a perturbation."""
        return int(rng.integers(self._lengths[0], self._lengths[1] + 1))

    def draw(
        self, path: Array, first: int, last: int, count: int, rng: np.random.Generator
    ) -> Array:
        """Draw offsets (N, L, A) for `count` candidates over the L steps from `first` to `last`.

        Half are noise, constant or interpolated from the first step to the last. The others move
        earlier or later, go some of the way to the plan, hold the current posture, or lift the hand
        for a time. `path` (T, A) are the positions before each step.
        """
        kinds = (
            self._noise,
            self._shift_in_time,
            self._noise,
            self._draw_back,
            self._constant_noise,
            self._lift_hand,
        )
        after = np.minimum(np.arange(first, last) + 1, len(path) - 1)
        candidates = [
            kinds[i % len(kinds)](path, after, rng) * self.servos(rng) for i in range(count)
        ]
        return np.stack(candidates)

    def _noise(self, path: Array, after: Ids, rng: np.random.Generator) -> Array:
        ends = rng.standard_normal((2, len(self._sigma))) * self._sigma
        late = np.linspace(0.0, 1.0, len(after))[:, None]
        return 10 ** rng.uniform(*_NOISE_EXPONENTS) * ((1 - late) * ends[0] + late * ends[1])

    def _constant_noise(self, path: Array, after: Ids, rng: np.random.Generator) -> Array:
        noise = rng.standard_normal(len(self._sigma)) * self._sigma
        return 10 ** rng.uniform(*_NOISE_EXPONENTS) * np.tile(noise, (len(after), 1))

    def _lift_hand(self, path: Array, after: Ids, rng: np.random.Generator) -> Array:
        is_lifted = np.arange(len(after)) < rng.integers(1, len(after) + 1)
        return rng.uniform(*_SHARES) * is_lifted[:, None] * self._lift

    def _shift_in_time(self, path: Array, after: Ids, rng: np.random.Generator) -> Array:
        first, last = rng.uniform(-self._shift, self._shift, 2)
        times = np.clip(after + np.linspace(first, last, len(after)), 0, len(path) - 1)
        before, part = times.astype(np.intp), (times % 1.0)[:, None]
        later = np.minimum(before + 1, len(path) - 1)
        return (1 - part) * path[before] + part * path[later] - path[after]

    def _draw_back(self, path: Array, after: Ids, rng: np.random.Generator) -> Array:
        towards = self._planned[after] if rng.random() < 0.5 else path[after[0] - 1]
        return rng.uniform(*_SHARES) * (towards - path[after])

    def servos(self, rng: np.random.Generator) -> Mask:
        """Draw a mask (A,) of the servos that change."""
        kind = rng.random()
        if kind < _ALL_SERVOS:
            return np.ones(len(self._sigma), bool)
        if kind < _ALL_SERVOS + _ONE_FINGER:  # or those of the whole hand
            return self._finger == rng.integers(-1, self._finger.max() + 1)
        return rng.random(len(self._sigma)) < _SPARSE
