"""Two simulated Shadow Hands play the piano from any MIDI file.

Importing the package registers its environments with Gymnasium as `cadenza/<Song>-v0`. What is
named here is imported when it is first used.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from cadenza.rounding import round_as_haswell

round_as_haswell()  # and so before anything of ours imports NumPy

from cadenza.tasks.registration import register_envs  # noqa: E402

if TYPE_CHECKING:  # "as" tells a type checker that the name is offered here
    from cadenza.agents.agent import Agent as Agent
    from cadenza.agents.planner.config import PlannerConfig as PlannerConfig
    from cadenza.agents.registry import make_agent as make_agent
    from cadenza.episode import Episode as Episode
    from cadenza.episode import load_episode as load_episode
    from cadenza.errors import CadenzaError as CadenzaError
    from cadenza.errors import CadenzaWarning as CadenzaWarning
    from cadenza.fingers import Finger as Finger
    from cadenza.learning.config import TrainingConfig as TrainingConfig
    from cadenza.music.arrangement import Arrangement as Arrangement
    from cadenza.music.libraries.bundled import Piece as Piece
    from cadenza.music.libraries.bundled import songs as songs
    from cadenza.music.libraries.library import open_library as open_library
    from cadenza.music.libraries.songs import Library as Library
    from cadenza.music.libraries.songs import Song as Song
    from cadenza.music.score import Note as Note
    from cadenza.music.score import PedalEvent as PedalEvent
    from cadenza.music.score import Score as Score
    from cadenza.performing.performance import Performance as Performance
    from cadenza.performing.performance import play as play
    from cadenza.performing.planning import Plan as Plan
    from cadenza.performing.planning import plan as plan
    from cadenza.performing.source import load_song as load_song
    from cadenza.performing.training import train as train
    from cadenza.scene.config import SceneConfig as SceneConfig
    from cadenza.tasks.config import DomainRandomization as DomainRandomization
    from cadenza.tasks.config import TaskConfig as TaskConfig
    from cadenza.tasks.env import PianoEnv as PianoEnv
    from cadenza.tasks.env import PianoVectorEnv as PianoVectorEnv
    from cadenza.tasks.reward import Outcome as Outcome
    from cadenza.tasks.view import TaskSpec as TaskSpec
    from cadenza.tasks.view import View as View

__version__ = "1.0.0"

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
__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return [*(name for name in globals() if name.startswith("__")), *__all__]


if "MUJOCO_GL" in os.environ:  # and so before anything else of ours imports MuJoCo
    import_module("cadenza.sim.without_graphics")
register_envs()
