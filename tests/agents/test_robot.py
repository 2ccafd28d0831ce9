"""Practice with a robot that nobody knows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import cadenza
from cadenza import CadenzaError, Note, Score
from cadenza.agents.planner.planner import Planner
from cadenza.agents.robot.closed_loop import ClosedLoop
from cadenza.agents.robot.places import HandPlaces
from cadenza.agents.robot.practice import RobotPractice, Take
from cadenza.agents.robot.protocol import CheckedRobot, KeyMessage, in_turn, notes_heard, play
from cadenza.agents.robot.servo_response import Response, ServoResponse, identified, usual_response
from cadenza.agents.robot.simulated import SimulatedRobot
from cadenza.agents.rollout import EpisodeResult, begin_episodes, play_episode
from cadenza.cli import main
from cadenza.errors import by_others
from cadenza.music.formats.midi import write_midi
from cadenza.music.libraries.library import load_score
from cadenza.scene.scene import build_scene
from cadenza.scene.servos import servos_of
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.robots import REALISTIC
from cadenza.tasks.unknown_robot import PLAYS, UnknownRobotEnv

DT = 0.05
TUNE = Score(
    tuple(Note(0.3 * i, 0.3 * i + 0.25, p) for i, p in enumerate((60, 62, 64, 62, 60, 67)))
)


@pytest.fixture(scope="module")
def nominal() -> EpisodeResult:
    return play_episode(PianoTask([TUNE]), Planner(), 0)


def practice_of(nominal: EpisodeResult) -> RobotPractice:
    plan = nominal.plan
    assert plan is not None
    usual = usual_response(servos_of(plan.scene), DT, REALISTIC)
    return RobotPractice(plan, nominal.episode, REALISTIC, usual)


def played(practice: RobotPractice, robot: SimulatedRobot) -> Take:
    actions = practice.actions()
    return practice.learn(play(robot, len(actions), in_turn(actions)))


def test_practice_plays_better_than_at_first(nominal: EpisodeResult) -> None:
    robot = SimulatedRobot(UnknownRobotEnv(TUNE, robot=4))
    practice = practice_of(nominal)
    takes = [played(practice, robot).scored for _ in range(PLAYS)]
    assert practice.best is not None
    assert practice.best.scored.score == max(take.score for take in takes)
    play(robot, len(practice.best.scored.actions), in_turn(practice.best.scored.actions))
    first = takes[0]
    assert robot.scored["f1"] + robot.scored["note_onset_f1"] > first.score + 0.05
    assert robot.scored["note_onset_f1"] > 0.9


def test_the_delay_is_found(nominal: EpisodeResult) -> None:
    env = UnknownRobotEnv(TUNE, robot=3)
    practice = practice_of(nominal)
    played(practice, SimulatedRobot(env))
    drawn = env.task.drawn
    true = drawn["latency"][0] + drawn["observation_latency"][0]
    assert practice.response.late + practice.sensors_late == pytest.approx(true, abs=0.0051)


def test_what_is_heard_is_scored_as_what_is_true(nominal: EpisodeResult) -> None:
    env = UnknownRobotEnv(TUNE, robot=0)
    take = played(practice_of(nominal), SimulatedRobot(env))
    true = env.task.played(0).notes
    assert [note.pitch for note in take.notes] == [note.pitch for note in true]
    drawn = env.task.drawn["observation_latency"][0]
    strikes = [(note.start + 0.01 - drawn, note.velocity) for note in take.notes]
    assert_allclose(strikes, [(note.start, note.velocity) for note in true], atol=1e-6)


def test_notes_that_bounce_go_on() -> None:
    messages = [(0.1, 60, 70), (0.2, 60, 0), (0.21, 60, 50), (0.4, 60, 0), (0.5, 62, 40)]
    notes = notes_heard([KeyMessage(*message) for message in messages], 1.0, late=0.1)
    assert [(n.start, n.end, n.pitch, n.velocity) for n in notes] == [
        (0.0, pytest.approx(0.3), 60, 70),
        (0.4, 1.0, 62, 40),
    ]


@pytest.mark.parametrize("late", [0.0, 0.02, 0.05, 0.065])
def test_servos_respond_as_in_simulation_and_controls_undo_it(late: float) -> None:
    scene = build_scene(cadenza.SceneConfig(hands="right"))
    servos, steps = servos_of(scene), 40
    same = np.ones(len(servos.low))
    response = ServoResponse(servos, DT, Response(late, same, np.inf * same))
    one = np.zeros((steps, len(servos.low)))
    one[3:9] = 0.05
    assert_allclose(response.to(one), response.to(one / 2) * 2)
    if not late:
        simulation = PlanningSimulation(scene, 1, DT)
        thumb = servos.names.index("THJ2")
        start = simulation.state.hand_qpos[0] @ servos.of_joints
        moved = []
        for controls in one * (np.arange(len(servos.low)) == thumb):
            simulation.step((start + controls)[None])
            moved.append((simulation.state.hand_qpos[0] @ servos.of_joints - start)[thumb])
        assert_allclose(moved, response.to(one)[:, thumb], atol=0.006)
    expected = response.to(one)
    estimate = response.controls(np.zeros_like(one), expected, 1e-6 * same)
    assert_allclose(response.to(estimate), expected, atol=1e-3)


def test_slow_servos_begin_earlier() -> None:
    servos = servos_of(build_scene(cadenza.SceneConfig(hands="right")))
    same = np.ones(len(servos.low))
    slow = ServoResponse(servos, DT, Response(0.0, same, 0.02 * same))
    expected = np.zeros((60, len(same)))
    expected[30:] = 0.2
    controls = slow.controls(np.zeros_like(expected), expected, 0.01 * same)
    assert abs(np.diff(controls, axis=0, prepend=0.0)).max() <= 0.02 + 1e-9
    at_once = slow.limited(expected)
    error, late = (np.square(slow.to(each) - expected).sum(axis=0) for each in (controls, at_once))
    assert (error < 0.5 * late).all()


def test_it_is_found_how_late_and_slow_servos_are() -> None:
    servos = servos_of(build_scene(cadenza.SceneConfig(hands="right")))
    rng, same = np.random.default_rng(0), np.ones(len(servos.low))
    sent = 0.3 * rng.standard_normal((80, len(same))).cumsum(axis=0)
    true = Response(0.065, rng.choice([0.6, 1.0, 1.7], len(same)), 0.085 * same)
    response = ServoResponse(servos, DT, true)
    moved = response.to(response.limited(sent)) + 0.001 * rng.standard_normal(sent.shape)
    estimate = identified(servos, DT, [(sent, moved)], 0.1 * same)
    assert estimate.late == pytest.approx(true.late, abs=0.011)
    assert_allclose(estimate.fastest, true.fastest)


def test_the_generalist_finds_how_servos_respond_while_it_plays() -> None:
    score = load_score("MinuetInG").until(4.0)
    env, task = UnknownRobotEnv(score, robot=3), PianoTask([score])
    begin_episodes(task, [0])
    closed, robot = ClosedLoop(task.view(), REALISTIC), SimulatedRobot(env)
    scores = [
        closed.learn(play(robot, int(task.view().num_steps[0]), closed.acting(closed.response)))
        for _ in range(2)
    ]
    assert scores[1][1] > 0.9
    servos, drawn = servos_of(task.scene), env.task.drawn
    own = (servos.joints > 0) / (servos.joints > 0).sum(axis=1, keepdims=True)
    true = own @ drawn["joint_damping"][0][task.scene.hand_qvel] / drawn["servo_gain"][0]
    unknown, left = (np.square(np.log(true / d)).sum() for d in (1.0, closed.response.damping))
    assert left < 0.5 * unknown


@pytest.mark.parametrize("right", [-0.008, 0.0, 0.005])
def test_keys_that_sound_tell_where_a_hand_is(right: float) -> None:
    keyboard, rng = build_scene().keyboard, np.random.default_rng(0)
    places = HandPlaces(keyboard, 2, usual=0.006)
    front = keyboard.bounds[1, 0] - 0.02  # before all black keys
    white = np.flatnonzero(~keyboard.is_black)
    for key in rng.choice(white[5:-5], 30):
        tip = np.array([front, keyboard.centre[key, 1] + 0.003 * rng.standard_normal(), 0.0])
        away = abs(tip[1] + right - keyboard.centre[white, 1])
        wide = keyboard.spacing / 2 + 0.004  # fingertips are some 8 mm wide
        places.strike(0, key, tip, np.array([]), white[away < wide])
    assert places.right[0] == pytest.approx(right, abs=0.002)
    assert places.right[1] == pytest.approx(0.0, abs=1e-6)  # it has struck nothing


def test_keys_that_are_held_tell_how_high_a_hand_is() -> None:
    places = HandPlaces(build_scene().keyboard, 2, usual=0.006)
    places.hold(0, 0.004)
    assert 0.001 < places.up[0] < 0.002  # one may be caught elsewhere
    for lower in (0.0038, 0.0042, 0.02, 0.004, 0.0041):
        places.hold(0, lower)
    assert places.up == pytest.approx([0.003, 0.0], abs=0.001)


def test_the_command_keeps_what_was_played(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_midi(Score(TUNE.notes[:2]), tmp_path / "tune.mid")
    out = tmp_path / "out"
    main(["practice", str(tmp_path / "tune.mid"), "--robot", "1", "-o", str(out)])
    lines = capsys.readouterr().out.splitlines()
    assert [line[:7] for line in lines[:PLAYS]] == [f"play {i}:"[:7] for i in range(1, PLAYS + 1)]
    about = json.loads((out / "robot.json").read_text())
    assert len(about["scores"]) == PLAYS + 1
    assert about["metrics"]["note_onset_f1"] >= 0.5
    assert (out / "plays.safetensors").is_file()


def test_what_goes_with_no_robot_is_refused(tmp_path: Path) -> None:
    write_midi(TUNE, tmp_path / "tune.mid")
    for words in (["--robot", "1", "--minutes", "1"], ["--robot", "nobody"]):
        with pytest.raises((CadenzaError, SystemExit)):
            main(["practice", str(tmp_path / "tune.mid"), *words, "-o", str(tmp_path / "out")])


class Driver:
    """A driver that measures and hears what it is told to."""

    def __init__(self, joints: object = (0.0, 0.0), messages: object = ()) -> None:
        self.joints, self.sent = joints, messages

    def start(self) -> None: ...

    def send(self, action: object) -> None: ...

    def stop(self) -> None: ...

    def read(self) -> object:
        return self.joints

    def messages(self) -> object:
        return self.sent


def checked(driver: Driver) -> CheckedRobot:
    return CheckedRobot(driver, "hands", 2)  # type: ignore[arg-type]


def test_what_a_driver_says_is_checked() -> None:
    messages = checked(Driver(messages=[[0.1, 72.0, 64.0], (0.2, np.int64(72), 0)])).messages()
    assert messages == [KeyMessage(0.1, 72, 64.0), KeyMessage(0.2, 72, 0.0)]
    assert isinstance(messages[0].pitch, int)
    for joints in ([0.0], 0.0, [0.0, np.nan]):
        with pytest.raises(CadenzaError, match=r"^robot hands: read\(\) returned numbers of shape"):
            checked(Driver(joints)).read()
    for message in ((0.1, 72.5, 64), (0.1, 128, 64), (np.inf, 72, 64), (0.1, 72, 200)):
        with pytest.raises(CadenzaError, match=r"^robot hands: messages\(\) returned"):
            checked(Driver(messages=[message])).messages()


def test_a_lost_connection_says_of_what() -> None:
    message = "^robot hands: play 1 failed: TimeoutError: timed out"
    with pytest.raises(CadenzaError, match=message), by_others("robot hands: play 1 failed"):
        raise TimeoutError("timed out")


def test_another_profile() -> None:
    harsh = UnknownRobotEnv(TUNE, robot=2, profile="harsh")
    harsh.reset(seed=0)
    assert harsh.task.drawn["latency"][0] >= 0.03
    with pytest.raises(CadenzaError, match="profile 'mild': choose from gentle, realistic, harsh"):
        UnknownRobotEnv(TUNE, profile="mild")  # type: ignore[arg-type]
