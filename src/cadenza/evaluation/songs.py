"""What is kept of a song with a run."""

from __future__ import annotations

import hashlib
import json
import os.path
from dataclasses import astuple
from pathlib import Path

from cadenza.evaluation.job import SongFacts
from cadenza.files import sha256_of
from cadenza.music.formats.fingering_file import SUFFIX
from cadenza.music.libraries.songs import Library, Song

_HASH = 12  # hexadecimal digits


def facts_of(song: Song, library: Library) -> SongFacts:
    """What the library's index says."""
    return SongFacts(
        song.name,
        song.title,
        song.composer,
        library.name.partition(":")[0],
        song.split,
        song.difficulty,
        song.seconds,
        song.notes,
    )


def digest_of(song: Song) -> str:
    """A hash of what is played: of the song's files, so that many are planned in a moment.

    Raises:
        CadenzaError: a file cannot be read, or a song without one cannot be made.
    """
    files = [part for part in getattr(song.read, "args", ()) if isinstance(part, Path)]
    if files:
        fingers = [path for file in files if os.path.isfile(path := file.with_suffix(SUFFIX))]
        return sha256_of(*files, *fingers)[:_HASH]
    score = song.load()
    notes = [  # `astuple` of the whole takes as long as writing an etude
        (note.start, note.end, note.pitch, note.velocity, note.finger and astuple(note.finger))
        for note in score.notes
    ]
    pedal = [(event.time, event.value) for event in score.pedal]
    content = json.dumps([notes, pedal]).encode()
    return hashlib.sha256(content).hexdigest()[:_HASH]
