"""Draw states of a scene off screen, by MuJoCo with EGL or OSMesa, whichever works."""

from __future__ import annotations

import importlib
import os
import sys
import weakref
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.scene.drawn_model import key_geoms
from cadenza.scene.scene import Scene

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_RENDERED_IN: set[int] = set()  # this process, or the one that it was forked from
_MAX_GEOMS = 2000


class Canvas:
    """A canvas for states of a scene. It holds a graphics context of this thread until `close`."""

    def __init__(self, scene: Scene, model: mujoco.MjModel, width: int, height: int) -> None:
        """Open a graphics context for pictures of this size [px] of a scene's drawn model.

        Raises:
            CadenzaError: this machine cannot draw.
        """
        self._scene, self._model, self._size = scene, model, (width, height)
        self._gl, self._context = _opened(model, width, height)
        self.close = weakref.finalize(self, _free, self._context, self._gl)
        """Free the graphics context, at the latest when the program ends."""
        self._drawn = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
        self._options, self._data = mujoco.MjvOption(), mujoco.MjData(model)
        self._key_of_geom = key_geoms(model, scene)

    def _show(
        self, hand_qpos: NDArray[Any], key_qpos: NDArray[Any], camera: mujoco.MjvCamera
    ) -> Iterator[tuple[mujoco.MjvGeom, int | None]]:
        """Put the scene in the picture; yield its geoms, to be coloured, with the keys they are.

        Args:
            hand_qpos: (J,) [m, rad].
            key_qpos: (K,) [rad].
            camera: what sees them.
        """
        data = self._data
        data.qpos[self._scene.hand_qpos] = hand_qpos
        data.qpos[self._scene.key_qpos] = key_qpos
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_camlight(self._model, data)
        mujoco.mjv_updateScene(
            self._model, data, self._options, None, camera,
            mujoco.mjtCatBit.mjCAT_ALL.value, self._drawn,
        )  # fmt: skip
        for geom in self._drawn.geoms[: self._drawn.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                yield geom, self._key_of_geom.get(geom.objid)

    def _picture(self) -> NDArray[np.uint8]:
        """Draw what is in the picture (height, width, 3)."""
        self._gl.make_current()
        width, height = self._size
        pixels = np.empty((height, width, 3), np.uint8)
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, self._drawn, self._context)
        mujoco.mjr_readPixels(pixels, None, viewport, self._context)
        return pixels[::-1]


def _opened(model: mujoco.MjModel, width: int, height: int) -> tuple[Any, mujoco.MjrContext]:
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
            context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:  # missing libraries show in many ways
            reason, *_ = (str(error) or repr(error)).splitlines()
            reasons.append(f"{backend}: {reason}")
            _forget_opengl()
        else:
            _RENDERED_IN.add(os.getpid())
            return gl, context
    missing = _LIBRARIES.get(wanted, "EGL or OSMesa") + ", or unset MUJOCO_GL" * bool(wanted)
    raise CadenzaError(f"this machine cannot render ({'; '.join(reasons)}): install {missing}")


def _free(context: mujoco.MjrContext, gl: Any) -> None:
    """Free what `_opened` returned."""
    with suppress(Exception):  # it may be current in another thread, and can then not be used here
        gl.make_current()  # or the buffers of whichever context is current would go
        context.free()
    gl.free()


def _forget_opengl() -> None:
    """Let another backend be tried: PyOpenGL binds itself to the first platform it meets."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in [name for name in sys.modules if name.split(".")[0] == "OpenGL"]:
        del sys.modules[name]
