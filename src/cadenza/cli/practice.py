"""`cadenza practice`: the hands practise a song, and keep how they play it best."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cadenza.agents.registry import PLANNER
from cadenza.cli.arguments import Quiet
from cadenza.cli.output import check_writable
from cadenza.cli.performing import Again, Performing, default_folder, selected, setting_up
from cadenza.cli.play import keep
from cadenza.cli.progress import progress, stages
from cadenza.cli.stopping import asked_to_stop
from cadenza.errors import CadenzaError
from cadenza.files import locked
from cadenza.music.bars import places

if TYPE_CHECKING:
    from cadenza.agents.planning.practice import Practice
    from cadenza.performing.practising import Practising

_BETWEEN = 20.0  # [s] at least between two times that practice is kept
_LATE = 0.999  # of a step, so that a bar that begins within it has begun


@dataclass(frozen=True)
class PracticeCommand(Performing):
    """Practise a song: play it, go back to what fails, and keep what is better.

    Ctrl-C ends practice and keeps the best so far. The same command continues it, and "cadenza play
    FOLDER" plays the result.

    Example: cadenza practice FurEliseOpening -o elise --minutes 5
    """

    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder of practice and its results; played/SONG/practised by default."""
    effort: float | None = None
    """Practise until the effort is this much in all, 8 by default. 1 is 100 simulated control
    steps for each control step of the song and each hand. The same effort gives the same result."""
    minutes: float | None = None
    """Practise for so many minutes instead."""
    seed: int = 0
    """Random seed."""
    video: bool = True
    """Write video.mp4, if this machine can render."""
    quiet: Quiet = False

    of_ours = (PLANNER,)


def run(command: PracticeCommand, _: Again[PracticeCommand]) -> None:
    from cadenza.performing.practising import Practising
    from cadenza.performing.setup import PRACTISED

    _check(command)
    selection = selected(command, PLANNER)
    folder = command.output or default_folder(selection) / "practised"
    check_writable(folder)
    with locked(folder) as ours, setting_up(selection, command, command.seed) as setup:
        if not ours:
            raise CadenzaError(
                f"{folder}: somebody practises there; choose another folder with --output"
            )
        with stages("planning") as tell:
            practising = Practising(setup, folder, tell)
        with asked_to_stop("this passage") as stop:
            _practise(practising, command, stop)
            stopped = stop()
        practising.save()
        plan = practising.plan()
        plan.save(folder / PRACTISED)
        keep(plan.performance, folder, command.video)
    if stopped:
        print(f"stopped; the same command goes on in {folder}", file=sys.stderr)
        raise KeyboardInterrupt


def _check(command: PracticeCommand) -> None:
    from cadenza.agents.planning.practice import MOST_EFFORT

    if command.effort is not None and command.minutes is not None:
        raise CadenzaError("--effort and --minutes: give one of them")
    for name, most in ("effort", MOST_EFFORT), ("minutes", 1e6):
        value = getattr(command, name)
        if value is not None and not 0 <= value <= most:
            raise CadenzaError(f"--{name} {value}: choose 0 to {most:.0f}")
    if command.configs[PLANNER].effort:
        raise CadenzaError("--planner.effort is for other commands; give --effort")


def _practise(practising: Practising, command: PracticeCommand, stop: Callable[[], bool]) -> None:
    """Until the effort has been made, or the time is over, or `stop`; keeps it now and then."""
    from cadenza.agents.planning.config import ENOUGH
    from cadenza.agents.planning.practice import MOST_EFFORT

    practice, began = practising.practice, time.monotonic()
    minutes, effort = command.minutes, ENOUGH if command.effort is None else command.effort
    told, kept, saving = len(practice.history), began, 0.0
    with progress("practising", "%" if minutes is None else "s") as advance:

        def goes_on() -> bool:
            nonlocal told, kept, saving
            now = time.monotonic()
            for row in practice.history[told:]:
                print("effort {:.2g}: F1 {:.3f}, note onsets F1 {:.3f}".format(*row))
            told = len(practice.history)
            if minutes is None:
                done, total = 100 * practice.share_made(effort), 100.0
            else:
                done, total = now - began, 60 * minutes
            advance(int(min(done, total)), int(total), _where(practice))
            if now - kept > max(_BETWEEN, 20 * saving):
                practising.save()
                kept = time.monotonic()
                saving = kept - now
            return not stop() and (minutes is None or done < total)

        practice.run(MOST_EFFORT if minutes is not None else effort, goes_on)
        goes_on()
    if practice.history and (left := practice.passages()):
        print(f"not yet right: {_places(practice, left)}")


def _where(practice: Practice) -> str:
    """What is worked on, and what remains."""
    passages = len(practice.passages())
    so_far = f"F1 {practice.history[-1][1]:.3f}, " if practice.history else ""
    how = "another take, " if practice.plays_another_take else ""
    left = f"{passages} passage{'s'[: passages != 1]} left"
    return f"{so_far}{how}{_places(practice, practice.at)}, {left}"


def _places(practice: Practice, steps: Iterable[int]) -> str:
    """Such as "bars 3, 7-9"."""
    track = practice.plan.track
    dt = track.config.control_timestep
    return places(track.on_the_clock, [dt * (step + _LATE) for step in steps])
