"""The stream of states: a header with the song, then each step while it is played.

`python -m cadenza.studio.state_stream SONG` prints the header of a song, for the first picture of
the page: hands at rest, and the notes to come.
"""

import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.registry import PLANNER
from cadenza.music.performance import SoundedNotes, key_events
from cadenza.performing.performance import Performance
from cadenza.performing.setup import Setup, find_player, set_up
from cadenza.report.engraving import Engraver
from cadenza.report.performance_page import arranged_notes, finger_numbers, lost_notes, packed
from cadenza.scene.drawing import drawing
from cadenza.studio.messages import ROWS, SOUNDS, STEP_PARTS, Send, WireMessage, json_message
from cadenza.studio.tone_samples import INSTRUMENT
from cadenza.tasks import reward
from cadenza.tasks.augmentation import draws_variation
from cadenza.tasks.goal_track import GoalTrack

_PATIENCE = 20.0  # [s] to wait for a score
_FULL_DEPTH = 255  # in a row, of a key that is down


def words_of(performance: Performance) -> str:
    """The verdict and the advice, as the page shows them."""
    tip = performance.advice
    return f"{performance.verdict} {tip.words}." if tip else performance.verdict


class StateStream:
    """A sender of messages as `cadenza.studio.messages` describes them.

    Attributes:
        header: the song, its fingers once it begins, its engraved score once there is one and, once
            it is over, the causes of missed notes.
        rows: the states of all steps so far.
    """

    def __init__(self, setup: Setup, send: Send) -> None:
        task = setup.task
        self._setup, self._task, self._send = setup, task, send
        self._engraver: Engraver | None = None
        self._dt, keyboard = task.config.control_timestep, task.scene.keyboard
        self._lowest, self._travel = keyboard.lowest_pitch, keyboard.travel
        self._notes = SoundedNotes(self._dt)
        keys = ("u1", keyboard.num_keys)
        parts = [("joints", "<f4", len(task.scene.hand_start)), ("depth", *keys), ("sounds", *keys)]
        self._row = np.dtype([*parts, ("times", *keys), ("pedal", "u1")], align=True)
        self.header: dict[str, Any] = {}
        self.rows = bytearray()

    def begin(self) -> None:
        """Send the header; with random variations of the song, the first step does."""
        if not draws_variation(self._task.config):
            self._send_header(self._task.tracks[0])

    def _send_header(self, track: GoalTrack) -> None:
        scene, goals, arrangement = self._task.scene, track.goals, self._setup.arrangement
        fates = () if arrangement is None else arrangement.fates(track)
        self._add(
            dt=self._dt,
            steps=goals.num_steps,
            keys=scene.keyboard.num_keys,
            lowest=self._lowest,
            joints=len(scene.hand_start),
            row=self._row.itemsize,
            start=[round(float(x), 6) for x in scene.hand_start],
            scene=drawing(scene),
            goal=packed(goals.keys.astype(np.uint8)),
            pedal=packed(goals.sustain.astype(np.uint8)),
            notes=sorted((n.pitch - self._lowest, n.start) for n in track.delayed_score.notes),
            sound=INSTRUMENT,
            remarks=self._setup.settings.get("remarks", []),
            arrangement=arranged_notes([fate.as_json for fate in fates], self._lowest),
        )

    def _add(self, **fields: Any) -> None:
        """Send fields, and keep them in the header."""
        self._send(json_message(**fields))
        self.header |= fields

    def step(self) -> None:
        """Send the state after the step that was just taken, and the score when it is engraved."""
        task, state = self._task, self._task.state
        if not self.header:
            self._send_header(task.goals.tracks[0])
        if not self.rows:
            plan = self._setup.agent.song_plan(0)  # has the fingers, unless the song gives them
            score = (task.goals.tracks[0] if plan is None else plan.track).delayed_score
            if fingers := finger_numbers(score.notes, self._lowest):
                self._add(fingers=fingers)
            self._engraver = Engraver(score)
        self._send_score()
        row = np.zeros((), self._row)
        row["joints"] = state.hand_qpos[0]
        row["depth"] = _FULL_DEPTH * reward.key_state(state.key_qpos[0], self._travel)
        row["sounds"], row["times"] = self._sounds()
        row["pedal"] = task.pedal_down[0]
        self.rows += row.tobytes()
        self._send(WireMessage(ROWS, row.tobytes()))

    def finish(self, performance: Performance) -> None:
        """Send the verdict, the score if that is yet to come, and missed notes."""
        verdict, remarks = words_of(performance), performance.remarks
        self._send(json_message(state="played", verdict=verdict, remarks=remarks))
        self._send_score(_PATIENCE)
        self._add(misses=lost_notes(performance.losses))

    def _send_score(self, patience: float = 0.0) -> None:
        if self._engraver is None or not (engraving := self._engraver.engraving(patience)):
            return
        self._engraver = None
        self._add(engraving=engraving)

    def _sounds(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """The bytes of a row for keys that sound, and for times of events in the step."""
        task, step = self._task, int(self._task.goals.steps_done[0]) - 1
        onset, offset, speed = (values[:1] for values in task.state.key_events)
        velocity = reward.midi_velocity(speed, task.scene.keyboard)
        sounds = np.where(task.sounding[0], SOUNDS, 0).astype(np.uint8)
        times = np.zeros_like(sounds)
        for event in key_events(onset, offset, velocity):
            is_struck = self._notes.add(event._replace(step=step))
            time = event.onset if is_struck else event.offset
            if time == time:
                times[event.key] = round(time / self._dt * STEP_PARTS)
            if is_struck:
                sounds[event.key] |= int(event.velocity)
        return sounds, times


# The first picture

_NICENESS = 4  # the process that plays gets ready beside it


def main() -> None:
    """Print the picture of the song that the command line names."""
    os.nice(_NICENESS)
    with set_up(sys.argv[1], find_player(PLANNER)) as setup:
        StateStream(setup, lambda message: print(message.content.decode())).begin()


if __name__ == "__main__":
    main()
