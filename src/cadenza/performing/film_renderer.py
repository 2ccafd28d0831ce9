"""Draws the pictures of a film: an episode at any time, with falling notes behind the keys."""

from __future__ import annotations

from collections.abc import Sequence
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
from cadenza.hands.shell import METAL
from cadenza.music.score import Note, Score
from cadenza.performing.titles import draw_titles
from cadenza.scene.cameras import camera_on, eye_of
from cadenza.scene.drawn_model import drawn_model
from cadenza.scene.furniture import SLOPE, board_half_width, board_origin
from cadenza.scene.scene import Scene
from cadenza.sim.render import Canvas

# As pages colour them
_HIT, _WRONG, _MISSED = (0.0, 0.62, 0.45), (0.84, 0.37, 0.0), (0.56, 0.42, 0.85)
# Of the right hand, of the left, of an unknown one: on white keys, on black ones.
_COMING = (
    ((0.62, 0.72, 0.96), (0.44, 0.56, 0.88)),
    ((0.94, 0.69, 0.83), (0.78, 0.47, 0.66)),
    ((0.80, 0.83, 0.88), (0.55, 0.59, 0.66)),
)
_GLOW = 0.35  # of what sounds, so that its colour is the same in shadow
# Of the camera over the keys: before hands, and over arms, which stand before the keys
_ELEVATION, _OVER_ARMS = np.deg2rad(47.0), np.deg2rad(78.0)
_MIN_SIDE, _MAX_SIDE = 64, 2160  # [px]
_MAX_FPS = 120
_SHARPER = 1.25  # times the size at which pictures are drawn, which smooths their edges
_SHADOW_MAP = 640  # [px]; what it costs grows with its area
_TALL_SHADOWS = 0.6  # how far shadows reach in a tall picture, compared with a wide one

# The track on which notes fall: as that of pages.
_AHEAD, _PAST = 2.4, 0.35  # [s] of the score that it shows
_AHEAD_IF_TALL = 5.0  # [s]
_SPEED = 0.075  # [m/s]
_NOTE_WIDTH = {False: 0.0065, True: 0.0045}  # [m], halves
_NOTE_HEIGHT = 0.0015  # [m], half
_BESIDE = 0.035  # [m] in view beside the keys
_BEFORE = 0.16  # [m] in view before the keys, for the hands
_TALL = 1.2  # height over width from which the camera follows the hands
_NARROW = 0.42  # [m] that it then shows of the keyboard, if the hands are no farther apart
_STEADY = 1.0  # [s] over which it averages where the hands are

_FADED = 0.28  # opacity of a palm that hides a key which sounds
_FADING = 0.15  # [s] that it takes to fade, and to be solid again
_SOLID = 0.92  # opacity of a palm that is drawn solid
_TURN = np.linspace(0, 2 * np.pi, 12, endpoint=False)
_COSINES, _SINES = np.cos(_TURN), np.sin(_TURN)
_TRACK, _NOW = (0.085, 0.09, 0.10), (0.84, 0.86, 0.90)  # colours of the track, and of its line
# Numbers from 1 on, made of strokes: the middle upwards and to the right, the length, whether it
# stands, in parts of their height and their width.
_STROKES = (
    ((0.5, 0, 1, True),),
    ((1, 0, 1, False), (0.75, 0.5, 0.5, True), (0.5, 0, 1, False), (0.25, -0.5, 0.5, True),
     (0, 0, 1, False)),
    ((1, 0, 1, False), (0.5, 0.5, 1, True), (0.5, 0, 1, False), (0, 0, 1, False)),
    ((0.75, -0.5, 0.5, True), (0.5, 0.5, 1, True), (0.5, 0, 1, False)),
    ((1, 0, 1, False), (0.75, -0.5, 0.5, True), (0.5, 0, 1, False), (0.25, 0.5, 0.5, True),
     (0, 0, 1, False)),
)  # fmt: skip
_HIGH, _WIDE, _STROKE, _EDGE = 0.0075, 0.0042, 0.0011, 0.0018  # [m] of numbers
_INK = (0.06, 0.08, 0.11)
_ALONG_KEY = np.array([-0.4, 0.0, 0.4, 0.8])  # halves of a key's length from its middle


@dataclass(frozen=True)
class Look:
    """The size of a film [px], and its pictures a second. A tall film goes with the hands."""

    width: int = 1280
    height: int = 720
    fps: int = 60

    def __post_init__(self) -> None:
        """Check the size and the rate.

        Raises:
            CadenzaError: the film is too small, too large, too slow or too fast.
        """
        sides = self.width, self.height
        if not (min(sides) >= _MIN_SIDE and max(sides) <= _MAX_SIDE):
            raise CadenzaError(
                f"a film of {self.width} x {self.height} pixels: choose {_MIN_SIDE} to "
                f"{_MAX_SIDE} for each side"
            )
        if not 1 <= self.fps <= _MAX_FPS:
            raise CadenzaError(f"{self.fps} pictures a second: choose 1 to {_MAX_FPS}")


class FilmRenderer(Canvas):
    """Draws an episode at any time. Holds a graphics context of this thread until `close`."""

    def __init__(
        self, scene: Scene, episode: Episode, goal: Score, look: Look, titles: Sequence[str]
    ) -> None:
        """Open a graphics context.

        Args:
            scene: the scene of the episode.
            episode: what was played.
            goal: what was to be played, on its clock.
            look: the size of the pictures.
            titles: lines with which the film begins.

        Raises:
            CadenzaError: this machine cannot draw.
        """
        self._episode, self._titles = episode, titles
        width, height = round(look.width * _SHARPER), round(look.height * _SHARPER)
        model = drawn_model(scene)
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.quality.shadowsize, model.vis.quality.offsamples = _SHADOW_MAP, 0
        super().__init__(scene, model, width, height)
        tall = look.height > _TALL * look.width
        self._falling = _FallingNotes(scene, goal, episode, _AHEAD_IF_TALL if tall else _AHEAD)
        self._palms = [_Palm(model, scene, side) for side in scene.sides]
        self._palm_of_geom = {g: i for i, palm in enumerate(self._palms) for g in palm.geoms}
        self._aspect = look.width / look.height
        self._shown = None
        if tall:
            self._shown = _around_hands(episode)
            model.vis.map.shadowclip *= _TALL_SHADOWS
        self._drawn.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0  # the floor fills the picture
        self._light = float(model.light_pos[0, 1])

    def frame(self, time: float) -> NDArray[np.uint8]:
        """Draw the picture (height, width, 3) at a time [s], larger than the film by `_SHARPER`.

        States lie at the ends of control steps, and are interpolated between them.
        """
        episode = self._episode
        row = min(int(time / episode.dt + 1e-6), episode.num_steps - 1)
        opacity = _at(self._opacity, time, episode.dt)
        sounding, goal = episode["key_activation"][row], episode["goal_keys"][row]
        hands, keys = (
            _at(episode[name], time - episode.dt, episode.dt) for name in ("hand_qpos", "key_qpos")
        )
        if self._shown is not None:  # shadows are where one looks
            self._model.light_pos[0, 1] = self._light + _at(self._shown, time, episode.dt).mean()
        for geom, key in self._show(hands, keys, self._camera(time)):
            palm = self._palm_of_geom.get(geom.objid)
            if key is not None and (sounding[key] or goal[key]):
                geom.rgba[:3] = _MISSED if not sounding[key] else _HIT if goal[key] else _WRONG
                geom.emission = _GLOW
            elif palm is not None and opacity[palm] < _SOLID:
                geom.rgba[3] = self._palms[palm].seen(geom.objid, opacity[palm])
        self._falling.add_to(self._drawn, time, sounding)
        picture = self._picture()
        draw_titles(picture, self._titles, time)
        return picture

    def _camera(self, time: float) -> mujoco.MjvCamera:
        """The camera, which sees the whole keyboard, or in a tall picture goes with the hands."""
        keyboard, end = self._scene.keyboard, self._falling.end
        half = board_half_width(keyboard) + _BESIDE
        left, right = -half, half
        if self._shown is not None and 2 * half > _NARROW:
            left, right = _at(self._shown, time, self._episode.dt).tolist()
        white = keyboard.white
        front = white.centre_x + white.half_size[0] + _BEFORE
        corners = [(x, y, z) for x, z in ((front, 0.0), end) for y in (left, right)]
        elevation = _OVER_ARMS if self._scene.hand.body.mount else _ELEVATION
        return camera_on(np.array(corners), elevation, self._aspect)

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


def _around_hands(episode: Episode) -> NDArray[np.float64]:
    """Return where along the keyboard a tall picture begins and ends [m], (T, 2).

    All fingertips are in it now and for a while before and after, and it moves slowly.
    """
    tips, steady = episode["fingertip_xpos"][:, :, 1], _STEADY / episode.dt
    edges = np.stack([-tips.min(axis=1), tips.max(axis=1)], axis=1) + _BESIDE
    left, right = gaussian_filter1d(
        maximum_filter1d(edges, 1 + 2 * int(steady), axis=0), steady, axis=0
    ).T
    middle, half = (right - left) / 2, np.maximum(right + left, _NARROW) / 2
    return np.stack([middle - half, middle + half], axis=1)


class _FallingNotes:
    """The notes of a score, sliding down the fall board onto their keys."""

    def __init__(self, scene: Scene, score: Score, episode: Episode, ahead: float) -> None:
        self._keyboard = keyboard = scene.keyboard
        self._fingers, self._dt = episode["goal_fingers"], episode.dt
        self._of_a_hand = len(scene.hand.fingers)
        self._ahead, self._length = ahead, (ahead + _PAST) * _SPEED
        self._notes = [n for n in score.notes if n.pitch in keyboard.pitches]
        self._longest = max((n.end - n.start for n in self._notes), default=0.0)
        self._starts = np.array([n.start for n in self._notes])
        self._half_width = board_half_width(keyboard)
        x, z = board_origin(keyboard)
        self._origin = np.array([x, 0.0, z])
        self._back = np.array([-np.cos(SLOPE), 0.0, np.sin(SLOPE)])
        self.end = tuple((self._origin + self._length * self._back)[[0, 2]].tolist())
        """How far the track goes back, x, and up, z [m]."""
        side = np.array([0.0, 1.0, 0.0])
        self._frame = np.stack([self._back, side, np.cross(self._back, side)], axis=1)

    def add_to(self, scene: mujoco.MjvScene, time: float, sounding: NDArray[Any]) -> None:
        """Add the track and what is on it at a time [s], while the keys of a mask (K,) sound."""
        self._add(scene, (0.0, self._length), 0.0, self._half_width, 0.001, -0.0035, _TRACK)
        now = _PAST * _SPEED
        self._add(scene, (now - 0.0010, now + 0.0010), 0.0, self._half_width, 0.001, -0.002, _NOW)
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
        """Add a note that lies so many seconds from the lower edge; `hit` says what it is now.

        That is None for a note that is not to sound now.
        """
        key = note.pitch - self._keyboard.lowest_pitch
        black, finger = bool(self._keyboard.is_black[key]), self._finger(note)
        hand = finger // self._of_a_hand
        colour = _COMING[hand][black] if hit is None else _HIT if hit else _MISSED
        near, far = ahead[0] * _SPEED, max(ahead[1] * _SPEED - 0.001, ahead[0] * _SPEED + 0.0005)
        y, width, over = float(self._keyboard.centre[key, 1]), _NOTE_WIDTH[black], 0.001 * black
        glow = _GLOW * (hit is not None)
        self._add(scene, (near, far), y, width, _NOTE_HEIGHT, over, colour, glow)
        high = min(_HIGH, far - near - 2 * _EDGE)
        if finger < 0 or high < _HIGH / 2:
            return
        for up, right, length, stands in _STROKES[finger % self._of_a_hand]:
            half = (length * (high if stands else _WIDE) + _STROKE) / 2
            along, across = (half, _STROKE / 2) if stands else (_STROKE / 2, half)
            x = near + _EDGE + up * high
            span = x - along, x + along
            self._add(scene, span, y + right * _WIDE, across, 3e-4, over + _NOTE_HEIGHT, _INK)

    def _finger(self, note: Note) -> int:
        """The number of the finger that is to play a note among all; less than 0 for none."""
        row = min(int(note.start / self._dt + 1e-6), len(self._fingers) - 1)
        return int(self._fingers[row, note.pitch - self._keyboard.lowest_pitch])

    def _add(
        self, scene: mujoco.MjvScene, span: tuple[float, float], y: float, half_width: float,
        half_height: float, height: float, colour: tuple[float, float, float], glow: float = 0.0,
    ) -> None:  # fmt: skip
        """Add a box to the track, from and to so far from its lower edge [m]."""
        if scene.ngeom >= scene.maxgeom:
            return
        x = (span[0] + span[1]) / 2
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom],
            mujoco.mjtGeom.mjGEOM_BOX,
            np.array([(span[1] - span[0]) / 2, half_width, half_height]),
            self._origin + self._frame @ [x, y, -height],
            self._frame.ravel(),
            np.array([*colour, 1.0], np.float32),
        )
        geom = scene.geoms[scene.ngeom]
        geom.emission, geom.specular = glow, 0.0
        scene.ngeom += 1


class _Palm:
    """The palm of a hand, as the hulls that hide keys. Its joints stay as they are."""

    def __init__(self, model: mujoco.MjModel, scene: Scene, side: Side) -> None:
        self._hulls: list[tuple[int, NDArray[np.float64]]] = []
        self._covers: set[int] = set()
        self.geoms: list[int] = []
        for link in (link for link in scene.hand.body.links if link.hides_keys):
            body = model.body(prefix(side) + link.name)
            first = int(body.geomadr[0] + body.geomnum[0]) - len(link.drawn)
            for number, shell in enumerate(link.drawn):
                if shell.material != METAL:
                    self.geoms.append(first + number)
                    self._hulls.append((body.id, np.array(shell.mirrored(side).balls)))
            self._covers.add(first)

    def seen(self, geom: int, opacity: float) -> float:
        """How opaque a geom is while the palm is: of each link only the first cover stays in sight.

        What lies over another would add up.
        """
        return opacity if geom in self._covers else max(opacity - _FADED, 0.0)

    def hides(self, data: mujoco.MjData, points: NDArray[Any], eye: NDArray[Any]) -> bool:
        """Whether most points of any key (K, P, 3) are behind it, seen from an eye (3,)."""
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
        return bool((hidden.sum(axis=1) > points.shape[1] / 2).any())
