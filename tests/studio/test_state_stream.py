"""The states that are sent while it is played, against the episode that is kept."""

import base64
import json
import zlib

import numpy as np
import pytest

from cadenza.agents.agent import RandomAgent
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.registry import PLANNER, make_agent
from cadenza.music.arrangement import Arrangement
from cadenza.music.score import Note, Score
from cadenza.performing.performance import perform
from cadenza.performing.setup import find_player, set_up
from cadenza.studio.messages import JSON, ROWS, WireMessage
from cadenza.studio.state_stream import StateStream
from cadenza.tasks.config import TaskConfig


@pytest.mark.parametrize(
    "task", [TaskConfig(), TaskConfig(random_stretch=0.5, random_pitch_shift=3)]
)
def test_the_rows_hold_the_episode(task):
    score = Score(tuple(Note(0.2 * i, 0.2 * i + 0.2, 60 + i) for i in range(4)), title="Four")
    sent: list[WireMessage] = []
    with set_up(score, find_player(RandomAgent()).playing_in(task, None), seed=3) as setup:
        states = StateStream(setup, sent.append)
        states.begin()
        played = perform(setup, lambda stage, *_: states.step() if stage == "playing" else None)
    about = json.loads(sent[0].content)
    episode, joints = played.episode, about["joints"]
    rows = [message.content for message in sent if message.kind == ROWS]
    kept = json.loads(json.dumps(states.header))
    assert {number for *_, number in kept.pop("fingers")} <= set(range(1, 6))
    assert (kept, bytes(states.rows)) == (about, b"".join(rows))
    assert sent[0].kind == JSON
    assert about["steps"] == len(rows) == episode.num_steps
    assert {len(row) for row in rows} == {about["row"]}
    assert about["row"] % 4 == 0
    numbers = np.array([np.frombuffer(row[: 4 * joints], "<f4") for row in rows])
    np.testing.assert_array_equal(numbers, episode["hand_qpos"].astype(np.float32))
    keys = np.array([np.frombuffer(row[4 * joints :][:264], np.uint8) for row in rows])
    assert episode.key_depth is not None
    np.testing.assert_array_equal(keys[:, :88], (episode.key_depth * 255).astype(np.uint8))
    np.testing.assert_array_equal(keys[:, 88:176] >= 128, episode["key_activation"])
    np.testing.assert_array_equal(
        [row[4 * joints + 264] for row in rows], episode["sustain_activation"]
    )
    # Strikes are the notes of the file that is kept, as loud.
    key, step = np.nonzero(keys[:, 88:176].T % 128)
    assert len(key)  # random actions strike keys
    notes = sorted(played.played.notes, key=lambda note: (note.pitch, note.start))
    assert (key + 21).tolist() == [note.pitch for note in notes]
    assert (keys[step, 88 + key] % 128).tolist() == [note.velocity for note in notes]
    start = (step + keys[step, 176 + key] / 255) * about["dt"]
    assert start == pytest.approx([note.start for note in notes], abs=about["dt"] / 255)
    # What is to be played comes first, packed as in a report.
    planes = np.frombuffer(zlib.decompress(base64.b64decode(about["goal"])), np.uint8)
    goal = np.cumsum(planes.reshape(88, -1), axis=1, dtype=np.uint8).T
    np.testing.assert_array_equal(goal, episode["goal_keys"])


def test_what_an_arrangement_left_out_and_what_was_missed_is_sent():
    chords = tuple(Note(i, i + 0.9, pitch) for i in range(3) for pitch in range(36, 84, 6))
    sent: list[WireMessage] = []
    agent = make_agent(PLANNER, PlannerConfig(method="none"))
    always = Arrangement(arrange="always")
    with set_up(Score(chords), find_player(agent), arrangement=always) as setup:
        states = StateStream(setup, sent.append)
        states.begin()
        played = perform(setup, lambda stage, *_: states.step() if stage == "playing" else None)
        states.finish(played)
    about, explained = json.loads(sent[0].content), json.loads(sent[-1].content)
    became = about["arrangement"]
    assert len(became) == len(chords)
    assert all(note[3] in (note[0], None) or (note[3] - note[0]) % 12 == 0 for note in became)
    assert any(note[3] is None for note in became)
    assert about["remarks"][0].startswith("arranged for both hands: ")
    assert len(explained["misses"]) == len(played.misses or ())
    kept = json.loads(json.dumps(states.header))
    kept.pop("engraving", None)  # there as soon as a process of its own has made it
    fingers = kept.pop("fingers")
    assert kept == about | explained
    kept_notes = [note for note in became if note[3] is not None]
    assert sorted(key for key, *_ in fingers) == sorted(note[3] for note in kept_notes)
    assert {hand for _, _, hand, _ in fingers} == {0, 1}
    assert {number for *_, number in fingers} <= set(range(1, 6))
