"""`cadenza info`: facts about a song, or about this installation."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import accumulate
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from cadenza.agents.registry import AGENTS
from cadenza.cli.arguments import Flat
from cadenza.cli.printing import in_columns
from cadenza.errors import CadenzaError, counted
from cadenza.learning.learner import LEARNERS
from cadenza.music.arrangement import Arrangement
from cadenza.music.score import note_name
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cadenza.fingering.players import Players
    from cadenza.music.score import Score, Track


@dataclass(frozen=True)
class Info:
    """Describe a song: length, notes, range, fingering. Without a song, this installation."""

    song: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[SONG]")] = None
    """A song by its name, or a MIDI or MusicXML file."""
    arrangement: Flat[Arrangement] = field(default_factory=Arrangement)


def info(command: Info) -> None:
    from cadenza.music.libraries.library import find_song

    if command.song is None:
        _print_facts(_installation_facts())
        return
    how = command.arrangement
    score = how.performed(find_song(command.song).load(how.tracks, how.plain), command.song)
    _print_facts(_song_facts(score))
    if len(score.tracks) > 1:
        print("\n" + _table_of_tracks(score.tracks))


def _print_facts(facts: dict[str, Any]) -> None:
    width = max(len(name) for name in facts)
    for name, value in facts.items():
        print(f"{name:{width}}  {value}")


def _song_facts(score: Score) -> dict[str, Any]:
    from cadenza.music.goals import score_to_goals

    trimmed = score.with_silence_trimmed()
    goals = score_to_goals(trimmed, TaskConfig().control_timestep)
    pitches = [note.pitch for note in score.notes]
    ends = min(pitches), max(pitches)
    return {
        "title": score.title,
        "length": f"{trimmed.total_time:.1f} s, {counted(goals.num_steps, 'step')}",
        **({"bars": len(score.bars)} if score.bars else {}),
        "notes": len(score.notes),
        "range": f"{_notes(*ends)} (MIDI {ends[0]} to {ends[1]})",
        "at once": f"up to {counted(_most_at_once(score), 'key')}",
        "fingering": _about_fingering(score),
        **_about_hands(score),
        "pedal": counted(len(score.pedal), "movement"),
    } | {f"repaired {i}": remark for i, remark in enumerate(score.remarks, start=1)}


def _most_at_once(score: Score) -> int:
    """The largest number of keys that are down at a time; one may go up when another goes down."""
    moves = [(time, down) for n in score.notes for time, down in ((n.start, 1), (n.end, -1))]
    return max(accumulate(down for _, down in sorted(moves)))


def _notes(lowest: int, highest: int) -> str:
    return f"{note_name(lowest)} to {note_name(highest)}"


def _table_of_tracks(tracks: Sequence[Track]) -> str:
    rows = [("track", "notes", "range", "channel", "instrument", "name")]
    rows += [
        (
            str(t.number),
            str(t.notes),
            _notes(t.lowest, t.highest),
            str(t.channel or ""),
            t.instrument,
            t.name,
        )
        for t in tracks
    ]
    return in_columns(rows, "<<<<<<")


def _about_fingering(score: Score) -> str:
    from collections import Counter

    from cadenza.fingering.playable import playable

    given = sum(note.finger is not None for note in score.notes)
    reasons = Counter(playable(score, usual_players()).reasons.values())
    num_searched = len(score.notes) - given - reasons.total()
    parts = [f"given for {given} of {counted(len(score.notes), 'note')}"]
    parts += [f"found for {num_searched}"] if num_searched else []
    parts += [f"none for {count} ({reason})" for reason, count in reasons.most_common()]
    return "; ".join(parts)


def _about_hands(score: Score) -> dict[str, str]:
    """The number of notes written for each hand, if the score says so."""
    from cadenza.fingers import LEFT, RIGHT

    if not score.has_written_hands:
        return {}
    right, left = (sum(hand in note.hands for note in score.notes) for hand in (RIGHT, LEFT))
    return {"hands": f"as written, {counted(right, 'note')} for the right and {left} for the left"}


def usual_players() -> Players:
    """The hands of the default scene, by their reach."""
    from cadenza.fingering.players import players_at
    from cadenza.fingers import SIDES
    from cadenza.hands.registry import hand_named
    from cadenza.keyboards.registry import keyboard_named

    scene = SceneConfig()
    hand, keyboard = hand_named(scene.hand), keyboard_named(scene.keyboard)
    return players_at(hand.reach, keyboard, SIDES, scene.hand_spacing, slides=True)


def _installation_facts() -> dict[str, Any]:
    import platform
    from importlib.metadata import version

    import mujoco

    from cadenza.hands.registry import HANDS
    from cadenza.keyboards.registry import KEYBOARDS
    from cadenza.performing.filming import find_browser
    from cadenza.scene.scene import build_scene
    from cadenza.sim.render import Renderer
    from cadenza.sim.threads import available_cores
    from cadenza.tasks.setups import SETUPS

    try:
        Renderer(build_scene()).close()
        drawing = "yes"
    except CadenzaError as error:
        drawing = f"no; {error}"
    try:
        browser = find_browser()
    except CadenzaError as error:
        browser = f"nothing; {error}"
    return {
        "cadenza": version("cadenza"),
        "python": platform.python_version(),
        "mujoco": mujoco.__version__,
        "cores": available_cores(),
        "can draw pictures": drawing,
        "makes films with": browser,
        **{
            f"{registry.kind} {name}": entry.about
            for registry in (SETUPS, AGENTS, HANDS, KEYBOARDS, LEARNERS)
            for name, entry in registry.entries().items()
        },
    }
