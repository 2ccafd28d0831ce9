"""Batches of steps against a plain loop, and what a reader refuses."""

import numpy as np
import pytest

from cadenza.demonstrations.dataset import Dataset, kept, open_dataset
from cadenza.demonstrations.recorded_episode import played_actions
from cadenza.demonstrations.summary import summarize
from cadenza.errors import CadenzaError
from cadenza.evaluation.collecting.variation import Variation
from demonstrations.made import collected


def test_a_batch_is_what_a_plain_loop_reads(made):
    dataset = open_dataset(made)
    assert dataset.num_steps == sum(len(e.steps) - 1 for e in dataset.episodes)
    steps = dataset.sample(np.random.default_rng(0), 40)
    ahead, lookahead = (0, 1, 5), 4
    batch = dataset.batch(steps, lookahead, ahead)
    numbered = [(e, t) for e in dataset.episodes for t in range(e.facts.num_steps)]
    for i, number in enumerate(steps.tolist()):
        episode, t = numbered[number]
        row, goals, last = episode.steps[t], episode.goals(dataset.scene), len(episode.steps) - 1
        for name in ("hand_qpos", "hand_qvel", "fingertip_xpos", "key_state", "action"):
            assert (getattr(batch, name)[i] == row[name]).all()
        played = played_actions(episode.steps, dataset.scene)
        before = played[t - 1].astype(np.float32) if t else 0
        assert (batch.previous_action[i] == before).all()
        assert batch.previous_reward[i] == np.float32(row["previous_reward"])
        assert (np.packbits(batch.sounding[i]) == row["sounding"]).all()
        for j, later in enumerate(ahead):
            plan = episode.plan[min(t + later, last)]
            assert (batch.reference[i, j] == plan["reference"]).all()
        for j in range(lookahead + 1):
            asked, expected = batch.goal[i, j], batch.fingers[i, j]
            if t + j >= goals.num_steps:
                assert not asked.any()
                assert (expected == -1).all()
                continue
            assert (asked[:-1] == goals.keys[t + j]).all()
            assert asked[-1] == goals.sustain[t + j]
            keys = np.flatnonzero(goals.fingers[t + j] >= 0)
            assert {(int(goals.fingers[t + j, k]), int(k)) for k in keys} == {
                (f, int(k)) for f, k in enumerate(expected) if k >= 0
            }


@pytest.mark.parametrize("step", [-1, "num_steps"])
def test_steps_that_there_are_not(step, made):
    dataset = open_dataset(made)
    number = dataset.num_steps if isinstance(step, str) else step
    with pytest.raises(CadenzaError, match="choose from 0 to"):
        dataset.batch(np.array([0, number]))


def test_chunks_of_actions_end_with_the_episode(made):
    dataset = open_dataset(made)
    last = int(dataset.first[1]) - 1
    chunk = dataset.actions(np.array([last - 1, 0]), 4)
    actions = dataset.episodes[0].steps["action"]
    assert (chunk[0] == actions[[last - 1, last, last, last]]).all()
    assert (chunk[1] == actions[:4]).all()


def test_all_that_is_played_was_a_goal_or_is_an_error(made):
    """Recall of the recorded keys against the rebuilt goals is that of the episode."""
    for episode in kept(made):
        dataset = Dataset([episode])
        batch = dataset.batch(np.arange(dataset.num_steps), lookahead=0)
        sounds = np.unpackbits(episode.steps["sounding"][1:], axis=1, count=88).astype(bool)
        expected = batch.goal[:, 0, :-1]
        asked = expected.any(axis=1)
        share = [
            (s & w).sum() / w.sum() for s, w in zip(sounds[asked], expected[asked], strict=True)
        ]
        ones = len(expected) - asked.sum()  # nothing is missed where nothing is asked for
        recall = (sum(share) + ones) / len(expected)
        assert recall == pytest.approx(episode.facts.metrics["recall"])


def test_episodes_that_do_not_go_together_are_refused(made, tmp_path):
    collected(tmp_path, Variation(noise=0.0), control_timestep=0.1)
    with pytest.raises(CadenzaError, match="another control_timestep"):
        Dataset([*kept(made), *kept(tmp_path)])
    with pytest.raises(CadenzaError, match="no demonstrations"):
        open_dataset(made, lambda about: about.f1 > 1)
    with pytest.raises(CadenzaError, match="cadenza dataset collect"):
        open_dataset(tmp_path / "nowhere")


def test_a_million_steps_take_less_than_2500_megabytes(made):
    for episode in kept(made):
        rows = episode.steps.itemsize + episode.plan.itemsize
        assert 1e6 * rows < 2.5e9  # and there are about 200 bytes a step for all other files


def test_what_there_is(made):
    lines = list(summarize(made))
    assert lines[:2] == ["2 episodes of 1 song kept", "0 not kept, 0 not finished"]
    assert any("mujoco" in line for line in lines)
    assert any(line.startswith("note onset F1 ") for line in lines)
    assert "rewarded fingers: search in 2 episodes" in lines
