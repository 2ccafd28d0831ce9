"""Measures the task on a GPU: control steps a second of thousands of worlds.

    python -m benchmarks.gpu [--output gpu.csv] [--worlds 256 1024 4096 8192]

It is meant to take less than eight minutes, compiling included: no batch begins after --minutes.
Actions are drawn uniformly in each step ("random"), or replay a performance of CMajorScaleTwoHands
with noise of 1 % of the range, so that worlds differ ("skilled"). Each batch is compiled and warmed
up before the clock runs. The table is written anew after each batch. Without a GPU everything runs
on the CPU, slowly: try --worlds 4 --steps 5.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.arguments import one_or_more, parser_for
from cadenza.agents.playback import load_plan
from cadenza.errors import CadenzaError, errors_in_a_line, extra_packages
from cadenza.evaluation.tables import write_csv
from cadenza.music.libraries.library import load_score
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.setups import setup_named

with errors_in_a_line(), extra_packages("gpu", "this benchmark"):
    import jax
    import jax.numpy as jnp

    from cadenza.sim.warp import WarpPhysics
    from cadenza.tasks.functional import FunctionalPianoTask, PianoState

PAPERS = TaskConfig(**setup_named("paper").of(TaskConfig))
SONG = "CMajorScaleTwoHands"  # of the recorded performance
EPISODE = Path(__file__).parents[1] / "tests/data/episode_d.npz"
WORLDS = (256, 1024, 4096, 8192)
STEPS = 100  # of each batch while the clock runs
NOISE = 0.01  # on skilled actions in [-1, 1]
MINUTES = 5.0  # after which no batch begins: a batch of thousands compiles and runs in two


def advance(
    task: FunctionalPianoTask, plan: Any, state: PianoState, step: Any
) -> tuple[PianoState, dict[str, Any]]:
    """Takes a step with actions of the `plan` (T, A), or at random without one."""
    key = jax.random.fold_in(state.key, step)
    shape = task.num_envs, task.spec.action_size
    if plan is None:
        action = jax.random.uniform(key, shape, minval=-1.0, maxval=1.0)
    else:
        # Each world at its own place in the song, which it begins anew when it is over
        action = plan[state.episodes.steps_done] + NOISE * jax.random.normal(key, shape)
    after = task.step(state, action)
    ended = after.done & after.info["truncation"]
    told = {
        "f1": jnp.where(ended, after.metrics["f1"], 0.0).sum(),
        "ended": ended.sum(),
        "unstable": after.info["unstable"].sum(),
        "overflow": (after.info["overflow"] != 0).sum(),
    }
    return after, told


def measure(
    task: FunctionalPianoTask, plan: NDArray[np.float32] | None, steps: int
) -> dict[str, Any]:
    """A row of the table: how fast `steps` control steps of all worlds are, and how they went."""
    on_device = None if plan is None else jnp.asarray(plan)
    run = jax.jit(partial(jax.lax.scan, partial(advance, task, on_device)))
    state, numbers = task.reset(jax.random.key(0)), jnp.arange(steps)
    start = time.perf_counter()
    state, _ = jax.block_until_ready(run(state, numbers))
    compiled = time.perf_counter()
    _, told = jax.block_until_ready(run(state, numbers + steps))
    seconds = time.perf_counter() - compiled
    totals = {name: float(values.sum()) for name, values in told.items()}
    return {
        "worlds": task.num_envs,
        "actions": "random" if plan is None else "skilled",
        "steps_per_second": round(task.num_envs * steps / seconds),
        "ms_per_step": round(1000 * seconds / steps, 2),
        "first_run_s": round(compiled - start, 1),
        "episodes": int(totals["ended"]),
        "f1": round(totals["f1"] / totals["ended"], 4) if totals["ended"] else "",
        "unstable": int(totals["unstable"]),
        "overflow": int(totals["overflow"]),
        "device": device_name(),
    }


def measured(worlds: Sequence[int], steps: int, minutes: float) -> Iterator[dict[str, Any]]:
    """The rows of these numbers of worlds, as far as they begin within some minutes."""
    begin, song = time.perf_counter(), [load_score(SONG)]
    for num_envs in worlds:
        task = FunctionalPianoTask(song, PAPERS, None, num_envs, WarpPhysics)
        recorded = task.spec.unscale_action(load_plan(EPISODE).actions).astype(np.float32)
        if len(recorded) != int(task.songs.num_steps[0]):
            raise CadenzaError(f"{EPISODE}: {len(recorded)} steps, not those of {SONG}")
        for plan in (None, recorded):
            if (time.perf_counter() - begin) / 60 > minutes:
                print(f"no time for {num_envs} worlds or more: give more --minutes")
                return
            yield measure(task, plan, steps)


def device_name() -> str:
    """The card, or the CPU's kind."""
    device = jax.devices()[0]
    return platform.processor() or "cpu" if device.platform == "cpu" else device.device_kind


def print_table(rows: list[dict[str, Any]]) -> None:
    """Prints rows in Markdown."""
    print("| " + " | ".join(rows[0]) + " |\n|" + " --- |" * len(rows[0]))
    for row in rows:
        print("| " + " | ".join(str(value) for value in row.values()) + " |")


@errors_in_a_line()
def main() -> None:
    """Measures, prints a table in Markdown and writes it as CSV."""
    parser = parser_for(__doc__)
    parser.add_argument("--output", type=Path, default=Path("gpu.csv"))
    parser.add_argument("--worlds", type=one_or_more, nargs="+", default=WORLDS)
    parser.add_argument("--steps", type=one_or_more, default=STEPS)
    parser.add_argument("--minutes", type=float, default=MINUTES)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for row in measured(options.worlds, options.steps, options.minutes):
        rows.append(row)
        print(row, flush=True)
        write_csv(options.output, rows)
    if rows:
        print_table(rows)


if __name__ == "__main__":
    main()
