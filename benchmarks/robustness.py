"""Measures how robust plans are against other starts, noisy controls and another model.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.robustness SONG ... [--seeds N] [--agents A ...]

Prints a table in Markdown. Closed loop: the agent sees how the hands really are. Open
loop: its actions without a disturbance are recorded and replayed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.arguments import one_or_more, parser_for
from cadenza.agents.agent import Agent, Array
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episode
from cadenza.errors import errors_in_a_line
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.randomization import SCALED_FIELDS
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.piano_task import PianoTask

SCALED = SCALED_FIELDS.keys() - {"force_limit", "key_travel"}  # nor sizes and limits
AGENTS: dict[str, Callable[[], Agent]] = {
    "refined": Planner,
    "nominal": lambda: Planner(PlannerConfig(method="none")),
}


@dataclass(frozen=True)
class Disturbance:
    """A disturbance of hands, controls or model."""

    name: str
    start: float = 0.0
    """The hands start up to this far to the left or right [m]."""
    noise: float = 0.0
    """Standard deviation of the noise on every control, in units of half its range."""
    model: float = 0.0
    """Parameters of the model are off by up to this share, drawn for each episode."""


DISTURBANCES = (
    Disturbance("nothing"),
    Disturbance("hands start within 5 cm", start=0.05),
    Disturbance("1 % noise on controls", noise=0.01),
    Disturbance("5 % noise on controls", noise=0.05),
    Disturbance("model off by 10 %", model=0.1),
)


def disturbed_task(
    score: Score,
    config: TaskConfig,
    disturbance: Disturbance,
    scene: SceneConfig | None = None,
) -> PianoTask:
    """The task with disturbed hands, controls and model."""
    factors = (1.0 - disturbance.model, 1.0 + disturbance.model)
    model: Any = dict.fromkeys(SCALED, factors)
    randomization = DomainRandomization(**model, control_noise=disturbance.noise)
    disturbed = replace(config, random_hand_position=disturbance.start, randomization=randomization)
    return PianoTask([score], disturbed, scene)


def played_with(
    score: Score, config: TaskConfig, disturbance: Disturbance, agent: Agent, seed: int
) -> tuple[tuple[float, float], Array]:
    """F1 and note onset F1, and the actions (T, A) that the agent chose."""
    performance = play_episode(disturbed_task(score, config, disturbance), agent, seed)
    metrics = performance.metrics
    return (metrics["f1"], metrics["note_onset_f1"]), performance.episode.arrays["action"]


def rows(score: Score, config: TaskConfig, agent: Callable[[], Agent], seeds: int) -> Iterator[str]:
    """A row of the table for each disturbance, means and least over the seeds."""
    nothing = DISTURBANCES[0]
    plans = [played_with(score, config, nothing, agent(), seed)[1] for seed in range(seeds)]
    for disturbance in DISTURBANCES:
        scores = np.array(
            [
                [
                    played_with(score, config, disturbance, player, seed)[0]
                    for player in (agent(), Playback(plan))
                ]
                for seed, plan in enumerate(plans)
            ]
        )
        figures = zip(scores.mean(axis=0), scores[..., 0].min(axis=0), strict=True)
        cells = " | ".join(
            f"{f1:.3f} · {onset:.3f} | {least:.3f}" for (f1, onset), least in figures
        )
        yield f"{disturbance.name} | {cells} |"


@errors_in_a_line()
def main() -> None:
    """Plays and prints, agent by agent."""
    parser = parser_for(__doc__)
    parser.add_argument("songs", nargs="+", help="bundled pieces or MIDI files")
    parser.add_argument("--seeds", type=one_or_more, default=5)
    parser.add_argument("--agents", nargs="+", choices=AGENTS, default=["refined"])
    parser.add_argument("--initial-buffer-time", type=float, default=0.5, help="[s]")
    options = parser.parse_args()
    config = TaskConfig(initial_buffer_time=options.initial_buffer_time)
    print("| song | agent | disturbance | closed loop | least | open loop | least |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for song in options.songs:
        for name in options.agents:
            for row in rows(load_score(song), config, AGENTS[name], options.seeds):
                print(f"| {song} | {name} | {row}", flush=True)


if __name__ == "__main__":
    main()
