"""The options of the published RoboPianist, and their equivalents here."""

from collections.abc import Callable, Mapping
from typing import Any

from cadenza.errors import CadenzaError, quoted

_HAND_OFFSET = 0.05  # [m], up to which the published task moves both hands
_PAGE = "see docs/published.md"

DEFAULTS: dict[str, Any] = {
    "setup": "published",
    "n_steps_lookahead": 1,
    "trim_silence": False,
    "reduced_action_space": False,
    "gravity_compensation": False,
    "primitive_fingertips": False,
}
"""The published defaults: a setup, and fields of `TaskConfig` and `SceneConfig`."""

_RENAMED: dict[str, Callable[[Any], dict[str, Any]]] = {
    "shift": lambda semitones: {"transpose": semitones},
    "disable_fingering_reward": lambda off: {"fingering": "off"} if off else {},
    "disable_forearm_reward": lambda off: {"forearm_term": not off},
    "disable_hand_collisions": lambda off: {"hand_collisions": not off},
    "primitive_fingertip_collisions": lambda on: {"primitive_fingertips": bool(on)},
    "energy_penalty_coef": lambda weight: {"energy_coefficient": weight},
    "randomize_hand_positions": lambda on: {"random_hand_position": _HAND_OFFSET if on else 0.0},
    "hand_side": lambda side: {"hands": str(getattr(side, "name", side)).lower()},
    "forearm_dofs": lambda names: {
        "forearm_dofs": tuple(name.removeprefix("forearm_") for name in names)
    },
}
"""Published options with another name or other values here -> function to options of a value."""

_WITHOUT_EFFECT = (
    "change_color_on_activation",
    "disable_colorization",
    "recompile_physics",
    "legacy_step",
)
_ELSEWHERE = {
    "environment_name": "song='NAME'",
    "midi": "song='FILE.mid' or a cadenza.Score",
    "midi_file": "song='FILE.mid'",
    "seed": "reset(seed=0)",
    "task_kwargs": "given as options beside song",
    "physics_timestep": "physics='published' for 0.005 s, 'fast' for 0.01 s",
    "augmentations": "random_stretch, random_pitch_shift, random_octave_shift, or several songs",
    "add_piano_actuators": "hands='none', a piano that plays itself",
    "reward_type": "reward_terms={'key_press': function}",
}
"""Published options -> other ways to say the same here."""


def hint(name: str, value: Any) -> str | None:
    """The equivalent of a published option and its value, in words; None for unknown options."""
    if name in _WITHOUT_EFFECT:
        answer = "not needed"
    elif name in _ELSEWHERE:
        answer = _ELSEWHERE[name]
    elif name in _RENAMED:
        options = _RENAMED[name](value).items()
        answer = ", ".join(f"{n}={v!r}" for n, v in options) or "the default"
    else:
        return None
    return f"RoboPianist's {name}={quoted(value)} is {answer} here; {_PAGE}"


def translated(options: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of `TaskConfig` and `SceneConfig` for published options; other options stay.

    Raises CadenzaError if an option is not equivalent to one of these fields.
    """
    here: dict[str, Any] = {}
    for name, value in options.items():
        if name in _ELSEWHERE and value is None:  # the default there
            continue
        if name in _ELSEWHERE:
            raise CadenzaError(f"option {name}: {hint(name, value)}")
        if name not in _WITHOUT_EFFECT:
            here |= _RENAMED.get(name, lambda same, name=name: {name: same})(value)
    return here
