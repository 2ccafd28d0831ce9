"""Measures predictive sampling and iLQG at the paper's settings, and where their time goes.

    python -m benchmarks.planners SONG [--steps N] [--iterations I ...] [--budgets B ...]

With --whole-song instead `Planner`, which plans the whole song: its plan as it is, and refined.

Prints a table in Markdown.
"""

from __future__ import annotations

import time
from cProfile import Profile
from pstats import Stats
from typing import NamedTuple

import numpy as np

from benchmarks.arguments import one_or_more, parser_for
from cadenza.agents.agent import Agent, PlannerPerEnv, ZeroAgent
from cadenza.agents.baselines.ilqg import ILQG
from cadenza.agents.baselines.predictive_sampling import PredictiveSampling
from cadenza.agents.planner.config import (
    ILQGConfig,
    PlannerConfig,
    PredictiveSamplingConfig,
)
from cadenza.agents.planner.planner import Planner
from cadenza.agents.rollout import begin_episodes
from cadenza.errors import errors_in_a_line
from cadenza.music.libraries.library import load_score
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

# Parts of iLQG -> the functions that make them.
_PARTS = {
    "derivatives": "approximate",
    "backward pass": "backward_pass",
    "line search": "line_search",
}


class Result(NamedTuple):
    """Figures of the first steps of a song."""

    f1: float
    note_onset_f1: float
    fingering: float
    """Mean nearness of the fingers to their keys, 0..1, the task's fingering term."""
    ratio: float
    """Planning time over the music's; what is done beforehand is shared out over the song."""
    parts: dict[str, float]
    """The share of it that went to each part of iLQG; empty for others."""


def perform(agent: Agent, task: PianoTask, num_steps: int, seed: int) -> Result:
    """Has the agent play the first `num_steps` control steps."""
    (agent_rng,) = begin_episodes(task, [seed])
    started = time.perf_counter()
    agent.reset([0], [agent_rng])
    if isinstance(agent, PlannerPerEnv):
        agent.planners[0] = agent.begin(task.view(), agent_rng)
    beforehand = time.perf_counter() - started
    planning = beforehand * num_steps / int(task.goals.num_steps[0])
    fingering, profile = 0.0, Profile()
    for _ in range(num_steps):
        started = time.perf_counter()
        if isinstance(agent, ILQG):
            action = profile.runcall(agent.act, task.view())
        else:
            action = agent.act(task.view())
        planning += time.perf_counter() - started
        fingering += float(task.step(action).terms["fingering"][0])
    music = num_steps * task.config.control_timestep
    scores = task.episode_metrics(0)
    return Result(
        scores["f1"],
        scores["note_onset_f1"],
        fingering / num_steps,
        planning / music,
        {part: value / music for part, value in _seconds_of(profile).items()},
    )


def _seconds_of(profile: Profile) -> dict[str, float]:
    """The time in each of `_PARTS`, with all that they call [s]; empty if nothing was profiled."""
    stats = Stats(profile).get_stats_profile().func_profiles if profile.getstats() else {}
    return {part: stats[name].cumtime for part, name in _PARTS.items() if name in stats}


def line(name: str, results: list[Result]) -> str:
    """A row of the table: means over the seeds."""
    f1, onsets, fingering, ratio = (np.mean([r[i] for r in results]) for i in range(4))
    parts = ", ".join(f"{part} {value:.2f}" for part, value in results[0].parts.items())
    return f"| {name} | {f1:.3f} | {onsets:.3f} | {fingering:.3f} | {ratio:.2f} | {parts} |"


@errors_in_a_line()
def main() -> None:
    """Plays and prints, row by row."""
    parser = parser_for(__doc__)
    parser.add_argument("song", help="a bundled piece or a MIDI file")
    parser.add_argument(
        "--steps", type=one_or_more, default=40, help="control steps, at most the song's"
    )
    parser.add_argument(
        "--iterations", type=one_or_more, nargs="*", default=[1], help="a control step"
    )
    parser.add_argument(
        "--budgets", type=float, nargs="*", default=[], help="of predictive sampling: time / music"
    )
    parser.add_argument("--seeds", type=one_or_more, default=3, help="of planners that sample")
    parser.add_argument("--centred", action="store_true", help="iLQG with centred differences")
    parser.add_argument("--whole-song", action="store_true", help="plan the whole song")
    parser.add_argument("--initial-buffer-time", type=float, default=0.5, help="[s]")
    options = parser.parse_args()
    config = TaskConfig(initial_buffer_time=options.initial_buffer_time)
    task = PianoTask([load_score(options.song)], config)
    task.reset([np.random.default_rng(0)], [0])
    num_steps = min(options.steps, int(task.goals.num_steps[0]))

    def row(name: str, agent: Agent, seeds: int = 1) -> None:
        results = [perform(agent, task, num_steps, seed) for seed in range(seeds)]
        print(line(name, results), flush=True)

    print(f"{options.song}, {num_steps} control steps\n")
    print("| planner | F1 | note onsets | fingering | planning time / music | of which |")
    print("| --- | --- | --- | --- | --- | --- |")
    if options.whole_song:
        row("nominal plan", Planner(PlannerConfig(method="none")))
        row("nominal plan, refined", Planner(), options.seeds)
        return
    row("hands at rest", ZeroAgent())
    for iterations in options.iterations:
        sampling = PredictiveSamplingConfig(iterations=iterations)
        name = f"predictive sampling, {iterations} iteration(s)"
        row(name, PredictiveSampling(sampling), options.seeds)
    for budget in options.budgets:
        name = f"predictive sampling, budget {budget:g}"
        row(name, PredictiveSampling(PredictiveSamplingConfig(budget=budget)), options.seeds)
    for iterations in options.iterations:
        ilqg = ILQGConfig(iterations=iterations, centred=options.centred)
        row(f"iLQG, {iterations} iteration(s)", ILQG(ilqg))


if __name__ == "__main__":
    main()
