"""Players and tasks, made once from names and options of a performance."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Agent, Progress, silent
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
    options_name,
)
from cadenza.configs import MAX_SEED, as_config, whole_number
from cadenza.errors import CadenzaError, CadenzaWarning, counted, quoted
from cadenza.files import TENSORS
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.policy_folder import load_policy
from cadenza.learning.pretrained import pretrained_folder
from cadenza.music.arrangement import Arrangement, LoadedSong, SomeSong, load
from cadenza.music.goals import held_pedal_changes, merged_notes
from cadenza.music.score import Score
from cadenza.performing.arranging import HandArrangement, arranged_for
from cadenza.scene.config import SceneConfig, check_modules
from cadenza.scene.scene import build_scene
from cadenza.sim.threads import MAX_THREADS
from cadenza.tasks.config import TaskConfig, task_identity
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.piano_task import PianoTask

PRACTICE = f"practice{TENSORS}"  # the state of practice of a song in a folder
PRACTICE_SETTINGS = "practice.json"  # its task and scene

SomeAgent = str | Path | Agent | LearntPolicy


@dataclass(frozen=True)
class Player:
    """An agent with its song, and the task and scene in which it plays."""

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
        """The song or the notes written for the hands, whichever was learnt or practised.

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
    """Find the player of a song.

    Raises CadenzaError if the agent is not there, or cannot be used.

    Args:
        agent: a name of `cadenza.agents.registry`; `module:Class`; the folder of a policy, of a
            training run or of practice; a policy on the hub, as `hub:OWNER/NAME`; a policy; or an
            agent. None is the planner.
        song: the song, by whose name "pretrained" finds its policy.
        configs: agent's name -> its options, see `make_agent`. The planner's options hold for
            practised plans, too.
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
    """The player of a plan: open loop or, if it was practised, with feedback and a search."""
    if not isinstance(plan, str | Path):
        raise CadenzaError(f"plan {quoted(plan)}: give the path of a file")
    saved = load_plan(Path(plan))
    agent = _practised_hands(saved, configs) or Playback(saved.actions)
    return Player(PLAYBACK, agent, scene=replace(SceneConfig(), **saved.physics), plan=saved)


def _practised_hands(plan: SavedPlan, configs: Mapping[str, Any]) -> PractisedHands | None:
    if plan.practised is None:
        return None
    config: PlannerConfig = configs.get(PLANNER) or PlannerConfig()
    if config.effort:
        raise CadenzaError(
            f"{plan.path}: is played as it was practised; leave out --planner.effort, or practise "
            "more: cadenza practice"
        )
    return PractisedHands(plan.practised, config)


def _practised(name: str, configs: Mapping[str, Any]) -> Player | None:
    """The player of the practised song in a folder; None if nothing was practised there."""
    folder = Path(name)
    if not (path := folder / PRACTISED).is_file():
        if any((folder / file).is_file() for file in (PRACTICE, PRACTICE_SETTINGS)):
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


@dataclass(frozen=True)
class Setup:
    """A task and an agent that play once, and the options that were chosen."""

    score: Score  # the song in its own time and pitch; the task may stretch and transpose it
    agent: Agent
    task: PianoTask
    seed: int
    # The options by name, as in JSON; and `remarks` on parts of the song that are not played
    settings: dict[str, Any]
    options: dict[str, Any]  # the options that decide how a plan is played, see `task_identity`
    # The song as it was arranged for the hands, if it was
    arrangement: HandArrangement | None = None

    @property
    def num_steps(self) -> int:
        """The number of control steps of the episode."""
        return int(self.task.goals.num_steps[0])


@contextmanager
def set_up(
    song: SomeSong | LoadedSong | None,
    player: Player,
    *,
    arrangement: Arrangement | None = None,
    seed: int = 0,
    num_threads: int | None = None,
    progress: Progress = silent,
) -> Iterator[Setup]:
    """Load a song, and yield its task and player.

    Raises CadenzaError if the song is not there, an option makes no sense, or song and player do
    not go together.

    Args:
        song: see `cadenza.load_song`, or a score; None for the one that the agent has learnt.
        player: the player, with its task and its scene.
        arrangement: which notes of the song.
        seed: of everything random.
        num_threads: of an agent that can use several; by default its own, or one for each hand.
        progress: is called with "fingers", which are found before the song is played.
    """
    seed = whole_number(seed, "seed", 0, MAX_SEED)
    if num_threads is not None:
        num_threads = whole_number(num_threads, "num_threads", 1, MAX_THREADS)
    chosen, is_known = _chosen_song(song, arrangement, player)
    options = task_identity(player.task, player.scene, seed, **asdict(chosen.arrangement))
    if player.plan is not None:
        player.plan.check(options)
    scene = build_scene(player.scene)
    played = chosen if is_known else chosen.written_for(player.scene.hands)
    track, arranged = arranged_for(played, scene, player.task, progress, as_it_is=is_known)
    score = played.score if arranged is None else arranged.arranged.score
    with (
        closing(PianoTask([track], player.task, scene)) as task,
        closing(player.agent),
        threadpool_limits(1),  # the last bits of linear algebra depend on how many there are
    ):
        if num_threads is not None:
            player.agent.num_threads = num_threads
        lost = [*_lost_between_steps(track), *_about_hands(track, chosen.score, played.score)]
        about = [] if arranged is None else [str(arranged)]  # it changes most
        for remark in (*lost, *(f"{each}; as written: --arrange off" for each in about)):
            warnings.warn(f"{chosen.name}: {remark}", CadenzaWarning, stacklevel=4)
        if player.policy is not None:
            player.policy.check(player.name, task.spec)
        settings: dict[str, Any] = {
            "song": chosen.name,
            "agent": player.name,
            "seed": seed,
            "plan": None if player.plan is None else str(player.plan.path),
            "arrangement": asdict(chosen.arrangement),
            "task": asdict(player.task),
            "scene": asdict(player.scene),
        }
        if is_dataclass(config := player.agent.config) and not isinstance(config, type):
            settings[options_name(player.name)] = asdict(config)
        if remarks := [*about, *score.remarks, *lost]:
            settings["remarks"] = remarks
        yield Setup(score, player.agent, task, seed, settings, options, arranged)


def _chosen_song(
    song: SomeSong | LoadedSong | None, arrangement: Arrangement | None, player: Player
) -> tuple[LoadedSong, bool]:
    """The given song or the player's own, and whether the player knows it.

    Raises CadenzaError if there is none, or the player cannot play it.
    """
    if song is None:
        if player.song is None:
            raise CadenzaError(f"no song to play: give one; {player.name} has learnt none")
        if arrangement is not None and arrangement.chosen:
            raise CadenzaError(
                f"{player.name}: plays its song as it was trained or practised; leave out "
                "--tracks, --plain, --arrange, --level, --first-seconds and --expression"
            )
        return player.song, True
    chosen = load(song, arrangement)
    known = player.known(chosen)
    if player.song is not None:
        if known is None:
            _check_other_song(chosen, player, player.song)
        elif chosen.arrangement.asks_for_hands:
            raise CadenzaError(
                f"{player.name}: plays this song as it has learnt it; leave out --arrange and "
                "--level"
            )
        elif player.policy is None:  # the fingers are those of practice
            return player.song, True
    chosen = known or chosen
    # Plans are made for fingers that are found, and demonstrations of any song have such.
    if player.policy is not None and (player.policy.residual or player.song is None):
        chosen = replace(chosen, score=chosen.score.without_fingers())
    return chosen, known is not None


def _check_other_song(song: LoadedSong, player: Player, known: LoadedSong) -> None:
    """Warn that a player plays a song that it does not know, or raise CadenzaError if it cannot."""
    learnt = "was trained on" if player.policy is not None else "has practised"
    what = f"{player.name}: {learnt} {quoted(known.score.title)}"
    if known.score.title == song.score.title:
        what += " in another arrangement, or a part of it"
    if player.policy is None:
        raise CadenzaError(f"{what}, and can play nothing else; leave out the song")
    if player.policy.residual:
        raise CadenzaError(f"{what}, with residual learning, so it can play nothing else")
    warnings.warn(f"{what}, not {song.name}", CadenzaWarning, stacklevel=5)


def _about_hands(track: GoalTrack, song: Score, own: Score) -> Iterator[str]:
    """Yield remarks on notes that are left to the other hand, or left out.

    `song` has all notes, `own` the notes written for the hands of the scene.
    """
    if missing := len(song.notes) - len(own.notes):
        (side,) = track.scene.sides
        are = "is" if len(own.notes) == 1 else "are"
        yield (
            f"{counted(len(own.notes), 'note')} {are} written for the {side} hand; without the "
            f"other {missing} (all: --all-notes)"
        )
    if track.config.hands_as_written:
        notes = track.with_found_fingers().fingered().score.notes
        moved = sum(bool(n.finger and n.hands and n.finger.hand not in n.hands) for n in notes)
        if moved:
            are = "is" if moved == 1 else "are"
            notes_left = counted(moved, "note")
            yield f"{notes_left} that the written hand cannot play {are} left to the other"


def _lost_between_steps(track: GoalTrack) -> Iterator[str]:
    """Yield remarks on repeated notes and pedal changes that are too fast for control steps."""
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
