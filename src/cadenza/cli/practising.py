"""Practising in a folder: how far it has got, what remains, Ctrl-C."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cadenza.cli.progress import Advance, progress, stages
from cadenza.errors import CadenzaError
from cadenza.files import locked
from cadenza.music.score import describe_times

if TYPE_CHECKING:
    from cadenza.agents.planner.practice.practice import Practice
    from cadenza.music.score import Score
    from cadenza.performing.practising import Practising
    from cadenza.performing.setup import Setup

_BETWEEN = 20.0  # [s] at least between two times that practice is saved, or its plan
_LATE = 0.999  # of a step, so that a bar that begins within it has begun


@contextmanager
def practised(
    setup: Setup,
    folder: Path,
    effort: float,
    minutes: float | None = None,
    *,
    stop: Callable[[], bool],
) -> Iterator[Practising]:
    """Practises in a folder, which others keep out of for the block.

    Args:
        setup: of the planner.
        folder: where practice is kept.
        effort: how much in all, counting what was made before.
        minutes: how long instead.
        stop: is often asked whether that is enough.

    Yields:
        What was practised; it is kept.
    """
    from cadenza.performing.practising import Practising, check_is_practice

    check_is_practice(folder)
    with locked(folder) as ours:
        if not ours:
            raise CadenzaError(
                f"{folder}: somebody practises there; choose another folder with --output"
            )
        with stages("planning") as tell:
            practising = Practising(setup, folder, tell)
        _practise(practising, effort, minutes, stop)
        practising.save()
        practising.save_plan()
        yield practising


def _practise(
    practising: Practising, effort: float, minutes: float | None, stop: Callable[[], bool]
) -> None:
    """Until the effort has been made, or the time is over, or `stop`; keeps it now and then."""
    from cadenza.agents.planner.practice.practice import MOST_EFFORT

    practice = practising.practice
    score, told = practice.plan.track.delayed_score, len(practice.history)
    # Apart: the whole song is played to save its plan, which takes much longer.
    saved, plan_saved = _NowAndThen(practising.save), _NowAndThen(practising.save_plan)
    with _shown(practice, effort, minutes) as show:

        def goes_on() -> bool:
            nonlocal told
            played_first = not told and bool(practice.history)
            for row in practice.history[told:]:
                print("effort {:.2g}: F1 {:.3f}, note onsets F1 {:.3f}".format(*row))
            told = len(practice.history)
            time_left = show(_where(practice, score))
            saved.again(at_once=played_first)
            if practice.history:
                plan_saved.again(at_once=played_first)
            return not stop() and time_left

        practice.run(effort if minutes is None else MOST_EFFORT, goes_on)
        goes_on()
    if not practice.history:
        print("stopped within the first take; what follows is played as planned, without a search")
    elif left := practice.steps_with_loss() if score.bars else practice.passages_with_loss():
        print(f"not yet right: {_places(practice, score, left)}")


class _NowAndThen:
    """Something that is done again and again, in a twentieth of the time at most."""

    def __init__(self, do: Callable[[], None]) -> None:
        self._do, self._done, self._took = do, time.monotonic(), 0.0

    def again(self, at_once: bool) -> None:
        """Does it if it is time to, or anyway."""
        began = time.monotonic()
        if at_once or began - self._done > max(_BETWEEN, 20 * self._took):
            self._do()
            self._done = time.monotonic()
            self._took = self._done - began


@contextmanager
def _shown(
    practice: Practice, effort: float, minutes: float | None
) -> Iterator[Callable[[str], bool]]:
    """What to call with a remark to show how far practice is; it says whether any time is left.

    The first take, which counts for no effort, and what is finished after the effort are shown by
    themselves: what they take says nothing of how long the rest will take.
    """
    began, stage = time.monotonic(), ""
    advance: Advance
    with ExitStack() as shown:

        def show(remark: str) -> bool:
            nonlocal stage, advance
            now, unit, done, total = _how_far(practice, effort, minutes, time.monotonic() - began)
            if now != stage:
                shown.close()
                stage, advance = now, shown.enter_context(progress(now, unit))
            advance(int(min(done, total)), int(total), remark)
            return minutes is None or done < total

        yield show


def _how_far(
    practice: Practice, effort: float, minutes: float | None, seconds: float
) -> tuple[str, str, float, float]:
    """What is being done, in which unit, how much is done and of how much, after `seconds`."""
    if minutes is not None:
        return "practising", "s", seconds, 60 * minutes
    stage, done, total = practice.progress(effort)
    return stage, "%" if stage == "practising" else "steps", done, total


def _where(practice: Practice, score: Score) -> str:
    """What is worked on of a score, and what remains."""
    passages = len(practice.passages_with_loss())
    so_far = ""
    if practice.history:
        so_far = "F1 {1:.3f}, note onsets F1 {2:.3f}, ".format(*practice.history[-1])
    how = "another take, " if practice.plays_variant else ""
    left = f"{passages} passage{'s'[: passages != 1]} left"
    return f"{so_far}{how}{_places(practice, score, practice.current_steps)}, {left}"


def _places(practice: Practice, score: Score, steps: Iterable[int]) -> str:
    """Such as "bars 3, 7-9"."""
    dt = practice.plan.track.config.control_timestep
    return describe_times(score, [dt * (step + _LATE) for step in steps])
