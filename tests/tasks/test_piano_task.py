"""Goals, observations and rewards under every option of the task."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.errors import CadenzaError
from cadenza.fingering.search import find_fingering
from cadenza.keyboards.piano import PIANO
from cadenza.music.goals import score_to_goals
from cadenza.music.score import NUM_KEYS, Note, PedalEvent, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import players_of
from cadenza.tasks.piano_task import EpisodeStart, PianoTask, Transition
from numbered import FIVE, finger, numbers

DT = 0.05
ROW = NUM_KEYS + 1
TERMS = {"key_press", "fingering", "energy", "onset_timing", "loudness"}
AT_ONCE = {"initial_buffer_time": 0.0}
NOTES, KEYS = ("goal_onset", "goal_velocity"), ("key_onset", "key_velocity")
SIZES = {"goal": 979, "fingering": 10, "pedal": 1, "joints": 46, "key_state": 88}
SIZES |= dict.fromkeys(NOTES, 12 * 88) | dict.fromkeys(KEYS, 88)

# Half a second of silence, then three notes for both hands, ten steps in all.
SONG = Score(
    (
        Note(0.5, 0.6, 60, finger=finger(0)),
        Note(0.6, 0.8, 64, finger=finger(2)),
        Note(0.7, 0.95, 43, finger=finger(5)),
    ),
    (PedalEvent(0.7, 127),),
    title="Three notes",
)
UNFINGERED = Score(tuple(dataclasses.replace(note, finger=None) for note in SONG.notes))
SHORT = Score((Note(0, 0.1, 50, finger=finger(6)),), title="One note")


HANDS: tuple[Any, ...] = ("both", "right", "left", "none")


@pytest.fixture(scope="module")
def scenes():
    return {hands: build_scene(SceneConfig(hands=hands)) for hands in HANDS}


class Player:
    """A task and what it has seen, from reset on; the hands rest unless told otherwise."""

    def __init__(
        self, scene: Scene, *scores: Score, seeds: tuple[int, ...] = (0,), **options: Any
    ) -> None:
        self.task = PianoTask(
            scores or [SONG], TaskConfig(**(AT_ONCE | options)), scene, len(seeds)
        )
        self.seeds = seeds
        self.reset()

    def reset(self) -> None:
        rngs = [np.random.default_rng(seed) for seed in self.seeds]
        self.task.reset(rngs, range(len(rngs)))

    def seen(self, part: str) -> np.ndarray:
        return self.task.observation()[:, self.task.spec.observation_layout[part]]

    def goal(self) -> np.ndarray:
        """(N, rows, 89)"""
        return self.seen("goal").reshape(len(self.seeds), -1, ROW)

    def rest(self) -> Transition:
        ctrl = np.clip(0.0, self.task.spec.action_low, self.task.spec.action_high)
        return self.task.step(np.tile(ctrl, (len(self.seeds), 1)))

    def act(self, rng: np.random.Generator) -> Transition:
        low, high = self.task.spec.action_low, self.task.spec.action_high
        return self.task.step(rng.uniform(low, high, (len(self.seeds), len(low))))

    def play_on(self) -> list[Transition]:
        """To the end of the first environment's episode."""
        result = [self.rest()]
        while not (result[-1].terminated[0] or result[-1].truncated[0]):
            result.append(self.rest())
        return result


def goal_keys(row: np.ndarray) -> list[int]:
    return np.flatnonzero(row[:NUM_KEYS]).tolist()


# What is asked for


def test_trimmed_song_begins_with_its_first_note(scenes):
    player = Player(scenes["both"])
    rows = player.goal()[0]
    c, e, g = (pitch - 21 for pitch in (60, 64, 43))
    expected = [[c], [c], [e], [e], [g, e], [g, e], [g], [g], [g], []]
    assert [goal_keys(row) for row in rows] == [*expected, []]
    assert rows[:, NUM_KEYS].tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 0]
    assert len(player.play_on()) == 10


def test_untrimmed_song_keeps_its_silence(scenes):
    player = Player(scenes["both"], trim_silence=False)
    assert [goal_keys(row) for row in player.goal()[0]] == [[]] * 10 + [[39]]
    assert player.task.goals.num_steps.tolist() == [20]


@pytest.mark.parametrize(
    ("seconds", "silent_steps"),
    [(0.0, 0), (0.02, 0), (0.125, 2), (0.2, 4), (0.375, 8), (0.13, 3)],  # half to even
)
def test_initial_buffer(scenes, seconds, silent_steps):
    player = Player(scenes["both"], initial_buffer_time=seconds)
    rows = player.goal()[0]
    assert [goal_keys(row) for row in rows[: silent_steps + 1]] == [[]] * silent_steps + [[39]]
    assert not rows[:silent_steps, NUM_KEYS].any()
    assert player.task.goals.num_steps.tolist() == [10 + silent_steps]


@pytest.mark.parametrize(
    ("options", "rows"),
    [
        ({}, 11),
        ({"n_steps_lookahead": 0}, 1),
        ({"n_steps_lookahead": 3}, 4),
        ({"n_seconds_lookahead": 0.5}, 11),
        ({"n_seconds_lookahead": 0.12, "n_steps_lookahead": 7}, 4),
        ({"n_seconds_lookahead": 0.0}, 1),
        ({"n_seconds_lookahead": 0.12, "control_timestep": 0.02}, 7),
    ],
)
def test_lookahead(scenes, options, rows):
    player = Player(scenes["both"], **options)
    assert player.goal().shape == (1, rows, ROW)
    assert player.task.spec.observation_layout["goal"] == slice(0, rows * ROW)


@pytest.mark.parametrize("lookahead", [0, 4, 30])
def test_the_goal_moves_on_by_a_row_a_step_and_is_seen_once_more_at_the_end(scenes, lookahead):
    goal = Player(scenes["both"], n_steps_lookahead=9).goal()[0]
    padded = np.vstack([goal, np.zeros((lookahead + 1, ROW))])
    player = Player(scenes["both"], n_steps_lookahead=lookahead)
    for step in (*range(10), 9):  # the last observation repeats the last goal
        assert_array_equal(player.goal()[0], padded[step : step + lookahead + 1])
        player.rest()


def test_control_timestep(scenes):
    player = Player(scenes["both"], control_timestep=0.1)
    assert [goal_keys(row) for row in player.goal()[0][:5]] == [[39], [43], [22, 43], [22], [22]]
    assert len(player.play_on()) == player.task.goals.num_steps[0] == 5
    assert player.task.simulation.num_substeps == 20


# What is seen


@pytest.mark.parametrize(
    ("hands", "options", "parts"),
    [
        ("both", {}, ["goal", "fingering", *NOTES, "key_state", "pedal", "joints", *KEYS]),
        ("both", {"fingering": "off"}, ["goal", *NOTES, "key_state", "pedal", "joints", *KEYS]),
        ("left", {"onset_goals": False}, ["goal", "fingering", "key_state", "pedal", "joints"]),
        ("none", {}, ["goal", *NOTES, "key_state", "pedal", *KEYS]),
    ],
)
def test_layout_of_the_observation(scenes, hands, options, parts):
    player = Player(scenes[hands], **options)
    layout = player.task.spec.observation_layout
    sizes = {name: SIZES[name] for name in parts}
    if hands == "left":
        sizes["joints"] //= 2
    assert {name: part.stop - part.start for name, part in layout.items()} == sizes
    assert [part.start for part in layout.values()] == [0, *np.cumsum(list(sizes.values()))[:-1]]
    assert player.task.observation().shape == (1, sum(sizes.values()))
    assert player.task.observation().dtype == np.float32


def test_parts_of_the_observation(scenes):
    player, rng = Player(scenes["both"]), np.random.default_rng(0)
    fingers = [np.flatnonzero(player.seen("fingering")[0]).tolist()]
    for _ in range(9):
        ctrl = rng.uniform(player.task.spec.action_low, player.task.spec.action_high)
        player.task.step(ctrl[None])
        fingers.append(np.flatnonzero(player.seen("fingering")[0]).tolist())
        state = player.task.state
        assert_array_equal(player.seen("joints"), state.hand_qpos.astype(np.float32))
        assert_allclose(
            player.seen("key_state"), np.clip(state.key_qpos / PIANO.travel, 0, 1), 1e-6
        )
        assert player.seen("pedal") == np.float32(ctrl[-1])
    assert fingers == [[0], [0], [2], [2], [2, 5], [2, 5], [5], [5], [5], []]


@pytest.mark.parametrize(("given", "seen"), [(5.0, 1.0), (-2.0, 0.0), (np.nan, 0.0), (0.3, 0.3)])
def test_the_pedal_is_seen_within_its_range(scenes, given, seen):
    player = Player(scenes["none"])
    ctrl = player.task.spec.action_low[None].copy()
    ctrl[:, -1] = given
    player.task.step(ctrl)
    assert player.seen("pedal") == np.float32(seen)


def test_one_hand_is_asked_for_its_own_fingers_only(scenes):
    for hands, fingers in (("right", [2]), ("left", [5])):
        player = Player(scenes[hands])
        for _ in range(4):
            player.rest()
        assert np.flatnonzero(player.seen("fingering")[0]).tolist() == fingers


# What is rewarded


@pytest.mark.parametrize(
    ("hands", "options", "terms"),
    [
        ("both", {}, TERMS),
        ("both", {"fingering": "transport"}, TERMS),
        ("both", {"onset_goals": False}, TERMS - {"onset_timing", "loudness"}),
        ("both", {"fingering": "off"}, TERMS - {"fingering"}),
        ("both", {"sustain_term": True, "forearm_term": True}, TERMS | {"sustain", "forearm"}),
        ("right", {"sustain_term": True}, TERMS | {"sustain"}),
        ("none", {}, {"key_press", "onset_timing", "loudness"}),
        ("none", {"sustain_term": True, "onset_goals": False}, {"key_press", "sustain"}),
    ],
)
def test_terms_add_up_to_the_reward(scenes, hands, options, terms):
    player, rng = Player(scenes[hands], **options), np.random.default_rng(0)
    for _ in range(10):
        transition = player.act(rng)
        assert set(transition.terms) == terms
        assert_allclose(sum(transition.terms.values()), transition.reward)
        assert transition.reward.shape == (1,)


def test_energy_coefficient(scenes):
    energy = {}
    for coefficient in (0.0, 0.005, 0.01):
        player = Player(scenes["both"], energy_coefficient=coefficient)
        transitions = [player.act(np.random.default_rng(0)) for _ in range(3)]
        energy[coefficient] = [t.terms["energy"][0] for t in transitions]
    assert max(energy[0.005]) < 0
    assert_allclose(energy[0.01], 2 * np.array(energy[0.005]))
    assert_array_equal(energy[0.0], 0.0)


def test_the_pedal_is_rewarded_for_following_the_score(scenes):
    player = Player(scenes["both"], sustain_term=True)
    pedal = [0, 0, 1, 1, 1, 1, 0.5, 0.49, 1, 1]  # down from the middle on
    right = []
    for value in pedal:
        ctrl = np.clip(0.0, player.task.spec.action_low, player.task.spec.action_high)
        ctrl[-1] = value
        right.append(player.task.step(ctrl[None]).terms["sustain"][0] == 1.0)
    assert right == [True, True, False, False, True, True, True, False, True, True]


def test_touching_forearms_lose_the_forearm_term(scenes):
    player = Player(scenes["both"], forearm_term=True)
    names = player.task.scene.actuator_names
    ctrl = np.clip(0.0, player.task.spec.action_low, player.task.spec.action_high)
    ctrl[names.index("rh_A_forearm_tx")] = -0.3
    ctrl[names.index("lh_A_forearm_tx")] = 0.3
    terms = [player.task.step(ctrl[None]).terms["forearm"][0] for _ in range(10)]
    assert terms[0] == 0.5
    assert terms[-1] == 0.0


def test_fingering_by_the_score_or_by_transport(scenes):
    """Transport lets any finger do, whatever the score says."""
    near = {}
    for name, score, fingering in (
        ("score", SONG, "auto"),
        ("transport", SONG, "transport"),
        ("unfingered", UNFINGERED, "transport"),
    ):
        player = Player(scenes["both"], score, fingering=fingering)
        near[name] = [t.terms["fingering"][0] for t in player.play_on()]
    assert near["unfingered"] == near["transport"]
    assert all(t >= s for t, s in zip(near["transport"], near["score"], strict=True))
    assert (near["transport"][-1], near["score"][-1]) == (1.0, 0.0)  # nothing to press
    assert near["transport"] != near["score"]


@pytest.mark.parametrize(("hands", "fingers"), [("both", 10), ("right", 5), ("left", 5)])
def test_a_song_without_fingering_gets_one(scenes, hands, fingers):
    """Every note is for one hand if there is but one."""
    player = Player(scenes[hands], UNFINGERED)
    notes = player.task.goals.scores[0].notes
    there = range(fingers) if hands == "right" else range(10 - fingers, 10)
    played = [f for f in numbers(player.task.goals.scores[0]) if f >= 0]
    assert set(played) <= set(there)
    assert len(played) == 3  # one hand lets go of what it holds to reach the third
    assert np.flatnonzero(player.seen("fingering")[0]).tolist() == [FIVE.number(notes[0].finger)]
    assert "fingering" in player.rest().terms


def test_known_fingers_stay_when_the_others_are_found(scenes):
    notes = (SONG.notes[0], *UNFINGERED.notes[1:])
    score = Player(scenes["both"], Score(notes)).task.goals.scores[0]
    assert score.notes[0].finger == SONG.notes[0].finger
    assert all(note.finger for note in score.notes)


def test_reset_begins_anew(scenes):
    """Also after an episode that was cut short, or played past its end, with the pedal down."""
    for steps in (3, 12):
        player, rng = Player(scenes["both"]), np.random.default_rng(0)
        first = player.task.observation()
        for _ in range(steps):
            player.act(rng)
        player.task.step(player.task.spec.action_high[None])
        player.reset()
        assert_array_equal(player.task.observation(), first)
        assert player.task.view().reward[0] == 0
        assert not player.task.goal_keys.any()
        fresh = Player(scenes["both"])
        rewards = [(player.rest().reward[0], fresh.rest().reward[0]) for _ in range(10)]
        assert all(again == once for again, once in rewards)
        assert player.task.episode_metrics(0) == fresh.task.episode_metrics(0)


# When it ends


def press(player: Player, *keys: int) -> Transition:
    ctrl = np.zeros((1, NUM_KEYS + 1))
    ctrl[0, list(keys)] = PIANO.travel[list(keys)]
    return player.task.step(ctrl)


def test_plays_a_song_without_hands(scenes):
    player = Player(scenes["none"], onset_goals=False)
    transitions = []
    for _ in range(10):
        transitions.append(press(player, *goal_keys(player.goal()[0, 0])))
    assert_allclose([t.reward[0] for t in transitions], [1.0] * 9 + [0.5], atol=2e-3)
    assert [bool(t.truncated[0]) for t in transitions] == [False] * 9 + [True]
    metrics = player.task.episode_metrics(0)
    assert {metrics[name] for name in ("precision", "recall", "f1", "note_onset_f1")} == {1.0}
    press(player, 3)  # what comes after the end counts for nothing
    assert player.task.episode_metrics(0) == metrics


@pytest.mark.parametrize("ends", [True, False])
def test_wrong_press_termination(scenes, ends):
    player = Player(scenes["none"], wrong_press_termination=ends, onset_goals=False)
    right = press(player, 39)
    assert (right.terminated.tolist(), right.truncated.tolist()) == ([False], [False])
    missed = press(player)
    assert missed.terminated.tolist() == [False]
    wrong = press(player, 43, 44)
    assert wrong.terminated.tolist() == [ends]
    assert_allclose(wrong.reward, [0.5], atol=2e-3)  # that step is still paid


def test_a_wrong_press_on_the_last_step_terminates_and_does_not_truncate(scenes):
    player = Player(scenes["none"], wrong_press_termination=True)
    for _ in range(9):
        press(player)
    last = press(player, 10)
    assert (last.terminated.tolist(), last.truncated.tolist()) == ([True], [False])


def test_an_unstable_simulation_terminates_its_own_episode_only(scenes):
    player = Player(scenes["both"], seeds=(0, 1, 2))
    far_away = np.full(46, 1e12)  # [m, rad], which MuJoCo takes for a simulation that diverged
    player.task.reset([np.random.default_rng(0)], [1], [EpisodeStart(hand_qpos=far_away)])
    transition = player.rest()
    assert transition.terminated.tolist() == transition.unstable.tolist() == [False, True, False]
    assert np.isfinite(transition.reward).all()
    assert np.isfinite(player.task.observation()).all()
    player.reset()
    assert not player.rest().terminated.any()


# What is random


def test_random_hand_position(scenes):
    """Both hands begin as far to the side, within the range and differently each time."""
    seeds = tuple(range(40))
    still = Player(scenes["both"]).task.state.fingertip_xpos[0]
    player = Player(scenes["both"], seeds=seeds, random_hand_position=0.05)
    moved = player.task.state.fingertip_xpos - still
    assert_allclose(moved[..., [0, 2]], 0.0, atol=1e-6)
    offset = moved[:, 0, 1]
    assert_allclose(moved[..., 1], np.tile(offset, (10, 1)).T, atol=1e-6)
    assert 0.03 < abs(offset).max() <= 0.05
    assert offset.min() < 0 < offset.max()
    assert len(set(offset.tolist())) == len(seeds)
    again = Player(scenes["both"], seeds=seeds, random_hand_position=0.05)
    assert_array_equal(again.task.state.hand_qpos, player.task.state.hand_qpos)
    again.reset()
    assert_array_equal(again.task.state.hand_qpos, player.task.state.hand_qpos)  # nothing adds up


def songs_drawn(scene: Scene, count: int, *scores: Score, **options: Any) -> list[Score]:
    player = Player(scene, *scores, **options)
    drawn = []
    rng = np.random.default_rng(0)
    for _ in range(count):
        player.task.reset([rng], [0])
        drawn.append(player.task.goals.scores[0])
    return drawn


def test_random_stretch(scenes):
    drawn = songs_drawn(scenes["none"], 200, random_stretch=0.2)
    factor = np.array([song.total_time for song in drawn]) / 0.45
    assert (factor.min() >= 0.8, factor.max() <= 1.2) == (True, True)
    assert factor.max() - factor.min() > 0.35
    assert [n.pitch for n in drawn[0].notes] == [60, 64, 43]
    assert drawn == songs_drawn(scenes["none"], 200, random_stretch=0.2)


@pytest.mark.parametrize("repeats", ["published", "shortened"])
def test_the_score_is_on_the_clock_of_the_goals(scenes, repeats):
    song = dataclasses.replace(SONG, notes=(*SONG.notes, Note(0.8, 1.2, 64), Note(1.2, 1.5, 64)))
    options: dict[str, Any] = {"initial_buffer_time": 0.33, "stretch": 1.5, "random_stretch": 0.2}
    options |= {"random_pitch_shift": 3, "repeats": repeats}
    task = Player(scenes["none"], song, **options).task
    goals = score_to_goals(task.score(0), DT, repeats == "shortened")
    assert_array_equal(task.goals.between(0, 0, goals.num_steps)[0][:, :NUM_KEYS], goals.keys)
    assert task.goals.num_steps[0] == goals.num_steps


@pytest.mark.parametrize(
    ("options", "shifts"),
    [
        ({"random_pitch_shift": 3}, set(range(-3, 4))),
        ({"random_octave_shift": 1}, {-12, 0, 12}),
        ({"random_octave_shift": 7}, {-12, 0, 12, 24, 36}),  # the lowest note is 43, the highest 64
        (
            {"random_pitch_shift": 1, "random_octave_shift": 1},
            {-13, -12, -11, -1, 0, 1, 11, 12, 13},
        ),
    ],
)
def test_random_shifts(scenes, options, shifts):
    """Every shift comes up, and no note ever leaves the keyboard (Note would refuse it)."""
    drawn = songs_drawn(scenes["none"], 300, **options)
    assert {song.notes[0].pitch - 60 for song in drawn} == shifts
    assert all([n.pitch - song.notes[0].pitch for n in song.notes] == [0, 4, -17] for song in drawn)
    assert drawn == songs_drawn(scenes["none"], 300, **options)


def test_fingers_that_were_found_are_found_anew_for_other_keys(scenes):
    """At another tempo they stay; a song's own always do."""
    scene = scenes["both"]
    (song, slower), (_, higher), (given, moved) = (
        (player.task.tracks[0].score, player.task.goals.tracks[0].score)
        for player in (
            Player(scene, UNFINGERED, random_stretch=0.2),
            Player(scene, UNFINGERED, seeds=(1,), random_pitch_shift=3),
            Player(scene, SONG, random_pitch_shift=3),
        )
    )
    assert slower.total_time != song.total_time
    assert [note.finger for note in slower.notes] == [note.finger for note in song.notes]
    again, _ = find_fingering(higher.without_fingers(), players_of(scene))
    assert higher.notes == again.notes
    assert higher.notes[0].pitch != song.notes[0].pitch
    assert [note.finger for note in moved.notes] == [note.finger for note in given.notes]


def test_a_song_as_wide_as_the_keyboard_is_not_shifted(scenes):
    wide = Score((Note(0, 1, 21), Note(0, 1, 108)))
    drawn = songs_drawn(scenes["none"], 20, wide, random_pitch_shift=5, random_octave_shift=2)
    assert set(drawn) == {wide}


@pytest.mark.parametrize("probability", [0.0, 0.3, 1.0])
def test_randomization_probability(scenes, probability):
    drawn = songs_drawn(
        scenes["none"], 400, random_stretch=0.5, randomization_probability=probability
    )
    unchanged = SONG.with_silence_trimmed()
    changed = np.mean([song != unchanged for song in drawn])
    assert abs(changed - probability) < 0.08


def test_every_song_comes_up(scenes):
    drawn = songs_drawn(scenes["none"], 120, SONG, UNFINGERED, SHORT)
    count = [drawn.count(s.with_silence_trimmed()) for s in (SONG, UNFINGERED, SHORT)]
    assert sum(count) == 120
    assert min(count) > 20


# Batches


@pytest.mark.parametrize("hands", ["both", "none"])
def test_each_row_is_as_if_alone(scenes, hands):
    """Songs of different lengths, tempos and places, one generator for each environment."""
    options = {"random_stretch": 0.3, "random_pitch_shift": 5, "sustain_term": True}
    options |= {"random_hand_position": 0.05} if hands == "both" else {}
    scores, seeds = (SONG, SHORT, UNFINGERED), tuple(range(5))
    batch = Player(scenes[hands], *scores, seeds=seeds, **options)
    alone = [Player(scenes[hands], *scores, seeds=(seed,), **options) for seed in seeds]
    assert len(set(batch.task.goals.num_steps.tolist())) > 1
    ctrl_rng = np.random.default_rng(0)
    low, high = batch.task.spec.action_low, batch.task.spec.action_high
    for _ in range(int(batch.task.goals.num_steps.min())):
        ctrl = ctrl_rng.uniform(low, high, (len(seeds), len(low)))
        together = batch.task.step(ctrl)
        for i, player in enumerate(alone):
            single = player.task.step(ctrl[i : i + 1])
            assert_array_equal(batch.task.observation()[i], player.task.observation()[0])
            assert together.reward[i] == single.reward[0]
            assert together.truncated[i] == single.truncated[0]
    for i, player in enumerate(alone):
        assert batch.task.episode_metrics(i) == player.task.episode_metrics(0)


def test_a_longer_song_beside_a_running_episode_leaves_it_alone(scenes):
    """Resetting one environment makes room for a longer song; the other goes on."""
    task = PianoTask([SHORT, SONG], TaskConfig(**AT_ONCE), scenes["none"], 2)
    alone = Player(scenes["none"], SHORT)
    short, long = (seed_that_draws(task, song) for song in (SHORT, SONG))
    task.reset([np.random.default_rng(short), np.random.default_rng(short)], [0, 1])
    task.step(np.zeros((2, NUM_KEYS + 1)), [0])
    alone.rest()
    task.reset([np.random.default_rng(long)], [1])
    assert task.goals.steps_done.tolist() == [1, 0]
    assert task.goals.num_steps.tolist() == [3, 10]
    for _ in range(2):
        before = task.observation()[1]
        transition = task.step(np.zeros((2, NUM_KEYS + 1)), [0])
        alone.rest()
        assert_array_equal(task.observation()[0], alone.task.observation()[0])
        assert_array_equal(task.observation()[1], before)
    assert transition.truncated[0]
    assert task.episode_metrics(0) == alone.task.episode_metrics(0)


def seed_that_draws(task: PianoTask, song: Score) -> int:
    for seed in range(100):
        task.reset([np.random.default_rng(seed)], [0])
        if task.goals.scores[0] == song.with_silence_trimmed():
            return seed
    raise AssertionError("never drawn")


# Wrong options


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"control_timestep": 0.0}, "control_timestep 0.0: choose more than 0"),
        ({"control_timestep": 0.012}, "not a multiple of the physics step"),
        ({"control_timestep": float("nan")}, "control_timestep nan"),
        ({"n_steps_lookahead": -1}, "n_steps_lookahead -1: choose 0 to"),
        ({"n_seconds_lookahead": float("nan")}, "n_seconds_lookahead nan"),
        ({"initial_buffer_time": -1.0}, "initial_buffer_time -1.0"),
        ({"fingering": "on"}, "fingering 'on': choose from auto, robot, human, transport, off"),
        ({"fingering_margin": 0.0}, "fingering_margin 0.0: choose more than 0"),
        ({"energy_coefficient": -1.0}, "energy_coefficient -1.0"),
        ({"onset_goals": "on"}, "onset_goals 'on': give True or False"),
        ({"random_hand_position": -0.1}, "random_hand_position -0.1"),
        ({"random_hand_position": 0.5}, "end after 0.46 m; choose less"),
        ({"random_stretch": 1.0}, "random_stretch 1.0: choose 0 to 0.99"),
        ({"random_pitch_shift": -1}, "random_pitch_shift -1: choose 0 to 88"),
        ({"randomization_probability": 1.5}, "randomization_probability 1.5: choose 0 to 1"),
    ],
)
def test_says_what_is_wrong(scenes, options, message):
    with pytest.raises(CadenzaError, match=message) as error:
        PianoTask([SONG], TaskConfig(**options), scenes["both"])
    assert "\n" not in str(error.value)


def test_hands_that_cannot_slide_cannot_be_placed(scenes):
    fixed = SceneConfig(forearm_dofs=("ty",))
    for scene in (fixed, scenes["none"]):
        with pytest.raises(CadenzaError, match="needs hands that slide along the keyboard"):
            PianoTask([SONG], TaskConfig(random_hand_position=0.05), scene)


@pytest.mark.parametrize(
    ("scores", "message"),
    [([], "no song"), ([SONG, Score((), title="Silence")], "Silence has no notes")],
)
def test_says_which_song_cannot_be_played(scenes, scores, message):
    with pytest.raises(CadenzaError, match=message):
        PianoTask(scores, scene=scenes["none"])


# What sounds


def press_keys(scene: Scene, rows: np.ndarray, dt: float) -> tuple[Note, ...]:
    """The notes that sound where the keys' own servos are given `rows` (T, 89) of 0.05 s."""
    task = Player(scene, control_timestep=dt).task
    for row in np.repeat(rows, round(DT / dt), axis=0):
        task.step(row[None])
    return task.played(0).notes


def test_notes_sound_at_the_times_of_the_physics(scenes):
    """As if every physics step were a control step."""
    scene, rng = scenes["none"], np.random.default_rng(0)
    rows = rng.uniform(0, scene.action_high, (9, ROW)) * (rng.random((9, ROW)) < 0.5)
    notes, exactly = press_keys(scene, rows, DT), press_keys(scene, rows, 0.005)
    assert len(notes) > 30
    for note, other in zip(notes, exactly, strict=True):
        assert (note.pitch, note.velocity) == (other.pitch, other.velocity)
        assert_allclose((note.start, note.end), (other.start, other.end), atol=1e-9)
    on_steps = [abs(note.start / DT - round(note.start / DT)) < 1e-6 for note in notes]
    assert not any(on_steps)


def test_keys_struck_harder_are_louder_and_earlier(scenes):
    scene = scenes["none"]
    keys = [20, 22, 24]  # all white
    rows = np.zeros((9, ROW))
    for key, seconds in zip(keys, (0.05, 0.2, 0.4), strict=True):
        way = np.minimum(np.arange(1, 10) * DT / seconds, 1)
        rows[:, key] = way * scene.action_high[key]
    notes = press_keys(scene, rows, DT)
    assert [note.pitch - 21 for note in notes] == keys
    loudness = [note.velocity for note in notes]
    assert loudness == sorted(set(loudness), reverse=True)
