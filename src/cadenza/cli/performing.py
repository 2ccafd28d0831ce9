"""What the commands that perform a song share: options, score, task, agents, scores."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cadenza.agents.planning.config import (
    ILQGConfig,
    PredictiveSamplingConfig,
    ScorePlannerConfig,
    TrackedPressesConfig,
)
from cadenza.cli.arrangement import Arrangement
from cadenza.cli.progress import stages
from cadenza.errors import CadenzaError
from cadenza.model.config import SceneConfig
from cadenza.tasks.config import TaskConfig

if TYPE_CHECKING:
    from cadenza.agents.agent import Agent
    from cadenza.agents.planning.misses import Miss
    from cadenza.agents.planning.song_plan import SongPlan
    from cadenza.agents.play import Performance
    from cadenza.agents.rl.policy_folder import LearntPolicy
    from cadenza.music.score import Score
    from cadenza.tasks.piano_task import PianoTask

_AGENTS = (
    "planner",
    "predictive-sampling",
    "ilqg",
    "tracked-presses",
    "zero",
    "random",
    "pretrained",
)


def with_time_to_begin() -> TaskConfig:
    """From where they start, the hands cannot sound a note at time 0."""
    return TaskConfig(initial_buffer_time=0.5)


@dataclass(frozen=True)
class Performing:
    """What all that perform a song have in common."""

    song: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SONG")]
    """A bundled song (see "cadenza songs"), the path of a MIDI file, or the folder of a policy,
    which holds the song that it has learnt."""
    arrangement: tyro.conf.OmitArgPrefixes[Arrangement] = field(default_factory=Arrangement)
    task: tyro.conf.OmitArgPrefixes[TaskConfig] = field(default_factory=with_time_to_begin)
    scene: tyro.conf.OmitArgPrefixes[SceneConfig] = field(default_factory=SceneConfig)
    planner: ScorePlannerConfig = field(default_factory=ScorePlannerConfig)

    @property
    def default_folder(self) -> Path:
        return Path("played") / Path(self.song).stem


@dataclass(frozen=True)
class WithOtherPlanners(Performing):
    """The planners to compare with have options of their own."""

    predictive_sampling: PredictiveSamplingConfig = field(default_factory=PredictiveSamplingConfig)
    ilqg: ILQGConfig = field(default_factory=ILQGConfig)
    tracked_presses: TrackedPressesConfig = field(default_factory=TrackedPressesConfig)


def score_of(song: str, arrangement: Arrangement) -> Score:
    """What SONG names, with remarks on it for whoever gave it."""
    from cadenza.agents.rl.policy_folder import load_policy

    if Path(song).is_dir():
        if arrangement.chosen:
            raise CadenzaError(f"{song}: holds its song as it was learnt; give no tracks of it")
        return load_policy(Path(song)).score
    score = arrangement.score(song)
    for remark in score.remarks:
        print(f"{song}: {remark}", file=sys.stderr)
    if len(score.tracks) > 2 and not arrangement.chosen:
        print(
            f"{song}: all {len(score.tracks)} tracks are played at once; choose some of those that "
            f'"cadenza info" lists, as in --tracks 1 3, or --reduce melody-bass',
            file=sys.stderr,
        )
    return score


def build_task(score: Score, command: Performing) -> PianoTask:
    """The score in the scene of the command."""
    from cadenza.tasks.piano_task import PianoTask

    return PianoTask([score], command.task, command.scene)


def agent_named(name: str, command: WithOtherPlanners) -> Agent:
    """With the options of the command."""
    from cadenza.agents.agent import RandomAgent, ZeroAgent
    from cadenza.agents.planning.ilqg import ILQG
    from cadenza.agents.planning.predictive_sampling import PredictiveSampling
    from cadenza.agents.planning.score_planner import ScorePlanner
    from cadenza.agents.planning.tracked_presses import TrackedPresses

    match name:
        case "planner":
            return ScorePlanner(command.planner)
        case "predictive-sampling":
            return PredictiveSampling(command.predictive_sampling)
        case "ilqg":
            return ILQG(command.ilqg)
        case "tracked-presses":
            return TrackedPresses(command.tracked_presses)
        case "zero":
            return ZeroAgent()
        case "random":
            return RandomAgent()
    if (learnt := learnt_policy(name, command.song)) is not None:
        return learnt.agent
    raise CadenzaError(
        f"no agent {name!r}: choose from {', '.join(_AGENTS)}, or give the folder of a policy"
    )


def learnt_policy(agent: str, song: str) -> LearntPolicy | None:
    """The policy that `agent` names, None where it names another agent."""
    from cadenza.agents.rl.policy_folder import load_policy
    from cadenza.agents.rl.pretrained import pretrained_folder

    if agent == "pretrained":
        return load_policy(pretrained_folder(song))
    return load_policy(Path(agent)) if Path(agent).is_dir() else None


def perform(task: PianoTask, agent: Agent, seed: int, doing: str) -> Performance:
    """Plays one episode; `doing` stands at its progress, after what has to be planned first."""
    from cadenza.agents.play import play as play_episode

    with stages(doing) as tell:
        return play_episode(task, agent, seed, tell)


def print_scores(performance: Performance) -> None:
    """How well it was played, and how long that took."""
    metrics = performance.metrics
    print(
        f"F1 {metrics['f1']:.3f}  precision {metrics['precision']:.3f}  "
        f"recall {metrics['recall']:.3f}  note onsets F1 {metrics['note_onset_f1']:.3f}"
    )
    print(
        f"{metrics['steps']} steps, return {metrics['return']:.1f}, "
        f"planned in {metrics['planning_seconds']:.1f} s and "
        f"simulated in {metrics['playing_seconds']:.1f} s for "
        f"{seconds_of_music(performance):.1f} s of music"
    )
    if metrics["unstable"]:
        print("the simulation became unstable and the episode ended early", file=sys.stderr)


def seconds_of_music(performance: Performance) -> float:
    """What was played of it, where an episode ended early."""
    return performance.episode.num_steps * performance.episode.dt


def print_what_was_lost(plan: SongPlan, performance: Performance, misses: Sequence[Miss]) -> None:
    """How many notes, and why."""
    from collections import Counter

    from cadenza.agents.planning.misses import in_a_line

    print(in_a_line(misses, performance.episode))
    reasons = Counter(reason for _, reason in plan.dropped)
    for reason, count in reasons.most_common():
        print(f"{count} of them have no finger: {reason}")
