"""Version 1 of the benchmark: its task, its tracks and its sets of songs.

All of it is frozen. `frozen.json` beside this file has hashes of the scene and of the goals of
every song, which detect a change to a generator, a reader or a hand.
"""

import hashlib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.registry import AGENTS
from cadenza.errors import CadenzaError, CadenzaWarning, quoted
from cadenza.files import read_json
from cadenza.fingers import NO_FINGER, Finger
from cadenza.music.libraries.benchmark import BENCHMARK
from cadenza.music.libraries.imported import is_imported
from cadenza.music.libraries.library import LIBRARIES, open_library
from cadenza.music.libraries.songs import Library, Song, song_named
from cadenza.performing.setup import Setup, find_player, set_up
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack

VERSION: Literal[1] = 1
MUJOCO = "3.17.0"  # the version of MuJoCo on which entries are ranked
TASK = TaskConfig(
    control_timestep=0.05,
    trim_silence=True,
    stretch=1.0,
    transpose=0,
    initial_buffer_time=0.5,
    repeats="shortened",
)
"""The task. Observations and rewards are up to the agent."""
SCENE = SceneConfig()
"""The scene: two Shadow Hands with the paper's reduced actions at a piano, published physics."""
METRICS = (
    *("f1", "precision", "recall", "pooled_f1", "note_onset_f1"),
    *("onset_delay", "onset_error_median", "velocity_error", "velocity_error_with_misses"),
)
"""Metrics of every run, see `cadenza.music.metrics`."""
TRACKS = {
    "one-song": "A policy or plan for each song, learnt or practised on that song itself.",
    "at-sight": "An agent that is finished before it meets the songs, and simulates nothing.",
    "planning": "An agent that plans with a model of hands and piano, with its time stated.",
    "deployment": "Ten plays on each of ten unknown robots; the eleventh counts.",
}
"""Track -> which agents belong to it."""
_OWN_TRACKS = {
    "generalist": "at-sight",
    "pretrained": "one-song",
    **dict.fromkeys(("planner", "predictive-sampling", "ilqg", "stitched", "icp"), "planning"),
}
_TRAINED = "train:"  # prefix of the names of agents that are trained on each song
_HASH = 16  # hexadecimal digits
_DIGITS = 6  # significant, of a number of the scene: engines differ in the last ones
_MODEL = {
    "body": "parentid pos quat mass ipos iquat inertia gravcomp",
    "jnt": "type bodyid pos axis range limited stiffness margin solref solimp actfrcrange",
    "dof": "armature damping frictionloss solref solimp",
    "qpos": "spring",
    "tendon": "adr num range limited stiffness damping frictionloss armature margin lengthspring",
    "wrap": "type objid prm",
    "exclude": "signature",
    "actuator": "trntype trnid gaintype gainprm biastype biasprm dyntype dynprm ctrllimited "
    "ctrlrange forcelimited forcerange gear",
}
"""Prefix -> arrays of a MuJoCo model that determine the motion of bodies."""
_COLLIDING = "type bodyid condim contype conaffinity size pos quat friction solref solimp solmix"
_COLLIDING += " margin gap priority"  # of geoms that collide; the others are only drawn
_OPTIONS = "timestep gravity integrator cone solver iterations ls_iterations tolerance impratio"
_OPTIONS += " ls_tolerance noslip_iterations disableflags enableflags sleep_tolerance"


@dataclass(frozen=True)
class _Frozen:
    """Content of frozen.json."""

    scene: str
    songs: dict[str, str]


@cache
def frozen() -> _Frozen:
    """The hashes of the scene and, by name, of the songs in version 1."""
    return read_json(Path(__file__).with_name("frozen.json"), _Frozen)


# Tracks


def own_track(agent: str, options: dict[str, Any]) -> str | None:
    """The track of an agent that comes with Cadenza; None for others, which choose one."""
    agent = agent.strip()
    agent = {entry.place: name for name, entry in AGENTS.own.items()}.get(agent, agent)
    if agent.startswith(_TRAINED):
        return "one-song"
    if agent == "generalist" and options.get("rehearsals"):
        return "planning"  # rehearsals are simulated
    return _OWN_TRACKS.get(agent)


# Sets


PUBLIC_SETS = (
    "bundled",
    *(
        f"{BENCHMARK}:{kind}-{split}"
        for kind in ("etudes", "band")
        for split in ("train", "valid", "test")
    ),
)
"""Sets that come with Cadenza."""
DEPLOYMENT, ROBOTS = "deployment", 10
"""The track of unknown robots, and its set; the number of robots, which are its seeds."""
_DEPLOYED = (
    *("TwinkleTwinkleLittleStar", "OdeToJoy", "MinuetInG"),
    *("BachPreludeInCMajor", "FurEliseOpening", "MoonlightOpening"),
)  # bundled songs, from easy to hard
PAPER_SETS = {"repertoire-150": 150, "etude-12": 12}
"""Sets of the paper, to be imported, and their numbers of songs."""


def open_set(name: str) -> Library:
    """The songs of a set: a public one, one of the paper, or an imported library.

    A folder of music is no set: its content might come with the entry that names it. Raises
    CadenzaError if there is no such set, or it has not been imported.
    """
    library = name.partition(":")[0]
    public = (*PUBLIC_SETS, DEPLOYMENT)
    is_set = name in (*public, *PAPER_SETS) or (
        is_imported(library) and library not in LIBRARIES.own
    )
    if not is_set:
        raise CadenzaError(
            f"set {quoted(name)}: choose from "
            f"{', '.join((*public, *PAPER_SETS))}, or import a "
            "library of your own (cadenza import)"
        )
    if name in public and is_imported(library):
        raise CadenzaError(f"set {name}: an imported library has its name; remove that library")
    if name == DEPLOYMENT:
        bundled = open_library("bundled")
        return Library(name, tuple(song_named(song, bundled) for song in _DEPLOYED))
    songs = open_library(name)
    if len(songs.songs) != (size := PAPER_SETS.get(name, len(songs.songs))):
        raise CadenzaError(
            f"set {name}: has {len(songs.songs)} of {size} songs here; import the whole dataset"
        )
    return songs


# The task


@contextmanager
def set_up_song(song: Song) -> Iterator[Setup]:
    """Yield a song in the task of the benchmark, without a search for fingers.

    Raises CadenzaError if it cannot be read.
    """
    task = replace(TASK, fingering="off")  # keys and metrics do not depend on it
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CadenzaWarning)  # of notes that cannot be played
        with set_up(song, find_player("zero").playing_in(task, SCENE)) as setup:
            yield setup


def check_frozen(song: Song, setup: Setup) -> str:
    """The hash of a song as the task plays it.

    Raises CadenzaError if the song or the scene differs from that of version 1.
    """
    if (scene := scene_digest(setup.task.scene)) != frozen().scene:
        raise CadenzaError(
            f"this version of Cadenza has another scene ({scene}) than version {VERSION} of the "
            "benchmark; install the one that the entry names"
        )
    digest = song_digest(setup.task.tracks[0])
    if digest != frozen().songs.get(song.name, digest):
        raise CadenzaError(
            f"{song.name}: has other notes here ({digest}) than in version {VERSION} of the "
            "benchmark; install the version of Cadenza that the entry names"
        )
    return digest


def song_digest(track: GoalTrack) -> str:
    """A hash of a song: its notes with given fingers, and its goals by step."""
    notes = [
        (n.start, n.end, n.pitch, n.velocity, *_numbers(n.finger))
        for n in track.delayed_score.notes
    ]
    digest = hashlib.sha256(np.array(notes, "<f8").tobytes())
    digest.update(np.packbits(track.goals.keys).tobytes())
    digest.update(np.packbits(track.goals.sustain).tobytes())
    return digest.hexdigest()[:_HASH]


def _numbers(finger: Finger | None) -> tuple[int, int]:
    return (NO_FINGER, NO_FINGER) if finger is None else (finger.hand, finger.index)


def scene_digest(scene: Scene) -> str:
    """A hash of all numbers that determine the motion of a scene, to six significant digits."""
    model, digest = scene.model, hashlib.sha256()
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    names = [f"{kind}_{name}" for kind, fields in _MODEL.items() for name in fields.split()]
    arrays = [getattr(model, name) for name in names]
    arrays += [getattr(model, f"geom_{name}")[collides] for name in _COLLIDING.split()]
    arrays += [getattr(model.opt, name) for name in _OPTIONS.split()]
    arrays += [scene.hand_start, scene.keyboard.sounds_from, TASK.control_timestep]
    for values in arrays:
        digest.update(_rounded(np.asarray(values, np.float64)).tobytes())
    return digest.hexdigest()[:_HASH]


def _rounded(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """An array (...) to `_DIGITS` significant digits, with one zero."""
    with np.errstate(divide="ignore"):
        size = np.floor(np.log10(np.abs(values)))
    scale = 10.0 ** np.clip(_DIGITS - 1 - size, -300, 300)
    return np.where(np.abs(values) < 1e-12, 0.0, np.round(values * scale) / scale) + 0.0
