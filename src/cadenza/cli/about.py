"""`cadenza songs` and `cadenza info`: what there is to play, and with what."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from cadenza.errors import CadenzaError
from cadenza.tasks.config import TaskConfig

if TYPE_CHECKING:
    from cadenza.music.score import Score


@dataclass(frozen=True)
class Songs:
    """List the bundled songs."""


@dataclass(frozen=True)
class Info:
    """Tell what a song asks for; without a song, what this installation can do."""

    song: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[SONG]")] = None
    """A bundled song or the path of a MIDI file."""


def songs(_: Songs) -> None:
    from cadenza.music.library import songs as pieces

    for piece in pieces():
        print(
            f"{piece.name:34} {piece.difficulty:12} {piece.seconds:5.1f} s  "
            f"{piece.title} ({piece.composer})"
        )


def info(command: Info) -> None:
    facts = _song_facts(command.song) if command.song else _installation_facts()
    width = max(len(name) for name in facts)
    for name, value in facts.items():
        print(f"{name:{width}}  {value}")


def _song_facts(song: str) -> dict[str, Any]:
    from cadenza.music.goals import score_to_goals
    from cadenza.music.library import load_score

    score = load_score(song)
    pitches = [note.pitch for note in score.notes]
    goals = score_to_goals(score.with_silence_trimmed(), TaskConfig().control_timestep)
    return {
        "title": score.title,
        "length": f"{score.with_silence_trimmed().total_time:.1f} s, {goals.num_steps} steps",
        "notes": len(score.notes),
        "range": f"MIDI {min(pitches)} to {max(pitches)}",
        "at once": f"up to {goals.keys.sum(axis=1).max()} keys",
        "fingering": _about_fingering(score),
        "pedal": f"{len(score.pedal)} movements",
    } | {f"repaired {i}": remark for i, remark in enumerate(score.remarks, start=1)}


def _about_fingering(score: Score) -> str:
    from collections import Counter

    from cadenza.music.fingering import find_fingering

    given = sum(note.finger >= 0 for note in score.notes)
    fingered, dropped = find_fingering(score)
    found = sum(note.finger >= 0 for note in fingered.notes) - given
    reasons = Counter(reason for _, reason in dropped)
    parts = [f"{given} of {len(score.notes)} notes"]
    parts += [f"found for {found}"] if found else []
    parts += [f"{count} cannot be played: {reason}" for reason, count in reasons.most_common()]
    return "; ".join(parts)


def _installation_facts() -> dict[str, Any]:
    import platform
    from importlib.metadata import version

    import mujoco

    from cadenza.model.scene import build_scene
    from cadenza.sim.render import Renderer
    from cadenza.sim.simulation import available_cores

    try:
        Renderer(build_scene()).close()
        drawing = "yes"
    except CadenzaError as error:
        drawing = f"no; {error}"
    return {
        "cadenza": version("cadenza"),
        "python": platform.python_version(),
        "mujoco": mujoco.__version__,
        "cores": available_cores(),
        "can draw video": drawing,
    }
