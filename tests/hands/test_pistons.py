"""A hand without a single hinge: six pistons side by side, over six white keys."""

import json
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import cadenza
from cadenza import Finger, Note, PianoEnv, SceneConfig, Score, load_episode
from cadenza.agents.planner.misses import Miss
from cadenza.hands import forearm
from cadenza.hands.body import Actuator, Body, Geom, Joint, Link
from cadenza.hands.hand import FingerChain, Hand
from cadenza.hands.reach import Reach
from cadenza.hands.servo import Servo
from cadenza.music.formats.fingering_file import read_fingering
from report_pages import recording_in

RADIUS = 0.006  # [m]
COUNT = 6
RIGHT = 0.0235 * np.arange(-2, COUNT - 2)  # [m] of the forearm; neighbouring white keys
APART = np.maximum(RIGHT - RIGHT[:, None], 0.0)
OFF = 0.002  # [m] that a piston can be beside the middle of its key


def piston(number: int) -> Link:
    return Link(
        f"rod{number}",
        "palm",
        pos=(-RIGHT[number], 0, 0.08),
        mass=0.05,
        com=(0, -0.04, 0),
        inertia=(3e-5, 3e-6, 3e-5),
        joint=Joint(f"push{number}", axis=(0, -1, 0), range=(0.0, 0.04), damping=2.0, slide=True),
        geoms=(Geom("capsule", (RADIUS, 0.035), (0, -0.045, 0), (0.5**0.5, 0.5**0.5, 0, 0)),),
    )


BODY = Body(
    links=(
        Link(forearm.FOREARM, "", (0, 0, 0), 3.0, (0, 0, 0.09), (0.014, 0.014, 0.007)),
        Link("palm", forearm.FOREARM, (0, 0, 0.25), 0.3, (0, 0, 0.04), (5e-4, 4e-4, 2e-4)),
        *map(piston, range(COUNT)),
    ),
    actuators=tuple(Actuator(f"push{number}", kp=400.0, force=10.0) for number in range(COUNT)),
)
PISTONS = Hand(
    name="pistons",
    body=BODY,
    fingers=tuple(
        FingerChain(f"piston{number}", (f"rod{number}",), (RADIUS,), (0, -0.08, 0), on_white=0.05)
        for number in range(COUNT)
    ),
    servos={
        f"push{number}": Servo(0.012, 0.02, 4.0, 0.02, noise=0.003, lift=-0.01, finger=number)
        for number in range(COUNT)
    },
    reach=Reach(
        rest=RIGHT,
        least=np.maximum(APART - OFF, 0.0),
        most=APART + OFF * (APART > 0),
        outward=OFF - RIGHT,
        inward=OFF + RIGHT,
        forearm_width=0.1,
    ),
)


@pytest.mark.parametrize(("side", "lowest"), [("right", 60), ("left", 48)])
def test_the_planner_plays_with_it(side, lowest):
    song = Score(tuple(Note(0.4 * i, 0.4 * i + 0.4, lowest + p) for i, p in enumerate((0, 4, 2))))
    scene = SceneConfig(hand=f"{__name__}:PISTONS", hands=side)
    performance = cadenza.play(song, scene=scene)
    assert performance.metrics["note_onset_f1"] == 1.0
    assert performance.metrics["f1"] > 0.9


SIX = f"{__name__}:PISTONS"
RUN = (60, 62, 64, 65, 67, 69)


def run() -> Score:
    return Score(tuple(Note(0.3 * i, 0.3 * i + 0.3, pitch) for i, pitch in enumerate(RUN)))


def test_six_keys_in_a_row_take_the_six_fingers(tmp_path):
    """From the search to the files that a plan leaves, and back."""
    plan = cadenza.plan(run(), scene=SceneConfig(hand=SIX, hands="right"))
    assert plan.fingering == tuple(Finger(0, index) for index in range(COUNT))
    assert plan.metrics["note_onset_f1"] == 1.0
    plan.save(tmp_path / "run.safetensors")
    assert (tmp_path / "run.safetensors.fingering").read_text().splitlines()[-1] == "1.5000 69 R6"
    read = read_fingering(tmp_path / "run.safetensors.fingering", run())
    assert tuple(note.finger for note in read.notes) == plan.fingering
    episode = plan.performance.episode
    assert episode["fingertip_xpos"].shape[1:] == (2 * COUNT, 3)
    assert episode["goal_fingers"].max() == COUNT - 1
    plan.performance.save(tmp_path)
    assert (tmp_path / "report.html").stat().st_size > 1e5
    assert load_episode(tmp_path / "episode.npz").num_steps == episode.num_steps


@pytest.mark.parametrize("fingering", ["auto", "transport"])
def test_gymnasium_checks_its_environment(fingering):
    env = PianoEnv(run(), hand=SIX, fingering=fingering)
    check_env(env, skip_render_check=True)
    part = env.observation_layout["fingering"]
    assert part.stop - part.start == 2 * COUNT
    env.close()


def test_what_a_six_fingered_hand_lost_is_named(tmp_path):
    performance = cadenza.play(run(), scene=SceneConfig(hand=SIX, hands="right"))
    lost = Miss(0.0, "A4", Finger(0, 5), "never sounded", "no finger", "why", False)
    replace(performance, misses=[lost]).save(tmp_path)
    assert json.loads((tmp_path / "misses.json").read_text())[0]["finger"] == "R6"
    assert "right finger 6" in str(recording_in((tmp_path / "report.html").read_text()))
