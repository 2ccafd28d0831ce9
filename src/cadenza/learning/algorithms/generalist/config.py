"""The options of training a generalist. Imports nothing heavy: the command line shows them."""

import math
from dataclasses import dataclass

from cadenza.configs import MAX_COUNT, check_ranges

_COUNTS = "num_songs", "num_rounds", "num_envs", "rollout_steps", "batch_size", "num_epochs"
_SHARES = "weight_decay", "previous_dropout", "discount", "gae_lambda", "clip", "ema"
_RANGES = {
    **dict.fromkeys((*_COUNTS, "patience"), (1, MAX_COUNT)),
    **dict.fromkeys((*_SHARES, "learning_rate", "value_learning_rate"), (0, 1)),
    "dropout": (0, 0.99),
    "noise": (0.001, 1),
    "seconds": (1, 3600),
    "value_warmup": (0, MAX_COUNT),
    "checkpoint_interval": (0, math.inf),
    "seed": (0, MAX_COUNT),
}


@dataclass(frozen=True)
class _RunConfig:
    checkpoint_interval: float = 60.0
    """Time between checkpoints [s]."""
    seed: int = 0
    """Random seed, also for the songs that are drawn."""

    def check(self) -> None:
        """Check the options; raises a CadenzaError if one makes no sense."""
        check_ranges(self, {name: r for name, r in _RANGES.items() if hasattr(self, name)})


@dataclass(frozen=True)
class GeneralistCloningConfig(_RunConfig):
    """The options of fitting the networks to the planner's corrections."""

    hidden_sizes: tuple[int, int] = (128, 64)
    """Hidden layer widths."""
    learning_rate: float = 1e-3
    """Initial learning rate (AdamW, cosine decay)."""
    weight_decay: float = 0.01
    """Weight decay."""
    dropout: float = 0.15
    """Dropout rate of hidden units."""
    previous_dropout: float = 0.7
    """Probability that the previous correction is hidden from a network, lest it repeat it."""
    batch_size: int = 512
    """Examples per update."""
    num_epochs: int = 15
    """Epochs at most."""
    patience: int = 4
    """Epochs without improvement on held-out songs before a network stops."""


@dataclass(frozen=True)
class ExcerptConfig(_RunConfig):
    """The options of training on excerpts of songs, which are played many at once."""

    num_songs: int = 160
    """Songs of the library to learn from, drawn at random."""
    seconds: float = 12.0
    """Length of the excerpt of each song [s]."""
    num_rounds: int = 850
    """Rollouts, each followed by updates."""
    num_envs: int = 32
    """Excerpts played in parallel."""
    rollout_steps: int = 64
    """Control steps of each excerpt per rollout."""
    batch_size: int = 512
    """Steps of a hand per update."""
    num_epochs: int = 2
    """Passes over each rollout."""


@dataclass(frozen=True)
class GeneralistReinforcementConfig(ExcerptConfig):
    """The options of proximal policy optimisation over many songs."""

    noise: float = 0.2
    """Standard deviation of the exploration noise, as a fraction of the largest correction."""
    discount: float = 0.9
    """Discount factor per control step."""
    gae_lambda: float = 0.9
    """Lambda of generalised advantage estimation."""
    clip: float = 0.2
    """Clip range of the probability ratio."""
    learning_rate: float = 1e-4
    """Initial learning rate of the networks (Adam). It decays linearly to 0."""
    value_learning_rate: float = 5e-4
    """Learning rate of the value functions (Adam)."""
    value_warmup: int = 8
    """Rounds in which only the value functions are updated."""
    ema: float = 0.04
    """Update rate per round of the average of the networks, which is saved."""


@dataclass(frozen=True)
class GeneralistStrikingConfig(ExcerptConfig):
    """The options of learning how fingers strike."""

    num_songs: int = 200
    """Songs of the library to learn from, drawn at random."""
    num_rounds: int = 6
    """Rounds of playing, each followed by a fit to all that was played."""
    rollout_steps: int = 1000
    """Control steps of each excerpt per round."""
    batch_size: int = 256
    """Strikes per update."""
    num_epochs: int = 14
    """Epochs of each fit."""
    hidden_sizes: tuple[int, int] = (32, 32)
    """Hidden layer widths of the networks for touches."""
    learning_rate: float = 2e-3
    """Initial learning rate of these networks (AdamW, cosine decay)."""
