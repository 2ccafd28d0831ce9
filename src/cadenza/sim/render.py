"""Draw pictures of the scene off screen, by MuJoCo with EGL or OSMesa, whichever works."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, quoted
from cadenza.scene.cameras import CAMERAS, MAX_HEIGHT, MAX_WIDTH
from cadenza.scene.drawn_model import drawn_model
from cadenza.scene.scene import Scene
from cadenza.sim.graphics import Canvas

HIT_RGBA = (0.20, 0.72, 0.36, 1.0)
WRONG_RGBA = (0.88, 0.27, 0.22, 1.0)
_GLOW = 0.35  # of keys that sound, so that their colour is the same in shadow
_SAMPLES = 4  # of each pixel in small pictures; drawing takes two and a half times as long


@dataclass(frozen=True)
class Picture:
    """Size and camera of a picture."""

    width: int = 640
    height: int = 360
    camera: str = "back"
    """One of the published scene's: closeup, left, right, back, egocentric, topdown."""

    def __post_init__(self) -> None:
        """Check camera and size.

        Raises:
            CadenzaError: there is no such camera, or the picture is empty or too large.
        """
        if self.camera not in CAMERAS:
            raise CadenzaError(f"no camera {quoted(self.camera)}: choose from {', '.join(CAMERAS)}")
        if not (0 < self.width <= MAX_WIDTH and 0 < self.height <= MAX_HEIGHT):
            raise CadenzaError(
                f"an image of {self.width} x {self.height}: choose up to {MAX_WIDTH} x {MAX_HEIGHT}"
            )


class Renderer(Canvas):
    """A renderer of one scene. It holds a graphics context of this thread until `close`."""

    def __init__(self, scene: Scene, picture: Picture | None = None) -> None:
        """Open a graphics context to draw a scene in a picture of some size, by a camera.

        Raises:
            CadenzaError: this machine cannot draw.
        """
        picture = picture or Picture()
        model = drawn_model(scene)
        self._camera = _fixed_camera(model, picture.camera)
        model.vis.quality.offsamples = _SAMPLES
        super().__init__(scene, model, picture.width, picture.height)

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
        for geom, key in self._show(hand_qpos, key_qpos, self._camera):
            if key is not None and sounding[key]:
                geom.rgba[:] = HIT_RGBA if goal[key] else WRONG_RGBA
                geom.emission = _GLOW
        return self._picture()


def _fixed_camera(model: mujoco.MjModel, name: str) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    camera.fixedcamid = model.camera(name).id
    return camera
