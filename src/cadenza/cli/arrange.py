"""`cadenza arrange`: a song as two hands can play it, as sheet music or MIDI."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from cadenza.cli.arguments import Chosen, Flat, Output
from cadenza.cli.options import SETUP_HELP
from cadenza.cli.saving import check_sheet, write_sheet
from cadenza.errors import counted
from cadenza.files import folder_name
from cadenza.fingers import SIDES
from cadenza.music.arrangement import Arrangement, load
from cadenza.music.formats.reading import SHEET, name_without_ending
from cadenza.scene.config import SceneConfig
from cadenza.tasks.setups import NamedSetup, setup_named


@dataclass(frozen=True)
class Arrange:
    """Arrange a song for the hands, and write it as sheet music with fingers, or as MIDI.

    What the hands can play as written stays as it is, unless there is a level.
    Example: cadenza arrange song.mid -o song.musicxml --level 4
    """

    song: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SONG")]
    """A song by its name, or a MIDI or MusicXML file."""
    output: Output[Path | None] = None
    """The arrangement: a .pdf to print, a .musicxml file to edit, an .svg picture, or a .mid file,
    with its fingers as text beside it; SONG.musicxml by default."""
    arrangement: Flat[Arrangement] = field(default_factory=Arrangement)
    fingering: Literal["robot", "human"] = "robot"
    """Fingers that suit the robot's hands, or those that a pianist would use."""
    hands_as_written: bool = False
    """Have each hand play what the score has for it, as far as it can."""
    setup: Annotated[str | None, tyro.conf.arg(help=SETUP_HELP)] = None
    scene: Flat[SceneConfig] = field(default_factory=SceneConfig)


def default(chosen: Chosen) -> Arrange:
    """The command's default, with the hands and keys of the setup that is chosen."""
    setup = NamedSetup() if chosen.setup is None else setup_named(chosen.setup)
    return Arrange(song=tyro.MISSING_NONPROP, scene=SceneConfig(**setup.of(SceneConfig)))


def run(command: Arrange) -> None:
    from cadenza.fingering.difficulty import grade
    from cadenza.performing.arranging import arranged_for
    from cadenza.scene.scene import build_scene
    from cadenza.tasks.config import TaskConfig

    song = load(command.song, command.arrangement)
    path = command.output or Path(f"{folder_name(name_without_ending(song.name))}{SHEET}")
    check_sheet(path, "--output")
    scene = build_scene(command.scene)
    if any(note.pitch not in scene.keyboard.pitches for note in song.score.notes):
        song = replace(song, arrangement=replace(song.arrangement, arrange="always"))
    task = TaskConfig(
        fingering=command.fingering, hands_as_written=command.hands_as_written, trim_silence=False
    )
    track, arrangement = arranged_for(song.written_for(command.scene.hands), scene, task)
    score = track.fingered().score
    write_sheet(score, path)
    if arrangement:
        difficulty, result = arrangement.arranged.grade, str(arrangement.arranged.fidelity)
    else:
        difficulty, result = grade(score), "as written, which hands can play"
        if track.dropped:
            result = f"as written, {counted(len(track.dropped), 'note')} of it out of reach"
    sides = {note.finger.hand for note in score.notes if note.finger}
    hands = "both hands" if len(sides) > 1 else "".join(f"the {SIDES[i]} hand" for i in sides)
    notes = counted(len(score.notes), "note")
    print(f"{path}: {notes} for {hands}, grade {difficulty:.1f}: {result}")
