"""Measures how soon PPO learns on a GPU: one song from nothing, and many with one policy.

    python -m benchmarks.gpu_learning [--output gpu_learning.csv] [--worlds 4096] [--engine warp]

It takes less than eight minutes: Twinkle until an evaluation in C has F1 0.95, but three minutes at
most; then one policy for the 24 bundled pieces for as long, which afterwards plays those that it
has learnt and etudes that it has not seen, in C. Compiling counts. The table is written anew after
each part. On CPU cores, try --engine c --worlds 32.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.arguments import one_or_more, parser_for
from benchmarks.gpu import device_name, print_table
from cadenza.agents.rollout import play_episode
from cadenza.errors import errors_in_a_line
from cadenza.evaluation.tables import write_csv
from cadenza.learning.config import TrainingConfig, preset
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import begin
from cadenza.music.libraries.library import load_score
from cadenza.music.libraries.songs import songs
from cadenza.music.score import Score
from cadenza.scene.config import Engine, SceneConfig
from cadenza.tasks.piano_task import PianoTask

SONG, ENOUGH = "TwinkleTwinkleLittleStar", 0.95  # F1
UNSEEN = ("etudes/scales-1-0", "etudes/notes-3-0", "etudes/dyads-2-0")
MINUTES = 3.0  # of each part
STEPS = 8  # of a rollout: with thousands of worlds, updates would be too rare after more
UPDATES = 40  # after each rollout, as on a CPU
PASSES = 10  # over a rollout
ROUNDS = 20  # between evaluations


def configured(worlds: int, engine: Engine) -> TrainingConfig:
    """The preset fast for so many worlds, with short rollouts and with large batches."""
    config = preset("fast", learner="ppo")
    rollout = STEPS * worlds
    learner = replace(config.learner, batch_size=PASSES * rollout // UPDATES)
    return replace(
        config,
        learner=learner,
        num_envs=worlds,
        train_freq=STEPS,
        gradient_steps=UPDATES,
        scene=SceneConfig(engine=engine),
        eval_interval=ROUNDS * rollout,
        log_interval=rollout,
        num_steps=10**10,  # the clock ends it
    )


def learn(
    scores: Sequence[Score], config: TrainingConfig, minutes: float, enough: float = 1.0
) -> tuple[dict[str, Any], LearntPolicy]:
    """Learns until an evaluation is good enough, or for so many minutes.

    Returns:
        A row of the table, and the policy.
    """
    start = time.perf_counter()
    reached: dict[str, float] = {}
    with (
        TemporaryDirectory() as folder,
        closing(begin(config, scores, RunFolder(Path(folder)))) as run,
    ):

        def goes_on() -> bool:
            seconds = time.perf_counter() - start
            if run.best.get("eval/f1", 0.0) >= enough:
                reached.setdefault("seconds", seconds)
            return not reached and seconds < 60 * minutes

        run.run(goes_on)
        row = {
            "songs": len(scores),
            "worlds": config.num_envs,
            "engine": config.scene.engine,
            "steps": run.step,
            "seconds": round(time.perf_counter() - start),
            "seconds_to_enough": round(reached["seconds"]) if reached else "",
            "f1": round(run.best["eval/f1"], 4) if run.best else "",
            "note_onset_f1": round(run.best["eval/note_onset_f1"], 4) if run.best else "",
            "unseen_f1": "",
            "device": device_name(),
        }
        return row, run.learnt()


def played(learnt: LearntPolicy, scores: Sequence[Score]) -> float:
    """The mean F1 with which a policy plays songs in C."""
    f1 = []
    for score in scores:
        with closing(PianoTask([score], learnt.task, learnt.scene)) as task:
            f1.append(play_episode(task, learnt.agent).metrics["f1"])
    return float(np.mean(f1))


@errors_in_a_line()
def main() -> None:
    """Measures, prints a table in Markdown and writes it as CSV."""
    parser = parser_for(__doc__)
    parser.add_argument("--output", type=Path, default=Path("gpu_learning.csv"))
    parser.add_argument("--worlds", type=one_or_more, default=4096)
    parser.add_argument("--engine", choices=("warp", "c"), default="warp")
    parser.add_argument("--minutes", type=float, default=MINUTES)
    options = parser.parse_args()
    config = configured(options.worlds, options.engine)
    row, _ = learn([load_score(SONG)], config, options.minutes, ENOUGH)
    rows = [row]
    write_csv(options.output, rows)
    every = replace(config, prune_inputs=False)  # songs with other keys are played afterwards
    pieces = [load_score(piece.name) for piece in songs()]
    row, learnt = learn(pieces, every, options.minutes)
    unseen = [load_score(name) for name in UNSEEN]
    rows.append(row | {"unseen_f1": round(played(learnt, unseen), 4)})
    write_csv(options.output, rows)
    print_table(rows)


if __name__ == "__main__":
    main()
