"""Plans a song offline, with the fingers that iterative closest points choose.

As systems of arms with four-fingered hands do: fingertips are matched to the keys of a chord, then
inverse kinematics over arm and hand finds the motion. It is rehearsed in simulation, and then
played with feedback of the joints' positions and speeds alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cadenza.agents.agent import Array, PlannerPerEnv
from cadenza.agents.baselines.rehearsal import rehearsed
from cadenza.agents.planning.config import ICPConfig
from cadenza.agents.planning.song_plan import SongPlan, plan_song
from cadenza.agents.planning.tracking import Follower, Tracking
from cadenza.fingering.players import Players
from cadenza.fingering.search import Dropped
from cadenza.fingers import SIDES, Finger
from cadenza.hands.reach import Reach
from cadenza.music.score import Note, chords
from cadenza.tasks.goal_track import GoalTrack, players_of
from cadenza.tasks.view import View

_MOVES = 20  # of the hand; the matches repeat after two or three
_LIFT = 0.1  # [s] that a finger takes from one key to another


class ICP(PlannerPerEnv["PlanFollower"]):
    """Plans the whole song, and rehearses it, when an episode begins.

    Its progress is that of "fingers", "postures" and "rehearsing".
    """

    def __init__(self, config: ICPConfig | None = None) -> None:
        super().__init__()
        self.config = config or ICPConfig()

    def begin(self, view: View, rng: np.random.Generator) -> PlanFollower:
        """Raises:
        CadenzaError: there are no hands in the scene.
        """
        (track,) = view.tracks
        track, start = track.with_found_fingers(), view.state.hand_qpos[0]
        if self.config.fingers == "nearest" and track.scene.sides:
            track = with_nearest_fingers(track)
        plan = plan_song(track, start, self.progress)
        if not self.config.rehearse:
            return PlanFollower(plan, plan.nominal.tracking)
        return PlanFollower(plan, rehearsed(plan, start, rng, self.threads, self.progress))


class PlanFollower:
    """Plays what was planned.

    Attributes:
        plan: of the song.
    """

    def __init__(self, plan: SongPlan, tracking: Tracking) -> None:
        """`tracking` are the controls for its servos."""
        self.plan = plan
        self._follower = Follower(plan.scene, tracking)
        self._pedal = plan.goals.sustain.astype(np.float64)

    def act(self, view: View) -> Array:
        (step,) = view.steps
        return np.append(self._follower.ctrl(view.steps, view.state)[0], self._pedal[step])


def with_nearest_fingers(track: GoalTrack) -> GoalTrack:
    """A track whose fingers are those that come nearest.

    Which hand plays a note is taken from the search for fingers; which of its fingers is not.
    """
    searched, players = track.fingered(), players_of(track.scene)
    notes = {note: note for note in searched.score.notes}
    dropped = list(searched.dropped or ())
    for hand in range(len(SIDES)):
        mine = [n for n in searched.score.notes if n.finger is not None and n.finger.hand == hand]
        for note, index in zip(mine, nearest_fingers(mine, hand, players), strict=True):
            notes[note] = replace(note, finger=None if index is None else Finger(hand, index))
            if index is None:
                dropped.append(Dropped(notes[note], "no free finger of the hand comes near enough"))
    score = replace(searched.score, notes=tuple(notes.values()))
    return replace(searched, score=score, dropped=tuple(dropped), found=True)


def nearest_fingers(notes: Sequence[Note], hand: int, players: Players) -> list[int | None]:
    """The finger of one hand for each of its notes, None for one that none is free for.

    Args:
        notes: of the right hand, 0, or of the left, 1, by time.
        hand: which.
        players: the hands at their keyboard.
    """
    forearm, lowest = players.forearm(hand), players.keyboard.lowest_pitch
    if forearm is None:
        return [None] * len(notes)
    y, moving = players.key_y(hand), _Hand(players.reach, forearm.home)
    return [
        finger
        for chord in chords(notes)
        for finger in moving.play(chord, y[[note.pitch - lowest for note in chord]])
    ]


@dataclass
class _Hand:
    """A hand that moves along the keyboard as one rigid body, from chord to chord."""

    reach: Reach
    place: float
    """[m]"""
    last: dict[int, tuple[float, float]] = field(default_factory=dict)
    """Finger -> where it pressed last [m], and until when [s]."""

    def play(self, chord: Sequence[Note], keys: Array) -> list[int | None]:
        """The fingers for notes that begin together, on keys at `keys` (N,) [m]."""
        now = chord[0].start
        held = {finger: y for finger, (y, end) in self.last.items() if end > now + _LIFT}
        free = [f for f in range(self.reach.num_fingers) if f not in held]
        left = np.array([self.last.get(f, (np.nan, -np.inf)) for f in free]).reshape(-1, 2)
        rising = left[:, 1] > now - _LIFT
        busy = rising[:, None] & (left[:, :1] != keys)
        matches = self._matched(keys, free, busy, held)
        chosen: list[int | None] = [None] * len(chord)
        for i, finger in sorted(matches.items()):
            others = {**held, **{f: keys[j] for j in range(i) if (f := chosen[j]) is not None}}
            if all(self.reach.spans(finger, f, y - keys[i]) for f, y in others.items()):
                chosen[i] = finger
                self.last[finger] = float(keys[i]), chord[i].end
        return chosen

    def _matched(
        self,
        keys: Array,
        free: Sequence[int],
        busy: NDArray[np.bool_],
        held: dict[int, float],
    ) -> dict[int, int]:
        """Key -> finger: nearest points, the hand moved onto them, and again.

        Iterative closest points (Besl & McKay, 1992) for a motion along the keyboard alone.

        Args:
            keys: (N,) [m].
            free: the F fingers that can be matched.
            busy: (F, N) whether a finger is still on its way from another key.
            held: where the other fingers stay.
        """
        rest, fingers, matches = self.reach.rest, list(free), dict[int, int]()
        for _ in range(_MOVES):
            tips = self.place + rest[fingers]
            rows, columns = linear_sum_assignment((tips[:, None] - keys) ** 2 + busy)
            found = {int(key): fingers[row] for row, key in zip(rows, columns, strict=True)}
            ways = [keys[key] - rest[finger] for key, finger in found.items()]
            ways += [y - rest[finger] for finger, y in held.items()]
            self.place = float(np.mean(ways)) if ways else self.place
            if found == matches:
                break
            matches = found
        return matches
