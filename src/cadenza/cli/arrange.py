"""`cadenza arrange`: a song as two hands can play it, as sheet music or MIDI."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from cadenza.cli.arguments import Output
from cadenza.cli.saving import check_writable
from cadenza.errors import CadenzaError
from cadenza.files import folder_name
from cadenza.music.arrangement import Arrangement
from cadenza.music.formats.reading import SHEET, name_without_ending
from cadenza.scene.config import SceneConfig

_MIDI = ".mid"


@dataclass(frozen=True)
class Arrange:
    """Arrange a song for the hands, and write it as sheet music with fingers, or as MIDI.

    Example: cadenza arrange song.mid -o song.musicxml --level 4
    """

    song: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SONG")]
    """A song by its name, or a MIDI or MusicXML file."""
    output: Output[Path | None] = None
    """The arrangement, a .musicxml or .mid file; SONG.musicxml by default."""
    arrangement: tyro.conf.OmitArgPrefixes[Arrangement] = field(
        default_factory=lambda: Arrangement(arrange="always")
    )
    scene: tyro.conf.OmitArgPrefixes[SceneConfig] = field(default_factory=SceneConfig)


def arrange(command: Arrange) -> None:
    from cadenza.fingering.search import find_fingering
    from cadenza.music.formats.midi import write_midi
    from cadenza.music.formats.musicxml_writing import write_musicxml
    from cadenza.performing.arranging import arranged_for
    from cadenza.performing.source import resolve
    from cadenza.scene.scene import build_scene
    from cadenza.tasks.goal_track import players_of

    path = command.output or Path(f"{folder_name(name_without_ending(command.song))}{SHEET}")
    if path.suffix not in (SHEET, _MIDI):
        raise CadenzaError(f"{path}: an arrangement is a {SHEET} or {_MIDI} file")
    check_writable(path.parent)
    arrangement = replace(command.arrangement, arrange="always")
    source, scene = resolve(command.song, arrangement), build_scene(command.scene)
    found = arranged_for(source.score, arrangement, scene)
    if found is None:
        raise CadenzaError(f"{command.song}: there are no hands to arrange it for")
    arranged = found.arranged
    score, _ = find_fingering(arranged.score, players_of(scene))
    if path.suffix == SHEET:
        for remark in write_musicxml(score, path):
            print(f"{path}: {remark}")
    else:
        write_midi(score, path)
    print(f"{path}: {len(score.notes)} notes of grade {arranged.grade:.1f}: {arranged.fidelity}")
