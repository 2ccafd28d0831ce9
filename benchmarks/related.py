"""The robots before and ours, on the same few pieces: the tables of docs/related.md.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.related [--settings NAME ...] [--seeds N]

plays what is missing in docs/results/related.csv, a row for each performance. To measure a setting
anew, delete its rows. `make tables` then writes the tables.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.arguments import one_or_more, parser_for
from cadenza.agents.agent import Agent, Array
from cadenza.agents.baselines.icp import ICP
from cadenza.agents.baselines.predictive_sampling import PredictiveSampling
from cadenza.agents.baselines.stitched import Stitched
from cadenza.agents.planner.config import ICPConfig, PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episode
from cadenza.errors import errors_in_a_line
from cadenza.evaluation.tables import write_csv
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.randomization import SCALED_FIELDS
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.setups import setup_named
from cadenza.tasks.view import View

RESULTS = Path(__file__).parents[1] / "docs" / "results" / "related.csv"
SECONDS = 12.0  # of each piece, at most
_NAMES = (
    "CMajorScaleOneHand",
    "TwinkleTwinkleLittleStar",
    "OdeToJoy",
    "MinuetInG",
    "etudes/hanon-3-7",
)
PIECES: dict[str, Callable[[], Score]] = {name: partial(load_score, name) for name in _NAMES}
_OF_A_ROW = "setting", "piece", "disturbance", "seed"
NOTHING = "nothing"
_SCALED = SCALED_FIELDS.keys() - {"force_limit", "key_travel"}  # nor sizes and limits
_MODEL: dict[str, Any] = dict.fromkeys(_SCALED, (0.9, 1.1))
DISTURBANCES = {
    NOTHING: DomainRandomization(),
    "1 % noise on controls": DomainRandomization(control_noise=0.01),
    "5 % noise on controls": DomainRandomization(control_noise=0.05),
    "model off by 10 %": DomainRandomization(**_MODEL),
}


@dataclass(frozen=True)
class Setting:
    """A robot at a piano, and who moves it."""

    agent: Callable[[], Agent]
    scene: SceneConfig = field(default_factory=SceneConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    open_loop: bool = False
    """Whether actions are replayed that the agent chose without a disturbance."""
    disturbances: Collection[str] = (NOTHING,)


def _nominal() -> Agent:
    return Planner(PlannerConfig(method="none"))


_ARM = setup_named("arm-allegro")
ARMS = replace(SceneConfig(), **_ARM.of(SceneConfig))
TIME = replace(TaskConfig(), **_ARM.of(TaskConfig))
SETTINGS: dict[str, Setting] = {
    "planner": Setting(Planner, disturbances=DISTURBANCES),
    "planner-played-back": Setting(Planner, open_loop=True, disturbances=DISTURBANCES),
    "nominal": Setting(_nominal, disturbances=DISTURBANCES),
    "nominal-played-back": Setting(_nominal, open_loop=True, disturbances=DISTURBANCES),
    "stitched": Setting(Stitched, disturbances=DISTURBANCES),
    "arm-icp": Setting(ICP, ARMS, TIME),
    "arm-search": Setting(partial(ICP, ICPConfig("found")), ARMS, TIME),
    "arm-unrehearsed": Setting(partial(ICP, ICPConfig(rehearse=False)), ARMS, TIME),
    "arm-together": Setting(ICP, replace(ARMS, hands="both"), TIME),
    "predictive-sampling": Setting(PredictiveSampling),
}


class Timed(Agent):
    """Another agent, with the seconds of CPU time that it takes.

    Attributes:
        prepare: until its first action.
        total: in all.
    """

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        agent.num_threads = 1
        self.prepare = self.total = 0.0

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        self._agent.reset(env_ids, rngs)

    def act(self, view: View) -> Array:
        began = time.process_time()
        action = self._agent.act(view)
        self.total += time.process_time() - began
        self.prepare = self.prepare or self.total
        return action


def played(
    setting: Setting, score: Score, disturbance: str, seed: int, agent: Agent | None = None
) -> tuple[dict[str, Any], Array]:
    """Figures of a performance, and its actions (T, A)."""
    config = replace(setting.task, randomization=DISTURBANCES[disturbance])
    task = PianoTask([score], config, setting.scene)
    timed = Timed(agent or setting.agent())
    with threadpool_limits(1):
        result = play_episode(task, timed, seed)
    task.close()
    dropped = task.tracks[0].with_found_fingers().fingered().dropped or ()
    row = {name: result.metrics[name] for name in ("f1", "note_onset_f1", "precision", "recall")}
    row |= {
        "music_seconds": result.episode.num_steps * result.episode.dt,
        "notes": len(score.notes),
        "out_of_reach": len(dropped),
        "prepare_cpu_seconds": timed.prepare,
        "cpu_seconds": timed.total,
    }
    return row, result.episode["action"]


def rows(name: str, seeds: int, known: Collection[tuple[str, ...]]) -> Iterator[dict[str, Any]]:
    """Yields the rows of a setting that are not known yet."""
    setting = SETTINGS[name]
    for piece, load in PIECES.items():
        score = load().beginning(SECONDS)
        for seed in range(seeds):
            plan: Agent | None = None
            for disturbance in setting.disturbances:
                of = name, piece, disturbance, str(seed)
                if of in known:
                    continue
                if setting.open_loop and plan is None:
                    plan = Playback(played(setting, score, NOTHING, seed)[1])
                row, _ = played(setting, score, disturbance, seed, plan)
                yield dict(zip(_OF_A_ROW, of, strict=True)) | row


def read() -> list[dict[str, str]]:
    """The rows that there are."""
    if not RESULTS.exists():
        return []
    with RESULTS.open(newline="") as file:
        return list(csv.DictReader(file))


@errors_in_a_line()
def main() -> None:
    """Measures what is missing."""
    parser = parser_for(__doc__)
    parser.add_argument("--settings", nargs="+", choices=SETTINGS, default=list(SETTINGS))
    parser.add_argument("--seeds", type=one_or_more, default=2)
    options = parser.parse_args()
    for name in options.settings:
        known = {tuple(r[column] for column in _OF_A_ROW) for r in read()}
        for row in rows(name, options.seeds, known):
            write_csv(RESULTS, [*read(), row])
            print(
                name, row["piece"], row["disturbance"], row["seed"], f"{row['f1']:.3f}", flush=True
            )


if __name__ == "__main__":
    main()
