"""Measures how policies play their own song, with hands that begin in place and beside it.

    python -m benchmarks.drills RUN/best ... [--starts N]

Prints a table in Markdown. An episode succeeds if all keys are right: every note sounds for half of
its time or more, and no other key sounds, but for one control step before or after its note.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.arguments import one_or_more, parser_for
from cadenza.agents.rollout import EpisodeResult, play_episodes
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.policy_folder import load_policy
from cadenza.music.performance import key_runs
from cadenza.tasks.piano_task import PianoTask

_BESIDE = 0.01  # [m] that hands begin to the left or to the right, at most


def succeeds(goal: NDArray[np.bool_], sounding: NDArray[np.bool_]) -> bool:
    """Whether all keys are right; arrays (T, K)."""
    near = np.pad(goal, ((1, 1), (0, 0)))
    near = near[:-2] | near[1:-1] | near[2:]
    held = [sounding[a:b, key].mean() for a, b, key in zip(*key_runs(goal), strict=True)]
    return not (sounding & ~near).any() and min(held) >= 0.5


def played(learnt: LearntPolicy, starts: int, beside: float) -> list[EpisodeResult]:
    """The episodes of a policy whose hands begin up to `beside` [m] from where hands usually do.

    Raises:
        CadenzaError: the policy was not trained on one song.
    """
    if learnt.score is None:
        raise CadenzaError("a policy that plays any song; give one that was trained on one song")
    config = replace(learnt.task, random_hand_position=beside)
    with closing(PianoTask([learnt.score], config, learnt.scene, starts)) as task:
        return play_episodes(task, learnt.agent, range(starts))


@errors_in_a_line()
def main() -> None:
    """Plays and prints a table in Markdown."""
    parser = parser_for(__doc__)
    parser.add_argument("policies", nargs="+", type=Path)
    parser.add_argument("--starts", type=one_or_more, default=20)
    options = parser.parse_args()
    print("Scores are F1 · note onset F1.\n")
    print("| policy | scores | all keys right | begun beside | all keys right, begun beside |")
    print("| --- | --- | --- | --- | --- |")
    for folder in options.policies:
        learnt, cells = load_policy(folder), [str(folder)]
        for starts, beside in ((1, 0.0), (options.starts, _BESIDE)):
            results = played(learnt, starts, beside)
            arrays = [result.episode.arrays for result in results]
            right = sum(succeeds(a["goal_keys"], a["key_activation"]) for a in arrays)
            f1, onsets = (
                np.mean([result.metrics[name] for result in results])
                for name in ("f1", "note_onset_f1")
            )
            cells += [f"{f1:.3f} · {onsets:.3f}", f"{right} of {starts}"]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
