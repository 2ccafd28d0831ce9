"""Measures what the fast physics changes: it replays recorded performances in both physics.

    python -m benchmarks.physics tests/data/episode_d.npz ...

Prints the F1 of each performance as it was recorded and, since a few hundredths of a millimetre
decide whether a finger catches on a key, of the same actions with a little noise on them.
"""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from benchmarks.arguments import parser_for
from cadenza.agents.playback import load_plan
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.files import ANY, read_arrays
from cadenza.music.metrics import step_metrics
from cadenza.music.score import NUM_KEYS
from cadenza.scene.config import Physics, SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.threads import available_cores
from cadenza.tasks.reward import key_activation

NOISE = 0.01  # standard deviation, in units of half the control range
NUM_NOISY = 32


def variations(plan: NDArray[np.float64], scene: Scene) -> NDArray[np.float64]:
    """The plan (T, A) as it is, and NUM_NOISY times with noise, (1 + NUM_NOISY, T, A)."""
    half_range = (scene.action_high - scene.action_low) / 2
    noise = np.random.default_rng(0).standard_normal((1 + NUM_NOISY, *plan.shape))
    noise[0] = 0.0
    return np.clip(plan + NOISE * half_range * noise, scene.action_low, scene.action_high)


def replayed_f1(
    plan: NDArray[np.float64], goal: NDArray[np.bool_], scene: Scene, dt: float
) -> NDArray[np.float64]:
    """F1 of each variation of the plan, (1 + NUM_NOISY,), in control steps of `dt` [s]."""
    ctrl = variations(plan, scene)[..., :-1]
    simulation = PlanningSimulation(scene, len(ctrl), dt, available_cores())
    played = key_activation(simulation.rollout(ctrl).key_qpos, scene.keyboard.sounds_from)
    simulation.close()
    return np.array([step_metrics(keys, goal)[2].mean() for keys in played])


@errors_in_a_line()
def main() -> None:
    """Replays and prints a table in Markdown."""
    parser = parser_for(__doc__)
    parser.add_argument("episodes", type=Path, nargs="+", help="recorded episodes (.npz)")
    options = parser.parse_args()
    print("| performance | physics | F1 | with noise: mean | least | most |")
    print("| --- | --- | --- | --- | --- | --- |")
    for path in options.episodes:
        plan, about = load_plan(path).actions, read_arrays(path, ANY, 2**30)
        if "goal_obs" not in about:
            raise CadenzaError(f"{path}: no recorded episode, but a plan; give an episode.npz")
        seen = np.concatenate([about["goal_obs0"][None], about["goal_obs"][:-1]])
        goal = seen[:, :NUM_KEYS].astype(bool)
        for physics in get_args(Physics):
            reduced = bool(about["reduced_action_space"])
            scene = build_scene(SceneConfig(physics=physics, reduced_action_space=reduced))
            if plan.shape[1] != len(scene.action_low):
                raise CadenzaError(f"{path}: not played by two Shadow hands as they are by default")
            exact, *noisy = replayed_f1(plan, goal, scene, float(about["dt"]))
            print(
                f"| {about['song']} | {physics} | {exact:.3f} | {np.mean(noisy):.3f} "
                f"| {np.min(noisy):.3f} | {np.max(noisy):.3f} |"
            )


if __name__ == "__main__":
    main()
