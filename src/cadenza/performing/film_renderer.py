"""Draws the pictures of a film: an episode at any time, with falling notes behind the keys."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from cadenza.episode import Episode
from cadenza.errors import CadenzaError
from cadenza.fingers import Side
from cadenza.hands.body import prefix
from cadenza.music.score import Note, Score
from cadenza.scene.cameras import camera_on, eye_of
from cadenza.scene.drawn_model import drawn_model
from cadenza.scene.scene import Scene
from cadenza.sim.graphics import Canvas

# As pages colour them
_HIT, _WRONG, _MISSED = (0.0, 0.62, 0.45), (0.84, 0.37, 0.0), (0.56, 0.42, 0.85)
_COMING = {False: (0.80, 0.83, 0.88), True: (0.55, 0.59, 0.66)}  # for black keys or not
_GLOW = 0.35  # of what sounds, so that its colour is the same in shadow
_ELEVATION = np.deg2rad(47.0)  # of the camera over the keys
_LEAST_SIDE, _MOST_SIDE = 64, 2160  # [px]
_MOST_FPS = 120
_SHARPER = 1.5  # times the size at which pictures are drawn, which smooths their edges
_SHADOW_MAP = 1024  # [px]

# The track on which notes fall: as that of pages.
_AHEAD, _PAST = 2.4, 0.35  # [s] of the score that it shows
_AHEAD_IF_TALL = 5.0  # [s]
_SPEED = 0.075  # [m/s]
_SLOPE = 0.5  # [rad]
_BEHIND, _OVER = 0.012, 0.016  # [m] from the keys to its lower edge
_NOTE_WIDTH = {False: 0.0065, True: 0.0045}  # [m], halves
_NOTE_HEIGHT = 0.0015  # [m], half
_BESIDE = 0.03  # [m] in view beside the keys of the song
_BEFORE = 0.16  # [m] in view before the keys, for the hands
_TALL = 1.2  # height over width from which the camera follows the hands
_NARROW = 0.42  # [m] that it then shows of the keyboard
_STEADY = 1.0  # [s] over which it averages where the hands are

_FADED = 0.28  # opacity of a palm that hides a key which sounds
_FADING = 0.15  # [s] that it takes to fade, and to be solid again
_SOLID = 0.92  # opacity of a palm that is drawn solid
_TURN = np.linspace(0, 2 * np.pi, 12, endpoint=False)
_COSINES, _SINES = np.cos(_TURN), np.sin(_TURN)
_TRACK, _NOW = (0.14, 0.155, 0.185), (0.84, 0.86, 0.90)  # colours of the track, and of its line
_ALONG_KEY = np.array([-0.4, 0.0, 0.4, 0.8])  # halves of a key's length from its middle


@dataclass(frozen=True)
class Look:
    """The size of a film [px], and its pictures a second. A tall film goes with the hands."""

    width: int = 1280
    height: int = 720
    fps: int = 60

    def __post_init__(self) -> None:
        """Checks the size and the rate.

        Raises:
            CadenzaError: the film is too small, too large, too slow or too fast.
        """
        sides = self.width, self.height
        if not (min(sides) >= _LEAST_SIDE and max(sides) <= _MOST_SIDE):
            raise CadenzaError(
                f"a film of {self.width} x {self.height} pixels: choose {_LEAST_SIDE} to "
                f"{_MOST_SIDE} for each side"
            )
        if not 1 <= self.fps <= _MOST_FPS:
            raise CadenzaError(f"{self.fps} pictures a second: choose 1 to {_MOST_FPS}")


class FilmRenderer(Canvas):
    """Draws an episode at any time. Holds a graphics context of this thread until `close`."""

    def __init__(self, scene: Scene, episode: Episode, goal: Score, look: Look) -> None:
        """Opens a graphics context.

        Args:
            scene: the scene of the episode.
            episode: what was played.
            goal: what was to be played, on its clock.
            look: the size of the pictures.

        Raises:
            CadenzaError: this machine cannot draw.
        """
        self._episode = episode
        width, height = round(look.width * _SHARPER), round(look.height * _SHARPER)
        model = drawn_model(scene, furniture=True)
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.quality.shadowsize, model.vis.quality.offsamples = _SHADOW_MAP, 0
        super().__init__(scene, model, width, height)
        tall = look.height > _TALL * look.width
        self._falling = _FallingNotes(scene, goal, episode, _AHEAD_IF_TALL if tall else _AHEAD)
        self._palms = [_Palm(model, scene, side) for side in scene.sides]
        self._palm_of_geom = {g: i for i, palm in enumerate(self._palms) for g in palm.geoms}
        self._aspect = look.width / look.height
        self._middle = _middle_of_hands(episode) if tall else None

    def frame(self, time: float) -> NDArray[np.uint8]:
        """Draws the picture (height, width, 3) at a time [s], larger than the film by `_SHARPER`.

        States lie at the ends of control steps, and are interpolated between them.
        """
        episode = self._episode
        row = min(int(time / episode.dt + 1e-6), episode.num_steps - 1)
        opacity = _at(self._opacity, time, episode.dt)
        sounding, goal = episode["key_activation"][row], episode["goal_keys"][row]
        hands, keys = (
            _at(episode[name], time - episode.dt, episode.dt) for name in ("hand_qpos", "key_qpos")
        )
        for geom, key in self._show(hands, keys, self._camera(time)):
            palm = self._palm_of_geom.get(geom.objid)
            if key is not None and (sounding[key] or goal[key]):
                geom.rgba[:3] = _MISSED if not sounding[key] else _HIT if goal[key] else _WRONG
                geom.emission = _GLOW
            elif palm is not None and opacity[palm] < _SOLID:
                geom.rgba[3] = opacity[palm]
        self._falling.add_to(self._drawn, time, sounding)
        return self._picture()

    def _camera(self, time: float) -> mujoco.MjvCamera:
        """The camera, which sees the keys of the song, or in a tall picture goes with the hands."""
        keyboard, falling = self._scene.keyboard, self._falling
        left, right = falling.sides
        if self._middle is not None:
            middle = float(_at(self._middle, time, self._episode.dt))
            left, right = middle - _NARROW / 2, middle + _NARROW / 2
        white = keyboard.white
        front = white.centre_x + white.half_size[0] + _BEFORE
        box = np.array([[falling.end[0], left, 0.0], [front, right, falling.end[1]]])
        return camera_on(box, _ELEVATION, self._aspect)

    @cached_property  # only what draws needs it, and it takes a while
    def _opacity(self) -> NDArray[np.float64]:
        """How opaque each palm is at the beginning of each control step, (T, palms).

        Palms fade while they hide a key that sounds, or should.
        """
        episode, keyboard, data = self._episode, self._scene.keyboard, self._data
        lit = episode["key_activation"] | episode["goal_keys"]
        surface = np.repeat(keyboard.centre[:, None], len(_ALONG_KEY), axis=1)
        surface[..., 0] += _ALONG_KEY * keyboard.half_size[:, :1]
        surface[..., 2] += keyboard.half_size[:, 2:]
        hidden = np.zeros((episode.num_steps, len(self._palms)))
        for step, keys in enumerate(lit):
            data.qpos[self._scene.hand_qpos] = episode["hand_qpos"][step]
            mujoco.mj_kinematics(self._model, data)
            eye = eye_of(self._camera(step * episode.dt))
            hidden[step] = [palm.hides(data, surface[keys], eye) for palm in self._palms]
        longer = maximum_filter1d(hidden, 1 + 2 * round(_FADING / episode.dt), axis=0)
        return 1.0 - (1.0 - _FADED) * gaussian_filter1d(longer, _FADING / episode.dt, axis=0)


def _at(rows: NDArray[Any], time: float, dt: float) -> NDArray[Any]:
    """The row (...) of rows (T, ...), `dt` [s] apart, at a time [s], between two where it is so."""
    at = min(max(time / dt, 0.0), len(rows) - 1.0)
    row = min(int(at), len(rows) - 2) if len(rows) > 1 else 0
    return rows[row] + (at - row) * (rows[min(row + 1, len(rows) - 1)] - rows[row])


def _middle_of_hands(episode: Episode) -> NDArray[np.float64]:
    """The place along the keyboard of all fingertips [m], averaged over time, (T,)."""
    return gaussian_filter1d(episode["fingertip_xpos"][:, :, 1].mean(axis=1), _STEADY / episode.dt)


class _FallingNotes:
    """The notes of a score, sliding down a track behind the keyboard onto their keys."""

    def __init__(self, scene: Scene, score: Score, episode: Episode, ahead: float) -> None:
        self._keyboard = keyboard = scene.keyboard
        self._fingers, self._dt = episode["goal_fingers"], episode.dt
        self._of_a_hand = len(scene.hand.fingers)
        self._ahead, self._length = ahead, (ahead + _PAST) * _SPEED
        self._notes = [n for n in score.notes if n.pitch in keyboard.pitches]
        self._longest = max((n.end - n.start for n in self._notes), default=0.0)
        self._starts = np.array([n.start for n in self._notes])
        keys = [n.pitch - keyboard.lowest_pitch for n in self._notes] or [0, keyboard.num_keys - 1]
        y = keyboard.centre[[min(keys), max(keys)], 1]
        self.sides = float(y[0]) - _BESIDE, float(y[1]) + _BESIDE
        """The left and the right edge of the track [m]."""
        low, high = keyboard.bounds
        self._origin = np.array([low[0] - _BEHIND, 0.0, high[2] + _OVER])
        self._back = np.array([-np.cos(_SLOPE), 0.0, np.sin(_SLOPE)])
        self.end = tuple((self._origin + self._length * self._back)[[0, 2]].tolist())
        """How far the track goes back, x, and up, z [m]."""
        side = np.array([0.0, 1.0, 0.0])
        self._frame = np.stack([self._back, side, np.cross(self._back, side)], axis=1)

    def add_to(self, scene: mujoco.MjvScene, time: float, sounding: NDArray[Any]) -> None:
        """Adds the track and what is on it at a time [s], while the keys of a mask (K,) sound."""
        left, right = self.sides
        middle, half = (left + right) / 2, (right - left) / 2
        self._add(scene, (0.0, self._length), middle, half, 0.001, -0.004, _TRACK)
        now = _PAST * _SPEED
        self._add(scene, (now - 0.0015, now + 0.0015), middle, half, 0.001, -0.0025, _NOW)
        first = np.searchsorted(self._starts, time - _PAST - self._longest)
        for note in self._notes[first : np.searchsorted(self._starts, time + self._ahead)]:
            near, far = max(note.start, time - _PAST), min(note.end, time + self._ahead)
            if near < far:
                span = near - time + _PAST, far - time + _PAST
                hit = bool(sounding[note.pitch - self._keyboard.lowest_pitch])
                self._add_note(scene, note, span, hit if note.start <= time < note.end else None)

    def _add_note(
        self, scene: mujoco.MjvScene, note: Note, ahead: tuple[float, float], hit: bool | None
    ) -> None:
        """Adds a note that lies so many seconds from the lower edge; `hit` says what it is now.

        That is None for a note that is not to sound now.
        """
        key = note.pitch - self._keyboard.lowest_pitch
        black = bool(self._keyboard.is_black[key])
        colour = _COMING[black] if hit is None else _HIT if hit else _MISSED
        span = ahead[0] * _SPEED, max(ahead[1] * _SPEED - 0.001, ahead[0] * _SPEED + 0.0005)
        y, width = float(self._keyboard.centre[key, 1]), _NOTE_WIDTH[black]
        glow = 0.0 if hit is None else _GLOW
        self._add(
            scene, span, y, width, _NOTE_HEIGHT, 0.001 * black, colour, glow, self._finger(note)
        )

    def _finger(self, note: Note) -> str:
        """The number of the finger of a note, as pianists count; nothing where there is none."""
        row = min(int(note.start / self._dt + 1e-6), len(self._fingers) - 1)
        finger = int(self._fingers[row, note.pitch - self._keyboard.lowest_pitch])
        return "" if finger < 0 else str(finger % self._of_a_hand + 1)

    def _add(
        self, scene: mujoco.MjvScene, span: tuple[float, float], y: float, half_width: float,
        half_height: float, height: float, colour: tuple[float, float, float],
        glow: float = 0.0, label: str = "",
    ) -> None:  # fmt: skip
        """Adds a box to the track, from and to so far from its lower edge [m]."""
        if scene.ngeom >= scene.maxgeom:
            return
        x = (span[0] + span[1]) / 2
        pos = self._origin + self._frame @ [x, y, 0.0] - height * self._frame[:, 2]
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom],
            mujoco.mjtGeom.mjGEOM_BOX,
            np.array([(span[1] - span[0]) / 2, half_width, half_height]),
            pos,
            self._frame.ravel(),
            np.array([*colour, 1.0], np.float32),
        )
        geom = scene.geoms[scene.ngeom]
        geom.emission, geom.specular, geom.label = glow, 0.0, label
        scene.ngeom += 1


class _Palm:
    """The palm of a hand, as the hulls that hide keys."""

    def __init__(self, model: mujoco.MjModel, scene: Scene, side: Side) -> None:
        links = [link for link in scene.hand.body.links if link.hides_keys]
        bodies = [model.body(prefix(side) + link.name).id for link in links]
        self.geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies)).tolist()
        self._hulls = [
            (body, np.array(shell.mirrored(side).balls))
            for body, link in zip(bodies, links, strict=True)
            for shell in link.drawn
        ]

    def hides(self, data: mujoco.MjData, points: NDArray[Any], eye: NDArray[Any]) -> bool:
        """Whether more than one point of any key (K, P, 3) is behind it, seen from an eye (3,)."""
        hidden = np.zeros(points.shape[:2], bool)
        ray = eye - points
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        across = np.cross(ray, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        upwards = np.cross(across, ray)
        for body, balls in self._hulls:
            centre = data.xpos[body] + balls[:, :3] @ data.xmat[body].reshape(3, 3).T
            offset = centre - points[:, :, None]  # (K, P, balls, 3)
            x, y, depth = (
                np.einsum("kpbi,kpi->kpb", offset, axis) for axis in (across, upwards, ray)
            )
            reach = x[..., None] * _COSINES + y[..., None] * _SINES + balls[:, 3, None]
            # Seen along the line from a point to the eye, the hull is around it on all sides.
            hidden |= (np.where(depth[..., None] > 0, reach, -1.0).max(axis=2) > 0).all(axis=-1)
        return bool((hidden.sum(axis=1) > 1).any())
