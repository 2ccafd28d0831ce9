"""`cadenza play`: the hands play a song, and leave a folder of results."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from cadenza.cli.performing import (
    WithOtherPlanners,
    agent_named,
    build_task,
    learnt_policy,
    perform,
    print_scores,
    print_what_was_lost,
    score_of,
    with_time_to_begin,
)
from cadenza.cli.progress import progress
from cadenza.cli.results import check_writable, plain, write_json
from cadenza.errors import CadenzaError
from cadenza.model.config import SceneConfig

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cadenza.agents.agent import Agent
    from cadenza.agents.planning.misses import Miss
    from cadenza.agents.play import Performance
    from cadenza.agents.rl.policy_folder import LearntPolicy
    from cadenza.music.score import Score
    from cadenza.tasks.piano_task import PianoTask


@dataclass(frozen=True)
class Play(WithOtherPlanners):
    """Have the hands play a song, and leave sound, video, scores and a page to look at.

    Example: cadenza play OdeToJoy -o joy
    """

    agent: str = "planner"
    """Who plays: planner, predictive-sampling, ilqg, tracked-presses, zero or random; replay, which
    plays the actions of --plan; pretrained, the policy that comes with a song; or the folder of a
    policy."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the results; played/SONG by default. Files of an earlier run are replaced."""
    seed: int = 0
    """Of everything random; the same seed plays the same."""
    plan: Path | None = None
    """For --agent replay: what "cadenza plan" wrote, or another .npz file with an array "action"
    (T, A) in actuator units."""
    video: bool = True
    """Write video.mp4 too, where this machine can draw."""


def play(command: Play) -> None:
    from cadenza.agents.planning.misses import misses_of
    from cadenza.agents.planning.score_planner import ScorePlanner
    from cadenza.agents.planning.tracked_presses import TrackedPresses

    score = score_of(command.song, command.arrangement)
    if (learnt := learnt_policy(command.agent, command.song)) is not None:
        score, command = _as_learnt(learnt, score, command)
    agent = _player(command)
    if command.plan is not None:
        command = _as_planned(command.plan, command)
    task = build_task(score, command)
    folder = command.output or command.default_folder
    check_writable(folder)
    with closing(task):
        performance = perform(task, agent, command.seed, "playing")
    plan = agent.plan if isinstance(agent, ScorePlanner | TrackedPresses) else None
    misses = misses_of(performance.episode, plan) if plan else None
    _write_results(folder, command, performance, task, misses)
    print_scores(performance)
    if plan and misses is not None:
        print_what_was_lost(plan, performance, misses)
    print(f"\nOpen {folder / 'report.html'}")


def _as_learnt(learnt: LearntPolicy, score: Score, command: Play) -> tuple[Score, Play]:
    """With the options that the policy was trained with, but for those that the user changed."""

    def changed(options: Any, default: Any) -> dict[str, Any]:
        values = vars(options)
        return {name: v for name, v in values.items() if v != getattr(default, name)}

    task = replace(learnt.task, **changed(command.task, with_time_to_begin()))
    scene = replace(learnt.scene, **changed(command.scene, SceneConfig()))
    if learnt.plan is not None:
        score, known = score.without_fingers(), learnt.score.without_fingers()
        if (score.notes, score.pedal) != (known.notes, known.pedal):
            raise CadenzaError(
                f"{command.agent}: corrects the plan of {known.title!r} and plays nothing else"
            )
    return score, replace(command, task=task, scene=scene)


def _player(command: Play) -> Agent:
    from cadenza.agents.replay import ReplayAgent, load_plan

    if command.agent == "replay" and command.plan is not None:
        return ReplayAgent(load_plan(command.plan))
    if command.agent == "replay" or command.plan is not None:
        raise CadenzaError("--agent replay and --plan FILE.npz go together: give both or neither")
    return agent_named(command.agent, command)


def _as_planned(plan: Path, command: Play) -> Play:
    """In the physics of the plan; its other options must be those of the command."""
    from cadenza.agents.replay import check_options, options_of, physics_of

    check_options(
        plan, options_of(command.task, command.scene, command.seed, **asdict(command.arrangement))
    )
    scene = replace(command.scene, **physics_of(plan))
    if scene.physics != command.scene.physics:
        print(f"{plan}: was made in the {scene.physics} physics, played in it", file=sys.stderr)
    return replace(command, scene=scene)


def _write_results(
    folder: Path,
    command: Play,
    performance: Performance,
    task: PianoTask,
    misses: Sequence[Miss] | None,
) -> None:
    """`misses` of those that follow a plan; it has to be known to say why."""
    from cadenza.music.midi import write_midi
    from cadenza.music.performance import performed_score
    from cadenza.report.page import write_report
    from cadenza.report.sound import synthesize

    episode, metrics = performance.episode, performance.metrics
    settings = plain(asdict(command))
    played = performed_score(
        episode["key_activation"], episode["sustain_activation"], episode.dt, episode["key_qpos"]
    )
    episode.save(folder / "episode.npz")
    write_json(folder / "metrics.json", metrics)
    write_json(folder / "settings.json", settings)
    lost = [asdict(miss) for miss in misses or ()]
    if misses is not None:
        write_json(folder / "misses.json", lost)
    write_midi(played, folder / "played.mid")
    with progress("writing sound and page", "files") as advance:
        advance(0, 2)
        audio = synthesize(played)
        advance(1, 2)
        write_report(folder / "report.html", episode, metrics, settings, audio, misses=lost)
    if command.video:
        _write_video(folder / "video.mp4", performance, task, audio)


def _write_video(path: Path, performance: Performance, task: PianoTask, audio: Any) -> None:
    from cadenza.report.sound import SAMPLE_RATE
    from cadenza.report.video import write_video
    from cadenza.sim.render import Renderer

    try:
        renderer = closing(Renderer(task.scene))
    except CadenzaError as error:
        print(f"no video: {error}", file=sys.stderr)
        return
    episode = performance.episode
    rows = zip(
        episode["hand_qpos"],
        episode["key_qpos"],
        episode["key_activation"],
        episode["goal_keys"],
        strict=True,
    )
    with renderer as draw, progress("drawing", "frames") as advance:

        def frames() -> Iterator[NDArray[np.uint8]]:
            for done, row in enumerate(rows, start=1):
                yield draw.frame(*row)
                advance(done, episode.num_steps)

        write_video(path, frames(), 1 / episode.dt, audio, SAMPLE_RATE)
