"""Learnt policies: from observations to actions, without the parts that only learning needs."""

from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Activation = Literal["relu", "gelu"]

_SQRT_2_OVER_PI = np.float32(np.sqrt(2 / np.pi))


def relu(x: Floats) -> Floats:
    return np.maximum(x, np.float32(0))


def gelu(x: Floats) -> Floats:
    """GELU as approximated by tanh (Hendrycks & Gimpel, GELUs, 2016)."""
    return x / 2 * (1 + np.tanh(_SQRT_2_OVER_PI * (x + np.float32(0.044715) * x**3)))


_ACTIVATIONS = {"relu": relu, "gelu": gelu}


class Policy(Protocol):
    """A map from observations (N, D) to actions (N, A) in [-1, 1]."""

    def mode(self, observation: Floats) -> Floats:
        """The best actions (N, A), with which the policy is evaluated and plays."""

    def sample(self, observation: Floats, rng: np.random.Generator) -> Floats:
        """Draw actions (N, A), with which the policy collects experience."""

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Facts for JSON and arrays by name, for `LearnerConfig.policy_of`."""


class Perceptron:
    """A `Policy`: a perceptron from observations to a squashed normal distribution of actions.

    It is read without the learner that made it.
    """

    def __init__(
        self,
        weights: dict[str, NDArray[Any]],
        activation: Activation,
        log_std_range: tuple[float, float],
    ) -> None:
        """Keep the weights: "hidden_0/kernel" (D, H), "hidden_0/bias" (H,), "mean/...", ...

        The activation follows every hidden layer, and log standard deviations stay in a range.
        """
        self.weights, self.activation, self.log_std_range = weights, activation, log_std_range
        self._activate = _ACTIVATIONS[activation]
        depth = sum(name.endswith("/kernel") for name in weights) - 2
        self._hidden = [f"hidden_{i}" for i in range(depth)]

    def mode(self, observation: Floats) -> Floats:
        """The mean (N, A), squashed by tanh."""
        return np.tanh(self._layer("mean", self._features(observation)))

    def sample(self, observation: Floats, rng: np.random.Generator) -> Floats:
        """Draw actions (N, A) from the distribution."""
        features = self._features(observation)
        mean, log_std = self._layer("mean", features), self._layer("log_std", features)
        noise = rng.standard_normal(mean.shape, np.float32)
        return np.tanh(mean + np.exp(np.clip(log_std, *self.log_std_range)) * noise)

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """The arguments of `__init__`."""
        facts = {"activation": self.activation, "log_std_range": self.log_std_range}
        return facts, self.weights

    def _features(self, observation: Floats) -> Floats:
        x = observation
        for name in self._hidden:
            x = self._activate(self._layer(name, x))
        return x

    def _layer(self, name: str, x: Floats) -> Floats:
        return x @ self.weights[f"{name}/kernel"] + self.weights[f"{name}/bias"]
