"""Songs are arranged for the hands where much would be missed as written."""

from dataclasses import replace

import pytest

from cadenza.agents.planner.misses import foreseen_misses
from cadenza.music.arrangement import Arrangement, load
from cadenza.music.etudes import make_etude
from cadenza.music.score import Note, Score, Track, chords
from cadenza.performing.arranging import arranged_for
from cadenza.scene.scene import build_scene
from cadenza.tasks.augmentation import prepare_tracks
from cadenza.tasks.config import TaskConfig

MIDDLES = {"Violin I": 79, "Violin II": 70, "Viola": 62, "Cello": 48}
SCENE, TASK = build_scene(), TaskConfig()


def quartet(*voices: list[Note]) -> Score:
    """Voices for string instruments, each with a track of its own."""
    notes = [replace(n, tracks=(i,)) for i, voice in enumerate(voices, 1) for n in voice]
    tracks = [Track(i, name, "Strings", None, 1, 0, 127) for i, name in enumerate(MIDDLES, 1)]
    return Score(tuple(notes), tracks=tuple(tracks[: len(voices)]))


def restless() -> Score:
    """Four voices that leap an octave after every fourth chord; hands reach each chord."""
    steps = [0.2 * i for i in range(40)]
    return quartet(
        *(
            [Note(at, at + 0.19, middle + 12 * (i // 4 % 2), 80) for i, at in enumerate(steps)]
            for middle in (76, 72, 55, 48)
        )
    )


def chorale() -> Score:
    """Four voices that stay together, and that two hands have fingers for."""
    struck = [
        sorted(each, key=lambda n: n.pitch) for each in chords(make_etude("chorale", 6, 1).notes)
    ]
    return quartet(*map(list, zip(*(each for each in struck if len(each) == 4), strict=True)))


def piano(score: Score) -> Score:
    """The same notes for one instrument."""
    return replace(score, tracks=(Track(1, "", "Piano", None, 1, 0, 127),))


@pytest.mark.parametrize(
    ("score", "stretch", "arranged"),
    [
        (restless(), 1.0, True),
        (restless(), 3.0, False),
        (piano(restless()), 1.0, False),
        (chorale(), 1.0, False),
        (piano(Score(tuple(Note(0.0, 1.0, pitch) for pitch in range(40, 72)))), 1.0, True),
    ],
)
def test_a_song_is_arranged_where_much_would_be_missed(score, stretch, arranged):
    task, source = replace(TASK, stretch=stretch), load(score, Arrangement())
    assert (arranged_for(source, SCENE, task)[1] is not None) == arranged


def test_what_no_finger_plays_is_foreseen_to_be_missed():
    """Ten fingers and twelve keys; then a hand that leaps four octaves in a tenth of a second."""
    (track,) = prepare_tracks([Score(tuple(Note(0, 1, p) for p in range(60, 72)))], TASK, SCENE)
    assert foreseen_misses(track) == pytest.approx(len(track.fingered().dropped or ()) / 12)
    assert foreseen_misses(track) >= 2 / 12
