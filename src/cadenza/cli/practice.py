"""`cadenza practice`: practice of a song, which keeps its best plan."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from cadenza.agents.registry import PLANNER
from cadenza.cli.arguments import Output, Quiet
from cadenza.cli.options import Options, Read, setting_up
from cadenza.cli.printing import one_after_other, stages, stop_on_signal
from cadenza.cli.saving import check_writable, default_folder, save
from cadenza.errors import CadenzaError, counted
from cadenza.files import checked, read_json
from cadenza.music.arrangement import Arrangement
from cadenza.music.score import describe_times
from cadenza.scene.config import SceneConfig, check_modules
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.robots import Profile

if TYPE_CHECKING:
    from cadenza.agents.planner.practice.practice import Practice
    from cadenza.music.score import Score
    from cadenza.performing.practising import Practising
    from cadenza.performing.setup import Setup

_LATE = 0.999  # share of a step, late enough for a bar that begins within it


@dataclass(frozen=True)
class PracticeCommand(Options):
    """Practise a song: play it, go back to what fails, and keep what is better.

    Ctrl-C keeps the best so far; the same command goes on. "cadenza play --agent FOLDER" plays it.

    Example: cadenza practice FurEliseOpening -o elise --effort 4
    """

    song: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[SONG]")] = None
    """A song by its name (see "cadenza songs"), or a MIDI or MusicXML file."""
    resume: Path | None = None
    """Go on with the practice in this folder, with its song and its options."""
    output: Output[Path | None] = None
    """Folder of practice and its results; played/SONG/practised by default."""
    effort: float | None = None
    """Effort in all, 8 by default, 0 before practice with a robot; 1 is 100 simulated steps for
    each step and hand."""
    minutes: float | None = None
    """Practise for this long instead [min]."""
    robot: str | None = None
    """Practise with an unknown robot, in ten plays: the seed of a simulated one, or module:Name of
    a driver."""
    profile: Profile = "realistic"
    """Profile from which a simulated robot is drawn, or whose delays another robot has."""
    seed: int = 0
    """Random seed."""
    video: bool = False
    """Make a film, too, as "cadenza film" does."""
    quiet: Quiet = False


def run(command: PracticeCommand, read: Read[PracticeCommand]) -> None:
    from cadenza.agents.planner.config import ENOUGH
    from cadenza.performing.performance import check_replaceable
    from cadenza.performing.setup import find_player

    if (command.song is None) == (command.resume is None):
        raise CadenzaError("give a song to practise, or the folder of practice with --resume")
    if command.resume is not None:
        command = _resumed(command.resume, command, read)
    _check(command)
    if command.robot is not None:
        _with_robot(command, command.robot)
        return
    player = find_player(PLANNER, configs=command.configs)
    effort = ENOUGH if command.effort is None else command.effort
    with setting_up(command, command.song, player, command.seed) as setup:
        folder = command.output or default_folder(setup) / "practised"
        check_writable(folder)
        check_replaceable(folder, command.song)
        with (
            stop_on_signal("this passage, and writing the results") as stop,
            practised(setup, folder, effort, command.minutes, stop=stop) as practising,
        ):
            assert practising.performance is not None
            save(practising.performance, folder, command.video)
            stopped = stop()
    if stopped:
        print(f"stopped; the same command goes on in {folder}", file=sys.stderr)
        raise KeyboardInterrupt


def _with_robot(command: PracticeCommand, robot: str) -> None:
    """Practise with a robot, print the scores of each play, and keep all plays."""
    from cadenza.performing.setup import find_player
    from cadenza.performing.with_robot import practise, save

    planner = replace(command.configs[PLANNER], effort=command.effort or 0.0)
    player = find_player(PLANNER, configs={PLANNER: planner})
    with setting_up(command, command.song, player, command.seed) as setup:
        name = f"robot-{command.profile}-{robot.replace(':', '-')}"
        folder = command.output or default_folder(setup) / name
        check_writable(folder)
        for plays, actions in practise(setup, robot, command.profile):
            save(folder, plays, actions)
            print(f"play {len(plays.scores)}: {_scores(*plays.scores[-1])}", flush=True)
        print(f"scored: {_scores(plays.metrics['f1'], plays.metrics['note_onset_f1'])}")
        print(f"wrote {folder}")


def _resumed(
    folder: Path, command: PracticeCommand, read: Read[PracticeCommand]
) -> PracticeCommand:
    """The command with the song and the options of the practice in `folder`.

    Raises CadenzaError if the folder has no settings of practice, or they cannot be read.
    """
    from cadenza.agents.planner.config import PlannerConfig
    from cadenza.performing.setup import PRACTICE_SETTINGS

    where = folder / PRACTICE_SETTINGS
    settings = read_json(where, dict[str, Any]) if where.exists() else {}
    kinds = {"seed": int, "arrangement": Arrangement, "task": TaskConfig, "scene": SceneConfig}
    kinds |= {"song": str, command.options[PLANNER]: PlannerConfig}
    if not kinds.keys() <= settings.keys():
        raise CadenzaError(
            f"{folder}: does not say how it was practised; run the same command again that "
            "practised there"
        )
    before: dict[str, Any] = {
        name: checked(settings[name], kind, where) for name, kind in kinds.items()
    }
    check_modules(before["scene"], where)
    before[command.options[PLANNER]] = replace(before[command.options[PLANNER]], effort=0.0)
    song = before.pop("song")
    return replace(read(**before), song=song, output=folder)


def _check(command: PracticeCommand) -> None:
    from cadenza.agents.planner.config import MAX_EFFORT

    if command.effort is not None and command.minutes is not None:
        raise CadenzaError("--effort and --minutes: give one of them")
    if command.robot is not None and (command.resume or command.minutes or command.video):
        raise CadenzaError(
            "--robot: plays a song ten times; leave out --resume, --minutes, --video"
        )
    for name, limit in ("effort", MAX_EFFORT), ("minutes", 1e6):
        value = getattr(command, name)
        if value is not None and not 0 <= value <= limit:
            raise CadenzaError(f"--{name} {value}: choose 0 to {limit:.0f}")
    if command.configs[PLANNER].effort:
        raise CadenzaError("--planner.effort is for other commands; give --effort")
    if command.task.wrong_press_termination:
        raise CadenzaError(
            "--wrong-press-termination: a song that ends early cannot be played as it was "
            "practised; leave it out"
        )
    if command.scene.engine != "c":
        raise CadenzaError(
            f"--engine {command.scene.engine}: hands practise in the engine c; give it to "
            '"cadenza play --agent FOLDER", to hear what becomes of what was practised'
        )
    if command.task.randomization.is_on:
        raise CadenzaError(
            "--randomization: hands practise with the nominal model; give it to "
            '"cadenza play --agent FOLDER", to hear what becomes of what was practised'
        )


@contextmanager
def practised(
    setup: Setup,
    folder: Path,
    effort: float,
    minutes: float | None = None,
    *,
    stop: Callable[[], bool],
) -> Iterator[Practising]:
    """Practise in a folder, which is locked for the block and keeps the practice.

    The effort includes the effort so far; or practice lasts for some minutes. `stop`, called often,
    ends it.
    """
    from cadenza.performing.practising import Practising, check_is_practice, practice_folder

    check_is_practice(folder)
    resumable = practice_folder(folder)
    with resumable.locked():
        with stages("planning") as progress:
            practising = Practising(setup, resumable, progress)
        _practise(practising, effort, minutes, stop)
        practising.save()
        practising.save_plan()
        yield practising


def _practise(
    practising: Practising, effort: float, minutes: float | None, stop: Callable[[], bool]
) -> None:
    """Practise until the effort is made, the time is over, or `stop`; save it now and then."""
    from cadenza.agents.planner.config import MAX_EFFORT

    practice = practising.practice
    score, num_printed = practice.plan.track.delayed_score, len(practice.history)
    began = time.monotonic()
    with one_after_other() as show:

        def should_continue() -> bool:
            nonlocal num_printed
            played_first = not num_printed and bool(practice.history)
            for row in practice.history[num_printed:]:
                print(f"effort {row[0]:.2g}: {_scores(*row[1:])}")
            num_printed = len(practice.history)
            seconds = time.monotonic() - began
            stage, unit, done, total = _progress(practice, effort, minutes, seconds)
            show(stage, unit, int(min(done, total)), int(total), _remark(practice, score))
            practising.save_if_due(at_once=played_first)
            if practice.history:
                practising.save_plan_if_due(at_once=played_first)
            return not stop() and (minutes is None or done < total)

        practice.run(effort if minutes is None else MAX_EFFORT, should_continue)
        should_continue()
    if not practice.history:
        print("stopped within the first take; what follows is played as planned, without a search")
    elif left := practice.steps_with_faults() if score.bars else practice.passages_with_faults():
        print(f"not yet right: {_places(practice, score, left)}")


def _progress(
    practice: Practice, effort: float, minutes: float | None, seconds: float
) -> tuple[str, str, float, float]:
    """The stage, its unit, units done and units in all, after `seconds`.

    The first take and passages finished after the effort are stages of their own, as their pace is
    another.
    """
    if minutes is not None:
        return "practising", "s", seconds, 60 * minutes
    stage, done, total = practice.progress(effort)
    return stage, "%" if stage == "practising" else "steps", done, total


def _remark(practice: Practice, score: Score) -> str:
    """The remark beside the progress: scores, the present passage, and how many are left."""
    so_far = f"{_scores(*practice.history[-1][1:])}, " if practice.history else ""
    how = "another take, " if practice.plays_variant else ""
    num_left = len(practice.passages_with_faults())
    left = f"{counted(num_left, 'passage')} left" if num_left else "all notes right"
    return f"{so_far}{how}{_places(practice, score, practice.current_steps)}, {left}"


def _scores(f1: float, note_onset_f1: float) -> str:
    return f"F1 {f1:.3f}, note onset F1 {note_onset_f1:.3f}"


def _places(practice: Practice, score: Score, steps: Iterable[int]) -> str:
    """Control steps as bars or times of the score, such as "bars 3, 7-9"."""
    dt = practice.plan.track.config.control_timestep
    return describe_times(score, [dt * (step + _LATE) for step in steps])
