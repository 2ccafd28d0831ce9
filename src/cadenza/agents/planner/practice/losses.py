"""Loss and cost of every control step of a hand: notes first, then frames, then strikes."""

from __future__ import annotations

from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Mask, steps_in
from cadenza.agents.planner.plan.hand_goals import HandGoals, first_steps
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.fingertip_correction import MAX_ERROR
from cadenza.agents.planner.search.horizon_cost import HARMLESS_DEPTH
from cadenza.agents.planner.search.strikes import TOLERANCE, log_speed, strike_costs
from cadenza.music.metrics import ONSET_TOLERANCE
from cadenza.music.performance import BOUNCE
from cadenza.tasks import reward

NOTE_WEIGHT = 2.0  # the weight of note onset F1 beside that of F1, which is 1
_IN_TIME = ONSET_TOLERANCE + 5e-5  # [s] early or late: metrics round differences to 0.1 ms
_RECENT = 0.2  # [s] after which an event of a key no longer matters to its next onset
# Weights that are small beside the loss of one key in one step, so that they only decide between
# rollouts of equal loss.
_DEPTH_WEIGHT = 0.06  # of the squared share of a key's travel that is missing or too much
_FINGERTIP_WEIGHT = 0.02  # of the cost that the search gives fingertips off their targets
_STRIKE_WEIGHT = 0.01  # of the cost that the search gives strikes


class KeyEvents(NamedTuple):
    """Last onsets and offsets of K keys in a step, (K,) each; NaN without any."""

    onset: Array  # when the key began to sound, from the beginning of the step on [s]
    offset: Array  # when it ceased to sound [s]
    speed: Array  # its speed at the onset [rad/s]


class KeyHistory(NamedTuple):
    """The state of K keys after a step, (K,) each."""

    sounding: Mask
    ended: Array  # when the last note of the key ended, from the beginning of the song on [s]
    # The number of written notes of each key that have been struck or missed
    decided: NDArray[np.intp]

    def of(self, keys: slice) -> KeyHistory:
        """The history of some of the keys."""
        return KeyHistory._make(values[keys] for values in self)


class NoteEvents(NamedTuple):
    """The fate of notes in a step."""

    missed: int  # the number of the hand's notes for which it is now too late
    extra: Mask  # (K,) keys that began to sound without a written note
    struck: NDArray[np.intp]  # (S,) keys whose written notes were struck in time
    note: NDArray[np.intp]  # (S,) the numbers of these notes among those of their keys
    history: KeyHistory  # the keys after the step


class WrittenNotes:
    """The written notes, and how strikes are matched with them.

    The matching is that of note onset F1: a key that sounds for a single physics step has played a
    note, a bounce is not another note, and the first strike within the tolerance of a written note
    matches it.
    """

    def __init__(self, plan: SongPlan, goals: HandGoals) -> None:
        """Take all notes of a plan that have a first step; those of the hand can be missed."""
        track, keys = plan.track, plan.goals.keys
        dt, begins, strikes = goals.dt, first_steps(keys), plan.strikes.by_place(0, len(keys))
        by_key: list[dict[int, float]] = [{} for _ in range(keys.shape[1])]  # starts by first step
        for note in sorted(track.delayed_score.notes, key=attrgetter("start")):
            key, step = note.pitch - plan.scene.keyboard.lowest_pitch, int(note.start * (1 / dt))
            for first in step, step + 1:  # a repeated note may begin a step late
                if begins[first : first + 1, key].any():
                    by_key[key].setdefault(first, note.start)
                    break
        shape = len(by_key), max(map(len, by_key)) + 1
        self._latest, self._of_hand = np.full(shape, np.inf), np.zeros(shape, bool)
        self._strikes, end = np.full((*shape, 2), np.nan), len(keys) * dt
        for key, notes in enumerate(by_key):
            for i, (step, start) in enumerate(notes.items()):
                self._latest[key, i] = min(start + _IN_TIME, end)
                self._of_hand[key, i] = goals.keys[step, key]
                if strike := strikes.get((step, key)):
                    self._strikes[key, i] = step * dt + strike.time, np.log2(strike.speed)
        self.count, self._dt, self._recent = sum(map(len, by_key)), dt, steps_in(_RECENT, dt)

    def events(
        self, step: int, sounding: Mask, events: KeyEvents, history: KeyHistory, keys: slice
    ) -> NoteEvents:
        """Fate of notes in a step after which keys (K,) are `sounding`."""
        begin, row = step * self._dt, np.arange(len(sounding))
        latest, of_hand = self._latest[keys], self._of_hand[keys]
        onset, offset = begin + events.onset, begin + events.offset
        repeats = history.sounding & (offset < onset)
        ended = np.where(repeats, offset, history.ended)
        begins = (repeats | ~history.sounding) & (onset - ended >= BOUNCE)
        too_late = begins & (latest[row, history.decided] < onset)
        missed = int(np.count_nonzero(too_late & of_hand[row, history.decided]))
        note = history.decided + too_late
        struck = begins & (latest[row, note] - onset <= 2 * _IN_TIME)
        decided = note + struck
        too_late = latest[row, decided] <= (step + 1) * self._dt
        missed += int(np.count_nonzero(too_late & of_hand[row, decided]))
        ended = np.where(sounding | np.isnan(offset), ended, offset)
        where = np.flatnonzero(struck & of_hand[row, note])
        after = KeyHistory(sounding, ended, decided + too_late)
        return NoteEvents(missed, begins & ~struck, where, note[where], after)

    def strikes(self, key: NDArray[np.intp], note: NDArray[np.intp]) -> Array:
        """(S, 2) target times of notes of keys (S,) [s], and log2 of their speeds [rad/s]."""
        return self._strikes[key, note]

    def history(self, step: int, sounding: Mask, onset: Array, offset: Array) -> KeyHistory:
        """The keys before a step, given whether and when (T, K) they sounded in earlier steps."""
        first = max(step - self._recent, 0)
        before = sounding[first - 1] if first else np.zeros(sounding.shape[1], bool)
        decided = np.count_nonzero(self._latest <= first * self._dt, axis=1)
        history = KeyHistory(before, np.full(len(before), -np.inf), decided)
        for row in range(first, step):
            events = KeyEvents(onset[row], offset[row], onset[row])
            history = self.events(row, sounding[row], events, history, slice(None)).history
        return history


class StepLoss(NamedTuple):
    """The evaluation of a step."""

    loss: float  # the loss of notes and of F1
    faults: int  # the number of missed and extra notes
    strike_loss: float  # the loss of strikes that are out of time, or too loud or too soft
    cost: float  # both losses, and a little for errors that are nearly a loss
    history: KeyHistory  # the keys after the step


class Losses:
    """Evaluation of one hand after each step of a song.

    The loss of a step is 1 - F1, as if the other hand played all its keys, and that of the missed
    and extra notes in it, which lose the same. The sum over the song is about
    T (1 - F1 + `NOTE_WEIGHT` (1 - note onset F1)). Strikes lose little, and nothing within
    `TOLERANCE`.

    Attributes:
        notes: the written notes.
        fault: the loss of a missed or an extra note.
    """

    def __init__(self, plan: SongPlan, goals: HandGoals) -> None:
        """Take the plan of the whole song, and the goals of the hand in it."""
        self._goals, self._keyboard = goals, plan.scene.keyboard
        self._keys, self._num_target = plan.goals.keys, plan.goals.keys.sum(axis=1)
        self.notes = WrittenNotes(plan, goals)
        self.fault = NOTE_WEIGHT * len(self._keys) / max(2 * self.notes.count, 1)

    def after(
        self,
        step: int,
        key_qpos: Array,
        events: KeyEvents,
        fingertips: Array,
        history: KeyHistory,
        keys: slice = slice(None),
        near: Mask | bool = True,
    ) -> StepLoss:
        """Evaluate the state after a step.

        Args:
            step: the control step of the song.
            key_qpos: (K,) angles of the keys [rad].
            events: their events in the step.
            fingertips: (F, 3) positions of the hand's fingertips [m].
            history: the keys before the step.
            keys: the numbers of these keys; all by default.
            near: (K,) keys for which the hand pays if they sound and should not.
        """
        goals, keyboard, target = self._goals, self._keyboard, self._keys[step, keys]
        of_hand, travel = goals.keys[step, keys], keyboard.travel[keys]
        wrong_keys = ~target & near
        sounding = reward.key_activation(key_qpos, keyboard.sounds_from[keys])
        missing = np.count_nonzero(of_hand & ~sounding)
        wrong = np.count_nonzero(sounding & wrong_keys)
        frame = (missing + wrong) / max(2 * self._num_target[step] - missing + wrong, 1)
        notes = self.notes.events(step, sounding, events, history, keys)
        faults = notes.missed + int(np.count_nonzero(notes.extra & near))
        loss = float(frame + self.fault * faults)
        depth = reward.key_state(key_qpos, travel)
        too_high = of_hand * (1.0 - depth)
        too_deep = wrong_keys * np.maximum(depth - HARMLESS_DEPTH, 0.0)
        offset = fingertips - goals.fingertips[step + 1]
        squared = np.minimum((offset * offset).sum(axis=1), MAX_ERROR**2)
        fingertip_error = squared @ goals.weight[step + 1]
        extra_cost = _DEPTH_WEIGHT * (too_high @ too_high + too_deep @ too_deep)
        extra_cost += _FINGERTIP_WEIGHT * fingertip_error
        strike_loss, strike_cost = self._strikes(step, events, notes, keys)
        cost = float(loss + extra_cost) + strike_cost
        return StepLoss(loss, faults, strike_loss, cost, notes.history)

    def _strikes(
        self, step: int, events: KeyEvents, notes: NoteEvents, keys: slice
    ) -> tuple[float, float]:
        """Loss and cost of the strikes of these keys in a step."""
        if not len(notes.struck):
            return 0.0, 0.0
        first, *_ = keys.indices(self._keyboard.num_keys)
        target = self.notes.strikes(notes.struck + first, notes.note)
        onset = step * self._goals.dt + events.onset[notes.struck]
        outcome = np.column_stack([onset, log_speed(events.speed[notes.struck])])
        is_timed = np.isfinite(target).all(axis=1)
        outcome, target = outcome[is_timed], target[is_timed]
        costs = _STRIKE_WEIGHT * strike_costs(outcome, target)
        good = (np.abs(outcome - target) < TOLERANCE).all(axis=1)
        return float(costs[~good].sum()), float(costs.sum())
