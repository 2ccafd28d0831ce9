"""Practice: the same effort comes to the same, stopped or not, and what comes out plays better."""

import itertools
import json
import shutil
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import cadenza
from begun import begun
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.context import PlanningContext
from cadenza.agents.planner.planner import Planner
from cadenza.agents.planner.practice import practice as practice_of_hands
from cadenza.agents.planner.practice.initial_trajectories import PlannedVariant
from cadenza.agents.planner.practice.perturbations import Perturbations
from cadenza.agents.planner.practice.practice import Practice
from cadenza.agents.planner.practice.practised_planner import PractisedHands, PractisedPlanner
from cadenza.agents.planner.practice.trajectory import WholeScene
from cadenza.agents.planner.search.hands_in_scene import HandsInScene
from cadenza.agents.playback import Playback, load_plan
from cadenza.agents.rollout import play_episode
from cadenza.cli import main
from cadenza.episode import load_episode
from cadenza.errors import CadenzaError
from cadenza.evaluation.results import read_results
from cadenza.files import ANY, locked, read_arrays, read_tensors, write_tensors
from cadenza.fingers import Finger
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from cadenza.performing import performance
from cadenza.report.sound import encode_opus
from cadenza.scene.config import SceneConfig
from cadenza.sim.threads import Threads
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.piano_task import PianoTask
from melodies import melody
from refusals import refused
from rounds import so_often
from watched import watched

QUICK = TaskConfig(initial_buffer_time=0.4)
EFFORT = 0.06
STAGES = "first take", "practising", "playing"
# For one finger, at a tempo at which a plan without search misses some.
BLACK_KEYS = (66, 70, 75, 68, 73, 78)
NO_SEARCH = PlannerConfig(method="none")
GIVEN_FINGERS = replace(NO_SEARCH, fingering="score")  # there are no others to be tried
HARD = Score(
    tuple(
        Note(0.2 * i, 0.2 * i + 0.2, pitch, 80, finger=Finger(0, 1))
        for i, pitch in enumerate(BLACK_KEYS)
    )
)
LONG = Score(
    tuple(replace(n, start=n.start + t, end=n.end + t) for t in (0.0, 1.2, 2.4) for n in HARD.notes)
)

EASY = Score(
    tuple(Note(0.4 * i, 0.4 * i + 0.4, 60 + 2 * i, 80, finger=Finger(0, i)) for i in range(3))
)
JUMPS = Score(
    tuple(Note(0.4 * i, 0.4 * i + 0.4, (48, 62)[i % 2], 80, finger=Finger(0, 2)) for i in range(10))
)

# Far apart, so that other fingers lose less, with whatever kernels linear algebra uses.
WIDE = melody(*(71, 78, 76, 65, 78, 79, 79, 52, 63, 68, 58, 61, 68, 74, 67, 55, 70, 76), length=0.2)

# Both thumbs on neighbouring keys, closely enough for hands to meet.
CLOSE = Score(
    tuple(
        Note(0.3 * i, 0.3 * i + 0.3, pitch, 80, finger=Finger(hand, 0))
        for i in range(4)
        for pitch, hand in enumerate((1, 0), start=(60, 62)[i % 2])
    )
)


@pytest.fixture(autouse=True, scope="module")
def short_sweeps():
    """What sweeps come to by chance takes less time."""
    patch = pytest.MonkeyPatch()
    for sweep in ("_FIRST_SWEEP", "_SWEEP"):
        patch.setattr(practice_of_hands, sweep, 0.2)
    yield
    patch.undo()


def practice(
    num_threads: int = 1,
    seed: int = 0,
    score: Score = HARD,
    config: PlannerConfig = GIVEN_FINGERS,
    task: TaskConfig = QUICK,
    scene: SceneConfig | None = None,
) -> Practice:
    context = PlanningContext(config, Threads(num_threads))
    view = begun(PianoTask([score], task, scene)).view()
    return Practice(view, np.random.default_rng(seed), context)


def restored(begun: Practice, left: Practice, tmp_path: Path) -> Practice:
    """Practice that goes on where another was left, by way of a file."""
    left.save(tmp_path / "left.safetensors")
    begun.restore(tmp_path / "left.safetensors")
    return begun


def changed(practised: Practice, tmp_path: Path, **arrays: NDArray[Any] | None) -> Path:
    """A file of its state with other arrays by "part/name", or without them."""
    path = tmp_path / "state.safetensors"
    practised.save(path)
    state, facts = read_tensors(path, ANY, 2**28)
    state = {name: array for name, array in (state | arrays).items() if array is not None}
    write_tensors(path, state, facts)
    return path


def assert_same(one: Practice, other: Practice) -> None:
    state, others = one.state(), other.state()
    assert state.keys() == others.keys()
    for name in state:
        np.testing.assert_array_equal(state[name], others[name], name)


@pytest.fixture(scope="module")
def practised():
    done = practice()
    assert done.run(EFFORT)
    return done


def test_it_plays_better_than_at_first_sight(practised):
    (_, f1, onsets), *_, (effort, later_f1, later_onsets) = practised.history
    assert effort >= EFFORT
    assert later_f1 + 2 * later_onsets > f1 + 2 * onsets


def test_the_first_take_is_what_the_planner_plays():
    score = Score(HARD.notes[:2])
    planner = Planner()
    planner.num_threads = 1
    played = play_episode(PianoTask([score], QUICK), planner, 0).episode["action"]
    task_rng, rng = np.random.default_rng(0).spawn(2)
    del task_rng
    view = begun(PianoTask([score], QUICK)).view()
    take = Practice(view, rng, PlanningContext(PlannerConfig(), Threads(1)))
    take.run(0.0)
    np.testing.assert_array_equal(take.best().practised.tracking.ctrl, played[:, :-1])


def test_more_practice_is_never_worse_and_plays_the_same_in_the_scene():
    one = practice(score=CLOSE)
    before = 0.0
    for effort in 0.0, 0.05:
        one.run(effort)
        assert one.best().score >= before
        before = one.best().score
        best_played(one, CLOSE)
    one.run(np.inf, so_often(3))  # in the middle of a sweep
    assert one.best().score >= before
    best_played(one, CLOSE)
    scores = [f1 + 2 * onsets for _, f1, onsets in one.history]
    assert scores == sorted(scores)
    assert scores[-1] > scores[0]
    onsets = [onsets for *_, onsets in one.history]
    assert onsets == sorted(onsets)
    # Fingers of the score are kept.
    assert [note.finger for note in one.plan.track.score.notes] == [n.finger for n in CLOSE.notes]


def best_played(practised: Practice, score: Score) -> dict[str, float]:
    """How its best is played in the scene, which is as it says."""
    best = practised.best()
    actions = np.append(best.practised.tracking.ctrl, practised.plan.goals.sustain[:, None], axis=1)
    metrics = play_episode(PianoTask([score], QUICK), Playback(actions)).metrics
    assert (metrics["f1"], metrics["note_onset_f1"]) == (best.f1, best.note_onset_f1)
    return metrics


def test_it_plays_more_in_time_and_as_loud_as_written():
    """Of a song of which no key is missed."""
    times = zip((0.0, 0.42, 0.83), (40, 90, 60), EASY.notes, strict=True)
    score = Score(tuple(replace(n, start=t, end=t + 0.3, velocity=v) for t, v, n in times))
    one, stages = practice(score=score), []
    for effort in 0.0, EFFORT:
        one.run(effort)
        stages.append(best_played(one, score))
        assert (stages[-1]["f1"], stages[-1]["note_onset_f1"]) == (1.0, 1.0)
    before, after = stages
    assert after["onset_error_90"] < before["onset_error_90"]
    assert after["velocity_error"] < before["velocity_error"]


def test_it_goes_on_after_a_stop_as_if_there_had_been_none_on_any_threads(practised, tmp_path):
    left = practice(2)
    for units in 1, 2, 4:  # in the first take, where a sweep begins, within one
        assert not left.run(EFFORT, so_often(units))
        left = restored(practice(2), left, tmp_path)
    assert left.run(EFFORT)
    assert_same(left, practised)


@pytest.mark.slow
def test_hands_that_were_pushed_search_for_what_sounded_before():
    one, rng = practice(config=PlannerConfig()), np.random.default_rng(0)
    one.run(0.0)
    task = PianoTask([HARD], QUICK)
    task.reset([rng], [0])
    start = task.state.hand_qpos[0]
    planned = PlannedVariant(
        one.plan.track, start, rng, PlanningContext(PlannerConfig(), Threads(1))
    )
    played, scene, last = one.trajectory, planned.scene, one.num_steps

    def loss(first: int, push: float, *, search: bool) -> float:
        """From step `first` on, after a push in the two before."""
        pushed = played.copied()
        pushed.ctrl[first - 2 : first] += push * (-1.0) ** np.arange(pushed.ctrl.shape[1])
        start = {0: scene.at_start()}
        _, snapshots = scene.roll_out(pushed, start, 0, first, first)
        planned.follow(played, first, [np.random.default_rng(hand) for hand in range(2)])
        act = planned.search.act if search else None
        after, _ = scene.roll_out(played, snapshots, first, last, last, act)
        return float(after.loss.sum())

    pushes = [(first, push) for first in (4, 8) for push in (0.1, 0.2)]
    searched, led_back = ([loss(*p, search=search) for p in pushes] for search in (True, False))
    assert sum(searched) < 0.8 * sum(led_back)
    assert loss(*pushes[0], search=True) == searched[0]  # whatever they did before
    assert planned.search.simulated > 0


def test_a_hand_corrects_how_far_its_fingertips_are_off(monkeypatch):
    def nothing(_: Perturbations, path: Any, first: int, last: int, count: int, *_rng: Any) -> Any:
        return np.zeros((count, last - first, path.shape[1]))

    monkeypatch.setattr(Perturbations, "draw", nothing)
    corrected = practice()
    corrected.run(EFFORT)
    (_, f1, onsets), *_, (_, later_f1, later_onsets) = corrected.history
    assert later_f1 + 2 * later_onsets > f1 + 2 * onsets


@pytest.mark.parametrize(
    ("score", "config", "effort", "follows"),
    [
        (WIDE, NO_SEARCH, 0.02, False),
        pytest.param(JUMPS, GIVEN_FINGERS, 0.04, True, marks=pytest.mark.slow),
    ],
)
def test_other_takes_are_played_alike_after_a_stop_and_the_best_goes_on(
    score, config, effort, follows, tmp_path, monkeypatch
):
    straight = practice(score=score, config=config)
    at_sight = straight.plan
    straight.run(effort)
    (_, f1, onsets), *_, (_, later_f1, later_onsets) = straight.history
    assert (later_onsets, later_f1) > (onsets, f1)
    assert straight.plan.nominal.presses != at_sight.nominal.presses
    best_played(straight, score)
    left, within = practice(2, score=score, config=config), set[bool]()
    followed = watched(monkeypatch, PlannedVariant, "follow")
    while not left.run(effort, so_often(5)):
        within.add(left.plays_variant)
        left = restored(practice(2, score=score, config=config), left, tmp_path)
    assert within == {False, True}  # takes of other fingers or release times
    assert bool(followed) >= follows  # and those that follow what was put together
    assert_same(left, straight)


@pytest.mark.slow
def test_what_follows_a_change_is_searched_for_alike_after_a_stop_and_in_two_threads(
    monkeypatch, tmp_path
):
    with_search = PlannerConfig(  # a short one, which leaves something to practise
        fingering="score", num_candidates=4, iterations=1, horizon=0.1, proposals="none"
    )
    straight = practice(score=JUMPS, config=with_search, seed=1)
    restarted = watched(monkeypatch, HandsInScene, "restart")
    straight.run(0.3)
    assert restarted
    done = False
    left = practice(2, score=JUMPS, config=with_search, seed=1)
    while not done:
        done = left.run(0.3, so_often(6))
        left = restored(practice(2, score=JUMPS, config=with_search, seed=1), left, tmp_path)
    assert_same(left, straight)


@pytest.mark.parametrize(
    ("seed", "config", "scene"),
    [
        (1, QUICK, SceneConfig()),
        (0, QUICK, SceneConfig(physics="fast")),
        (0, replace(QUICK, wrong_press_termination=True), SceneConfig()),
    ],
)
def test_practice_of_something_else_is_refused(practised, seed, config, scene, tmp_path):
    other = practice(seed=seed, task=config, scene=scene)
    with pytest.raises(CadenzaError, match=r"left\.safetensors: is the practice of another song"):
        restored(other, practised, tmp_path)


@pytest.mark.parametrize("lost", ["spliced/fingers", "practice/numbers", "best/ctrl"])
def test_practice_with_parts_missing_is_refused(lost, tmp_path):
    begun = practice()
    begun.run(EFFORT, so_often(1))
    assert lost in begun.state()
    path = changed(begun, tmp_path, **{lost: None})
    with pytest.raises(CadenzaError, match=r"state\.safetensors: parts of it are missing"):
        practice().restore(path)


@pytest.mark.slow
def test_to_go_on_with_a_sweep_takes_as_much_memory_as_to_stay_in_it(monkeypatch, tmp_path):
    """Snapshots are whole simulations: none is made of the song before the window."""
    later = tuple(replace(n, start=n.start + 2.0, end=n.end + 2.0) for n in HARD.notes[:3])
    late = Score((*EASY.notes, *later))
    left = practice(score=late)
    while not left.state().get("sweep/first"):
        left.run(2.0, so_often(1))
    again = practice(score=late)
    rollouts = watched(monkeypatch, WholeScene, "roll_out")
    restored(again, left, tmp_path)
    made = {step for _, (_, snapshots) in rollouts for step in snapshots}
    assert min(made) == left.state()["sweep/first"]


def test_hands_that_do_not_slide_practise():
    done = practice(config=NO_SEARCH, scene=SceneConfig(hands="right", forearm_dofs=()))
    assert done.run(EFFORT)
    assert done.effort > EFFORT / 2  # there was something to mend


def test_the_only_passage_of_a_short_song_is_told():
    done = practice(score=Score(HARD.notes[:1]))
    done.run(0.01)
    done.trajectory.faults[:] = 0
    done.trajectory.faults[0, 0] = 1
    assert done.passages_with_faults() == [0]


def test_only_notes_that_are_wrong_are_not_yet_right(tmp_path, capsys):
    """A hand that lets go early to leap plays every note, and one neighbour where it leaps far."""
    for far, is_right in (22, True), (24, False):
        leaps = (Note(t, t + 1.0, 48 + i % 2 * far) for i, t in enumerate((0.0, 1.0, 2.0, 3.0)))
        write_midi(Score(tuple(leaps)), tmp_path / "leaps.mid")
        options = ["--effort", "0", "--hands", "right", "--planner.method", "none", "-o"]
        main(["practice", str(tmp_path / "leaps.mid"), *options, str(tmp_path / str(far))])
        output = capsys.readouterr().out
        assert "F1 1.000, note" not in output  # keys are silent that should sound
        assert ("note onset F1 1.000" in output) == is_right
        assert ("not yet right" in output) != is_right


def test_the_planner_practises_before_it_plays():
    planner = Planner(replace(NO_SEARCH, effort=0.01))
    planner.num_threads = 1
    messages = []
    result = play_episode(
        PianoTask([HARD], QUICK), planner, 0, lambda stage, *_: messages.append(stage)
    )
    stages = [stage for stage in dict.fromkeys(messages) if stage in STAGES]
    assert stages == list(STAGES)
    assert result.metrics["f1"] > 0.5


def test_hands_that_are_pushed_find_back_before_a_finger_slips(practised):
    rng, best = np.random.default_rng(0), practised.best()
    task = PianoTask([HARD], QUICK)
    task.reset([rng], [0])
    view, made = task.view(), best.practised
    context = PlanningContext(NO_SEARCH, Threads(1))
    player = PractisedPlanner(view, made, rng, context, practised.plan)
    expected = made.tracking.ctrl
    off = []
    for step in range(len(expected)):
        action = player.act(task.view())
        off.append(float(np.abs(action[:-1] - expected[step]).max()))
        task.step((action + (0.1 if step == 8 else 0.0))[None])
    assert not any(off[:9])  # nothing had happened yet
    assert off[9] > 0.05
    assert off[13] < off[9] / 3


USUAL = (
    *("--no-video", "-q", "--num-threads", "1"),
    *("--initial-buffer-time", "0.4", "--planner.method", "none"),
)


def folder_of(tmp_path: Path, *options: str) -> Path:
    tmp_path.mkdir(exist_ok=True)
    write_midi(HARD, tmp_path / "hard.mid")
    song, folder = str(tmp_path / "hard.mid"), tmp_path / "practised"
    main(["practice", song, "-o", str(folder), *USUAL, *options])
    return folder


@pytest.fixture(scope="module", params=["both", "apart"])
def practised_folder(request, tmp_path_factory):
    """What practice has left, and with which hands."""
    folder = tmp_path_factory.mktemp(request.param)
    return folder_of(folder, "--effort", "0.1", "--hands", request.param), request.param


@pytest.fixture(scope="module")
def begun_folder(tmp_path_factory):
    """What practice leaves that was played once."""
    return folder_of(tmp_path_factory.mktemp("begun"), "--effort", "0")


def test_a_practised_plan_plays_again_bit_for_bit(practised_folder, tmp_path):
    folder, hands = practised_folder
    played = load_episode(folder / "episode.npz")
    with_feedback = cadenza.play(agent=folder)  # song and task are those of the folder
    task = PianoTask([HARD], QUICK, SceneConfig(hands=hands))
    actions = load_plan(folder / "plan.safetensors").actions
    song, bench = folder.parent / "hard.mid", tmp_path / "bench"
    options = ["--agents", str(folder), "--jobs", "1", "--pages", "none"]
    main(["bench", "--songs", str(song), *options, "-o", str(bench)])
    (run,) = read_results(bench).results
    playback = play_episode(task, Playback(actions)).episode
    for again in with_feedback.episode, playback, load_episode(run.folder / "episode.npz"):
        for name in ("action", "hand_qpos", "key_qpos", "key_activation"):
            np.testing.assert_array_equal(again[name], played[name])
    assert (folder / "report.html").exists()


def test_practice_goes_on_from_elsewhere_and_after_something_else_was_played(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    write_midi(Score(HARD.notes[:4]), tmp_path / "hard.mid")
    quick = ("--no-video", "-q", "--planner.method", "none", "--initial-buffer-time", "0.4")
    main(["practice", "hard.mid", "-o", "hard", "--effort", "0", *quick])
    main(["play", "OdeToJoy", "--agent", "zero", "--first-seconds", "1", "-o", "hard", *quick[:2]])
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    before = (tmp_path / "hard" / "practice.safetensors").read_bytes()
    main(["practice", "--resume", "../hard", "--effort", "0.05", *quick[:2]])
    assert (tmp_path / "hard" / "practice.safetensors").read_bytes() != before
    message = refused(capsys, "play", "OdeToJoy", "--agent", "../hard")
    assert "../hard: has practised 'hard', and can play nothing else" in message
    main(["play", "../hard.mid", "--agent", "../hard", "-o", "played", *quick[:2]])  # the same song


def test_what_was_practised_is_scored_and_explained_alike_when_it_is_played(tmp_path, capsys):
    """Other fingers than the task would find, and notes that no hand can reach."""
    apart = tuple(Note(t, t + 0.3, pitch, 80) for t in (0.0, 0.4) for pitch in (48, 60, 71, 84))
    write_midi(Score(apart), tmp_path / "apart.mid")
    folder, out = tmp_path / "practised", tmp_path / "out"
    options = ["--hands", "right", "--planner.method", "none", "--no-video", "-o", str(folder)]
    options += ["--arrange", "off"]
    main(["practice", "--effort", "0.1", str(tmp_path / "apart.mid"), *options])
    output = capsys.readouterr().out
    main(["play", "--agent", str(folder), "--no-video", "-o", str(out)])
    again = capsys.readouterr().out
    (verdict,) = [line for line in output.splitlines() if "in time (within 50 ms)" in line]
    assert verdict in again
    before, after = (load_episode(each / "episode.npz").arrays for each in (folder, out))
    assert before.keys() == after.keys()
    for name in before.keys() - {"metrics"}:
        np.testing.assert_array_equal(before[name], after[name], name)
    assert (folder / "misses.json").read_bytes() == (out / "misses.json").read_bytes()


@pytest.mark.parametrize("practised_folder", ["both"], indirect=True)
def test_practised_hands_that_are_pushed_search_as_the_planner_does(practised_folder, monkeypatch):
    folder, _ = practised_folder
    noise = DomainRandomization(control_noise=0.1)
    noisy = TaskConfig(initial_buffer_time=0.4, repeats="shortened", randomization=noise)
    searches = watched(monkeypatch, HandsInScene, "restart")
    cadenza.play(agent=folder)
    assert not searches
    pushed = cadenza.play(agent=folder, task=noisy)
    assert searches
    actions = load_plan(folder / "plan.safetensors").actions
    open_loop = play_episode(PianoTask([HARD], noisy), Playback(actions))
    assert pushed.metrics["f1"] > open_loop.metrics["f1"]


def test_another_song_than_the_practised_one_is_told(practised):
    hands = PractisedHands(practised.best().practised, NO_SEARCH)
    with pytest.raises(
        CadenzaError, match=r"has 2 hands and 6 notes, .* 2 and 3: was another song practised"
    ):
        play_episode(PianoTask([EASY], QUICK), hands)
    one_hand = PianoTask([HARD], QUICK, SceneConfig(hands="right"))
    with pytest.raises(CadenzaError, match="for other hands"):
        play_episode(one_hand, hands)


def test_the_planner_practises_in_the_folder_of_what_it_plays(tmp_path, capsys):
    short = "--first-seconds", "0.6"
    folder = folder_of(tmp_path, "--effort", "0.01", *short)
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("effort")]
    more = [*short, "--planner.effort", "0.01", "-o", str(tmp_path / "played")]
    main(["play", str(tmp_path / "hard.mid"), *USUAL, *more])
    assert [line for line in capsys.readouterr().out.splitlines() if line in lines] == lines
    for read, name in (
        (lambda path: read_tensors(path, ANY, 2**28)[0], "practice.safetensors"),
        (lambda path: read_tensors(path, ANY, 2**28)[0], "plan.safetensors"),
        (lambda path: read_arrays(path, ANY, 2**28), "episode.npz"),
    ):
        ours, theirs = (read(each / name) for each in (folder, tmp_path / "played"))
        for array in ours.keys() - {"metrics", "song"}:
            np.testing.assert_array_equal(ours[array], theirs[array])


def test_practice_that_was_killed_has_its_plan_after_the_first_take(tmp_path, monkeypatch):
    class Killed(BaseException): ...

    def killed(self: Practice, effort: float, goes_on: Callable[[], bool]) -> bool:
        run(self, effort, goes_on)
        raise Killed

    run = Practice.run
    monkeypatch.setattr(Practice, "run", killed)
    with pytest.raises(Killed):
        folder_of(tmp_path, "--effort", "0.05")
    folder = tmp_path / "practised"
    assert not (folder / "report.html").exists()
    assert cadenza.play(agent=folder).metrics["f1"] > 0.5
    (folder / "plan.safetensors").unlink()
    with pytest.raises(CadenzaError, match="practice has not played the song to the end yet"):
        cadenza.play(agent=folder)


A_SECOND = "--effort", "0.02", "--first-seconds", "1.1", "--seed", "3"


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """What practice leaves that never stopped."""
    return folder_of(tmp_path_factory.mktemp("straight"), *A_SECOND, "--effort", "0.3")


def test_practice_is_resumed_where_it_was_left(straight, tmp_path):
    folder = folder_of(tmp_path, *A_SECOND)
    begun = read_tensors(folder / "practice.safetensors", ANY, 2**28)[0]
    before = json.loads((folder / "settings.json").read_text())
    assert 0 < before["planner"]["effort"] < 0.3
    main(["practice", "--resume", str(folder), "--effort", "0.3", "--no-video"])
    one, other = ((f / "practice.safetensors").read_bytes() for f in (folder, straight))
    assert one == other
    done = read_tensors(folder / "practice.safetensors", ANY, 2**28)[0]
    assert len(done["practice/history"]) > len(begun["practice/history"])
    after = json.loads((folder / "settings.json").read_text())
    assert after["planner"].pop("effort") > before["planner"].pop("effort")
    for settings in before, after:
        settings.pop("notices", None)  # they tell what might help
    assert after == before
    assert before["arrangement"]["first_seconds"] == 1.1


@pytest.mark.slow
def test_the_time_of_the_first_take_says_nothing_of_how_long_practice_takes(
    tmp_path, monkeypatch, capsys
):
    seconds = itertools.count(0, 100)
    monkeypatch.setattr(time, "monotonic", lambda: float(next(seconds)))
    write_midi(HARD, tmp_path / "hard.mid")
    usual = "--no-video", "--num-threads", "1", "--planner.method", "none"
    main(["practice", str(tmp_path / "hard.mid"), "-o", str(tmp_path), "--effort", "0.02", *usual])
    lines = capsys.readouterr().err.splitlines()
    shown = [line.split(",")[0] for line in lines if line.startswith(("first take", "practising"))]
    assert shown[0] == "first take: 20 of 35 steps"  # a second of it
    assert shown[1].startswith("practising")
    assert not any(line.startswith("first take") for line in shown[1:])


def test_what_is_finished_after_the_effort_is_shown_until_its_end():
    done, progress = practice(score=LONG), list[tuple[str, int, int]]()

    def goes_on() -> bool:
        progress.append(done.progress(0.002))
        return True

    done.run(0.002, goes_on)
    stages = list(dict.fromkeys(stage for stage, _, _ in progress))
    assert stages == ["first take", "practising", "finishing a take"]
    assert ("practising", 100, 100) not in progress
    finishing = [(played, of) for stage, played, of in progress if stage == stages[-1]]
    assert finishing == sorted(set(finishing))  # goes forward, up to
    assert finishing[-1][1] == done.num_steps
    assert done.progress(0.002) == ("practising", 100, 100)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["play", "--agent", "BEGUN", "--planner.effort", "1"], "leave out --planner.effort"),
        (["practice", "easy.mid", "-o", "BEGUN"], "is the practice of another song"),
        (
            ["practice", "easy.mid", "--randomization.control-noise", "0.05"],
            "hands practise with the nominal model",
        ),
        (
            ["practice", "easy.mid", "--wrong-press-termination"],
            "--wrong-press-termination: a song that ends",
        ),
        (["practice", "easy.mid", "-o", "taken"], "somebody practises there"),
        (["practice", "--resume", "silent"], "run the same command again that practised there"),
    ],
)
def test_practice_that_cannot_be_is_refused(
    words, message, begun_folder, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    write_midi(EASY, Path("easy.mid"))
    without_settings = shutil.ignore_patterns(
        "practice.json", "settings.json"
    )  # how it was practised
    shutil.copytree(begun_folder, "silent", ignore=without_settings)
    with locked(tmp_path / "taken"):
        given = [begun_folder if word == "BEGUN" else word for word in words]
        assert message in refused(capsys, *given)


def test_ctrl_c_keeps_the_best_so_far(tmp_path, monkeypatch):
    run = Practice.run

    def run_and_interrupt(self: Practice, _: float, goes_on: Callable[[], bool]) -> bool:
        run(self, 0.0)
        assert goes_on()
        signal.raise_signal(signal.SIGINT)
        return goes_on()

    monkeypatch.setattr(Practice, "run", run_and_interrupt)
    with pytest.raises(SystemExit) as stop:
        folder_of(tmp_path)
    assert stop.value.code == 130
    assert load_episode(tmp_path / "practised" / "episode.npz").num_steps > 20
    monkeypatch.setattr(Practice, "run", lambda self, *_: variants.append(self.history))
    variants: list[Any] = []
    folder_of(tmp_path)
    assert [len(history) for history in variants] == [1]


def test_ctrl_c_while_results_are_written_writes_them_all(tmp_path, monkeypatch):
    def encode_and_interrupt(*arguments: Any, **options: Any) -> bytes:
        if not sounds:
            signal.raise_signal(signal.SIGINT)
        sounds.append(encode_opus(*arguments, **options))
        return sounds[-1]

    sounds: list[bytes] = []
    monkeypatch.setattr(performance, "encode_opus", encode_and_interrupt)
    with pytest.raises(SystemExit) as stop:
        folder_of(tmp_path, "--effort", "0")
    assert stop.value.code == 130
    assert "</html>" in (tmp_path / "practised" / "report.html").read_text()
