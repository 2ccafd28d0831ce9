"""Pictures of the scene, drawn off screen by MuJoCo through EGL or OSMesa, whichever works."""

from __future__ import annotations

import importlib
import os
import sys
import threading
import weakref
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.model.piano import NUM_KEYS, key_name
from cadenza.model.scene import Scene

RIGHT_RGBA = (0.20, 0.72, 0.36, 1.0)
WRONG_RGBA = (0.88, 0.27, 0.22, 1.0)


@dataclass(frozen=True)
class Picture:
    """How to look at the scene."""

    width: int = 640
    height: int = 360
    camera: str = "back"


class Renderer:
    """Draws states of one scene. Holds a graphics context of this thread until `close`."""

    def __init__(self, scene: Scene, picture: Picture | None = None) -> None:
        """Raises:
        CadenzaError: this machine cannot draw, or there is no such camera, or the size is odd.
        """
        self._picture = picture = picture or Picture()
        self._scene = scene
        self._camera = _fixed_camera(scene.model, picture.camera)
        self._check_size()
        self._gl, self._context = _open(scene.model, picture.width, picture.height)
        self.close = weakref.finalize(self, _free, self._context, self._gl)
        """Frees the graphics context, at the latest when the program ends."""
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._drawn = mujoco.MjvScene(scene.model, maxgeom=1000)
        self._options = mujoco.MjvOption()
        self._data = mujoco.MjData(scene.model)
        self._key_of_geom = {scene.model.geom(key_name(k)).id: k for k in range(NUM_KEYS)}

    def _check_size(self) -> None:
        limits = self._scene.model.vis.global_
        width, height = self._picture.width, self._picture.height
        if not (0 < width <= limits.offwidth and 0 < height <= limits.offheight):
            raise CadenzaError(
                f"a picture of {width} x {height}: choose up to {limits.offwidth} x "
                f"{limits.offheight}"
            )

    def frame(
        self,
        hand_qpos: NDArray[Any],
        key_qpos: NDArray[Any],
        sounding: NDArray[Any],
        goal: NDArray[Any],
    ) -> NDArray[np.uint8]:
        """One picture (height, width, 3).

        Args:
            hand_qpos: (J,) [m, rad].
            key_qpos: (88,) [rad].
            sounding: (88,) keys that sound; lit green where they should, red where not.
            goal: (88,) keys that should sound.
        """
        model, data = self._scene.model, self._data
        data.qpos[self._scene.hand_qpos] = hand_qpos
        data.qpos[self._scene.key_qpos] = key_qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        mujoco.mjv_updateScene(
            model, data, self._options, None, self._camera,
            mujoco.mjtCatBit.mjCAT_ALL.value, self._drawn,
        )  # fmt: skip
        self._light_keys(sounding, goal)
        return self._read()

    def _light_keys(self, sounding: NDArray[Any], goal: NDArray[Any]) -> None:
        for geom in self._drawn.geoms[: self._drawn.ngeom]:
            key = self._key_of_geom.get(geom.objid)
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and key is not None and sounding[key]:
                geom.rgba[:] = RIGHT_RGBA if goal[key] else WRONG_RGBA

    def _read(self) -> NDArray[np.uint8]:
        picture = self._picture
        pixels = np.empty((picture.height, picture.width, 3), np.uint8)
        viewport = mujoco.MjrRect(0, 0, picture.width, picture.height)
        self._gl.make_current()
        mujoco.mjr_render(viewport, self._drawn, self._context)
        mujoco.mjr_readPixels(pixels, None, viewport, self._context)
        return pixels[::-1]


class Drawing:
    """Draws from any thread: each has a renderer of its own, as a graphics context belongs to one.

    Renderers are made when they are first needed; a copy or a forked child makes its own.
    """

    def __init__(self, scene: Scene, picture: Picture) -> None:
        self._scene, self._picture = scene, picture
        self._mine = threading.local()

    def frame(
        self,
        hand_qpos: NDArray[Any],
        key_qpos: NDArray[Any],
        sounding: NDArray[Any],
        goal: NDArray[Any],
    ) -> NDArray[np.uint8]:
        """See `Renderer.frame`.

        Raises:
            CadenzaError: this machine cannot draw, or the picture makes no sense.
        """
        return self._renderer().frame(hand_qpos, key_qpos, sounding, goal)

    def _renderer(self) -> Renderer:
        renderer, process = getattr(self._mine, "made", (None, None))
        if renderer is not None and process == os.getpid():
            return renderer
        if renderer is not None:
            renderer.close.detach()  # its graphics context is the parent's
        self._mine.made = Renderer(self._scene, self._picture), os.getpid()
        return self._mine.made[0]

    def close(self) -> None:
        """Frees this thread's graphics; those of other threads go when these end."""
        renderer, process = getattr(self._mine, "made", (None, None))
        if renderer is not None and process == os.getpid():
            renderer.close()
        self._mine = threading.local()

    def __reduce__(self) -> tuple[type[Drawing], tuple[Scene, Picture]]:
        return Drawing, (self._scene, self._picture)


def _fixed_camera(model: mujoco.MjModel, name: str) -> mujoco.MjvCamera:
    names = [model.camera(i).name for i in range(model.ncam)]
    if name not in names:
        raise CadenzaError(f"no camera {name!r}: choose from {', '.join(names)}")
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    camera.fixedcamid = names.index(name)
    return camera


def _open(model: mujoco.MjModel, width: int, height: int) -> tuple[Any, mujoco.MjrContext]:
    """A graphics context of the first backend that works; MUJOCO_GL, if set, names the only one."""
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted in ("off", "disable", "disabled", "0", "false"):
        raise CadenzaError(f"drawing is switched off by MUJOCO_GL={wanted}: unset it to draw")
    default = ("egl", "osmesa") if sys.platform == "linux" else ("glfw",)
    reasons = []
    for backend in (wanted,) if wanted else default:
        try:
            gl = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
            gl.make_current()
            return gl, mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:  # missing libraries show in many ways
            reasons.append(f"{backend}: {str(error).splitlines()[0] if str(error) else error!r}")
            _forget_opengl()
    raise CadenzaError(
        "this machine cannot draw pictures "
        f"({'; '.join(reasons)}): install EGL or OSMesa, or do without"
    )


def _free(context: mujoco.MjrContext, gl: Any) -> None:
    with suppress(Exception):  # it may be current in another thread, and can then not be used here
        gl.make_current()  # or the buffers of whichever context is current would go
        context.free()
    gl.free()


def _forget_opengl() -> None:
    """Lets another backend be tried: PyOpenGL binds itself to the first platform it meets."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in [name for name in sys.modules if name.split(".")[0] == "OpenGL"]:
        del sys.modules[name]
