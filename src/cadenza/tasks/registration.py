"""Register the environments with Gymnasium."""

from importlib import import_module
from typing import Any

import gymnasium
from gymnasium.vector import VectorEnv

from cadenza.errors import CadenzaError, quoted
from cadenza.music.libraries.songs import songs

_DRILLS = {"MiniNote": "notes-1", "MiniNotes": "notes-6", "MiniDyads": "dyads-3"}
_ENGINES = {
    "c": ("cadenza.tasks.env", "PianoVectorEnv"),
    "warp": ("cadenza.tasks.device_env", "DevicePianoVectorEnv"),
}
_NUM_DRILLS = 20
_MINI = {"setup": "mini-allegro"}


def register_envs() -> None:
    """Register `cadenza/<Song>-v0` for every bundled song and `cadenza/Piano-v0` for any.

    And `cadenza/UnknownRobot-v0`, a robot that has to be learnt in ten plays.

    And `cadenza/MiniNote-v0`, `MiniNotes-v0` and `MiniDyads-v0`: drills for one hand with touch at
    25 mini keys; each episode draws one.
    """
    for piece in songs():
        _register(f"cadenza/{piece.name}-v0", {"song": piece.name})
    _register("cadenza/Piano-v0", {})
    gymnasium.register(
        "cadenza/UnknownRobot-v0", entry_point="cadenza.tasks.unknown_robot:UnknownRobotEnv"
    )
    for name, drills in _DRILLS.items():
        songs_of_it = [f"etudes/{drills}-{seed}" for seed in range(_NUM_DRILLS)]
        _register(f"cadenza/{name}-v0", {"song": songs_of_it, **_MINI})


def make_vector_env(engine: str = "c", **options: Any) -> VectorEnv:
    """N environments, by an `engine`: "c", or "warp" for GPUs, whose arrays stay on the device.

    The options are those of `PianoVectorEnv`, or of `DevicePianoVectorEnv`. Raises CadenzaError if
    there is no such engine or option, or a song cannot be played.
    """
    if engine not in _ENGINES:
        raise CadenzaError(f"engine {quoted(engine)}: choose from {', '.join(_ENGINES)}")
    module, name = _ENGINES[engine]
    made: VectorEnv = getattr(import_module(module), name)(**options)
    return made


def _register(env_id: str, kwargs: dict[str, Any]) -> None:
    gymnasium.register(
        id=env_id,
        entry_point="cadenza.tasks.env:PianoEnv",
        vector_entry_point="cadenza.tasks.registration:make_vector_env",
        kwargs=kwargs,
    )
