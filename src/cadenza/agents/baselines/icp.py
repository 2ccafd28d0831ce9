"""Offline planning of a song, with fingers chosen by the iterative closest point algorithm.

Fingertips are matched to the keys of a chord, then inverse kinematics over arm and hand finds the
motion, as in systems of arms with four-fingered hands. The motion is rehearsed in simulation, and
played with feedback of the joints' positions and speeds alone.
"""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cadenza.agents.agent import Array, PlannerPerEnv, Progress
from cadenza.agents.baselines.plan_follower import PlanFollower
from cadenza.agents.planner.config import ICPConfig, PlannerConfig
from cadenza.agents.planner.plan.song_plan import SongPlan, plan_song
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.hand_search import HandSearch
from cadenza.fingering.players import Players
from cadenza.fingering.search import Dropped
from cadenza.fingers import SIDES, Finger
from cadenza.hands.reach import Reach
from cadenza.music.score import Note, chords
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.tasks.goal_track import GoalTrack, players_of
from cadenza.tasks.view import View

_MAX_ITERATIONS = 20  # iterations of ICP; the matches repeat after two or three
_LIFT = 0.1  # [s] that a finger takes from one key to another
_LOOK_AHEAD = 2.0  # [s] after a chord, of keys that the hand is matched to at the same time
_FORBIDDEN = 2.0  # [m^2] penalty of a match, more than any squared distance
_BUSY = 1.0  # [m^2] penalty of a finger that is on its way from another key

# More iterations than while the planner plays, and a shorter horizon.
_REHEARSAL = PlannerConfig(num_candidates=16, iterations=8, horizon=0.3, proposals="none")


class ICP(PlannerPerEnv["PlanFollower"]):
    """An agent that plans the whole song, and rehearses it, when an episode begins.

    It reports the progress of "fingers", "postures" and "rehearsing".
    """

    def __init__(self, config: ICPConfig | None = None) -> None:
        super().__init__()
        self.config = config or ICPConfig()

    def begin(self, view: View, rng: np.random.Generator) -> PlanFollower:
        (track,) = view.tracks
        track, start = track.with_found_fingers(), view.state.hand_qpos[0]
        if self.config.fingers == "nearest" and track.scene.sides:
            track = with_nearest_fingers(track)
        plan = plan_song(track, start, self.progress)
        if not self.config.rehearse:
            return PlanFollower(plan, plan.nominal.tracking)
        return PlanFollower(plan, rehearsed(plan, start, rng, self.progress))


def rehearsed(
    plan: SongPlan, start: Array, rng: np.random.Generator, progress: Progress
) -> Tracking:
    """Controls and states of a rehearsal, in which the planner's search refined the plan.

    Each hand rehearses by itself, from joint positions `start` (J,) [m, rad]. Feedback makes up for
    disturbances in the performance, such as another arm.
    """
    tracking = plan.nominal.tracking
    ctrl, expected = tracking.ctrl.copy(), tracking.expected.copy()
    sides, dt = plan.scene.sides, plan.track.config.control_timestep
    steps = len(ctrl)
    for i, side in enumerate(sides):
        search = HandSearch(plan, side, rng, _REHEARSAL)
        scene, columns, joints = hand_alone(plan.scene, side)
        servos, simulation = servos_of(scene), MujocoSimulation(scene, 1, dt)
        simulation.reset([0], start[None, joints])
        for step in range(steps):
            state = simulation.state
            qpos, qvel, keys = state.hand_qpos[0], state.hand_qvel[0], state.key_qpos[0]
            ctrl[step, columns] = search.act(qpos, qvel, keys)
            simulation.step(ctrl[step : step + 1, columns])
            state = simulation.state
            expected[step + 1, columns] = servos.state(state.hand_qpos, state.hand_qvel)[0]
            progress("rehearsing", i * steps + step + 1, len(sides) * steps)
    return tracking._replace(ctrl=ctrl, expected=expected)


def with_nearest_fingers(track: GoalTrack) -> GoalTrack:
    """A track with the nearest fingers, of the hands that the search for fingers found."""
    searched, players = track.fingered(), players_of(track.scene)
    notes = list(searched.score.notes)
    dropped = list(searched.dropped or ())
    for hand in range(len(SIDES)):
        indices = [i for i, n in enumerate(notes) if n.finger is not None and n.finger.hand == hand]
        nearest = nearest_fingers([notes[i] for i in indices], hand, players)
        for i, index in zip(indices, nearest, strict=True):
            notes[i] = replace(notes[i], finger=None if index is None else Finger(hand, index))
            if index is None:
                dropped.append(Dropped(notes[i], "no free finger of the hand comes near enough"))
    score = replace(searched.score, notes=tuple(notes))
    return replace(searched, score=score, dropped=tuple(dropped), searched=True)


def nearest_fingers(notes: Sequence[Note], hand: int, players: Players) -> list[int | None]:
    """Fingers of one hand for its notes, which are by time; None where no finger is free."""
    forearm, lowest = players.forearm(hand), players.keyboard.lowest_pitch
    if forearm is None:
        return [None] * len(notes)
    y, reached = players.key_y(hand), players.reaches(hand)
    moving_hand, starts = _Hand(players.reach, forearm.home), [note.start for note in notes]
    done, fingers = 0, list[int | None]()
    for chord in chords(notes):
        done += len(chord)
        next_notes = notes[done : bisect_left(starts, chord[0].start + _LOOK_AHEAD)]
        struck = {note.pitch: note for note in sorted(chord, key=lambda n: (n.pitch, n.end))}
        keys, ahead = (
            [note.pitch - lowest for note in group] for group in (struck.values(), next_notes)
        )
        chord_fingers = moving_hand.play([*struck.values()], y[keys], y[ahead], reached[keys])
        finger_on = dict(zip(struck, chord_fingers, strict=True))
        fingers += [finger_on[note.pitch] for note in chord]
    return fingers


@dataclass
class _Hand:
    """A hand that moves along the keyboard as one rigid body, from chord to chord."""

    reach: Reach
    position: float  # [m]
    # Finger -> the place of its last press [m], and the end of this [s]
    last: dict[int, tuple[float, float]] = field(default_factory=dict)

    def play(
        self, chord: Sequence[Note], keys: Array, ahead: Array, reached: NDArray[np.bool_]
    ) -> list[int | None]:
        """Fingers for a chord of N notes on different keys.

        Args:
            chord: the notes, which begin together.
            keys: (N,) positions of their keys along the keyboard [m].
            ahead: (M,) positions of the next keys [m].
            reached: (N, F) whether each finger reaches each key, wherever the hand is.
        """
        now = min(note.start for note in chord)
        # A note whose key is struck again ends there.
        for finger, (y, end) in self.last.items():
            self.last[finger] = y, min(end, now) if y in keys else end
        held = {finger: y for finger, (y, end) in self.last.items() if end > now + _LIFT}
        free = [f for f in range(self.reach.num_fingers) if f not in held]
        last_presses = np.array([self.last.get(f, (np.nan, -np.inf)) for f in free]).reshape(-1, 2)
        rising = last_presses[:, 1] > now - _LIFT
        window = self._window(keys, ahead, len(free))
        busy = rising[:, None] & (last_presses[:, :1] != window)
        penalty = _BUSY * busy + _FORBIDDEN * ~self._spans(free, window, held)
        penalty[:, len(keys) :] = 0.0
        penalty[:, : len(keys)] += _FORBIDDEN * ~reached.T[free]
        matches = self._match(window, free, penalty, held)
        chosen: list[int | None] = [None] * len(chord)
        for i, finger in sorted((i, f) for i, f in matches.items() if i < len(chord)):
            others = {**held, **{f: keys[j] for j in range(i) if (f := chosen[j]) is not None}}
            spans = (self.reach.spans(finger, f, y - keys[i]) for f, y in others.items())
            if reached[i, finger] and all(spans):
                chosen[i] = finger
                self.last[finger] = float(keys[i]), chord[i].end
        return chosen

    def _window(self, keys: Array, ahead: Array, max_keys: int) -> Array:
        """Keys of a chord, followed by the next ones that a hand at rest also covers."""
        width, window = np.ptp(self.reach.rest), list(keys)
        for key in ahead:
            if key in window:
                continue
            if len(window) >= max_keys or np.ptp([*window, key]) > width:
                break
            window.append(key)
        return np.array(window)

    def _spans(
        self, fingers: Sequence[int], keys: Array, held: dict[int, float]
    ) -> NDArray[np.bool_]:
        """(F, N) whether each finger reaches each key while others hold theirs."""
        others, places = np.array([*held], np.intp), np.array([*held.values()])
        finger_ids = np.array(fingers, np.intp)[:, None, None]
        return np.logical_and.reduce(
            self.reach.spans(finger_ids, others, places - keys[:, None]), axis=-1
        )

    def _match(
        self, keys: Array, free: Sequence[int], penalty: Array, held: dict[int, float]
    ) -> dict[int, int]:
        """Match keys to fingers by iterative closest point (Besl & McKay, 1992); key -> finger.

        The hand moves along the keyboard only.

        Args:
            keys: (N,) positions of the keys [m].
            free: the F fingers that hold no key.
            penalty: (F, N) penalties, added to squared distances [m^2].
            held: positions [m] at which other fingers stay.
        """
        rest, fingers, matches = self.reach.rest, list(free), dict[int, int]()
        for _ in range(_MAX_ITERATIONS):
            tips = self.position + rest[fingers]
            rows, columns = linear_sum_assignment((tips[:, None] - keys) ** 2 + penalty)
            new_matches = {int(key): fingers[row] for row, key in zip(rows, columns, strict=True)}
            offsets = [keys[key] - rest[finger] for key, finger in new_matches.items()]
            offsets += [y - rest[finger] for finger, y in held.items()]
            self.position = float(np.mean(offsets)) if offsets else self.position
            if new_matches == matches:
                break
            matches = new_matches
        return matches
