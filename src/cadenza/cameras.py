"""The cameras of pages, films and pictures, and their places, as `camera.js` has them, too."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]  # (N, 3) [m], x towards the player, y to the player's right, z up

VIEWS = {
    "player": (0.5, 0.0, 0.87),
    "close": (0.45, 0.0, 0.9),
    "top": (0.005, 0.0, 1.0),
    "audience": (-0.66, 0.0, 0.75),
    "side": (0.2, -0.8, 0.55),
}
"""Name of each -> the direction to it, of any length. `close` looks at the hands; the others at the
whole keyboard, or at the hands where the keyboard does not fill the picture."""
FIELD_OF_VIEW = 28.0  # of all views, from the lower edge of the picture to the upper one [degree]

_ROOM = np.array([0.97, 0.95])  # share of width and height of the picture for the subject
_FILLED = 0.88  # share of width and height, with surroundings, below which the camera turns
_ALONG = 65  # points of a long edge; some are beside the picture
_CLOSEST = 0.05  # the nearest visible distance from the camera [m]
_ROUNDS = 8  # rounds of fitting, until nothing moves by a pixel
_MAX_TURN = np.radians(70)  # around hands that are too far apart to fill a picture
_HALVINGS = 11  # halvings of the range of turns, down to .03 degrees


def points_of_box(low: Any, high: Any, along: int = 2) -> Points:
    """Return `along` points on each long edge of a box between two corners (3,)."""
    x, y, z = (np.linspace(low[i], high[i], count) for i, count in enumerate((2, along, 2)))
    return np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)


def outline_of(low: Any, high: Any) -> Points:
    """Points of a case between two corners (3,), low at the front and high at the back."""
    points = points_of_box(low, high, _ALONG)
    return points[(points[:, 0] < high[0]) | (points[:, 2] < high[2])]


class Sight(NamedTuple):
    """A scene before a camera."""

    subject: Points  # has to be in the picture
    surroundings: Points  # may fill the rest of it


class Camera:
    """A camera of `VIEWS` in a picture of some shape."""

    def __init__(self, view: str, aspect: float) -> None:
        """Look from a side; `aspect` is the width of the picture over its height."""
        self._from = np.array(VIEWS[view]) / np.linalg.norm(VIEWS[view])
        self._follows = view == "close"
        self._slope = np.tan(np.radians(FIELD_OF_VIEW) / 2) * np.array([aspect, 1.0])
        self._turn(0.0)

    def _turn(self, angle: float) -> None:
        """Turn around the subject, by an angle from the direction of the view [rad]."""
        (x, y, z), cos, sin = self._from, np.cos(angle), np.sin(angle)
        away = np.array([cos * x - sin * y, sin * x + cos * y, z])
        side = np.array([-away[1], away[0], 0.0]) / np.hypot(away[0], away[1])
        self.axes = np.array([side, np.cross(away, side), away])
        """(3, 3) its directions to the right, up, and away from the subject."""

    def place(self, overview: Sight, hands: Sight) -> tuple[Points, float]:
        """Place the camera so that its subject fills the picture.

        Where hands are too far apart to fill it, it turns as little as fills it. Returns the point
        (3,) in the middle of the picture [m], and its distance [m].

        Args:
            overview: the subject from afar.
            hands: the subject close by, which is always shown.
        """
        self._turn(0.0)
        sight, (target, distance) = overview, self._fit(overview.subject)
        nearest = distance
        if self._follows or self._filled(overview, target, distance).min() < _FILLED:
            sight, (target, nearest) = hands, self._fit_turning(hands)
        if self._follows:
            distance = nearest
        for _ in range(_ROUNDS):
            if distance > nearest:
                share = self._filled(sight, target, distance).min() / _FILLED
                distance = max(nearest, distance * share)
            target = target + self._shift(sight, target, distance)
        return target, distance

    def _fit_turning(self, sight: Sight) -> tuple[Points, float]:
        """Fit the subject, turned as little as fills the picture along its less filled axis."""
        target, distance = self._fit(sight.subject)
        filled = self._filled(sight, target, distance)
        way = filled.argmin()
        if filled[way] >= _FILLED:
            return target, distance
        low, high = 0.0, _MAX_TURN
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            self._turn(middle)
            target, distance = self._fit(sight.subject)
            if self._filled(sight, target, distance)[way] < _FILLED:
                low = middle
            else:
                high = middle
        return target, distance

    def _shift(self, sight: Sight, target: Points, distance: float) -> Points:
        """The shift [m] that leaves the least empty space, the same at both edges."""
        low, high = self._extent(sight, target, distance)
        aside = np.minimum(high - 1, 0) + np.maximum(low + 1, 0)
        shift = np.where(high - low < 2, (low + high) / 2, aside)
        seen = self._seen(sight.subject, target, distance)
        shift = np.clip(shift, np.minimum(seen.max(0) - 1, 0), np.maximum(seen.min(0) + 1, 0))
        return (shift * self._slope * distance) @ self.axes[:2]

    def _filled(self, sight: Sight, target: Points, distance: float) -> Points:
        """The share of width and height (2,) of the picture that is filled."""
        low, high = self._extent(sight, target, distance)
        return (high - low) / 2

    def _seen(self, points: Points, target: Points, distance: float) -> Points:
        """(N, 2) the places of points in the picture, from -1 to 1 both ways."""
        x, y, z = ((points - target) @ self.axes.T).T
        return np.stack([x, y], axis=1) / np.maximum(distance - z, _CLOSEST)[:, None] / self._slope

    def _fit(self, points: Points) -> tuple[Points, float]:
        """The point to look at and the distance at which points fill the picture [m]."""
        target, distance = (points.min(0) + points.max(0)) / 2, 1.0
        for _ in range(_ROUNDS):
            seen = self._seen(points, target, distance)
            low, high = seen.min(0), seen.max(0)
            target = target + ((low + high) / 2 * self._slope * distance) @ self.axes[:2]
            distance *= float(((high - low) / 2 / _ROOM).max())
        return target, distance

    def _extent(self, sight: Sight, target: Points, distance: float) -> tuple[Any, Any]:
        """The bounds (2,) of visible points; those outside the other way do not count."""
        seen = self._seen(np.concatenate(sight), target, distance)
        inside = np.abs(seen[:, ::-1]) <= 1
        inside |= ~inside.any(0)
        low, high = (np.where(inside, seen, far) for far in (np.inf, -np.inf))
        return low.min(0), high.max(0)
