"""Verdicts on performances, in a pianist's words, and advice where much was lost."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from cadenza.agents.planner.misses import Miss
from cadenza.errors import counted
from cadenza.fingers import SIDES
from cadenza.music.arrangement import HARDEST
from cadenza.music.metrics import ONSET_TOLERANCE, note_errors
from cadenza.music.score import MS_PER_SECOND, Score

_AUDIBLE = 0.02  # [s], from which a delay or unevenness is heard
_STEP = 16  # MIDI velocities between two dynamics such as mp and mf
_MIN_F1 = 0.88  # F1 below which a song is lost in part: the mean of whole pieces is 0.9
_MAX_MISSED = 0.1  # share of missed notes, beyond which a song is lost in part
_OUT_OF_REACH = ("no finger", "out of reach")  # causes against which more time does not help
_SLOWER = 1.5  # times as long


class Advice(NamedTuple):
    """What to try, in words, and as an option of a command."""

    words: str
    option: str

    def __str__(self) -> str:
        return f"{self.words} ({self.option})"


def verdict(played: Score, written: Score, metrics: Mapping[str, Any]) -> str:
    """How well a song was played, as a sentence with its figures, see `expressive_metrics`.

    Notes of one key that begin within 50 ms of each other are in time; others are early or late if
    they begin within 0.2 s. `written` is the score on the same clock, up to where it was played.
    """
    errors, notes = note_errors(written.notes, played.notes), counted(len(written.notes), "note")
    off_time, missed, extra = errors.missed.off_time, errors.missed, errors.extra
    all_hit = len(errors.pairs) == len(written.notes) > 1
    share = "All" if all_hit else f"{len(errors.pairs)} of"
    parts = [f"{share} {notes} in time (within {_ms(ONSET_TOLERANCE)})"]
    if off_time:
        parts += [f"{len(off_time)} early or late"]
    if num_missed := len(missed.held) + len(missed.silent):
        parts += [f"{num_missed} missed"]
    if num_extra := len(extra.again) + len(extra.neighbour) + len(extra.other):
        parts += [f"{counted(num_extra, 'note')} that nobody wrote"]
    return f"{', '.join([*parts, *_expression(metrics)])}."


def _expression(metrics: Mapping[str, Any]) -> list[str]:
    """Timing and loudness of the notes that were hit; nothing if none was."""
    delay, unevenness = metrics["onset_delay"], metrics["onset_error_median"]
    loudness = metrics["velocity_error"]
    if delay is None or unevenness is None or loudness is None:
        return []
    is_even, deviation = unevenness < _AUDIBLE, _ms(unevenness)
    parts = [f"evenly timed to {deviation}" if is_even else f"timing {deviation} uneven"]
    if abs(delay) >= _AUDIBLE:
        parts += [f"{_ms(abs(delay))} {'late' if delay > 0 else 'early'} throughout"]
    if loudness < _STEP / 2:
        return [*parts, "loudness as written"]
    error = "half a step" if loudness < _STEP else "a step or more"
    return [*parts, f"loudness {error} off what is written (mp to mf is a step)"]


def _ms(seconds: float) -> str:
    return f"{seconds * MS_PER_SECOND:.0f} ms"


def advice(
    misses: Sequence[Miss], num_notes: int, f1: float, settings: dict[str, Any], arranged: bool
) -> Advice | None:
    """Advice on a song of `num_notes` notes; None if it was played well enough.

    `settings` are the performance's, `arranged` says whether the song was arranged for the hands.
    """
    missed = [miss.cause for miss in misses if not miss.sounded]
    if not misses or (f1 >= _MIN_F1 and len(missed) <= _MAX_MISSED * num_notes):
        return None
    if arranged or 2 * sum(cause in _OUT_OF_REACH for cause in missed) <= len(missed):
        stretch = _SLOWER * settings["task"]["stretch"]
        words = "Most was lost for want of time: try a slower tempo"
        return Advice(words, f"--stretch {stretch:g}")
    if settings["scene"]["hands"] in SIDES:
        return Advice("Most was lost for want of a hand: try both", "--hands both")
    words = "Most was lost because it is out of reach: try it arranged for the hands"
    return Advice(words, f"--level {HARDEST}")
