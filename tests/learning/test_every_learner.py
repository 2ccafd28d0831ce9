"""What every learner keeps to."""

import io
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from rl_examples import random_batches

from cadenza.learning.algorithms.cloning.config import CloningConfig
from cadenza.learning.algorithms.cloning.learner import Cloning
from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.algorithms.ppo.config import PPOConfig
from cadenza.learning.env_rollout import EnvRollout
from cadenza.learning.observation import Inputs

INPUTS, ACTIONS, UPDATES, BATCH = 10, 3, 6, 8
ALL = Inputs(tuple(range(INPUTS)), INPUTS)
SIZES: dict[str, Any] = {"hidden_sizes": (16,), "batch_size": BATCH}
LEARNERS = {
    "droq": lambda: DroQConfig(**SIZES, dropout=0.2, policy_delay=2).make(ALL, ACTIONS),
    "ppo": lambda: PPOConfig(**SIZES).make(ALL, ACTIONS),
    "cloning": lambda: Cloning(CloningConfig(**SIZES), ALL, ACTIONS),
}


@pytest.fixture(scope="module", params=LEARNERS)
def kind(request):
    return request.param, LEARNERS[request.param]()


def experience(name: str, seed: int) -> tuple[Any, ...]:
    """The experience of a few updates."""
    rng = np.random.default_rng(seed)
    batches = random_batches(rng, (UPDATES, BATCH), INPUTS, ACTIONS)
    if name == "droq":
        return (batches,)
    if name == "cloning":
        return (batches[:2],)
    others = rng.standard_normal((3, UPDATES, BATCH)).astype(np.float32)
    ended = batches.discount == 0
    rollout = EnvRollout(*batches[:2], *others[:2], batches.reward, ended, others[2], others[0, 0])
    return rollout, rng.permutation(UPDATES * BATCH).reshape(UPDATES, BATCH)


def arrays(learner: Any, state: Any) -> dict[str, np.ndarray]:
    """A copy: an update uses its state up."""
    return {name: array.copy() for name, array in learner.to_arrays(state).items()}


def updated(kind: tuple[str, Any], state: Any, *seeds: int) -> Any:
    for seed in seeds:
        state, figures = kind[1].update(state, *experience(kind[0], seed))
        assert all(len(values) == UPDATES for values in figures.values())
    return state


class TestLearner:
    def test_the_same_seed_gives_the_same_bits(self, kind):
        learner = kind[1]
        one, same, other = (
            arrays(learner, updated(kind, learner.init(seed), 0, 1)) for seed in (3, 3, 4)
        )
        for name, array in one.items():
            assert_array_equal(array, same[name], err_msg=name)
        assert any((array != other[name]).any() for name, array in one.items())

    def test_a_state_that_was_kept_goes_on_with_the_same_bits(self, kind):
        learner = kind[1]
        state, file = updated(kind, learner.init(0), 0), io.BytesIO()
        np.savez(file, allow_pickle=False, **learner.to_arrays(state))
        expected = arrays(learner, updated(kind, state, 1))
        file.seek(0)
        with np.load(file) as kept:
            restored = learner.from_arrays(dict(kept))
        for name, array in arrays(learner, updated(kind, restored, 1)).items():
            assert_array_equal(array, expected[name], err_msg=name)

    def test_a_policy_is_not_changed_by_the_updates_after_it(self, kind):
        """An update uses up the memory of the state before it, which a policy may still look at."""
        learner, observation = kind[1], experience("droq", 0)[0].observation[0]
        state = learner.init(0)
        policy = learner.policy(state)
        before = policy.mode(observation).copy()
        state = updated(kind, state, 0, 1, 2)
        assert_array_equal(policy.mode(observation), before)
        assert (learner.policy(state).mode(observation) != before).any()
