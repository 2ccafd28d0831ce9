"""The folder of a bench whose results nobody has played."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cadenza.evaluation.jobs import key_of
from cadenza.evaluation.summary import WRONG_NOTES

AGENTS = ("planner", "predictive-sampling", "ilqg", "train:fast", "stitched")
TITLES = ("Für Elise", "Nocturne", "Invention", "Sonata in C, first movement", "Étude", "Minuet")
COMPOSERS = ("Beethoven", "Chopin", "Bach", "Mozart", "Debussy", "Petzold")


def result(
    name: str, agent: str, seed: int, metrics: dict[str, Any], **song: Any
) -> dict[str, Any]:
    """The content of a result.json."""
    job = {"song": name, "song_digest": "0" * 12, "agent": agent, "agent_digest": "", "seed": seed}
    job |= {"task": {"control_timestep": 0.05}, "scene": {"physics": "original"}}
    about = {"name": name, "title": name, "composer": "", "library": "made-up", "split": ""}
    about |= {"difficulty": 3.0, "seconds": 20.0, "notes": 60}
    return {
        "format": 1,
        "job": job | {"arrangement": {"tracks": None}, "config": None},
        "song": about | song,
        "metrics": metrics,
        "timing": {"wall_seconds": 30.0, "music_seconds": 20.0, "threads": 2},
        "versions": {"cadenza": "1.0", "mujoco": "3.17", "numpy": "2.4", "python": "3.12"},
    }


def write_result(bench: Path, name: str, content: Any) -> Path:
    """Into a folder whose name ends as that of such a run does."""
    folder = bench / "runs" / f"{name}--{key_of(content['job'])}"
    folder.mkdir(parents=True)
    (folder / "result.json").write_text(json.dumps(content))
    return folder


def write_bench(
    bench: Path,
    pieces: int = 150,
    agents: Sequence[str] = AGENTS,
    seeds: int = 3,
    libraries: int = 1,
) -> None:
    """Write a bench of some pieces, harder ones played worse; the first seed has a page."""
    rng = np.random.default_rng(0)
    for i in range(pieces):
        difficulty, seconds = float(rng.uniform(1, 10)), float(rng.uniform(15, 180))
        kind = int(rng.integers(len(TITLES)))
        song = {
            "title": f"{TITLES[kind]} no. {i + 1}",
            "composer": COMPOSERS[kind],
            "library": f"library-{i % libraries + 1}" if libraries > 1 else "repertoire-150",
            "difficulty": difficulty,
            "seconds": seconds,
            "notes": int(seconds * difficulty),
        }
        for j, agent in enumerate(agents):
            own = 1 - 0.012 * (1 + 3 * j) * difficulty * rng.uniform(0.5, 1.5)
            for seed in range(seeds):
                metrics = _metrics(np.clip(own + rng.normal(0, 0.012), 0.02, 0.999), seconds)
                content = result(f"repertoire/{i:03}", agent, seed, metrics, **song)
                content["timing"] |= {
                    "wall_seconds": seconds * (0.4 + j),
                    "cpu_seconds": seconds * (0.3 + j),
                    "music_seconds": seconds,
                }
                name = f"{i:03}--{agent.replace(':', '_')}--s{seed}"
                folder = write_result(bench, name, content)
                if seed == 0:
                    (folder / "report.html").write_text("<!doctype html><title>A run</title>")


def _metrics(f1: float, seconds: float) -> dict[str, Any]:
    f1 = float(f1)
    return {
        "precision": 0.5 + f1 / 2,
        "recall": f1**1.2,
        "f1": f1,
        "pooled_precision": f1,
        "pooled_recall": f1,
        "pooled_f1": f1**1.3,
        "note_onset_f1": f1**2,
        "note_onset_offset_f1": f1**3,
        "extra_notes_per_100": 100 * (1 - f1),
        "missed_notes_per_100": 60 * (1 - f1),
        **{f"{kind}_per_100": 20 * (1 - f1) for kind in WRONG_NOTES},
        "timing_error": 0.01,
        "onset_error_median": 0.004,
        "velocity_error": 8 * (1 - f1),
        "energy": 20 * seconds * f1,
        "steps": int(seconds / 0.05),
        "unstable": False,
    }
