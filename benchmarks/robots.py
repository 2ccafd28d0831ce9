"""Measures agents on robots that differ from the model as real ones do.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.robots SONG ... [--agents A ...]
        [--profiles P ...] [--robots N] [--apart]

Prints a table in Markdown: means over the songs and robots 0 to N - 1, F1 and note onset F1.
With --apart, also what each part of a profile costs by itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.arguments import one_or_more, parser_for
from cadenza.agents.registry import make_agent
from cadenza.agents.rollout import play_episode
from cadenza.errors import errors_in_a_line
from cadenza.music.libraries.library import load_score
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.robots import GENTLE, HARSH, REALISTIC

PROFILES = {"gentle": GENTLE, "realistic": REALISTIC, "harsh": HARSH}
PARTS = {
    "late actions": ("latency",),
    "late observations": ("observation_latency",),
    "noise of sensors": ("joint_noise", "slide_noise", "key_noise"),
    "biased joints": ("joint_bias", "slide_bias", "drift"),
    "masses, friction, gains, forces": (
        *("mass", "friction", "joint_damping", "joint_friction", "servo_gain", "force_limit"),
    ),
    "speed, dead band, backlash, noise of servos": (
        *("sweep_time", "dead_band", "backlash", "control_noise"),
    ),
    "place and tilt of keyboard and hands": (
        *("keyboard_offset", "keyboard_tilt", "mount_offset", "mount_tilt"),
    ),
    "springs, travel, depth of keys": ("key_spring", "key_travel", "key_sounding"),
    "gravity and pushes": ("gravity_tilt", "push"),
}


def variants(profile: str, apart: bool) -> dict[str, DomainRandomization]:
    """The whole profile, and with `apart` each of its parts alone."""
    whole = PROFILES[profile]
    parts = PARTS if apart else {}
    alone = {
        part: DomainRandomization(**{name: getattr(whole, name) for name in names})
        for part, names in parts.items()
    }
    return {f"{profile}, all of it": whole} | {f"{profile}: {n}": part for n, part in alone.items()}


def played(song: str, agent: str, randomization: DomainRandomization) -> tuple[float, float]:
    """F1 and note onset F1 of a song by an agent, the name of one or a policy's folder."""
    task = PianoTask([load_score(song)], TaskConfig(randomization=randomization))
    metrics = play_episode(task, make_agent(agent), 0).metrics
    return metrics["f1"], metrics["note_onset_f1"]


@errors_in_a_line()
def main() -> None:
    """Plays and prints, row by row."""
    parser = parser_for(__doc__)
    parser.add_argument("songs", nargs="+", help="bundled pieces or MIDI files")
    parser.add_argument("--agents", nargs="+", default=["planner"])
    parser.add_argument("--profiles", nargs="+", choices=PROFILES, default=["realistic"])
    parser.add_argument("--robots", type=one_or_more, default=3)
    parser.add_argument("--apart", action="store_true")
    options = parser.parse_args()
    rows = {"nothing": DomainRandomization()}
    for profile in options.profiles:
        rows |= variants(profile, options.apart)
    print("| robots | agent | F1 | note onset F1 |\n| --- | --- | --- | --- |")
    for name, randomization in rows.items():
        robots = range(options.robots if randomization.is_on else 1)
        for agent in options.agents:
            scores = [
                played(song, agent, replace(randomization, seed=robot))
                for song in options.songs
                for robot in robots
            ]
            f1, onsets = np.mean(scores, axis=0)
            print(f"| {name} | {agent} | {f1:.3f} | {onsets:.3f} |", flush=True)


if __name__ == "__main__":
    main()
