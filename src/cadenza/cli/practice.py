"""`cadenza practice`: the hands practise a song, and keep how they play it best."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from cadenza.agents.registry import PLANNER
from cadenza.cli.arguments import Quiet
from cadenza.cli.output import check_writable
from cadenza.cli.performing import Again, Performing, default_folder, selected, setting_up
from cadenza.cli.play import keep
from cadenza.cli.practising import practised
from cadenza.cli.stopping import asked_to_stop
from cadenza.errors import CadenzaError
from cadenza.files import checked, read_json
from cadenza.music.arrangement import Arrangement
from cadenza.scene.config import SceneConfig, check_modules
from cadenza.tasks.config import TaskConfig


@dataclass(frozen=True)
class PracticeCommand(Performing):
    """Practise a song: play it, go back to what fails, and keep what is better.

    Ctrl-C ends practice and keeps the best so far. The same command continues it, and so does
    "cadenza practice FOLDER"; "cadenza play FOLDER" plays the result.

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
    refused = ("randomization", "wrong_press_termination")


def run(command: PracticeCommand, again: Again[PracticeCommand]) -> None:
    from cadenza.agents.planner.config import ENOUGH
    from cadenza.performing.performance import check_replaceable

    command = _going_on(command, again)
    _check(command)
    selection = selected(command, PLANNER)
    folder = command.output or default_folder(selection) / "practised"
    check_writable(folder)
    check_replaceable(folder, command.song)
    effort = ENOUGH if command.effort is None else command.effort
    with (
        setting_up(selection, command, command.seed) as setup,
        asked_to_stop("this passage, and writing the results") as stop,
        practised(setup, folder, effort, command.minutes, stop=stop) as practising,
    ):
        assert practising.performance is not None
        keep(practising.performance, folder, command.video)
        stopped = stop()
    if stopped:
        print(f"stopped; the same command goes on in {folder}", file=sys.stderr)
        raise KeyboardInterrupt


def _going_on(command: PracticeCommand, again: Again[PracticeCommand]) -> PracticeCommand:
    """As was practised in the folder that is given as the song, unless another is to be begun."""
    from cadenza.agents.planner.config import PlannerConfig
    from cadenza.performing.setup import PRACTISED_HOW, practised_plan

    folder = Path(command.song)
    elsewhere = command.output is not None and command.output.resolve() != folder.resolve()
    if elsewhere or practised_plan(command.song) is None:
        return command
    where = folder / PRACTISED_HOW
    if not where.exists():
        where = folder / "settings.json"  # of folders that earlier versions made
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
    return replace(again(replace(command, **before)), song=before["song"], output=folder)


def _check(command: PracticeCommand) -> None:
    from cadenza.agents.planner.practice.practice import MOST_EFFORT

    if command.effort is not None and command.minutes is not None:
        raise CadenzaError("--effort and --minutes: give one of them")
    for name, most in ("effort", MOST_EFFORT), ("minutes", 1e6):
        value = getattr(command, name)
        if value is not None and not 0 <= value <= most:
            raise CadenzaError(f"--{name} {value}: choose 0 to {most:.0f}")
    if command.configs[PLANNER].effort:
        raise CadenzaError("--planner.effort is for other commands; give --effort")
    if command.task.wrong_press_termination:
        raise CadenzaError(
            "--wrong-press-termination: a song that ends early cannot be played as it was "
            "practised; leave it out"
        )
    if command.task.randomization.is_on:
        raise CadenzaError(
            "--randomization: hands practise with the nominal model; give it to "
            '"cadenza play FOLDER", to hear what becomes of what was practised'
        )
