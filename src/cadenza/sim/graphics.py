"""Graphics contexts to draw in off screen, by EGL or OSMesa, whichever works."""

from __future__ import annotations

import importlib
import os
import sys
from contextlib import suppress
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_RENDERED_IN: set[int] = set()  # this process, or the one that it was forked from


def opened(
    model: mujoco.MjModel,
    width: int,
    height: int,
    font: mujoco.mjtFontScale = mujoco.mjtFontScale.mjFONTSCALE_100,
) -> tuple[Any, mujoco.MjrContext]:
    """A graphics context of the first backend that works, or of that which MUJOCO_GL names.

    Raises:
        CadenzaError: none works here, or none can in this process.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted in ("on", "enable", "enabled", "1", "true"):
        wanted = ""
    if wanted in ("off", "disable", "disabled", "0", "false"):
        raise CadenzaError(f"rendering is disabled by MUJOCO_GL={wanted}: unset it to render")
    if any(process != os.getpid() for process in _RENDERED_IN):
        raise CadenzaError(
            "this process was forked from one that has rendered, and its graphics are unusable: "
            "start it with spawn, as in multiprocessing.get_context('spawn')"
        )
    default = tuple(_LIBRARIES) if sys.platform == "linux" else ("glfw",)
    reasons = []
    for backend in (wanted,) if wanted else default:
        try:
            gl = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
            gl.make_current()
            context = mujoco.MjrContext(model, font)
        except Exception as error:  # missing libraries show in many ways
            reason, *_ = (str(error) or repr(error)).splitlines()
            reasons.append(f"{backend}: {reason}")
            _forget_opengl()
        else:
            _RENDERED_IN.add(os.getpid())
            return gl, context
    missing = _LIBRARIES.get(wanted, "EGL or OSMesa") + ", or unset MUJOCO_GL" * bool(wanted)
    raise CadenzaError(f"this machine cannot render ({'; '.join(reasons)}): install {missing}")


def free(context: mujoco.MjrContext, gl: Any) -> None:
    """Frees what `opened` returned."""
    with suppress(Exception):  # it may be current in another thread, and can then not be used here
        gl.make_current()  # or the buffers of whichever context is current would go
        context.free()
    gl.free()


def read(
    scene: mujoco.MjvScene, context: mujoco.MjrContext, width: int, height: int
) -> NDArray[np.uint8]:
    """Draws a scene in the context that is current; returns the picture (height, width, 3)."""
    pixels = np.empty((height, width, 3), np.uint8)
    viewport = mujoco.MjrRect(0, 0, width, height)
    mujoco.mjr_render(viewport, scene, context)
    mujoco.mjr_readPixels(pixels, None, viewport, context)
    return pixels[::-1]


def _forget_opengl() -> None:
    """Lets another backend be tried: PyOpenGL binds itself to the first platform it meets."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in [name for name in sys.modules if name.split(".")[0] == "OpenGL"]:
        del sys.modules[name]
