"""The agent that corrects plans by what it has learnt from the planner."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import cadenza
from cadenza.agents.agent import Array
from cadenza.agents.generalist import generalist
from cadenza.agents.generalist.config import GeneralistConfig
from cadenza.agents.generalist.corrected_hands import CorrectedHands
from cadenza.agents.generalist.generalist import Generalist
from cadenza.agents.generalist.receding_plan import RecedingPlanner
from cadenza.agents.generalist.rehearsed_hand import RehearsedHand
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.nominal_trajectory import MotionPlanner
from cadenza.agents.planner.plan.song_plan import SongPlan, plan_song
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.planner import Planner
from cadenza.agents.planner.search import hand_rehearsal
from cadenza.agents.planner.search.fingertip_correction import control_update
from cadenza.agents.planner.search.hand_rehearsal import HandRehearsal
from cadenza.agents.planner.search.networks.inputs import Corrections, HandInputs
from cadenza.agents.planner.search.networks.weights import Weights
from cadenza.agents.rollout import play_episode
from cadenza.errors import CadenzaError
from cadenza.fingers import SIDES
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import State
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import players_of
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import View
from numbered import finger
from watched import watched

TASK = TaskConfig(initial_buffer_time=0.5)
SHIPPED = Path(generalist.__file__).parent / "shadow.npz"
CORRECTED, REHEARSED = GeneralistConfig(rehearsals=0), GeneralistConfig(rehearsals=4)
WHITE = (60, 62, 64, 65, 67, 65, 64, 62)


def notes_of_thumb_to_little(first_finger: int) -> Score:
    """Two bars of five white keys, with the fingers of one hand."""
    step = 0.3
    return Score(
        tuple(
            Note(i * step, (i + 1) * step, pitch, 80, finger(first_finger + WHITE.index(pitch)))
            for i, pitch in enumerate(WHITE)
        )
    )


def planned(score: Score, strikes: bool = False) -> SongPlan:
    task = PianoTask([score], TASK)
    (track,) = task.tracks
    plan = plan_song(track, task.state.hand_qpos[0], strikes=strikes)
    task.close()
    return plan


def state_on(plan: SongPlan, step: int, depths: dict[int, float]) -> State:
    """As if the hands had come exactly where the plan has them.

    Args:
        plan: of both hands.
        step: before which.
        depths: how far down keys are [rad], by index.
    """
    tips, keys = np.zeros((1, 10, 3)), np.zeros((1, 88))
    tips[0, plan.scene.present_fingers] = plan.nominal.fingertips[step]
    keys[0, list(depths)] = list(depths.values())
    posture = plan.nominal.tracking.expected[step, :, 0]
    return State.at_rest(plan.scene, 1)._replace(
        hand_qpos=(posture @ servos_of(plan.scene).joints)[None], fingertip_xpos=tips, key_qpos=keys
    )


def elsewhere(plan: SongPlan, key: Callable[[int], int], of: list[int], sign: float) -> SongPlan:
    """The same motion in another place.

    Args:
        plan: of both hands.
        key: where each key goes.
        of: whose servos become those of the right and the left hand.
        sign: of distances along the keyboard.
    """
    nominal, servos = plan.nominal, servos_of(plan.scene)
    turned = np.ones(len(servos.names))
    turned[servos.along_keyboard] = sign
    half = len(turned) // 2
    order = np.concatenate([np.arange(half) + half * hand for hand in of])
    ctrl, gain, expected = nominal.tracking
    tracking = Tracking(
        ctrl[:, order] * turned, gain[:, order], expected[:, order] * turned[:, None]
    )
    tips = nominal.fingertips[:, np.concatenate([np.arange(5) + 5 * hand for hand in of])].copy()
    centre = plan.scene.keyboard.centre[:, 1]
    here = plan.nominal.presses[0].key
    tips[..., 1] = centre[key(here)] + sign * (tips[..., 1] - centre[here])
    presses = [
        press._replace(
            side=SIDES[of[SIDES.index(press.side)]],
            finger=press.finger % 5 + 5 * of[press.finger // 5],
            key=key(press.key),
        )
        for press in nominal.presses
    ]
    keys = np.zeros_like(plan.goals.keys)
    for i in np.flatnonzero(plan.goals.keys.any(axis=0)):
        keys[:, key(i)] = plan.goals.keys[:, i]
    return plan._replace(
        goals=replace(plan.goals, keys=keys),
        nominal=nominal._replace(tracking=tracking, fingertips=tips, presses=presses),
    )


def actions(score: Score, config: GeneralistConfig) -> Array:
    return play_episode(PianoTask([score], TASK), Generalist(config), 0).episode["action"]


def play(score: Score, agent: Generalist | Planner, seed: int = 0) -> dict[str, float]:
    return play_episode(PianoTask([score], TASK), agent, seed).metrics


# Inputs of the networks


@pytest.mark.parametrize("step", [10, 25, 40])
def test_inputs_of_a_left_hand_are_those_of_the_right_hand_in_the_mirror(scene_of_both, step):
    images = elsewhere(scene_of_both, lambda key: 82 - key, [1, 0], -1.0)
    inputs, _ = CorrectedHands(scene_of_both).observe(
        step, state_on(scene_of_both, step, {39: 0.02, 41: 0.05})
    )
    mirrored, _ = CorrectedHands(images).observe(step, state_on(images, step, {43: 0.02, 41: 0.05}))
    # Black keys are up to a millimetre from where their images would be.
    np.testing.assert_allclose(inputs, mirrored[::-1], atol=0.05)


def test_corrections_of_a_left_hand_are_mirrored(scene_of_both):
    scene = scene_of_both.scene
    corrections = Corrections.of(SIDES, hand_alone(scene, "right").scene)
    names = [name.rpartition("/")[2] for name in scene.actuator_names]
    output = np.full(corrections.sign.shape, 0.5, np.float32)
    right, left = corrections.ctrl(output)
    opposite = np.flatnonzero(right == -left)
    assert [names[i] for i in opposite] == [n for n in names[: len(right)] if "forearm_tx" in n]
    np.testing.assert_allclose(corrections.output(corrections.ctrl(output)), output)


@pytest.fixture(scope="module")
def scene_of_both():
    return planned(notes_of_thumb_to_little(0))


def test_same_wherever_on_the_keyboard(scene_of_both):
    higher = elsewhere(scene_of_both, lambda key: key + 12, [0, 1], 1.0)
    here, _ = CorrectedHands(scene_of_both).observe(25, state_on(scene_of_both, 25, {39: 0.02}))
    there, _ = CorrectedHands(higher).observe(25, state_on(higher, 25, {51: 0.02}))
    np.testing.assert_allclose(here[0], there[0], atol=1e-3)


def test_inputs_have_the_output_of_the_step_before(scene_of_both):
    hands = CorrectedHands(scene_of_both)
    ctrl = hands.observe(24, state_on(scene_of_both, 24, {}))[1]
    hands.record(ctrl + 0.01 * np.sin(np.arange(len(ctrl))), ctrl)
    inputs = hands.observe(25, state_on(scene_of_both, 25, {}))[0]
    assert hands.output.any(axis=1).all()
    np.testing.assert_allclose(inputs[:, hands.layout.previous], hands.output, rtol=1e-6)


@pytest.mark.parametrize("side", SIDES)
def test_a_hand_has_the_same_inputs_without_the_other(scene_of_both, side):
    plan, (alone, _, joints) = scene_of_both, hand_alone(scene_of_both.scene, side)
    hands, state = CorrectedHands(plan), state_on(scene_of_both, 25, {39: 0.02, 60: 0.01})
    hands.output = np.random.default_rng(0).uniform(-1, 1, hands.output.shape)
    number, to_posture = SIDES.index(side), servos_of(alone).of_joints
    joints_now = (values[:, joints] for values in (state.hand_qpos, state.hand_qvel))
    inputs = HandInputs(plan, [side], alone, 20).at(
        25,
        np.stack([values @ to_posture for values in joints_now], axis=-1),
        hands.output[[number]],
        state.fingertip_xpos[0, plan.scene.fingers.of_hand(number)],
        state.key_qpos[0],
    )
    np.testing.assert_allclose(hands.observe(25, state)[0][[number]], inputs, atol=1e-6)


@pytest.mark.parametrize("seen", [4, 8, 16])
def test_inputs_are_the_same_by_a_plan_of_what_is_in_sight(scene_of_both, seen):
    """Such a plan begins now, and goes on for a few steps; presses of the past go on in it."""
    plan, now = scene_of_both, 25
    presses = [
        press._replace(first=press.first - now, last=press.last - now)
        for press in plan.nominal.presses
        if press.first < now + seen
    ]
    assert any(press.last < 0 for press in presses)
    keys = plan.goals.keys[now : now + seen]
    nominal = plan.nominal.part(now, now + seen)._replace(presses=presses)
    in_sight = plan._replace(goals=replace(plan.goals, keys=keys), nominal=nominal)
    longer = plan._replace(
        nominal=plan.nominal.part(0, now + seen)._replace(
            presses=[press for press in plan.nominal.presses if press.first < now + seen]
        )
    )
    state = state_on(plan, now, {39: 0.02, 60: 0.01})
    inputs = CorrectedHands(in_sight).observe(0, state)[0]
    np.testing.assert_allclose(inputs, CorrectedHands(longer).observe(now, state)[0], atol=1e-6)


def test_inputs_say_when_and_how_loud_a_finger_is_to_strike():
    score = Score((Note(0.0, 0.3, 64), Note(0.53, 1.0, 64, 92)))  # 30 ms after a step begins
    plan = planned(score, strikes=True)
    _, press = plan.nominal.presses
    side, own = divmod(press.finger, 5)
    hands = CorrectedHands(plan)
    ours = hands.layout.striking[own]
    _, first = plan.strikes.step
    now, later, time, speed, _ = np.transpose(
        [
            hands.observe(step, state_on(plan, step, {}))[0][side, ours : ours + 5]
            for step in range(first - 3, first + 3)
        ]
    )
    np.testing.assert_array_equal(now, [0, 0, 0, 1, 0, 0])
    np.testing.assert_array_equal(later, [0, 0, 1, 0, 0, 0])
    np.testing.assert_allclose(time, [0, 0.32, 0.32, 0.32, 0, 0], atol=0.01)  # 3 ms late
    np.testing.assert_allclose(speed, [0, 2, 2, 2, 0, 0], atol=0.1)  # 4 rad/s


def test_a_touch_moves_the_finger_that_strikes_and_spares_it_corrections():
    plan = planned(notes_of_thumb_to_little(0), strikes=True)
    hands, step = CorrectedHands(plan), plan.strikes.step[1]
    inputs, ctrl = hands.observe(step, state_on(plan, step, {}))
    ((side, finger),) = np.argwhere(hands.striking(inputs))
    touch = np.zeros((2, 5, 2), np.float32)
    touch[side, finger] = 0.5, 0.25
    output = np.ones(hands.output.shape, np.float32)
    lowered, less = hands.touched(step, ctrl, output, touch)
    servos = servos_of(hand_alone(plan.scene, "right").scene).finger
    moved = (lowered - ctrl).reshape(output.shape)
    assert set(servos[np.flatnonzero(moved[side])]) == {finger}
    assert not moved[1 - side].any()
    _, jacobian = Kinematics(plan.scene).fingertips(plan.nominal.postures[step + 1 : step + 2])
    fall = jacobian[0, 5 * side + finger, 2] @ moved[side]
    assert -0.005 <= fall < 0  # less than asked for where the finger hardly can
    np.testing.assert_allclose(less[side], np.where((servos < 0) | (servos == finger), 0.75, 1.0))
    np.testing.assert_array_equal(less[1 - side], 1.0)


# How it plays


@pytest.mark.parametrize("look_ahead", [None, 0.5])
def test_plays_loud_notes_louder(look_ahead):
    song = load_score("OdeToJoy").beginning(2.5)
    velocities = []
    for velocity in (40, 90):
        notes = tuple(replace(note, velocity=velocity) for note in song.notes)
        task = PianoTask([replace(song, notes=notes)], TASK)
        agent, speeds = Generalist(GeneralistConfig(look_ahead=look_ahead)), []

        def noted(view: View, act: Any = agent.act, speeds: list[Array] = speeds) -> Array:
            speeds.append(view.state.key_speed)
            return act(view)

        agent.act = noted  # type: ignore[method-assign]
        play_episode(task, agent, 0)
        speed = np.concatenate(speeds)
        speed = speed[np.isfinite(speed)]
        velocities.append(np.median(task.scene.keyboard.velocity(speed)))
    assert velocities[1] > velocities[0] + 12


@pytest.mark.parametrize("config", [CORRECTED, REHEARSED], ids=["corrected", "rehearsed"])
def test_plays_better_than_its_plan(config):
    score = load_score("CanonInDOpening").beginning(4.0)
    alone = PlannerConfig(method="none")
    assert play(score, Generalist(config))["f1"] > play(score, Planner(alone))["f1"] + 0.05


def test_plays_as_it_has_rehearsed(monkeypatch):
    foreseen: list[bool] = []
    act = RehearsedHand.act

    def noted(self: RehearsedHand, step: int, state: State) -> Array:
        foreseen.append(self.rehearsal.goes_as_rehearsed(step, state.hand_qpos[0, self.joints]))
        return act(self, step, state)

    monkeypatch.setattr(RehearsedHand, "act", noted)
    play(load_score("FurEliseOpening").beginning(4.0), Generalist(REHEARSED))
    assert np.mean(foreseen) > 0.7  # of all steps but those in which half seconds begin


def test_keeps_no_change_that_makes_it_worse(monkeypatch):
    score = load_score("CanonInDOpening").beginning(6.0)
    changed = actions(score, GeneralistConfig(rehearsals=1))
    hardly = lambda off, *others: 1e-9 * control_update(off, *others)  # noqa: E731
    monkeypatch.setattr(hand_rehearsal, "control_update", hardly)
    plan = actions(score, GeneralistConfig(rehearsals=1))
    assert np.abs(changed - plan).max() > 0.01
    too_far = lambda off, *others: np.full_like(control_update(off, *others), 0.3)  # noqa: E731
    monkeypatch.setattr(hand_rehearsal, "control_update", too_far)
    np.testing.assert_allclose(actions(score, GeneralistConfig(rehearsals=1)), plan, atol=1e-3)


def test_half_a_second_begins_with_what_the_one_before_found_for_it(monkeypatch):
    rehearse, changes = HandRehearsal.rehearse, list[int]()

    def noted(
        self: HandRehearsal, goals: HandGoals, tracking: Tracking, steps: Any, *others: Any
    ) -> int:
        if len(known := self.tail):
            np.testing.assert_array_equal(tracking.ctrl[steps[: len(known)]], known)
            changes.append(len(known))
        return rehearse(self, goals, tracking, steps, *others)

    monkeypatch.setattr(HandRehearsal, "rehearse", noted)
    play(load_score("MoonlightOpening").beginning(2.0), Generalist(REHEARSED))
    assert changes


def test_rehearses_only_what_goes_wrong(monkeypatch):
    rehearsed = watched(monkeypatch, HandRehearsal, "rehearse")
    play(Score((Note(0.0, 1.0, 64, 80), Note(3.0, 4.0, 64, 80))), Generalist(REHEARSED))
    simulated = [steps for _, steps in rehearsed]
    assert len(simulated) == 2 * 10  # by either hand, once for each half second
    once = 24  # steps, with what comes soon after
    assert sum(steps > once for steps in simulated) <= 4  # in which a strike is refined
    assert max(simulated) <= 4 * once


def test_plays_on_where_a_window_of_the_plan_ends():
    agent = Generalist()
    task = PianoTask([load_score("OdeToJoy").beginning(9.0)], TASK)
    trajectories = []

    def noted(view: View) -> Array:
        action = act(view)
        trajectories.append(agent.planners[0].plan.complete)
        return action

    act, agent.act = agent.act, noted  # type: ignore[method-assign]
    assert play_episode(task, agent, 0).metrics["f1"] > 0.95
    assert not trajectories[0]
    assert trajectories[-1]


def test_corrects_by_default_what_it_has_learnt_to_correct():
    score = load_score("MoonlightOpening").beginning(1.0)
    played, corrected, rehearsed = (
        actions(score, config) for config in (GeneralistConfig(), CORRECTED, REHEARSED)
    )
    np.testing.assert_array_equal(played, corrected)
    assert (played != rehearsed).any()


def test_rehearses_with_hands_that_it_has_not_learnt_with():
    task = PianoTask([load_score("OdeToJoy").beginning(2.0)], TASK, SceneConfig(hand="allegro"))
    assert play_episode(task, Generalist(), 0).metrics["f1"] > 0.8


# What cannot be


OTHER_SERVOS = SceneConfig(reduced_action_space=not SceneConfig.reduced_action_space)


@pytest.mark.parametrize(
    ("scene", "config", "message"),
    [
        (SceneConfig(hand="allegro"), CORRECTED, "has not learnt to play with hand allegro"),
        (OTHER_SERVOS, CORRECTED, "leave out options that change the hands"),
        (OTHER_SERVOS, GeneralistConfig(str(SHIPPED)), "has learnt with hands of 19 servos"),
    ],
)
def test_hands_that_it_has_not_learnt_with(scene, config, message):
    task = PianoTask([load_score("OdeToJoy").beginning(1.0)], TASK, scene)
    with pytest.raises(CadenzaError, match=message) as raised:
        play_episode(task, Generalist(config), 0)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("other", [{"weights": str(SHIPPED)}, {"look_ahead": 0.5}], ids=str)
def test_rehearses_neither_what_networks_correct_nor_at_sight(other):
    Generalist(GeneralistConfig(rehearsals=0, **other))
    with pytest.raises(CadenzaError, match=f"does not rehearse with {next(iter(other))}"):
        Generalist(GeneralistConfig(rehearsals=4, **other))


def test_weights_that_are_damaged(tmp_path):
    path = tmp_path / "half.npz"
    path.write_bytes(SHIPPED.read_bytes()[:10_000])
    with pytest.raises(CadenzaError, match=r"half\.npz") as raised:
        play(load_score("OdeToJoy"), Generalist(GeneralistConfig(str(path))))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("name", "change", "what"),
    [
        ("thumb:kernel0", lambda kernel: kernel[:, 1:], "thumb:kernel0"),
        ("fingers:inputs", lambda inputs: inputs + 10, "do not fit 615 inputs"),
        ("hand:servos", lambda servos: servos * 0, "do not fit 615 inputs and 19 servos"),
    ],
)
def test_weights_that_do_not_fit_each_other(tmp_path, name, change, what):
    path = tmp_path / "other.npz"
    with np.load(SHIPPED) as arrays:
        np.savez(path, allow_pickle=False, **{**arrays, name: change(arrays[name])})
    with pytest.raises(CadenzaError, match=rf"other\.npz: .*{what}"):
        Weights.load(path)


def test_weights_are_kept_as_they_were_read(tmp_path):
    path, shipped = tmp_path / "again.npz", Weights.load(SHIPPED)
    shipped.save(path)
    inputs = np.random.default_rng(0).standard_normal(shipped.sizes[0]).astype(np.float32)
    np.testing.assert_array_equal(Weights.load(path)(inputs), shipped(inputs))


def test_fingers_share_what_they_have_learnt(scene_of_both):
    hands, weights = CorrectedHands(scene_of_both), Weights.load(SHIPPED)
    inputs = hands.observe(25, state_on(scene_of_both, 25, {}))[0][0]
    ring = inputs + np.where((hands.layout.finger == 3) & hands.layout.private, 0.3, 0.0).astype(
        np.float32
    )
    changed = np.flatnonzero(weights(ring) != weights(inputs))
    of_hand, of_ring = weights.networks[0].servos[0], weights.networks[2].servos[2]
    assert set(changed) == {*of_hand, *of_ring}


def test_plays_without_jax():
    code = """import sys, cadenza
score = cadenza.Score((cadenza.Note(0.0, 0.5, 60),))
cadenza.play(score, "generalist")
print("jax" in sys.modules)"""
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "False\n"


# What is in sight only


@pytest.mark.parametrize("look_ahead", [0.5, pytest.param(2.0, marks=pytest.mark.slow)])
def test_plays_the_same_whatever_comes_beyond_what_it_sees(look_ahead):
    known = load_score("BachPreludeInCMajor").beginning(4.5)
    others = tuple(Note(4 + i / 4, 5 + i / 4, 40 + i, 80) for i in range(12))
    changed = replace(known, notes=tuple(n for n in known.notes if n.end <= 4.0) + others)
    one, other = (goals_of(score) for score in (known, changed))
    alike = int((one[: len(other)] != other[: len(one)]).any(axis=1).argmax())
    blind = alike - round(look_ahead / TASK.control_timestep)
    assert blind > 20
    first, second = (
        actions(score, GeneralistConfig(look_ahead=look_ahead)) for score in (known, changed)
    )
    np.testing.assert_array_equal(first[:blind], second[:blind])
    assert (first[blind:alike] != second[blind:alike]).any()


def goals_of(score: Score) -> NDArray[np.bool_]:
    """(T, K) keys and pedal."""
    task = PianoTask([score], TASK)
    goals = task.tracks[0].goals
    task.close()
    return np.column_stack([goals.keys, goals.sustain])


def test_plays_at_sight_with_long_control_steps():
    task = replace(TASK, control_timestep=0.5)
    score = Score((Note(0.5, 1.0, 60), Note(1.0, 2.0, 64)))
    played = cadenza.play(score, Generalist(GeneralistConfig(look_ahead=0.5)), task=task).episode
    assert np.isfinite(played["action"]).all()


@pytest.mark.parametrize(("look_ahead", "least"), [(0.5, 0.9), (2.0, 0.9)])
def test_plays_at_sight(look_ahead, least):
    score = load_score("CanonInDOpening").beginning(4.0)
    assert play(score, Generalist(GeneralistConfig(look_ahead=look_ahead)))["f1"] > least


def test_fingers_that_a_song_gives_are_not_in_sight():
    given = notes_of_thumb_to_little(0)
    other = notes_of_thumb_to_little(5)
    half_a_second = GeneralistConfig(look_ahead=0.5)
    np.testing.assert_array_equal(actions(given, half_a_second), actions(other, half_a_second))


def receding_planner(task: PianoTask) -> RecedingPlanner:
    scene, dt = task.scene, TASK.control_timestep
    motion, players = MotionPlanner(scene, dt), players_of(scene)
    return RecedingPlanner(scene, motion, players, task.state.hand_qpos[0], dt)


def test_a_look_takes_as_much_work_late_in_a_song_as_early(monkeypatch):
    notes = tuple(Note(i / 8, (i + 1) / 8, WHITE[i % 8], 80) for i in range(160))
    task = PianoTask([Score(notes)], TASK)
    (track,) = task.tracks
    in_sight = receding_planner(task)
    tips = task.state.fingertip_xpos[0]  # astray most of the time
    in_sight.replan(0, track.goals.keys[:11], {}, tips)
    linked, work = watched(monkeypatch, Kinematics, "links"), list[int]()
    for step in range(1, 380):
        linked.clear()
        in_sight.replan(step, track.goals.keys[step : step + 11], {}, tips)
        work.append(sum(len(postures) for (_, postures), _ in linked))
    task.close()
    assert 0 < max(work) <= 8 * 12
    assert sum(work[-30:]) < 1.5 * sum(work[20:50])


@pytest.mark.parametrize(("astray", "lifted"), [(0.0, False), (0.02, True)])
def test_finger_that_is_caught_beside_its_key_is_lifted_over_all_keys_and_presses_again(
    astray, lifted
):
    task = PianoTask([Score((Note(0.0, 4.0, 64, 80),))], TASK)
    (track,) = task.tracks
    in_sight = receding_planner(task)
    plan, tips = in_sight.replan(0, track.goals.keys[:11], {}, task.state.fingertip_xpos[0]), None
    heights = []
    for step in range(1, 36):
        (finger,) = {press.finger for press in plan.presses}
        tips = plan.fingertips[1].copy()
        tips[finger, 0] -= astray if step == 24 else 0.0  # it should be down since step 10
        plan = in_sight.replan(step, track.goals.keys[step : step + 11], {}, tips)
        heights.append(plan.fingertips[1, finger, 2])
    black = task.scene.keyboard.black.top
    task.close()
    down = heights[15]
    assert down < black
    assert (max(heights[21:27]) > black) == lifted
    assert abs(heights[-1] - down) < 0.002
