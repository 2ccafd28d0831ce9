"""Corrections of a song note by note, by the notes that were heard."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.presses import Press
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.strike_model import strike_model
from cadenza.agents.planner.search.fingertip_correction import servo_corrections
from cadenza.agents.planner.search.strikes import UNIT, log_speed
from cadenza.agents.robot.places import HandPlaces
from cadenza.fingers import SIDES
from cadenza.music.score import Note
from cadenza.scene.kinematics import TIP, Kinematics
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of

# Corrections by one play [m].
_DEEPER = 0.003  # depth for a key that was lost
_BESIDE = 0.0015  # shift of a finger that brushes the next key
_RAISE = 0.003  # height of an idle finger that sounds a key
_LIFT = 0.004  # maximum at the end of a press, to either side
_MAX_STRIKE = np.array([0.004, 0.008])
_BOUNDS: dict[str, tuple[Any, Any]] = {
    "deeper": (-1.0, 2.0),
    "lift": (-2.0, 4.0),
    "beside": (-4 / 3, 4 / 3),
    "reach": (np.array([-3.0, -1.0]), np.array([3.0, 1.0])),  # not as far as the next key
    "strike": (np.array([-20 / 3, -40 / 3]), np.array([20 / 3, 40 / 3])),
    "hands": (-2.0, 2.0),
}
"""Bounds of all corrections together, as multiples of the usual error of the keyboard's place."""
_SHARE = 0.6  # share of the error of a strike that is corrected

_MAX_LATENESS = 0.15  # [s] of the note that a press played
_MAX_ERROR = np.array([0.06, 1.5])  # [s, octaves] of a strike that counts
_UNIT = UNIT / [1.0, 0.4]  # errors of equal weight: times matter more than loudness
_DAMPING = 1e3  # [1/m^2] of the corrections of strikes, as in `StrikeRefinement`
_END = 0.02  # target time from the end of a press to the end of its note, to be not too early [s]
_LIFT_SPEED = 0.15  # [m/s] of lifts by the error of the end
_LOST = 0.06  # [s] by which a note is too short, above which its key was lost, not released
_HOLD = 0.006  # [m] of lowering at the end of a press for which its finger stays a control step
_NEAR = 5  # control steps around a press in which its finger may sound its key
_BEFORE = 3  # control steps before a press in which its finger moves over its key
_STRIKING = 4  # first control steps of a press, which show where its finger struck
_HIT = 0.005  # [m] from its target at which a finger still hits its key
_REACH = 0.5  # share of a larger distance that is corrected
_MIN_SOUNDING = 0.2  # share of a press in which its key sounds, unless its finger did not arrive
_LONG = 40  # control steps of a press that may be struck late, rather than never
_MAX_WAIT_SHARE = 3  # it waits at most for an n-th of the press
_AWAY = 0.012  # [m] above its target at which a finger waits
_HIGHEST = 0.055  # [m] height of fingertips above which they sound no key


@dataclass
class PressCorrections:
    """The corrections of N presses and H hands [m]."""

    deeper: Array
    """(N,) while a key is held."""
    lift: Array
    """(N,) at the end of the press; below 0, its finger stays longer."""
    beside: Array
    """(N,) to the player's right."""
    reach: Array
    """(N, 2) along the key and across it, for a finger that fell short."""
    wait: Array
    """(N,) control steps by which a finger strikes late, as it does not arrive in time."""
    strike: Array
    """(N, 2) deeper controls before the strike, and in it."""
    hands: Array
    """(H, 3) of all fingertips of a hand."""
    raised: list[tuple[int, int, int]] = field(default_factory=list)
    """First state, end and row of idle fingers that are raised."""

    @classmethod
    def none(cls, presses: int, hands: int) -> PressCorrections:
        """No corrections."""
        deeper, lift, beside, wait = np.zeros((4, presses))
        reach, strike = np.zeros((2, presses, 2))
        return cls(deeper, lift, beside, reach, wait, strike, np.zeros((hands, 3)))

    def towards(self, other: PressCorrections, share: float, place: float) -> PressCorrections:
        """These corrections, moved by a share of the way to others, within bounds.

        The usual error of the keyboard's place is `place` [m].
        """
        return PressCorrections(
            **{
                name: (old + share * (getattr(other, name) - old)).clip(low * place, high * place)
                for name, (low, high) in _BOUNDS.items()
                for old in [getattr(self, name)]
            },
            wait=other.wait,
            raised=other.raised,
        )


class NoteCorrections:
    """Corrections of a plan by the notes that were heard of it."""

    def __init__(self, plan: SongPlan, postures: Array, place: float) -> None:
        """Take the plan of a song, and the postures (T + 1, A) in which it is played.

        The usual error of the keyboard's place is `place` [m].
        """
        scene, dt = plan.scene, plan.track.config.control_timestep
        self._scene, self._dt, self._postures = scene, dt, postures
        self._place = place
        self._places = HandPlaces(scene.keyboard, len(scene.sides), place)
        self._kinematics = Kinematics(scene)
        self._tips, self._jacobian = self._kinematics.fingertips(postures)
        self._fingers = scene.fingers.per_hand
        self._servos = [servos_of(hand_alone(scene, side).scene) for side in scene.sides]
        self._presses, self._lowering = plan.nominal.presses, plan.nominal.lowering
        self._rows = [self._row(press) for press in self._presses]
        self._model = strike_model(scene, dt)
        self._steps = len(postures) - 1

    def _row(self, press: Press) -> int:
        first = self._scene.fingers.of_hand(SIDES.index(press.side)).start
        return self._fingers * self._scene.sides.index(press.side) + press.finger - first

    def none(self) -> PressCorrections:
        """No corrections."""
        return PressCorrections.none(len(self._presses), len(self._scene.sides))

    # Corrections as motions of servos

    def postures(self, corrections: PressCorrections) -> Array:
        """Postures (T + 1, A) with all corrections except those of strikes."""
        error, postures = self._displacements(corrections), self._postures.copy()
        reach = np.zeros_like(error[..., :2])
        for press, row, way in zip(self._presses, self._rows, corrections.reach, strict=True):
            reach[max(press.first - _BEFORE, 0) : press.last, row] = way
        error[..., :2] += reach
        for hand, side in enumerate(self._scene.sides):
            fingers = slice(hand * self._fingers, (hand + 1) * self._fingers)
            weight = np.ones((len(error), self._fingers))
            jacobian = self._jacobian[:, fingers]
            change = servo_corrections(error[:, fingers], weight, jacobian, self._servos[hand])
            postures[:, self._scene.servos_on(side)] += change
        return postures + self._held_longer(corrections)

    def _held_longer(self, corrections: PressCorrections) -> Array:
        """Changes of postures (T + 1, A) for fingers that release their keys later."""
        change, steps = np.zeros_like(self._postures), np.arange(len(self._postures))
        share = (-corrections.lift / _HOLD).clip(0.0, 1.0)
        for press, row, hold in zip(self._presses, self._rows, share, strict=True):
            hand, finger = divmod(row, self._fingers)
            servos = self._scene.servos_on(self._scene.sides[hand])
            last = steps[press.last - 1 : press.last + 2]
            delayed = hold * (self._postures[last - 1, servos] - self._postures[last, servos])
            change[last, servos] += delayed * (self._servos[hand].finger == finger)
        return change

    def _displacements(self, corrections: PressCorrections) -> Array:
        """Displacements (T + 1, F, 3) of fingertips by the corrections [m]."""
        result = np.zeros_like(self._tips)
        result += np.repeat(corrections.hands, self._fingers, axis=0)
        for i, (press, row) in enumerate(zip(self._presses, self._rows, strict=True)):
            result[press.first : press.last, row, 2] -= corrections.deeper[i]
            result[press.first - 1 : press.last, row, 1] += corrections.beside[i]
            if wait := int(corrections.wait[i]):
                result[max(press.first - _BEFORE, 0) : press.first + wait, row, 2] += _AWAY
            lift = max(corrections.lift[i], 0.0)
            result[press.last - 1, row, 2] += lift / 2
            result[press.last : press.last + 1, row, 2] += lift
        for first, last, row in corrections.raised:
            result[first:last, row, 2] += _RAISE
        return result

    def strikes(self, corrections: PressCorrections) -> Array:
        """Changes (T, A) of controls that correct strikes."""
        controls = np.zeros((self._steps, self._postures.shape[1]))
        for press, row, (before, during) in zip(
            self._presses, self._rows, corrections.strike, strict=True
        ):
            step, (hand, finger) = press.first - 1, divmod(row, self._fingers)
            servos = self._scene.servos_on(self._scene.sides[hand])
            is_of_finger = self._servos[hand].finger == finger
            lowering = self._lowering[step, servos] * is_of_finger
            controls[max(step - 1, 0), servos] += before * lowering * (step > 0)
            controls[step, servos] += during * lowering
        return controls

    # Corrections by the notes heard

    def locate(self, notes: Sequence[Note], postures: Array) -> None:
        """Learn from a play, in `postures` (T + 1, A), where the hands strike."""
        self._places.begin()
        tips = self._kinematics.points(postures)[:, :, TIP]
        lower = (self._tips - tips)[:, :, 2]
        lowest = self._scene.keyboard.lowest_pitch
        due = np.array([self._due(press)[0] for press in self._presses])
        keys = np.array([press.key for press in self._presses])
        for press, row, time in zip(self._presses, self._rows, due, strict=True):
            tip = tips[press.first : press.last, row][:_STRIKING].mean(axis=0)
            others = keys[(abs(due - time) < 2 * _MAX_LATENESS) & (keys != press.key)]
            sounding = np.array(
                [n.pitch - lowest for n in notes if abs(n.start - time) < _MAX_LATENESS]
            )
            self._places.strike(row // self._fingers, press.key, tip, others, sounding)
            if down := self._down(press, notes):
                self._places.hold(row // self._fingers, float(lower[down, row].mean()))

    def _down(self, press: Press, notes: Sequence[Note]) -> list[int]:
        """The states of a press, except the first, in which its key has sounded for a step."""
        pitch, dt = press.key + self._scene.keyboard.lowest_pitch, self._dt
        spans = [(note.start + dt, note.end + dt) for note in notes if note.pitch == pitch]
        states = range(press.first + 1, press.last)
        return [s for s in states if any(start < s * dt < end for start, end in spans)]

    def corrected(
        self, corrections: PressCorrections, notes: Sequence[Note], postures: Array, share: float
    ) -> PressCorrections:
        """Corrections by a `share` of the errors heard in a play, in `postures` (T + 1, A)."""
        new, by_key = deepcopy(corrections), defaultdict[int, list[Note]](list)
        for note in notes:
            by_key[note.pitch - self._scene.keyboard.lowest_pitch].append(note)
        matches = self._matches(by_key)
        for i, (press, match) in enumerate(zip(self._presses, matches, strict=True)):
            if match is None:
                self._correct_missed(new, i, by_key[press.key])
            else:
                self._correct_strike(new, i, match)
                self._correct_end(new, i, match)
            min_length = max(_LONG, _MAX_WAIT_SHARE * (new.wait[i] + _STRIKING))
            is_long = press.last - press.first >= min_length
            if is_long and self._share_sounding(press, by_key[press.key]) < _MIN_SOUNDING:
                new.wait[i] += _STRIKING
        tips = self._kinematics.points(postures)[:, :, TIP]
        shortfall = self._shortfall(corrections, tips)
        new.reach += _REACH * (shortfall - shortfall.clip(-_HIT, _HIT))
        extra_notes = [note for note in notes if not any(note is match for match in matches)]
        self._correct_others(new, extra_notes, tips)
        new.hands[:, 1:] = -np.stack([self._places.right, self._places.up], axis=1)
        return corrections.towards(new, share, self._place)

    def _due(self, press: Press) -> tuple[float, float]:
        """Target times of onset and offset of a press [s]."""
        within = press.strike.time if press.strike else self._dt / 2
        return (press.first - 1) * self._dt + within, (press.last - 1) * self._dt

    def _matches(self, by_key: dict[int, list[Note]]) -> list[Note | None]:
        """The note of each press, None without any."""
        result: list[Note | None] = []
        for press in self._presses:
            due, _ = self._due(press)
            near = [n for n in by_key[press.key] if abs(n.start - due) < _MAX_LATENESS]
            near = [n for n in near if not any(n is matched for matched in result)]
            result.append(min(near, key=lambda n: abs(n.start - due), default=None))
        return result

    def _share_sounding(self, press: Press, notes: list[Note]) -> float:
        begin, end = (press.first - 1) * self._dt, (press.last - 1) * self._dt
        sounding = sum(max(min(n.end, end) - max(n.start, begin), 0.0) for n in notes)
        return sounding / (end - begin)

    def _shortfall(self, corrections: PressCorrections, tips: Array) -> Array:
        """Distances (N, 2) of fingers from their targets when they struck, along and across [m]."""
        error = (self._tips + self._displacements(corrections) - tips)[:, :, :2]
        presses = zip(self._presses, self._rows, strict=True)
        return np.array(
            [error[p.first : p.last, row][:_STRIKING].mean(axis=0) for p, row in presses]
        )

    def _correct_missed(self, new: PressCorrections, i: int, notes: list[Note]) -> None:
        """Correct a press without a note: its key was still down, or has not gone down."""
        press = self._presses[i]
        due, _ = self._due(press)
        if any(note.start < due < note.end for note in notes):
            return  # the note before is corrected, as it ends late
        new.deeper[i] += _DEEPER
        new.strike[i, 1] += 2 * _DEEPER

    def _correct_strike(self, new: PressCorrections, i: int, note: Note) -> None:
        """Correct onset and loudness of a note by a damped least-squares step."""
        press, (due, _) = self._presses[i], self._due(self._presses[i])
        if press.strike is None:
            return
        keyboard = self._scene.keyboard
        lever = 2 * keyboard.white.half_size[0]  # nearly
        speed = log_speed(keyboard.speed(max(note.velocity, 1)))
        error = np.array([note.start - due, speed - np.log2(press.strike.speed)])
        error = error.clip(-_MAX_ERROR, _MAX_ERROR) / _UNIT
        depth = np.tan(keyboard.sounds_from[press.key]) * lever
        response = self._model.response(
            *np.array([[press.strike.time], [press.strike.speed * lever], [depth]])
        )
        response = response[0] / _UNIT[:, None]
        damped = response.T @ response + _DAMPING * np.eye(2)
        step = -np.linalg.solve(damped, response.T @ error).clip(-_MAX_STRIKE, _MAX_STRIKE)
        new.strike[i] += _SHARE * step

    def _correct_end(self, new: PressCorrections, i: int, note: Note) -> None:
        """Correct the end of a note: its key was lost, or released early or late."""
        _, end = self._due(self._presses[i])
        if note.end < end - _LOST:
            new.deeper[i] += _DEEPER
        elif self._presses[i].last <= self._steps:  # the last notes end with the song
            new.lift[i] += np.clip(_LIFT_SPEED * (note.end - end - _END), -_LIFT, _LIFT)

    def _correct_others(self, new: PressCorrections, notes: list[Note], tips: Array) -> None:
        """Correct extra notes, by the places of fingertips (T + 1, F, 3)."""
        keyboard, right = self._scene.keyboard, np.repeat(self._places.right, self._fingers)
        for note in notes:
            key = note.pitch - keyboard.lowest_pitch
            state = min(int(note.start / self._dt) + 1, self._steps)
            if of_key := self._pressing(state, _NEAR, key=key):
                if note.start > self._due(self._presses[of_key[0]])[1]:
                    new.lift[of_key[0]] += _LIFT
                continue
            away = abs(tips[state, :, 1] + right - keyboard.centre[key, 1])
            row = int(np.argmin(away + np.maximum(tips[state, :, 2] - _HIGHEST, 0.0)))
            if pressing := self._pressing(state, 1, row=row):
                left = key < self._presses[pressing[0]].key
                new.beside[pressing[0]] += _BESIDE if left else -_BESIDE
            else:
                last = int(note.end / self._dt) + 2
                new.raised.append((max(state - 2, 1), last, row))

    def _pressing(
        self, state: int, near: int, *, key: int | None = None, row: int | None = None
    ) -> list[int]:
        """Numbers of the presses of a key, or of a finger, within some steps around a state."""
        return [
            i
            for i, press in enumerate(self._presses)
            if (press.key == key or self._rows[i] == row)
            and press.first - near <= state <= press.last + near
        ]
