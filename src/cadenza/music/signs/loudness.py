"""How loud notes are by the dynamics and hairpins of their staff."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from operator import itemgetter

from cadenza.music.score import LOUDEST, SOFTEST
from cadenza.music.signs import HAIRPIN_STEP, OPEN_HAIRPIN, SFORZATO

_GOAL_WITHIN = Fraction(1)  # [quarters] after a hairpin within which a dynamic is its goal


@dataclass(frozen=True, slots=True)
class Dynamic:
    """A dynamic mark: notes have a `velocity` from an `onset` on.

    With `then`, as of fp, it is that of the notes at `onset` alone, and those after have `then`.
    """

    onset: Fraction
    velocity: int
    then: int | None = None


@dataclass(frozen=True, slots=True)
class Sforzato:
    """A sforzato, sf, fz or the like: the notes at `onset` are louder than those around them."""

    onset: Fraction


@dataclass(frozen=True, slots=True)
class Hairpin:
    """A hairpin: from `onset` to `end` notes become louder (`step` 1) or softer (-1) by degrees.

    The end of a word such as cresc. is None: it goes on up to the next dynamic. With `niente` they
    come from silence, or fade into it.
    """

    onset: Fraction
    end: Fraction | None
    step: int
    niente: bool = False


class Loudness:
    """The velocity of notes as a function of their place, by the marks of one staff in any order.

    Under a hairpin it leads from the dynamic before to that after it. Where there is none, or one
    in the other direction, it changes by `HAIRPIN_STEP`. Up to the first dynamic it is `unmarked`.
    """

    def __init__(self, marks: Iterable[Dynamic | Sforzato | Hairpin], unmarked: int) -> None:
        marks = list(marks)
        self._accented = {mark.onset for mark in marks if isinstance(mark, Sforzato)}
        self._alone = {
            mark.onset: mark.velocity
            for mark in marks
            if isinstance(mark, Dynamic) and mark.then is not None
        }
        levels = {
            mark.onset: float(mark.velocity if mark.then is None else mark.then)
            for mark in marks
            if isinstance(mark, Dynamic)
        }
        hairpins = {mark.onset: mark for mark in marks if isinstance(mark, Hairpin)}
        # From which place on; the velocity there, and its slope [per quarter].
        self._segments = [(Fraction(0), float(unmarked), 0.0)]
        dynamics, begins = sorted(levels), sorted(hairpins)
        for place in sorted({*levels, *hairpins}):
            velocity = levels.get(place, self._at(place))
            self._add(place, velocity)
            if hairpin := hairpins.get(place):
                dynamic, following = _next(dynamics, place), _next(begins, place)
                goal = None if dynamic is None else (dynamic, levels[dynamic])
                self._ramp(hairpin, velocity, goal, following)

    def at(self, place: Fraction) -> int:
        """The velocity, 1 to 127, of notes at a place [quarters]; 0 where a dynamic of 0 holds."""
        velocity = self._alone.get(place, self._at(place))
        if place in self._accented:
            velocity *= SFORZATO
        return within_midi(velocity) if velocity else 0

    def _at(self, place: Fraction) -> float:
        index = bisect_right(self._segments, place, key=itemgetter(0))
        begin, velocity, slope = self._segments[max(index - 1, 0)]
        return velocity + slope * float(place - begin)

    def _add(self, place: Fraction, velocity: float, slope: float = 0.0) -> None:
        """Add a segment, and remove those after its beginning."""
        del self._segments[bisect_left(self._segments, place, key=itemgetter(0)) :]
        self._segments.append((place, velocity, slope))

    def _ramp(
        self,
        hairpin: Hairpin,
        first_velocity: float,
        dynamic: tuple[Fraction, float] | None,
        following: Fraction | None,
    ) -> None:
        """Add the change under a hairpin from `first_velocity` on, and the velocity after it.

        The next dynamic has a place and a velocity, the `following` hairpin a place.
        """
        end, grows = hairpin.end, hairpin.step > 0
        begin = SOFTEST if hairpin.niente and grows else first_velocity
        goal = begin + hairpin.step * HAIRPIN_STEP
        if hairpin.niente:
            goal = max(goal, first_velocity) if grows else SOFTEST
        if end is None:
            open_end = hairpin.onset + OPEN_HAIRPIN if dynamic is None else dynamic[0]
            end = open_end if following is None else following
        if dynamic is not None:
            end = min(end, dynamic[0])
            is_goal = (dynamic[1] - begin) * hairpin.step > 0 and (grows or not hairpin.niente)
            if dynamic[0] <= end + _GOAL_WITHIN and is_goal:
                goal = dynamic[1]
        if end > hairpin.onset:
            goal = min(max(goal, SOFTEST), LOUDEST)
            self._add(hairpin.onset, begin, (goal - begin) / float(end - hairpin.onset))
            self._add(end, goal)


def _next(places: list[Fraction], place: Fraction) -> Fraction | None:
    """The first of some `places`, in their order, that comes after another, if any."""
    index = bisect_right(places, place)
    return places[index] if index < len(places) else None


def within_midi(velocity: float) -> int:
    """The nearest whole velocity that MIDI has, 1 to 127."""
    return min(max(round(velocity), SOFTEST), LOUDEST)
