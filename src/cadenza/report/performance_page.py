"""The page of a performance: in three dimensions, with sound, piano roll and scores.

It holds the performance as data, which `recording.js` reads. Arrays over time are differences from
step to step, deflated. Hands are given by their joints' positions, from which the page places
bodies.
"""

import math
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.configs import flat
from cadenza.episode import Episode
from cadenza.fingers import finger_from
from cadenza.music.metrics import matched_notes
from cadenza.music.performance import SAME_NOTE, played_in
from cadenza.music.score import MS_PER_SECOND, Note, Score
from cadenza.report.engraving import engraving_within
from cadenza.report.html_pages import PLAYING, in_base64, render
from cadenza.report.sound import Samples, encode_opus

STYLES = ("uplot.min.css", "page.css", "chart.css", "score.css")
SCRIPTS = (*PLAYING, "rewards.js", "expression.js", "film.js", "page.js")
_HEADLINES = {
    "f1": ("F1", "The balance of precision and recall, 0 to 1. At 1 every key is right, always."),
    "precision": ("Precision", "Of the keys that sound, the share that should, 0 to 1."),
    "recall": ("Recall", "Of the keys that should sound, the share that do, 0 to 1."),
    "note_onset_f1": ("Note onset F1", "Notes that begin within 50 ms of their time, 0 to 1."),
}
"""Title and meaning of the metrics at the top."""
_ARRANGEMENT = {
    "original_f1": ("F1 against the original", "Of all keys of the song as written, 0 to 1."),
    "original_note_onset_f1": ("Note onset F1 against it", "Of all of its notes, 0 to 1."),
    "melody_kept": ("Melody kept", "The share of its notes that the arrangement has, 0 to 1."),
    "bass_kept": ("Bass kept", "The share of its notes, in any octave, 0 to 1."),
    "others_kept": ("Others kept", "The share of all other notes, in any octave, 0 to 1."),
    "pitch_classes_kept": ("Pitch classes kept", "The share of each beat's that sound, 0 to 1."),
    "notes_moved": ("Notes moved", "By one or more octaves."),
    "notes_added": ("Notes added", "Struck again while they sound."),
}
"""The same for songs that were arranged for the hands."""
_PATIENCE = 30.0  # [s] with the engraving of a score, also on a busy machine
_IN_SECONDS = "timing_error", "onset_delay", "onset_error_", "ioi_", "chord_spread_", "duration_"
"""Beginnings of the names of metrics that are times."""


def performance_page(
    episode: Episode,
    metrics: Mapping[str, Any],
    settings: Mapping[str, Any],
    audio: Samples,
    verdict: str = "",
    misses: Sequence[Mapping[str, Any]] = (),
    arrangement: Sequence[Mapping[str, Any]] = (),
    goal_sound: bytes = b"",
    midi: bytes = b"",
    goal_midi: bytes = b"",
    written: Score | None = None,
) -> Iterator[str]:
    """Yield the page of an episode piece by piece, see `html_pages.render`.

    Args:
        episode: what to show; without a drawn scene, the page has all but the 3D view.
        metrics: name -> number or text; nested mappings are flattened. NaN is shown as a dash.
        settings: name -> value, nested or not; `agent` and each of `notices` stand at the top, too;
            `remarks` are folded. None is not shown, and only the last part of absolute paths.
        audio: the performance as `synthesize` makes it, starting with the first step.
        verdict: a sentence on the performance.
        misses: lost notes, as in `misses.json`; without any, the page has no such table.
        arrangement: the fates of notes of an arranged song, as in `arrangement.json`; likewise.
        goal_sound: the sound of the score, of the same length, if it is to be heard.
        midi: a MIDI file of the performance, to download.
        goal_midi: a MIDI file of the score.
        written: the score on the clock of the episode; with it, the page shows how loudness and
            timing differ, and sheet music, see `engraving_of`, if it is made in 30 s.
    """
    metrics, remarks = _shown_metrics(episode, metrics), settings.get("remarks") or ()
    notices = settings.get("notices") or ()
    settings = {n: value for n, value in settings.items() if n not in ("remarks", "notices")}
    try:
        engraving = engraving_within(_PATIENCE, written) if written else ""
    except TimeoutError:
        engraving = ""
        remarks = [*remarks, f"no sheet music here: engraving took over {_PATIENCE:g} s"]
    # At least as long as the episode: the page's clock is this sound.
    seconds = episode.num_steps * episode.dt
    sound = encode_opus(audio, seconds=seconds)
    yield from render(
        "performance.html",
        title=episode.song or "Untitled",
        facts=_facts(episode, dict(flat(settings))),
        verdict=verdict,
        notices=notices,
        remarks=remarks,
        headlines=_figures(_HEADLINES, metrics),
        arrangement=_figures(_ARRANGEMENT, metrics),
        metrics=_other_metrics(metrics),
        settings=settings_table(settings),
        midi=midi,
        goal_midi=goal_midi,
        roll_description=_roll_description(episode),
        recording=recording_of(episode, written, misses, arrangement),
        engraving=engraving,
        has_expression=written is not None,
        sounds={"sound": sound} | ({"goal": goal_sound} if goal_sound else {}),
        styles=STYLES,
        scripts=SCRIPTS,
    )


def _facts(episode: Episode, settings: Mapping[str, Any]) -> dict[str, str]:
    by_name = {name.rsplit(".", 1)[-1]: settings[name] for name in reversed(list(settings))}
    facts = {} if by_name.get("agent") is None else {"played by": _plain(by_name["agent"])}
    if by_name.get("hands") == "apart":
        facts["recordings"] = "of each hand by itself, combined"
    return facts | {"length": f"{episode.num_steps * episode.dt:.1f} s"}


def _roll_description(episode: Episode) -> str:
    goal, played = episode["goal_keys"], episode["key_activation"]
    hit, wrong = np.sum(goal & played), np.sum(played & ~goal)
    return (
        f"Piano roll of {episode.num_steps * episode.dt:.1f} seconds: of {goal.sum()} key steps "
        f"to play, {hit} were hit; {wrong} were wrong"
    )


def _shown_metrics(episode: Episode, metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The metrics flattened, and without the pedal's where the piece has none."""
    pedal = bool(episode["goal_sustain"].any())
    return {name: v for name, v in flat(metrics) if pedal or not name.startswith("sustain_")}


def _figures(
    titles: Mapping[str, tuple[str, str]], metrics: Mapping[str, Any]
) -> list[tuple[str, str, str, float | None]]:
    """Title and meaning of metrics, their values as text, and the lengths of their bars."""
    names = [name for name in titles if name in metrics]
    return [(*titles[name], *_figure(metrics[name])) for name in names]


def _figure(value: Any) -> tuple[str, float | None]:
    """A value as text, and the length of its bar; a count has none."""
    number = _number(value)
    if number is None or isinstance(value, int):
        return "–" if number is None else str(value), None
    return f"{number:z.3f}", number or None


def _other_metrics(metrics: Mapping[str, Any]) -> dict[str, str]:
    return {
        _spoken(name.removesuffix("_seconds")): _with_unit(name, value)
        for name, value in metrics.items()
        if name not in _HEADLINES | _ARRANGEMENT
    }


def _with_unit(name: str, value: Any) -> str:
    if isinstance(value, str):
        return value
    number = _number(value)
    if number is None or isinstance(value, bool):
        return "–" if number is None else "yes" if value else "no"
    is_time = name.endswith("seconds") or name.startswith(_IN_SECONDS)
    unit = " s" if is_time else " J" if name == "energy" else ""
    return f"{round(number, 3):z.6g}{unit}"


def settings_table(settings: Mapping[str, Any]) -> dict[str, str]:
    """The text of each setting that is not None, under its full name."""
    return {name: _plain(value) for name, value in flat(settings) if value is not None}


def _plain(value: Any) -> str:
    """Return `value` as text, of a path only its name: folders say nothing to other people."""
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value)) or "–"
    path = Path(text := str(value))
    return path.name if path.is_absolute() else text


def _spoken(name: str) -> str:
    words = re.sub(r"[_./]+", " ", name).strip()
    return re.sub(r"\bf1\b", "F1", words[:1].upper() + words[1:], flags=re.IGNORECASE)


def _number(value: Any) -> float | None:
    """Return `value` short enough for the page, None where it is no finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return float(f"{number:.5g}") if math.isfinite(number) else None


_UNIT = 5e-5  # [m, rad] of a joint's position; a fingertip is then less than 0.1 mm off


def recording_of(
    episode: Episode,
    written: Score | None,
    misses: Iterable[Mapping[str, Any]],
    arrangement: Iterable[Mapping[str, Any]],
) -> dict[str, Any]:
    """The data of `recording.js`, for JSON; see `performance_page`."""
    scene = episode.scene
    joints = episode["hand_qpos"] if scene.get("skeleton") else np.empty((episode.num_steps, 0))
    depth = episode.key_depth
    depth = np.zeros_like(episode["key_qpos"]) if depth is None else depth
    rewards = {
        name.removeprefix("reward_"): packed(np.asarray(values, np.float32))
        for name, values in episode.arrays.items()
        if name.startswith("reward_")
    }
    performance = played_in(episode)
    target = written.until(episode.num_steps * episode.dt).notes if written else ()
    return {
        "dt": episode.dt,
        "steps": episode.num_steps,
        "keys": episode["key_qpos"].shape[1],
        "lowest": episode.lowest_pitch,
        "scene": scene,
        "unit": _UNIT,
        "joints": packed(np.round(joints / _UNIT).astype(np.int32)),
        "angles": packed((depth * 255).astype(np.uint8)),
        "notes": [
            [note.pitch - episode.lowest_pitch, note.start, note.end, note.velocity]
            for note in performance.notes
        ],
        "written": [[note.start, note.velocity] for note in target],
        "fingers": finger_numbers(target, episode.lowest_pitch),
        "onsetErrors": [
            [note.start, round(MS_PER_SECOND * (own_note.start - note.start), 2)]
            for note, own_note in matched_notes(target, performance.notes, SAME_NOTE)
        ],
        "states": packed(key_verdicts(episode["goal_keys"], episode["key_activation"])),
        "pedal": packed(key_verdicts(episode["goal_sustain"], episode["sustain_activation"])),
        "misses": lost_notes(misses),
        "arrangement": arranged_notes(arrangement, episode.lowest_pitch),
        "rewards": dict(sorted(rewards.items(), key=lambda item: item[0] != "total")),
    }


def finger_numbers(notes: Iterable[Note], lowest: int) -> list[list[float]]:
    """Key, onset [s], hand, and number from 1 of the finger of each note that has one.

    `recording.js` reads them.
    """
    return [
        [note.pitch - lowest, round(note.start, 3), note.finger.hand, note.finger.index + 1]
        for note in notes
        if note.finger is not None
    ]


def lost_notes(misses: Iterable[Mapping[str, Any]]) -> list[list[Any]]:
    """The notes of `misses.json`, as `explanations.js` reads them.

    Each has its time [s], its name, the name of its finger, its fate, cause and reason.
    """
    return [
        [
            round(miss["time"], 2),
            miss["note"],
            getattr(finger_from(miss["finger"]), "name", "–"),
            *(miss["what"], miss["cause"], miss["reason"]),
        ]
        for miss in misses
    ]


def arranged_notes(fates: Iterable[Mapping[str, Any]], lowest: int) -> list[list[Any]]:
    """The notes of `arrangement.json`, as `arrangement.js` reads them.

    Each has its key, from and to [s], the key that is played or None, its part, and whether it is
    struck again.
    """
    return [
        [
            *(fate["pitch"] - lowest, fate["start"], fate["end"]),
            None if fate["played"] is None else fate["played"] - lowest,
            *(fate["part"], fate.get("again", False)),
        ]
        for fate in fates
    ]


def key_verdicts(goal: NDArray[np.bool_], played: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """For each key and step, of any shape: 0 rightly silent, 1 hit, 2 wrong, 3 missed."""
    return np.select([goal & played, played, goal], [1, 2, 3], 0).astype(np.uint8)


def packed(values: NDArray[Any]) -> str:
    """Return `values` (T, ...) as base64 of deflated differences from step to step.

    The differences are of the bit patterns, modulo 2^bits: nothing is rounded. One column follows
    the other, first all lowest bytes, then all of the next.
    """
    size = values.dtype.itemsize
    patterns = np.ascontiguousarray(values).view(f"u{size}").reshape(len(values), -1)
    steps = np.diff(patterns, axis=0, prepend=np.zeros_like(patterns[:1]))
    planes = steps.T.astype(f"<u{size}", order="C").view(np.uint8).reshape(-1, size).T
    return in_base64(zlib.compress(planes.tobytes()))
