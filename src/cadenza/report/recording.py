"""A performance as the data that a page holds; `recording.js` reads it.

Arrays over time are differences from step to step, deflated. Of the hands there are only the
joints' positions: the page's scene puts the bodies where they belong.
"""

import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.episode import Episode
from cadenza.fingers import finger_from
from cadenza.music.metrics import matched_notes
from cadenza.music.performance import SAME_NOTE, played_in
from cadenza.music.score import MS_PER_SECOND, Note, Score
from cadenza.report.html_pages import in_base64

_UNIT = 5e-5  # [m, rad] of a joint's position; a fingertip is then less than 0.1 mm off


def recording_of(
    episode: Episode,
    written: Score | None,
    misses: Iterable[Mapping[str, Any]],
    arrangement: Iterable[Mapping[str, Any]],
) -> dict[str, Any]:
    """Return what `recording.js` reads, as JSON has it.

    Args:
        episode: what was played.
        written: what was to be played, on the clock of the episode; with None, the page cannot show
            how the loudness and the timing of what was played differ from it.
        misses: the notes that were lost, as `misses.json` has them.
        arrangement: what became of each note of a song that was arranged, as `arrangement.json`
            has it.
    """
    scene = episode.scene
    joints = episode["hand_qpos"] if scene.get("skeleton") else np.empty((episode.num_steps, 0))
    depth = episode.key_depth
    depth = np.zeros_like(episode["key_qpos"]) if depth is None else depth
    rewards = {
        name.removeprefix("reward_"): packed(np.asarray(values, np.float32))
        for name, values in episode.arrays.items()
        if name.startswith("reward_")
    }
    played = played_in(episode)
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
            for note in played.notes
        ],
        "written": [[note.start, note.velocity] for note in target],
        "fingers": finger_numbers(target, episode.lowest_pitch),
        "onsetErrors": [
            [note.start, round(MS_PER_SECOND * (own.start - note.start), 2)]
            for note, own in matched_notes(target, played.notes, SAME_NOTE)
        ],
        "states": packed(key_verdicts(episode["goal_keys"], episode["key_activation"])),
        "pedal": packed(key_verdicts(episode["goal_sustain"], episode["sustain_activation"])),
        "misses": lost_notes(misses),
        "arrangement": arranged_notes(arrangement, episode.lowest_pitch),
        "rewards": dict(sorted(rewards.items(), key=lambda item: item[0] != "total")),
    }


def finger_numbers(notes: Iterable[Note], lowest: int) -> list[list[float]]:
    """Return key, onset [s], hand, and number from 1 of the finger of each note that has one.

    `recording.js` reads them.
    """
    return [
        [note.pitch - lowest, round(note.start, 3), note.finger.hand, note.finger.index + 1]
        for note in notes
        if note.finger is not None
    ]


def lost_notes(misses: Iterable[Mapping[str, Any]]) -> list[list[Any]]:
    """Return the notes of `misses.json`, as `explanations.js` reads them.

    Each has its time [s], its name, the name of its finger, what became of it, cause and reason.
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
    """Return the notes of `arrangement.json`, as `arrangement.js` reads them.

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
    """Return for each key and step, of any shape: 0 rightly silent, 1 hit, 2 wrong, 3 missed."""
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
