"""Two simulated Shadow Hands play the piano from any MIDI file.

Importing the package registers its environments with Gymnasium as `cadenza/<Song>-v0`. What
`__init__.pyi` names is imported when it is first used.
"""

import ast
import os
from importlib import import_module
from pathlib import Path
from typing import Any

from cadenza.rounding import round_as_haswell

round_as_haswell()  # and so before anything of ours imports NumPy

from cadenza.tasks.registration import register_envs  # noqa: E402

__version__ = "1.0.0"

_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8")).body
_MODULE_OF = {
    name.name: str(line.module)
    for line in _STUB
    if isinstance(line, ast.ImportFrom)
    for name in line.names
}
__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return [*(name for name in globals() if name.startswith("__")), *__all__]


if "MUJOCO_GL" in os.environ:  # and so before anything else of ours imports MuJoCo
    import_module("cadenza.sim.without_graphics")
register_envs()
