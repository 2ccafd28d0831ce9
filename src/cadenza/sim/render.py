"""Draws pictures of the scene off screen, by MuJoCo with EGL or OSMesa, whichever works."""

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
from cadenza.scene.cameras import CAMERAS, MAX_HEIGHT, MAX_WIDTH, PLAYER, player_camera
from cadenza.scene.drawn_model import drawn_model
from cadenza.scene.scene import Scene

HIT_RGBA = (0.20, 0.72, 0.36, 1.0)
WRONG_RGBA = (0.88, 0.27, 0.22, 1.0)
_GLOW = 0.35  # of keys that sound, so that their colour is the same in shadow
_SEE_THROUGH = 0.14  # opacity of palms, which hide keys from the player
_SAMPLES = 4  # of each pixel in small pictures; drawing takes two and a half times as long


@dataclass(frozen=True)
class Picture:
    """Size and camera of a picture."""

    width: int = 640
    height: int = 360
    camera: str = "back"
    """`player`, which frames the keys of a song and sees them through the palms, or one of the
    published scene's: closeup, left, right, back, egocentric, topdown."""

    def __post_init__(self) -> None:
        """Checks camera and size.

        Raises:
            CadenzaError: there is no such camera, or the picture is empty or too large.
        """
        if self.camera not in (names := (PLAYER, *CAMERAS)):
            raise CadenzaError(f"no camera {self.camera!r}: choose from {', '.join(names)}")
        if not (0 < self.width <= MAX_WIDTH and 0 < self.height <= MAX_HEIGHT):
            raise CadenzaError(
                f"an image of {self.width} x {self.height}: choose up to {MAX_WIDTH} x {MAX_HEIGHT}"
            )


VIDEO = Picture(1280, 720, PLAYER)


class Renderer:
    """Draws states of one scene. Holds a graphics context of this thread until `close`."""

    def __init__(
        self,
        scene: Scene,
        picture: Picture | None = None,
        keys: tuple[int, int] | None = None,
    ) -> None:
        """Opens a graphics context to draw a scene.

        Args:
            scene: the scene to draw.
            picture: size and camera.
            keys: the lowest and the highest key that the player's camera frames; all by default.

        Raises:
            CadenzaError: this machine cannot draw.
        """
        self._picture = picture = picture or Picture()
        self._scene = scene
        self._model = model = drawn_model(scene)
        from_player = picture.camera == PLAYER
        if from_player:
            keys = keys or (0, scene.keyboard.num_keys - 1)
            self._camera = player_camera(scene.keyboard, keys, picture.width / picture.height)
        else:
            self._camera = _fixed_camera(model, picture.camera)
        model.vis.quality.offsamples = 0 if from_player else _SAMPLES
        self._gl, self._context = _open(model, picture.width, picture.height)
        self.close = weakref.finalize(self, _free, self._context, self._gl)
        """Frees the graphics context, at the latest when the program ends."""
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._drawn = mujoco.MjvScene(model, maxgeom=1000)
        self._options = mujoco.MjvOption()
        self._data = mujoco.MjData(model)
        geoms = [model.geom(scene.keyboard.key_name(k)).id for k in range(scene.keyboard.num_keys)]
        self._key_of_geom = {geom: key for key, geom in enumerate(geoms)}
        self._palms = frozenset(_palm_geoms(model, scene) if from_player else ())
        # The hands' shadows would lie on the very keys to look at, and take most of the time.
        self._drawn.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = not from_player

    def frame(
        self,
        hand_qpos: NDArray[Any],
        key_qpos: NDArray[Any],
        sounding: NDArray[Any],
        goal: NDArray[Any],
    ) -> NDArray[np.uint8]:
        """Draws a picture (height, width, 3).

        Args:
            hand_qpos: (J,) [m, rad].
            key_qpos: (K,) [rad].
            sounding: (K,) keys that sound; lit green where they should, red where not.
            goal: (K,) keys that should sound.
        """
        model, data = self._model, self._data
        data.qpos[self._scene.hand_qpos] = hand_qpos
        data.qpos[self._scene.key_qpos] = key_qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        mujoco.mjv_updateScene(
            model, data, self._options, None, self._camera,
            mujoco.mjtCatBit.mjCAT_ALL.value, self._drawn,
        )  # fmt: skip
        self._colour(sounding, goal)
        return self._read()

    def _colour(self, sounding: NDArray[Any], goal: NDArray[Any]) -> None:
        for geom in self._drawn.geoms[: self._drawn.ngeom]:
            if geom.objtype != mujoco.mjtObj.mjOBJ_GEOM:
                continue
            key = self._key_of_geom.get(geom.objid)
            if key is not None and sounding[key]:
                geom.rgba[:] = HIT_RGBA if goal[key] else WRONG_RGBA
                geom.emission = _GLOW
            elif geom.objid in self._palms:
                geom.rgba[3] = _SEE_THROUGH

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

    Renderers are made when they are first needed; a copy makes its own. A forked child cannot draw
    once its parent has.
    """

    def __init__(self, scene: Scene, picture: Picture) -> None:
        self._scene, self._picture = scene, picture
        self._mine = threading.local()

    def frame(self, *state: NDArray[Any]) -> NDArray[np.uint8]:
        """Draws a picture (height, width, 3) of the arrays that `Renderer.frame` takes.

        Raises:
            CadenzaError: this machine cannot draw, or the picture makes no sense.
        """
        return self._renderer().frame(*state)

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
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    camera.fixedcamid = model.camera(name).id
    return camera


def _palm_geoms(model: mujoco.MjModel, scene: Scene) -> list[int]:
    return np.flatnonzero(np.isin(model.geom_bodyid, scene.palm_bodies)).tolist()


_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_RENDERED_IN: set[int] = set()  # this process, or the one that it was forked from


def _open(model: mujoco.MjModel, width: int, height: int) -> tuple[Any, mujoco.MjrContext]:
    """A graphics context of the first backend that works, or of that which MUJOCO_GL names."""
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
    with suppress(Exception):  # it may be current in another thread, and can then not be used here
        gl.make_current()  # or the buffers of whichever context is current would go
        context.free()
    gl.free()


def _forget_opengl() -> None:
    """Lets another backend be tried: PyOpenGL binds itself to the first platform it meets."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in [name for name in sys.modules if name.split(".")[0] == "OpenGL"]:
        del sys.modules[name]
