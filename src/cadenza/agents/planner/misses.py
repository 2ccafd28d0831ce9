"""Diagnosis of a planned performance: the notes that were lost, and why, in plain words.

A note is a stretch of steps over which a key should sound without a break. It is lost if it never
sounded, sounded more than `_IN_TIME` late, or was let go more than that early. If it did not sound
in time, the first of these rules that holds gives the cause:

1. no finger: the fingering left it out, or gave it to a hand that is not there.
2. key not released: the key still sounded from the note before, or was silent for too short a time
   for another onset to be heard.
3. finger needed elsewhere: the plan holds the key for at most `_SHORTEST`, and less than written,
   because its finger, or the whole hand, has to be elsewhere soon.
4. neighbouring key struck: a key at most two keys away began to sound at about that time, and the
   finger was nearer to it than to its own.
5. collided: the finger was not over its key and more than `_ASTRAY` from where the plan has it,
   and another fingertip, or the other forearm, was within `_TOUCHING` of touching.
6. out of reach: the plan itself has the finger beside the key.
7. too fast to get there: the finger came late, or the plan has it come faster than `_FAST`.
8. finger beside the key: the finger was not over its key, and none of the above.
9. key not pressed far enough: the finger was over the key, which did not reach its stop.

If a note was let go early, the finger was needed elsewhere by the plan, left the key ("finger
beside the key"), or the key came up under it ("key not held down").

The rules look at positions; they do not prove causes, and name one cause of several.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array, Mask, steps_in
from cadenza.agents.planner.plan.nominal_trajectory import MotionPlanner
from cadenza.agents.planner.plan.presses import Press
from cadenza.agents.planner.plan.song_plan import SongPlan, planning_scene
from cadenza.episode import Episode
from cadenza.fingers import SIDES, Finger
from cadenza.hands.body import prefix
from cadenza.hands.forearm import FOREARM, WIDTH
from cadenza.music.performance import key_runs, played_in
from cadenza.music.score import note_name
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.reward import key_state

_IN_TIME = 0.05  # [s] that a note may begin late, or end early
_SHORTEST = 0.05  # [s] in which a key hardly goes down
_BESIDE = 0.002  # [m] a fingertip further than this from a key's edge is not over it
_ASTRAY = 0.01  # [m] off the plan, nearly half a key
_TOUCHING = 0.003  # [m] between surfaces: they may have touched within the step
_FAST = 0.7  # [m/s] along the keyboard in the plan, just before the key is struck
_NEAR = 2  # keys to either side that a finger may strike instead of its own
_COMING = 0.2  # [s] within which a late finger arrives
_ROUNDING = 1e-6  # of a step
_STRIDE = 0.1  # [s] over which its speed is taken


@dataclass(frozen=True)
class Miss:
    """A note that was lost, in whole or in part."""

    time: float  # the time at which it should have begun [s]
    note: str  # the name of the note, such as C4
    finger: Finger | None  # the finger that should have played it
    what: str  # the symptom, such as "never sounded"
    cause: str  # the cause in a few words, by which misses are counted
    reason: str  # the cause in more words
    sounded: bool  # whether it sounded in time, and was only let go early


class _GoalNote(NamedTuple):
    """A note: `key` should sound from step `first` up to, not including, `last`."""

    key: int
    first: int
    last: int


def misses_of(episode: Episode, plan: SongPlan) -> list[Miss]:
    """Misses of an episode by time, whose agent followed `plan`."""
    diagnosis = _Diagnosis(episode, plan)
    notes = sorted(_notes(episode["goal_keys"]), key=lambda n: n[1])
    return [miss for note in notes if (miss := diagnosis.miss(note))]


def foreseen_misses(track: GoalTrack) -> float:
    """Share of the notes of a song that are lost before anything moves, from 0 to 1.

    Rules 1 and 3 need fingers and presses alone: a tenth of a second for a thousand notes. Motion
    loses some more notes, and saves some that are let go early. Raises CadenzaError if there are no
    hands in the scene.
    """
    scene, track, dt = planning_scene(track), track.fingered(), track.config.control_timestep
    goals = track.goals
    presses = {(p.key, p.first - 1): p for p in MotionPlanner(scene, dt).presses(goals.fingers)}
    notes = _notes(goals.keys)
    pairs = ((note, presses.get((note.key, note.first))) for note in notes)
    return sum(not press or _is_cut(press, note, dt) for note, press in pairs) / max(len(notes), 1)


def _notes(keys: Mask) -> list[_GoalNote]:
    """Notes of the keys (T, K) that should sound in each step."""
    runs = zip(*(array.tolist() for array in key_runs(keys)), strict=True)
    return [_GoalNote(key, first, last) for first, last, key in runs]


def _is_cut(press: Press, note: _GoalNote, dt: float) -> bool:
    """Whether the plan lets a key go so early that its note may not sound."""
    return press.last <= note.last and press.last - press.first <= steps_in(_SHORTEST, dt)


class _Diagnosis:
    """The rules, and the arrays of an episode that they need."""

    def __init__(self, episode: Episode, plan: SongPlan) -> None:
        nominal, self._keyboard = plan.nominal, plan.scene.keyboard
        self._may_meet = plan.scene.config.hands != "apart"
        self._times = plan.scene.hand.jump_times
        self._numbers = plan.scene.fingers
        self._dt, self._steps = episode.dt, episode.num_steps
        self._in_time = steps_in(_IN_TIME, self._dt)
        self._goal, self._played = episode["goal_keys"], episode["key_activation"]
        self._onsets = defaultdict[int, list[int]](list)  # key -> the steps of its onsets
        for note in played_in(episode).notes:
            key = note.pitch - self._keyboard.lowest_pitch
            self._onsets[key].append(int(note.start / self._dt + _ROUNDING))
        self._depth = key_state(episode["key_qpos"], self._keyboard.travel)
        self._tips = episode["fingertip_xpos"]
        self._is_present = plan.scene.has_fingers(np.arange(self._numbers.count))
        self._radii = np.array([f.tip_radius for f in plan.scene.hand.fingers * len(SIDES)])
        self._planned_tips = np.zeros((len(nominal.fingertips), self._numbers.count, 3))
        self._planned_tips[:, self._is_present] = nominal.fingertips
        self._presses = {(press.key, press.first - 1): press for press in nominal.presses}
        self._of_finger = defaultdict[int, list[Press]](list)
        for press in nominal.presses:
            self._of_finger[press.finger].append(press)
        self._reasons_without_finger = _reasons_without_finger(plan.track)
        self._forearms = _forearms_apart(episode)

    def miss(self, note: _GoalNote) -> Miss | None:
        """Miss of a note, None if it was not lost."""
        press = self._presses.get((note.key, note.first))
        finger = self._numbers.finger(press.finger) if press else None
        sounding = note.first + np.flatnonzero(self._played[note.first : note.last, note.key])
        is_silent = not len(sounding)
        late = 0 if is_silent else int(sounding[0]) - note.first
        held_through = not (is_silent or late) and self._sounds_from_before(note)
        if is_silent or held_through or late > self._in_time:
            symptom = "never sounded" if is_silent else f"{self._ms(late)} late"
            symptom = "not struck again" if held_through else symptom
            cause, reason = self._why_not(note, press, held_through)
            sounded = False
        elif (early := note.last - 1 - int(sounding[-1])) > self._in_time:
            symptom, sounded = f"let go {self._ms(early)} early", True
            cause, reason = self._why_early(note, press, int(sounding[-1]) + 1)
        else:
            return None
        name = self._name(note.key)
        return Miss(note.first * self._dt, name, finger, symptom, cause, reason, sounded)

    def _name(self, key: int) -> str:
        return note_name(key + self._keyboard.lowest_pitch)

    def _ms(self, steps: int) -> str:
        return f"{1000 * steps * self._dt:.0f} ms"

    def _sounds_from_before(self, note: _GoalNote) -> bool:
        onsets = [step for step in self._onsets[note.key] if step <= note.first]
        since = onsets[-1] if onsets else note.first
        return bool(self._goal[since : note.first, note.key].any())

    # Notes that did not sound in time

    def _why_not(self, note: _GoalNote, press: Press | None, held_through: bool) -> tuple[str, str]:
        if press is None:
            why = self._reasons_without_finger.get((note.key, note.first), "its hand does not play")
            return "no finger", f"no finger for it: {why}"
        if held_through:
            return "key not released", "the key did not come up after the note before it"
        if _is_cut(press, note, self._dt):
            return (
                "finger needed elsewhere",
                f"let go too early to sound, as planned: {self._why_cut(press)}",
            )
        if (neighbour := self._neighbour(note, press)) is not None:
            return "neighbouring key struck", f"the finger pressed {self._name(neighbour)} instead"
        rows = slice(note.first, min(note.first + 1 + self._in_time, self._steps))
        beside = float(self._beside(self._tips[rows, press.finger], note.key).min())
        if beside <= _BESIDE:
            depth = float(self._depth[note.first : note.last, note.key].max())
            return "key not pressed far enough", f"the key went {100 * depth:.0f} % of its way"
        return self._why_elsewhere(note, press, f"the finger was {1000 * beside:.0f} mm away")

    def _why_elsewhere(self, note: _GoalNote, press: Press, where: str) -> tuple[str, str]:
        row, finger = note.first, press.finger
        if with_what := self._collision(row, finger):
            return "collided", f"collided with {with_what}: {where}"
        distance = float(self._beside(self._planned_tips[row + 1, finger], note.key))
        if distance > _BESIDE:
            return "out of reach", f"out of reach: the plan has it {1000 * distance:.0f} mm away"
        coming = self._tips[row : row + 1 + steps_in(_COMING, self._dt), finger]
        speed = self._speed(row + 1, finger)
        if (self._beside(coming, note.key) <= _BESIDE).any() or speed > _FAST:
            return "too fast to get there", f"too fast, planned at {speed:.1f} m/s: {where}"
        return "finger beside the key", where

    def _neighbour(self, note: _GoalNote, press: Press) -> int | None:
        """Key nearby that the finger struck instead of its own, if any."""
        rows = slice(max(note.first - self._in_time, 0), note.first + 1 + 2 * self._in_time)
        before = np.pad(self._played, ((1, 0), (0, 0)))[:-1]
        wrong = (self._played & ~before & ~self._goal)[rows]
        tip = self._tips[min(note.first + self._in_time, self._steps - 1), press.finger]
        for key in range(
            max(note.key - _NEAR, 0), min(note.key + _NEAR + 1, self._keyboard.num_keys)
        ):
            nearer = self._beside(tip, key) < self._beside(tip, note.key)
            if key != note.key and wrong[:, key].any() and nearer:
                return key
        return None

    def _collision(self, row: int, finger: int) -> str:
        """Name of what a finger that is off the plan touches, if anything."""
        tip = self._tips[row, finger]
        if np.linalg.norm(tip - self._planned_tips[row + 1, finger]) <= _ASTRAY:
            return ""
        room = np.linalg.norm(self._tips[row] - tip, axis=1) - self._radii - self._radii[finger]
        hand = self._numbers.hand_of(np.arange(len(room)))
        room[~self._is_present] = room[finger] = np.inf
        if not self._may_meet:
            room[hand != hand[finger]] = np.inf
        if room.min() < _TOUCHING:
            same = hand[room.argmin()] == hand[finger]
            return "the finger beside it" if same else "a finger of the other hand"
        touch = self._may_meet and self._forearms[row] < WIDTH + _TOUCHING
        return "the other forearm" if touch else ""

    def _speed(self, state: int, finger: int) -> float:
        """Planned speed of a finger along the keyboard before `state` [m/s]."""
        before = max(state - steps_in(_STRIDE, self._dt), 0)
        distance = self._planned_tips[state, finger, 1] - self._planned_tips[before, finger, 1]
        return float(abs(distance)) / ((state - before) * self._dt)

    # Notes that were let go early

    def _why_early(self, note: _GoalNote, press: Press | None, end: int) -> tuple[str, str]:
        """Cause and reason for a note that no longer sounds from step `end` on."""
        if press is None:
            return "no finger", "no finger was there for it; another pressed the key in passing"
        if press.last <= note.last and end >= press.last - 1 - self._in_time:
            return "finger needed elsewhere", f"as planned: {self._why_cut(press)}"
        beside = float(self._beside(self._tips[end, press.finger], note.key))
        if beside > _BESIDE:
            return (
                "finger beside the key",
                f"the finger left the key and was {1000 * beside:.0f} mm away",
            )
        return "key not held down", "the key came up under the finger"

    def _why_cut(self, press: Press) -> str:
        later = (p for p in self._of_finger[press.finger] if p.first > press.first)
        following = next((p for p in later if p.key != press.key), None)
        move = steps_in(self._times.next_key, self._dt)
        if following and following.first - press.last <= move:
            return f"its finger had to press {self._name(following.key)}"
        return "the hand had to jump"

    def _beside(self, tips: Array, key: int) -> Array:
        """(...) horizontal distance of fingertips (..., 3) from a key's top [m], 0 over it."""
        outside = np.abs(tips - self._keyboard.centre[key])[..., :2]
        outside -= self._keyboard.half_size[key, :2]
        return np.asarray(np.linalg.norm(np.maximum(outside, 0.0), axis=-1))


def _reasons_without_finger(track: GoalTrack) -> Mapping[tuple[int, int], str]:
    """(key, first step) -> the reason why this note has no finger.

    Where a key is struck again at once, the goal begins a step after the note.
    """
    lowest = track.scene.keyboard.lowest_pitch
    return {
        (note.pitch - lowest, track.first_step(note) + late): reason
        for late in (1, 0)
        for note, reason in track.dropped or ()
    }


def _forearms_apart(episode: Episode) -> Array:
    """(T,) distance of the forearms along the keyboard [m], infinite without two."""
    bodies = list(episode.scene["bodies"])
    forearms = [prefix(side) + FOREARM for side in SIDES]
    if not set(forearms) <= set(bodies):
        return np.full(episode.num_steps, np.inf)
    right, left = (episode["body_xpos"][:, bodies.index(name), 1] for name in forearms)
    return np.asarray(right - left, np.float64)
