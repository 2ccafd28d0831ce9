"""Pictures of the scene, drawn off screen by MuJoCo with EGL or OSMesa, whichever works."""

import importlib
import os
import sys
import weakref
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.cameras import FIELD_OF_VIEW, VIEWS, Camera, Points, Sight, outline_of, points_of_box
from cadenza.errors import CadenzaError, quoted
from cadenza.scene.cameras import CAMERAS, MAX_HEIGHT, MAX_WIDTH
from cadenza.scene.drawing import drawn_model, key_geoms
from cadenza.scene.furniture import case_bounds
from cadenza.scene.scene import Scene

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_RENDERED_IN: set[int] = set()  # ids of this process, or of the one from which it was forked
_MAX_GEOMS = 2000


def _opened(model: mujoco.MjModel, width: int, height: int) -> tuple[Any, mujoco.MjrContext]:
    """A graphics context of the backend that MUJOCO_GL names, or of the first one that works.

    Raises CadenzaError if none works here, or none can in this process.
    """
    library = os.environ.get("MUJOCO_GL", "").strip().lower()
    if library in ("on", "enable", "enabled", "1", "true"):
        library = ""
    if library in ("off", "disable", "disabled", "0", "false"):
        raise CadenzaError(f"rendering is disabled by MUJOCO_GL={library}: unset it to render")
    if any(process != os.getpid() for process in _RENDERED_IN):
        raise CadenzaError(
            "this process was forked from one that has rendered, and its graphics are unusable: "
            "start it with spawn, as in multiprocessing.get_context('spawn')"
        )
    default = tuple(_LIBRARIES) if sys.platform == "linux" else ("glfw",)
    reasons = []
    for backend in (library,) if library else default:
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
    missing = _LIBRARIES.get(library, "EGL or OSMesa") + ", or unset MUJOCO_GL" * bool(library)
    raise CadenzaError(f"this machine cannot render ({'; '.join(reasons)}): install {missing}")


def _free(context: mujoco.MjrContext, gl: Any) -> None:
    """Free what `_opened` returned."""
    with suppress(Exception):  # it may be current in another thread, and can then not be used here
        gl.make_current()  # or another context's buffers would be freed
        context.free()
    gl.free()


def _forget_opengl() -> None:
    """Let another backend be tried: PyOpenGL binds itself to the first platform it meets."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in [name for name in sys.modules if name.split(".")[0] == "OpenGL"]:
        del sys.modules[name]


HIT_RGBA = (0.20, 0.72, 0.36, 1.0)
WRONG_RGBA = (0.88, 0.27, 0.22, 1.0)
_GLOW = 0.35  # emission of sounding keys: their colour is the same in shadow
_SAMPLES = 4  # samples per pixel of small pictures; drawing takes 2.5 times as long


@dataclass(frozen=True)
class Picture:
    """Size and camera of a picture."""

    width: int = 640
    height: int = 360
    camera: str = "back"
    """One of `cadenza.cameras.VIEWS`, or of the published scene's `CAMERAS`, which stand still."""

    def __post_init__(self) -> None:
        """Check camera and size; raises CadenzaError if there is no such camera, or picture."""
        if self.camera not in VIEWS | CAMERAS:
            raise CadenzaError(
                f"no camera {quoted(self.camera)}: choose from {', '.join(VIEWS)}, or from the "
                f"published {', '.join(CAMERAS)}"
            )
        if not (0 < self.width <= MAX_WIDTH and 0 < self.height <= MAX_HEIGHT):
            raise CadenzaError(
                f"an image of {self.width} x {self.height}: choose up to {MAX_WIDTH} x {MAX_HEIGHT}"
            )


class Renderer:
    """A renderer of one scene. It holds a graphics context of this thread until `close`."""

    def __init__(self, scene: Scene, picture: Picture | None = None) -> None:
        """Open a graphics context for a picture of a scene, or raise CadenzaError."""
        picture = picture or Picture()
        model = drawn_model(scene)
        self._view = _View(scene, picture) if picture.camera in VIEWS else None
        self._camera = _free_camera(model) if self._view else _fixed_camera(model, picture.camera)
        model.vis.quality.offsamples = _SAMPLES
        self._scene, self._model, self._size = scene, model, (picture.width, picture.height)
        self._gl, self._context = _opened(model, *self._size)
        self.close = weakref.finalize(self, _free, self._context, self._gl)
        """Free the graphics context, at the latest when the program ends."""
        self._drawn = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
        self._options, self._data = mujoco.MjvOption(), mujoco.MjData(model)
        self._key_of_geom = key_geoms(model, scene)

    def frame(
        self,
        hand_qpos: NDArray[Any],
        key_qpos: NDArray[Any],
        sounding: NDArray[Any],
        goal: NDArray[Any],
    ) -> NDArray[np.uint8]:
        """Draw a picture (height, width, 3).

        Args:
            hand_qpos: (J,) [m, rad].
            key_qpos: (K,) [rad].
            sounding: (K,) keys that sound; lit green where they should, red where not.
            goal: (K,) keys that should sound.
        """
        data = self._data
        data.qpos[self._scene.hand_qpos] = hand_qpos
        data.qpos[self._scene.key_qpos] = key_qpos
        mujoco.mj_kinematics(self._model, data)
        if self._view:
            self._view.aim(self._camera, data)
        mujoco.mj_camlight(self._model, data)
        mujoco.mjv_updateScene(
            self._model, data, self._options, None, self._camera,
            mujoco.mjtCatBit.mjCAT_ALL.value, self._drawn,
        )  # fmt: skip
        for geom in self._drawn.geoms[: self._drawn.ngeom]:
            is_geom = geom.objtype == mujoco.mjtObj.mjOBJ_GEOM
            key = self._key_of_geom.get(geom.objid) if is_geom else None
            if key is not None and sounding[key]:
                geom.rgba[:] = HIT_RGBA if goal[key] else WRONG_RGBA
                geom.emission = _GLOW
        self._gl.make_current()
        width, height = self._size
        pixels = np.empty((height, width, 3), np.uint8)
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, self._drawn, self._context)
        mujoco.mjr_readPixels(pixels, None, viewport, self._context)
        return pixels[::-1]


def _fixed_camera(model: mujoco.MjModel, name: str) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    camera.fixedcamid = model.camera(name).id
    return camera


def _free_camera(model: mujoco.MjModel) -> mujoco.MjvCamera:
    model.vis.global_.fovy = FIELD_OF_VIEW
    return mujoco.MjvCamera()


_BOTH_WAYS = np.concatenate([np.eye(3), -np.eye(3)])  # along the axes both ways; [2::3] is up, down
_PALM, _TIP = 0.035, 0.03  # [m] from the middles of bodies of hands to their edges, about


class _View:
    """One of `VIEWS` of a scene."""

    def __init__(self, scene: Scene, picture: Picture) -> None:
        """Measure the piano, and the hands as an episode begins."""
        self._camera = Camera(picture.camera, picture.width / picture.height)
        model, data = scene.model, mujoco.MjData(scene.model)
        data.qpos[scene.hand_qpos] = scene.hand_start
        mujoco.mj_kinematics(model, data)
        self._hands = np.union1d(model.site_bodyid[scene.fingertip_sites], scene.palm_bodies)
        self._sizes = np.where(np.isin(self._hands, scene.palm_bodies), _PALM, _TIP)
        hung = ~np.isin(model.body_parentid[scene.hand_bodies], scene.hand_bodies)
        self._roots = scene.hand_bodies[hung]
        low, high = case_bounds(scene.keyboard)
        self._case = outline_of(low, high)
        near, far = scene.keyboard.bounds
        front = max(far[0], self._shown(data)[:, 0].max())  # hands reach out of it
        ends = (near[0], low[1], near[2]), (front, high[1], far[2])
        self._scene_sight = Sight(points_of_box(*ends), self._around(data))

    def _shown(self, data: mujoco.MjData) -> Points:
        bodies = data.xpos[self._hands, None] + self._sizes[:, None, None] * _BOTH_WAYS
        return bodies.reshape(-1, 3)

    def _around(self, data: mujoco.MjData) -> Points:
        ends = (data.xpos[self._roots, None] + _TIP * _BOTH_WAYS[2::3]).reshape(-1, 3)
        return np.concatenate([self._case, ends])

    def aim(self, camera: mujoco.MjvCamera, data: mujoco.MjData) -> None:
        """Place a free camera as the hands are."""
        hands = Sight(self._shown(data), self._around(data))
        camera.lookat[:], camera.distance = self._camera.place(self._scene_sight, hands)
        x, y, z = self._camera.axes[2]
        camera.azimuth, camera.elevation = np.degrees([np.arctan2(-y, -x), -np.arcsin(z)])
