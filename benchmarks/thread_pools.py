"""Compares ways to step many simulations on the cores of a CPU, side by side in one run.

    python -m benchmarks.thread_pools tests/data/episode_d.npz [--envs 64] [--threads 2]

All step the same scene by the same controls, one control step per call, as an environment has to:
our thread pool, which also reads states and finds when keys sound; `mujoco.rollout`; and, where it
is installed, `mjbatch`, which refuses models with sleep, so that each is measured without, too.
They take turns in each of several rounds, and medians count: of steps per second, and per second of
CPU time of all threads, which other work on the machine disturbs less. "random" draws controls
uniformly, for each simulation its own; "skilled" replays the recorded performance in all.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco.rollout import Rollout
from numpy.typing import NDArray

from benchmarks.arguments import one_or_more, parser_for
from cadenza.agents.playback import load_plan
from cadenza.errors import errors_in_a_line
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.mujoco_simulation import MujocoSimulation, physics_steps

CONTROL_TIMESTEP = 0.05  # [s]
STATES = mujoco.mjtState.mjSTATE_FULLPHYSICS

Contestant = Callable[[], NDArray[np.float64]]  # control steps a second, and a second of CPU time


def timed(ctrl: NDArray[np.float64], reset: Any, step: Any) -> Contestant:
    """Steps through controls (T, N, A) after a reset."""

    def run() -> NDArray[np.float64]:
        reset()
        start = np.array([time.perf_counter(), time.process_time()])
        for each in ctrl:
            step(each)
        seconds = np.array([time.perf_counter(), time.process_time()]) - start
        return ctrl.shape[0] * ctrl.shape[1] / seconds

    return run


def ours(scene: Scene, ctrl: NDArray[np.float64], num_threads: int) -> Contestant:
    """The simulation of the environments."""
    simulation = MujocoSimulation(scene, ctrl.shape[1], CONTROL_TIMESTEP, num_threads)
    return timed(ctrl, simulation.reset, simulation.step)


def rollout(scene: Scene, ctrl: NDArray[np.float64], num_threads: int) -> Contestant:
    """MuJoCo's own thread pool, which takes states and returns those after each physics step."""
    model, num_envs = scene.model, ctrl.shape[1]
    pool, scratch = Rollout(nthread=num_threads), [mujoco.MjData(model) for _ in range(num_threads)]
    substeps = physics_steps(CONTROL_TIMESTEP, model.opt.timestep)
    at_start = np.empty(mujoco.mj_stateSize(model, STATES))
    mujoco.mj_getState(model, mujoco.MjData(model), at_start, STATES)
    states = np.zeros((num_envs, substeps, len(at_start)))
    warmstart = np.zeros((num_envs, model.nv))

    def reset() -> None:
        states[:], warmstart[:] = at_start, 0.0

    def step(now: NDArray[np.float64]) -> None:
        held, first = np.repeat(now[:, None], substeps, axis=1), states[:, -1].copy()
        pool.rollout(model, scratch, first, held, initial_warmstart=warmstart, state=states)

    return timed(ctrl, reset, step)


def mjbatch(scene: Scene, ctrl: NDArray[np.float64], num_threads: int) -> Contestant:
    """The package of that name, https://github.com/kevinzakka/mjbatch."""
    from mjbatch import Batch

    batch = Batch(scene.model, ctrl.shape[1], num_threads)
    substeps = physics_steps(CONTROL_TIMESTEP, scene.model.opt.timestep)
    controls = batch.bind("ctrl")

    def step(now: NDArray[np.float64]) -> None:
        controls[:] = now
        batch.step(nstep=substeps)

    return timed(ctrl, batch.reset, step)


def contestants(ctrl: NDArray[np.float64], num_threads: int) -> dict[str, Contestant]:
    """Name -> who takes part with controls (T, N, A)."""
    awake, asleep = (build_scene(SceneConfig(sleeping_keys=keys)) for keys in (False, True))
    entered = {
        "ours": ours(asleep, ctrl, num_threads),
        "mujoco.rollout": rollout(asleep, ctrl, num_threads),
        "ours, without sleep": ours(awake, ctrl, num_threads),
        "mujoco.rollout, without sleep": rollout(awake, ctrl, num_threads),
    }
    try:
        entered["mjbatch, without sleep"] = mjbatch(awake, ctrl, num_threads)
    except ImportError:
        print("mjbatch is not installed, and left out")
    return entered


@errors_in_a_line()
def main() -> None:
    """Measures and prints a table in Markdown."""
    parser = parser_for(__doc__)
    parser.add_argument("episode", type=Path, help="the recorded skilled performance")
    parser.add_argument("--envs", type=one_or_more, default=64)
    parser.add_argument("--threads", type=one_or_more, default=2)
    parser.add_argument("--rounds", type=one_or_more, default=5)
    options = parser.parse_args()
    scene = build_scene()
    skilled = load_plan(options.episode).actions[:, :-1]
    low, high = scene.action_low[:-1], scene.action_high[:-1]
    replayed = np.repeat(skilled[:, None], options.envs, axis=1)
    drawn = np.random.default_rng(0).uniform(low, high, replayed.shape)
    for title, ctrl in ("random", drawn), ("skilled", replayed):
        entered = contestants(ctrl, options.threads)
        rounds = [{name: run() for name, run in entered.items()} for _ in range(options.rounds)]
        speeds = {name: np.median([each[name] for each in rounds], axis=0) for name in entered}
        what = f"{title} controls, N = {options.envs}, {options.threads} thread(s)"
        print(f"\n{what}, MuJoCo {mujoco.__version__}\n")
        print("| | steps/s | of ours | steps per CPU second | of ours |")
        print("| --- | --- | --- | --- | --- |")
        for name, (speed, of_cpu) in speeds.items():
            ratio, ratio_of_cpu = speeds[name] / speeds["ours"]
            figures = f"{speed:.0f} | {ratio:.2f} | {of_cpu:.0f} | {ratio_of_cpu:.2f}"
            print(f"| {name} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
