"""Registers the environments with Gymnasium."""

from __future__ import annotations

import gymnasium

from cadenza.music.libraries.bundled import songs


def register_envs() -> None:
    """Registers `cadenza/<Song>-v0` for every bundled song and `cadenza/Piano-v0` for any."""
    for piece in songs():
        _register(f"cadenza/{piece.name}-v0", {"song": piece.name})
    _register("cadenza/Piano-v0", {})


def _register(env_id: str, kwargs: dict[str, str]) -> None:
    gymnasium.register(
        id=env_id,
        entry_point="cadenza.tasks.env:PianoEnv",
        vector_entry_point="cadenza.tasks.env:PianoVectorEnv",
        kwargs=kwargs,
    )
