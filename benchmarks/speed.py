"""Measures how fast the environments are, as ratios side by side in one run.

    python -m benchmarks.speed tests/data/episode_d.npz [--published VENV]

Every contestant plays whole episodes in each of several rounds, one after the other, so that a
noisy machine disturbs all alike; of each the median speed counts. "random" draws actions uniformly,
"skilled" replays the recorded performance, in which fingers and keys touch all the time.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from benchmarks.arguments import one_or_more, parser_for
from cadenza.agents.playback import load_plan
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.tasks.env import PianoVectorEnv

SONG = "CMajorScaleTwoHands"  # of the recorded performance
EPISODES = 8  # in a run, of all environments together; at least one of each
BATCHES = (1, 8, 64)
THREADS = (1, 2)

Contestant = Callable[[], float]  # runs for a while and returns control steps per second


def plain_steps(actions: NDArray[np.float64]) -> Contestant:
    """`mj_step` of the same scene and nothing else."""
    model = build_scene().model
    substeps = round(0.05 / model.opt.timestep)

    def run() -> float:
        data, start = mujoco.MjData(model), time.perf_counter()
        for _ in range(EPISODES):
            mujoco.mj_resetData(model, data)
            for action in actions:
                data.ctrl = action[:-1]
                mujoco.mj_step(model, data, substeps)
        return EPISODES * len(actions) / (time.perf_counter() - start)

    return run


def environment(
    actions: NDArray[np.float64], num_envs: int, num_threads: int, physics: str
) -> Contestant:
    """The vector environment with observations, rewards and resets."""
    envs = PianoVectorEnv(
        SONG,
        num_envs,
        num_threads,
        autoreset_mode=AutoresetMode.SAME_STEP,
        setup="paper",
        sleeping_keys=True,
        physics=physics,
    )
    batches = np.repeat(envs.task.spec.unscale_action(actions)[:, None], num_envs, axis=1)
    episodes = max(EPISODES // num_envs, 1)
    envs.reset(seed=0)
    for batch in batches:  # a whole episode, so that nothing is loaded while the clock runs
        envs.step(batch)

    def run() -> float:
        start = time.perf_counter()
        for _ in range(episodes):
            for batch in batches:
                envs.step(batch)
        return episodes * batches.shape[0] * num_envs / (time.perf_counter() - start)

    return run


def published(venv: Path, arguments: list[str]) -> Contestant:
    """The published environment in an interpreter of its own (tools/published_steps.py).

    To measure it raises a CadenzaError if it does not run.
    """
    program = Path(__file__).parents[1] / "tools/published_steps.py"
    command = [str(venv / "bin" / "python"), str(program), *arguments, "--seconds", "3"]

    def run() -> float:
        result = subprocess.run(command, capture_output=True, text=True)
        if result.returncode:
            said = result.stderr.strip() or f"{command[0]} ended with status {result.returncode}"
            raise CadenzaError(said.splitlines()[-1])
        return float(json.loads(result.stdout)["steps_per_second"])

    return run


def contestants(
    actions: NDArray[np.float64], venv: Path | None, arguments: list[str]
) -> dict[str, Contestant]:
    """Name -> who takes part with these actions."""
    entered = {"mj_step": plain_steps(actions)}
    if venv:
        entered["published"] = published(venv, arguments)
    for physics in ("published", "fast"):
        for num_envs in BATCHES:
            for num_threads in THREADS:
                name = f"{physics} physics, N = {num_envs}, {num_threads} thread(s)"
                entered[name] = environment(actions, num_envs, num_threads, physics)
    return entered


def medians(entered: dict[str, Contestant], rounds: int) -> dict[str, float]:
    """Median steps per second of each over `rounds` rounds in which all take turns."""
    speeds: dict[str, list[float]] = {name: [] for name in entered}
    for done in range(rounds):
        for name, run in entered.items():
            speeds[name].append(run())
        print(f"round {done + 1} of {rounds} done", file=sys.stderr)
    return {name: float(np.median(values)) for name, values in speeds.items()}


def print_table(title: str, speeds: dict[str, float]) -> None:
    """Speeds, and their ratios to plain stepping and to the published environment."""
    reference = speeds.get("published", float("nan"))
    print(f"\n{title}\n\n| | steps/s | of mj_step | of published |\n| --- | --- | --- | --- |")
    for name, speed in speeds.items():
        plain, theirs = speed / speeds["mj_step"], speed / reference
        print(f"| {name} | {speed:.0f} | {plain:.2f} | {theirs:.2f} |")


def creation_seconds() -> float:
    """Shortest of five times that it takes to create and reset an environment [s]."""
    times = []
    for _ in range(5):
        start = time.perf_counter()
        PianoVectorEnv(SONG, 1).reset(seed=0)
        times.append(time.perf_counter() - start)
    return min(times)


@errors_in_a_line()
def main() -> None:
    """Measures and prints tables in Markdown."""
    parser = parser_for(__doc__)
    parser.add_argument("episode", type=Path, help="the recorded skilled performance")
    parser.add_argument("--published", type=Path, help="venv made by tools/published_setup.sh")
    parser.add_argument("--rounds", type=one_or_more, default=3)
    options = parser.parse_args()
    skilled = load_plan(options.episode).actions
    scene = build_scene(SceneConfig())
    drawn = np.random.default_rng(0).uniform(scene.action_low, scene.action_high, skilled.shape)
    print(f"creating an environment: {creation_seconds():.3f} s")
    for title, actions, arguments in (
        ("random actions", drawn, ["--song", SONG]),
        ("skilled performance", skilled, ["--episode", str(options.episode)]),
    ):
        entered = contestants(actions, options.published, arguments)
        print_table(title, medians(entered, options.rounds))


if __name__ == "__main__":
    main()
