"""Makes the task and the agent that play a song, from names and options."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Agent, Progress, silent
from cadenza.agents.planner.planner import Planner
from cadenza.agents.planner.practice.practised_planner import PractisedHands
from cadenza.agents.playback import Playback, SavedPlan, load_plan
from cadenza.agents.registry import (
    AGENTS,
    PLANNER,
    PLAYBACK,
    PRETRAINED,
    agent_options,
    checked_agent,
    make_agent,
    options_name,
)
from cadenza.configs import MAX_SEED, as_config, whole_number
from cadenza.errors import CadenzaError, CadenzaWarning, quoted
from cadenza.hub import is_on_hub
from cadenza.learning.policy_folder import LearntPolicy, load_policy
from cadenza.learning.pretrained import pretrained_folder
from cadenza.music.arrangement import Arrangement
from cadenza.music.goals import held_pedal_changes, merged_notes
from cadenza.music.score import Score
from cadenza.performing.arranging import HandArrangement, arranged_for
from cadenza.performing.source import PRACTICE, PRACTISED, Song, Source, resolve
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.threads import MAX_THREADS
from cadenza.tasks.config import TaskConfig, task_identity, with_time_to_begin
from cadenza.tasks.goal_track import GoalTrack, check_written_hands
from cadenza.tasks.piano_task import PianoTask

SomeAgent = str | Path | Agent


@dataclass(frozen=True)
class Selection:
    """A song and who is to play it."""

    source: Source
    name: str
    """The name of the agent."""
    agent: Agent
    config: Any = None
    """The options of the agent, if it has any."""
    task: TaskConfig = field(default_factory=with_time_to_begin)
    """The task; for a policy, the one that it was trained with."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    """The scene; for a plan, with the physics that it was made in."""
    learnt: LearntPolicy | None = None
    plan: SavedPlan | None = None
    seed: int = 0
    """Seed of everything random."""
    num_threads: int | None = None
    """Number of threads of an agent that can use several; by default its own, or one for each
    hand."""

    @property
    def score(self) -> Score:
        """The song that is to be played."""
        return self.source.score

    def with_score(self, score: Score) -> Selection:
        """Returns this selection with another score of the song."""
        return replace(self, source=replace(self.source, score=score))

    def with_options(
        self,
        task: TaskConfig | None = None,
        scene: SceneConfig | None = None,
        seed: int = 0,
        num_threads: int | None = None,
    ) -> Selection:
        """Returns the same with the options that are given.

        Raises:
            CadenzaError: an option makes no sense.
        """
        if num_threads is not None:
            num_threads = whole_number(num_threads, "num_threads", 1, MAX_THREADS)
        return replace(
            self,
            task=as_config(self.task if task is None else task, TaskConfig),
            scene=as_config(self.scene if scene is None else scene, SceneConfig),
            seed=whole_number(seed, "seed", 0, MAX_SEED),
            num_threads=num_threads,
        )


@dataclass(frozen=True)
class Setup:
    """A task and an agent that play once, and the options that were chosen."""

    score: Score
    """The song in its own time and pitch; the task may stretch and transpose it."""
    agent: Agent
    task: PianoTask
    seed: int
    settings: dict[str, Any]
    """The options by name, as JSON has them; and `remarks` on what of the song is not played."""
    options: dict[str, Any]
    """The options that have to be the same for a plan to play the same."""
    arrangement: HandArrangement | None = None
    """The song as it was arranged for the hands, if it was."""

    @property
    def num_steps(self) -> int:
        """The number of control steps of the episode."""
        return int(self.task.goals.num_steps[0])


def select(
    song: Song | Source,
    agent: SomeAgent | None = None,
    *,
    arrangement: Arrangement | None = None,
    configs: Mapping[str, Any] | None = None,
    plan: str | Path | None = None,
) -> Selection:
    """Loads a song and whoever is to play it.

    Args:
        song: see `cadenza.load_song`; a score; or what `resolve` has made of it.
        agent: a name of `cadenza.agents.registry`, the folder of a policy, which may lie on the
            hub as `hub:OWNER/NAME`, `module:Class`, or an agent. Where there is none, the policy
            or the practised plan plays whose folder is the song, or the planner.
        arrangement: which notes of a song that is a name or a path.
        configs: agent's name -> its options, see `make_agent`.
        plan: the file whose actions "playback" plays.

    Raises:
        CadenzaError: the song or the agent is not there, or cannot be used.
    """
    source = song if isinstance(song, Source) else resolve(song, arrangement)
    selection = partial(Selection, source)
    if agent is None and plan is None and (own := source.practised) is not None:
        task, scene = own.config(TaskConfig), own.config(SceneConfig)
        return _played_back(partial(selection, task=task, scene=scene), own, configs)
    if agent is None and source.policy is not None:
        agent = source.name
    if not isinstance(agent, str | Path | None):
        name = type(agent).__name__
        agent = checked_agent(agent, name)
        return selection(name=name, agent=agent, config=agent.config)
    name = PLANNER if agent is None else str(agent)
    if (name == PLAYBACK) != (plan is not None):
        raise CadenzaError("--agent playback and --plan FILE go together: give both or neither")
    if not isinstance(plan, str | Path | None):
        raise CadenzaError(f"plan {quoted(plan)}: give the path of a file")
    if plan is not None:
        saved = load_plan(Path(plan))
        scene = replace(SceneConfig(), **saved.physics)
        return _played_back(partial(selection, scene=scene), saved, configs)
    if (learnt := _policy(name, source)) is not None:
        return _with_policy(selection(name=name, agent=learnt.agent), learnt)
    config, options = (configs or {}).get(name), agent_options(name)
    config = config if options is None else as_config(config, options)
    return selection(name=name, agent=make_agent(name, config), config=config)


def _played_back(
    selection: Callable[..., Selection], plan: SavedPlan, configs: Mapping[str, Any] | None
) -> Selection:
    """Returns who plays a plan: open loop or, if it was practised, with feedback and a search.

    `configs` has the options of the planner that hold for the search.
    """
    if plan.practised is None:
        return selection(name=PLAYBACK, agent=Playback(plan.actions), plan=plan)
    config = Planner((configs or {}).get(PLANNER)).config
    if config.effort:
        raise CadenzaError(
            f"{plan.path}: is played as it was practised; leave out --planner.effort, or practise "
            "more: cadenza practice"
        )
    return selection(name=PLAYBACK, agent=PractisedHands(plan.practised, config), plan=plan)


def _policy(agent: str, source: Source) -> LearntPolicy | None:
    """Returns the policy that `agent` names, None where it names another agent."""
    if agent == PRETRAINED:
        return load_policy(pretrained_folder(source.name))
    if agent == source.name and source.policy is not None:
        return source.policy
    if not is_policy_folder(agent):
        return None
    if any((Path(agent) / name).is_file() for name in (PRACTISED, PRACTICE)):
        raise CadenzaError(
            f"{agent}: holds a song that was practised, not a policy; give it as the song, "
            "without an agent"
        )
    return load_policy(agent)


def is_policy_folder(agent: str) -> bool:
    """Returns whether an agent is named by the folder of a policy, which may lie on the hub."""
    return agent not in AGENTS.own and (os.path.isdir(agent) or is_on_hub(agent))


def _with_policy(selection: Selection, learnt: LearntPolicy) -> Selection:
    """Returns the selection with a policy, in the task and the scene that it was trained in."""
    if learnt.score is None or not learnt.has_learnt(selection.score):
        mine = selection.source.written_for(learnt.scene.hands)
        selection = replace(selection, source=mine)
    if learnt.score is not None and not learnt.has_learnt(selection.score):
        what = f"{selection.name}: was trained on {quoted(learnt.score.title)}"
        if learnt.score.title == selection.score.title:
            what += " in another arrangement, or a part of it"
        if learnt.residual:
            raise CadenzaError(f"{what}, with residual learning, so it can play nothing else")
        warnings.warn(f"{what}, not {selection.source.name}", CadenzaWarning, stacklevel=4)
    # Plans are made for fingers that are found, and demonstrations of any song have such.
    found = learnt.residual or learnt.score is None
    score = selection.score.without_fingers() if found else selection.score
    selection = selection.with_score(score)
    return replace(selection, task=learnt.task, scene=learnt.scene, learnt=learnt)


@contextmanager
def set_up(selection: Selection, progress: Progress = silent) -> Iterator[Setup]:
    """Yields what to play, in the task and the scene of the selection.

    Args:
        selection: what is played, who plays, and how.
        progress: is told of "fingers", which are looked for before anyone plays.

    Raises:
        CadenzaError: the agent cannot play with these options.
    """
    task, scene, seed = selection.task, selection.scene, selection.seed
    options = task_identity(task, scene, seed, **asdict(selection.source.arrangement))
    if selection.plan is not None:
        _check_plan(selection.plan, options, scene)
    settings = _settings(selection)
    looking = partial(progress, "fingers")
    built = build_scene(scene)
    whole = mine = selection.score
    if not _is_learnt(selection):
        selection = replace(selection, source=selection.source.written_for(scene.hands))
        mine = selection.score
    check_written_hands(task, mine, selection.source.name)
    arranged = _arranged(selection, built, progress)
    if arranged is not None:
        selection = selection.with_score(arranged.arranged.score)
    with (
        closing(PianoTask([selection.score], task, built, progress=looking)) as piano_task,
        _with_threads(selection.agent, selection.num_threads),
    ):
        remarks = list(_lost_between_steps(piano_task.tracks[0]))
        remarks += _about_hands(piano_task.tracks[0], whole, mine)
        for loss in remarks:
            warnings.warn(f"{selection.source.name}: {loss}", CadenzaWarning, stacklevel=4)
        remarks = [*selection.score.remarks, *remarks]
        if arranged is not None:
            said = f"{selection.source.name}: {arranged}; as written: --arrange off"
            warnings.warn(said, CadenzaWarning, stacklevel=4)
            remarks.insert(0, str(arranged))  # it changes most
        if remarks:
            settings["remarks"] = remarks
        if selection.learnt is not None:
            selection.learnt.check(selection.name, piano_task)
        score, agent = selection.score, selection.agent
        yield Setup(score, agent, piano_task, seed, settings, options, arranged)


def _arranged(selection: Selection, scene: Scene, progress: Progress) -> HandArrangement | None:
    """Arranges a song for the hands, but not one that was learnt or practised as it is."""
    learnt, arrangement = selection.learnt, selection.source.arrangement
    if _is_learnt(selection):
        if learnt is not None and arrangement.asks_for_hands:
            raise CadenzaError(
                f"{selection.name}: plays this song as it has learnt it; leave out --arrange and "
                "--level"
            )
        return None
    return arranged_for(selection.source, scene, selection.task, progress)


def _is_learnt(selection: Selection) -> bool:
    """Whether the song was learnt or practised as it is."""
    learnt = selection.learnt
    return selection.source.practised is not None or (
        learnt is not None and learnt.score is not None and learnt.has_learnt(selection.score)
    )


def _about_hands(track: GoalTrack, whole: Score, mine: Score) -> Iterator[str]:
    """Yields what one hand leaves to the other, and what is not played as it is written for hands.

    Args:
        track: the song as the task plays it.
        whole: all notes of the song.
        mine: those that are written for the hands of the scene.
    """
    if others := len(whole.notes) - len(mine.notes):
        (side,) = track.scene.sides
        what = "1 note is" if len(mine.notes) == 1 else f"{len(mine.notes)} notes are"
        yield (f"{what} written for the {side} hand; without the other {others} (all: --all-notes)")
    if track.config.hands_as_written:
        notes = track.with_found_fingers().fingered().score.notes
        moved = sum(bool(n.finger and n.hands and n.finger.hand not in n.hands) for n in notes)
        if moved:
            what, are = ("note", "is") if moved == 1 else ("notes", "are")
            yield f"{moved} {what} that the written hand cannot play {are} left to the other"


def _lost_between_steps(track: GoalTrack) -> Iterator[str]:
    """Yields what of the song control steps are too long for: repeated notes, pedal changes."""
    dt = track.config.control_timestep
    if count := merged_notes(track.score, track.goals):
        repeat, are = ("note repeats", "is") if count == 1 else ("notes repeat", "are")
        yield (
            f"{count} {repeat} too fast for control steps of {dt:g} s, "
            f"and {are} played as one with the note before"
        )
    if count := held_pedal_changes(track.score, dt, track.goals.sustain[track.silent_steps :]):
        changes, are = ("change", "is") if count == 1 else ("changes", "are")
        yield (
            f"{count} {changes} of the pedal within a control step of {dt:g} s {are} left out "
            "(with repeats shortened, it comes up)"
        )


def _check_plan(plan: SavedPlan, options: dict[str, Any], scene: SceneConfig) -> None:
    """Raises a CadenzaError if a plan would not play the same with these options."""
    plan.check(options)
    made_in = replace(SceneConfig(), **plan.physics).physics
    if scene.physics != made_in:
        made = f"{plan.path}: made in the {made_in} physics"
        played = f"{made}, played in the {scene.physics} physics"
        warnings.warn(played, CadenzaWarning, stacklevel=4)


def _settings(selection: Selection) -> dict[str, Any]:
    """Returns what was chosen, see `Setup.settings`."""
    settings: dict[str, Any] = {
        "song": selection.source.name,
        "agent": selection.name,
        "seed": selection.seed,
        "plan": None if selection.plan is None else str(selection.plan.path),
        "arrangement": asdict(selection.source.arrangement),
        "task": asdict(selection.task),
        "scene": asdict(selection.scene),
    }
    if is_dataclass(selection.config) and not isinstance(selection.config, type):
        settings[options_name(selection.name)] = asdict(selection.config)
    return settings


@contextmanager
def _with_threads(agent: Agent, num_threads: int | None) -> Iterator[None]:
    """Gives the agent `num_threads` threads and linear algebra one; closes the agent afterwards."""
    if num_threads is not None:
        agent.num_threads = num_threads
    try:
        with threadpool_limits(1):  # its last bits depend on how many threads share it
            yield
    finally:
        agent.close()
