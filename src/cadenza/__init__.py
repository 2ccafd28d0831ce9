"""Two simulated Shadow Hands play the piano from any MIDI file.

Importing the package registers its environments with Gymnasium as `cadenza/<Song>-v0`. What is
named here is imported when it is first used.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from cadenza.tasks.registration import register_envs

if TYPE_CHECKING:
    from cadenza.agents.agent import Agent
    from cadenza.agents.planner.config import PlannerConfig
    from cadenza.agents.registry import make_agent
    from cadenza.episode import Episode, load_episode
    from cadenza.errors import CadenzaError, CadenzaWarning
    from cadenza.fingers import Finger
    from cadenza.learning.config import TrainingConfig
    from cadenza.music.arrangement import Arrangement
    from cadenza.music.libraries.bundled import Piece, songs
    from cadenza.music.libraries.library import open_library
    from cadenza.music.libraries.songs import Library, Song
    from cadenza.music.score import Note, PedalEvent, Score
    from cadenza.performing.performance import Performance, play
    from cadenza.performing.planning import Plan, plan
    from cadenza.performing.source import load_song
    from cadenza.performing.training import train
    from cadenza.scene.config import SceneConfig
    from cadenza.tasks.config import DomainRandomization, TaskConfig
    from cadenza.tasks.env import PianoEnv, PianoVectorEnv
    from cadenza.tasks.reward import Outcome
    from cadenza.tasks.view import TaskSpec, View

__version__ = "1.0.0"

__all__ = [
    "Agent",
    "Arrangement",
    "CadenzaError",
    "CadenzaWarning",
    "DomainRandomization",
    "Episode",
    "Finger",
    "Library",
    "Note",
    "Outcome",
    "PedalEvent",
    "Performance",
    "PianoEnv",
    "PianoVectorEnv",
    "Piece",
    "Plan",
    "PlannerConfig",
    "SceneConfig",
    "Score",
    "Song",
    "TaskConfig",
    "TaskSpec",
    "TrainingConfig",
    "View",
    "load_episode",
    "load_song",
    "make_agent",
    "open_library",
    "plan",
    "play",
    "songs",
    "train",
]

_MODULES = {
    "agents.agent": ("Agent",),
    "agents.registry": ("make_agent",),
    "agents.planner.config": ("PlannerConfig",),
    "episode": ("Episode", "load_episode"),
    "errors": ("CadenzaError", "CadenzaWarning"),
    "fingers": ("Finger",),
    "learning.config": ("TrainingConfig",),
    "scene.config": ("SceneConfig",),
    "music.arrangement": ("Arrangement",),
    "music.score": ("Note", "PedalEvent", "Score"),
    "music.libraries.bundled": ("Piece", "songs"),
    "music.libraries.library": ("open_library",),
    "music.libraries.songs": ("Library", "Song"),
    "performing.source": ("load_song",),
    "performing.performance": ("Performance", "play"),
    "performing.planning": ("Plan", "plan"),
    "performing.training": ("train",),
    "tasks.config": ("DomainRandomization", "TaskConfig"),
    "tasks.env": ("PianoEnv", "PianoVectorEnv"),
    "tasks.reward": ("Outcome",),
    "tasks.view": ("TaskSpec", "View"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]


if "MUJOCO_GL" in os.environ:  # and so before anything else of ours imports MuJoCo
    import_module("cadenza.sim.without_graphics")
register_envs()
