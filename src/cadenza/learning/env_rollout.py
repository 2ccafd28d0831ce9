"""Rollouts of environments, which on-policy learners learn from."""

from typing import Any, NamedTuple

Array = Any  # of NumPy or of JAX


class Decision(NamedTuple):
    """What a policy does in N environments."""

    action: Array  # (N, A) what was drawn; its hyperbolic tangent is the action in [-1, 1]
    log_prob: Array  # (N,) log probability of what was drawn
    value: Array  # (N,) value of the observation


class EnvRollout(NamedTuple):
    """T control steps of N environments, in the order in which they were taken."""

    observation: Array  # (T, N, D) what was observed before each step
    action: Array  # (T, N, A) see `Decision`
    log_prob: Array  # (T, N)
    value: Array  # (T, N)
    reward: Array  # (T, N)
    ended: Array  # (T, N) whether the episode ended with the step
    # (T, N) value of the observation after the step where a song was over; 0 elsewhere
    value_at_end: Array
    # (N,) value of the observation after the last step, or of the next episode's first
    last_value: Array
