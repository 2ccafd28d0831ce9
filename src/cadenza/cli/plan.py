"""`cadenza plan`: how to play a song, kept as actions and fingers."""

from __future__ import annotations

import shlex
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from cadenza.cli.arrangement import Arrangement
from cadenza.cli.performing import (
    Performing,
    build_task,
    perform,
    print_scores,
    print_what_was_lost,
    score_of,
    with_time_to_begin,
)
from cadenza.cli.results import check_name, check_writable
from cadenza.errors import CadenzaError
from cadenza.model.config import SceneConfig


@dataclass(frozen=True)
class Plan(Performing):
    """Plan how to play a song, and keep the actions and the fingers.

    Example: cadenza plan OdeToJoy -o joy.npz
    """

    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The plan, a .npz file; played/SONG/plan.npz by default. Which finger plays which note stands
    as text beside it, in a file of the same name that ends in .fingering."""
    seed: int = 0
    """Of everything random; the same seed plans the same."""


def plan(command: Plan) -> None:
    from cadenza.agents.planning.misses import misses_of
    from cadenza.agents.planning.score_planner import ScorePlanner
    from cadenza.agents.replay import options_of, save_plan
    from cadenza.music.fingering_file import SUFFIX, write_fingering

    path = command.output or command.default_folder / "plan.npz"
    check_name(path, ".npz", "a plan is a .npz file")
    score = score_of(command.song, command.arrangement)
    agent = ScorePlanner(command.planner)
    task = build_task(score, command)
    check_writable(path.parent)
    with closing(task):
        performance = perform(task, agent, command.seed, "planning")
    if performance.episode.num_steps < task.sheets.num_steps[0]:
        raise CadenzaError(
            f"{command.song}: ended after {performance.episode.num_steps} of "
            f"{task.sheets.num_steps[0]} steps, at a wrong key or an unstable simulation, so that "
            "there is no whole plan to keep; try another seed"
        )
    # The notes are the same in the same order; times and pitches are again those of the file.
    notes = zip(score.notes, agent.plan.score.notes, strict=True)
    fingered = replace(score, notes=tuple(replace(n, finger=m.finger) for n, m in notes))
    options = options_of(command.task, command.scene, command.seed, **asdict(command.arrangement))
    save_plan(path, performance.episode, performance.metrics, options, fingered)
    write_fingering(fingered, path.with_suffix(SUFFIX))
    print_scores(performance)
    misses = misses_of(performance.episode, agent.plan)
    print_what_was_lost(agent.plan, performance, misses)
    print(f"\nFingers in {path.with_suffix(SUFFIX)}; to see and hear the plan:")
    print(shlex.join(["cadenza", "play", command.song, *_to_replay(command, path)]))


def _to_replay(command: Plan, path: Path) -> list[str]:
    """The options with which "cadenza play" replays what `command` has planned."""
    flags = ["--agent", "replay", "--plan", str(path)]
    for options, default in (
        (command.task, with_time_to_begin()),
        (command.scene, SceneConfig()),
        (command.arrangement, Arrangement()),
    ):
        for name, value in asdict(options).items():
            if value == getattr(default, name):
                continue
            flag = name.replace("_", "-")
            if isinstance(value, bool):
                flags.append(f"--{'' if value else 'no-'}{flag}")
            else:
                values = value if isinstance(value, tuple) else (value,)
                flags += [f"--{flag}", *map(str, values)]
    return [*flags, *(["--seed", str(command.seed)] if command.seed else [])]
