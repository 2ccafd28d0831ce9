"""Who plays: an agent by its name, a policy, a practised song, or a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cadenza.agents.agent import Agent
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.practice.practised_planner import PractisedHands
from cadenza.agents.playback import Playback, SavedPlan, load_plan
from cadenza.agents.registry import (
    PLANNER,
    PLAYBACK,
    PRACTISED,
    PRETRAINED,
    checked_agent,
    is_folder,
    make_agent,
)
from cadenza.configs import as_config
from cadenza.errors import CadenzaError, quoted
from cadenza.files import TENSORS
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.policy_folder import load_policy
from cadenza.learning.pretrained import pretrained_folder
from cadenza.music.arrangement import Arrangement, LoadedSong
from cadenza.scene.config import SceneConfig, check_modules
from cadenza.tasks.config import TaskConfig

PRACTICE = f"practice{TENSORS}"  # how far the song of a folder has been practised
PRACTISED_HOW = "practice.json"  # in what task and scene

SomeAgent = str | Path | Agent | LearntPolicy


@dataclass(frozen=True)
class Player:
    """An agent, and what it knows: its song, and the task and scene that it plays in."""

    name: str
    agent: Agent
    task: TaskConfig = field(default_factory=TaskConfig)
    """The task; of a policy or of practice, the one in which it was made."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    """The scene; of a plan, one with the physics that it was made in."""
    song: LoadedSong | None = None
    """The song that was learnt or practised, if it is one."""
    policy: LearntPolicy | None = None
    plan: SavedPlan | None = None

    def playing_in(self, task: TaskConfig | None, scene: SceneConfig | None) -> Player:
        """The player in another task and scene, if given; raises CadenzaError for a wrong type."""
        task = as_config(self.task if task is None else task, TaskConfig)
        scene = as_config(self.scene if scene is None else scene, SceneConfig)
        return replace(self, task=task, scene=scene)

    def known(self, song: LoadedSong) -> LoadedSong | None:
        """The song, or what is written for the hands, if just that was learnt or practised.

        Fingers may differ. None if neither was. Raises CadenzaError if nothing is written for the
        one hand that plays.
        """
        if self.song is None:
            return None
        notes = _without_fingers(self.song)
        if _without_fingers(song) == notes:
            return song
        song = song.written_for(self.scene.hands)
        return song if _without_fingers(song) == notes else None


def find_player(
    agent: SomeAgent | None = None,
    song: object = None,
    *,
    configs: Mapping[str, Any] | None = None,
    plan: str | Path | None = None,
) -> Player:
    """Find who plays.

    Raises CadenzaError if the agent is not there, or cannot be used.

    Args:
        agent: a name of `cadenza.agents.registry`; `module:Class`; the folder of a policy, of a
            training run or of practice; a policy on the hub, as `hub:OWNER/NAME`; a policy; or an
            agent. None is the planner.
        song: the song, by whose name "pretrained" finds its policy.
        configs: agent's name -> its options, see `make_agent`. Those of the planner hold for the
            search of what was practised, too.
        plan: the file whose actions "playback" plays.
    """
    configs = configs or {}
    if isinstance(agent, LearntPolicy):
        return _with_policy("policy", agent)
    if (agent == PLAYBACK) != (plan is not None):
        raise CadenzaError("--agent playback and --plan FILE go together: give both or neither")
    if plan is not None:
        return _with_plan(plan, configs)
    if not isinstance(agent, str | Path | None):
        name = type(agent).__name__
        return Player(name, checked_agent(agent, name))
    name = PLANNER if agent is None else str(agent)
    if name == PRETRAINED:
        folder = str(pretrained_folder(str(song or "")))
    elif is_folder(name):
        folder = name
    else:
        return Player(name, make_agent(name, configs.get(name)))
    return _practised(folder, configs) or _with_policy(name, load_policy(folder))


def _without_fingers(song: LoadedSong) -> tuple[object, object]:
    return song.score.without_fingers().notes, song.score.pedal


def _with_plan(plan: str | Path, configs: Mapping[str, Any]) -> Player:
    """Who plays a plan: open loop or, if it was practised, with feedback and a search."""
    if not isinstance(plan, str | Path):
        raise CadenzaError(f"plan {quoted(plan)}: give the path of a file")
    saved = load_plan(Path(plan))
    agent = _practised_hands(saved, configs) or Playback(saved.actions)
    return Player(PLAYBACK, agent, scene=replace(SceneConfig(), **saved.physics), plan=saved)


def _practised_hands(plan: SavedPlan, configs: Mapping[str, Any]) -> PractisedHands | None:
    if plan.practised is None:
        return None
    config = as_config(configs.get(PLANNER), PlannerConfig)
    if config.effort:
        raise CadenzaError(
            f"{plan.path}: is played as it was practised; leave out --planner.effort, or practise "
            "more: cadenza practice"
        )
    return PractisedHands(plan.practised, config)


def _practised(name: str, configs: Mapping[str, Any]) -> Player | None:
    """Who plays the practised song in a folder; None if nothing was practised there."""
    folder = Path(name)
    if not (path := folder / PRACTISED).is_file():
        if any((folder / file).is_file() for file in (PRACTICE, PRACTISED_HOW)):
            raise CadenzaError(
                f"{name}: practice has not played the song to the end yet; run the same command "
                "again that practised there"
            )
        return None
    plan = load_plan(path)
    hands = _practised_hands(plan, configs)
    if hands is None or plan.score is None:
        raise CadenzaError(f"{path}: holds no song that was practised; use another copy")
    scene = plan.config(SceneConfig)
    check_modules(scene, path)
    song = LoadedSong(plan.score.title, plan.score, plan.config(Arrangement))
    return Player(name, hands, task=plan.config(TaskConfig), scene=scene, song=song, plan=plan)


def _with_policy(name: str, policy: LearntPolicy) -> Player:
    song = None if policy.score is None else LoadedSong(policy.score.title, policy.score)
    return Player(name, policy.agent, policy.task, policy.scene, song, policy)
