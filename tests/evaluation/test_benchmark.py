"""The benchmark: what is frozen, and that forged entries are found out."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mutations
from cadenza.cli import main
from cadenza.errors import CadenzaError
from cadenza.evaluation.benchmark.about import About
from cadenza.evaluation.benchmark.card import CARD, actions_digest, actions_path
from cadenza.evaluation.benchmark.definition import (
    PUBLIC_SETS,
    SCENE,
    TASK,
    check_frozen,
    frozen,
    open_set,
    scene_digest,
    set_up_song,
    song_digest,
)
from cadenza.evaluation.benchmark.entry import enter
from cadenza.evaluation.benchmark.leaderboard import entries_in, leaderboard, standing
from cadenza.evaluation.benchmark.verification import BOUND, Verified, verify
from cadenza.evaluation.jobs import Contender, bench_jobs, key_of
from cadenza.evaluation.results import RESULT, RUNS
from cadenza.evaluation.run import carry_out
from cadenza.files import ANY, read_tensors, write_json, write_tensors
from cadenza.music.arrangement import Arrangement
from cadenza.music.etudes.library import HARDEST, KINDS
from cadenza.music.formats.midi import write_midi
from cadenza.music.libraries.imported import new_library
from cadenza.music.libraries.library import open_library
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import TaskConfig

MINE = "mine"
LEAP = 17  # semitones in a tenth of a second, which no hand plays without a fault
PITCHES = {"low": 60, "high": 67}
ABOUT = About(track="planning", songs=MINE, name="us", by="us", hardware="a processor")


def import_songs(pitches: dict[str, int]) -> None:
    """Imports the library `mine`, of songs of three notes."""
    with new_library(MINE, replace=True) as library:
        for name, pitch in pitches.items():
            score = Score(tuple(Note(i / 10, (i + 1) / 10, pitch + i * LEAP) for i in range(3)))
            write_midi(score, library.folder / f"{name}.mid")
            library.add(f"{name}.mid", score, {})


def played(folder: Path, task: TaskConfig = TASK, scene: SceneConfig = SCENE) -> Path:
    """A bench of the songs with two seeds, played in this process."""
    contender = Contender("planner", task, scene)
    jobs = bench_jobs(open_library(MINE), lambda _: [contender], [0, 1], Arrangement(), "none")
    for job in jobs:
        carry_out(job, folder / RUNS / job.spec.name, 1)
    return folder


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import_songs(PITCHES)
    return played(tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def made(bench: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "entry"
    enter(bench, folder, ABOUT)
    return folder


@pytest.fixture
def deep_folder(tmp_path: Path) -> Iterator[Path]:
    """A folder with so many within each other that code which calls itself for each fails."""
    folders = [tmp_path / "deep"]
    folders += [folders[0].joinpath(*["d"] * depth) for depth in range(1, 1300)]
    for folder in folders:
        folder.mkdir()
    yield folders[0]
    for folder in reversed(folders):
        folder.rmdir()


@pytest.fixture
def entry(made: Path, tmp_path: Path) -> Path:
    """An honest entry, to be forged."""
    return Path(shutil.copytree(made, tmp_path / "entry"))


def card_of(entry: Path) -> dict[str, Any]:
    card: dict[str, Any] = json.loads((entry / CARD).read_text())
    return card


def change(entry: Path, do: Callable[[dict[str, Any]], object]) -> None:
    """Changes the card."""
    card = card_of(entry)
    do(card)
    (entry / CARD).write_text(json.dumps(card))


def first_actions(entry: Path) -> Path:
    run = card_of(entry)["runs"][0]
    return actions_path(entry, run["song"], run["seed"])


def replace_actions(entry: Path, changed: Callable[[Any], Any], hashed: bool = True) -> None:
    """Changes the actions of the first run, with the hash on the card if asked to."""
    path = first_actions(entry)
    actions = changed(read(path))
    write_tensors(path, {"action": actions})
    if hashed:
        change(entry, lambda card: card["runs"][0].update(actions=actions_digest(actions)))


def read(path: Path) -> Any:
    return read_tensors(path, ANY, 2**24)[0]["action"]


def refusal(entry: Path) -> str:
    """The line with which it is refused."""
    try:
        problems = verify(entry).problems
    except CadenzaError as error:
        problems = [str(error)]
    assert problems, "it was not found out"
    assert all(problem.isprintable() for problem in problems)
    return problems[0]


# What is frozen


def test_the_scene_is_that_of_version_1() -> None:
    assert scene_digest(build_scene(SCENE)) == frozen().scene


@pytest.mark.parametrize(
    "other",
    [
        SceneConfig(physics="fast"),
        SceneConfig(reduced_action_space=False),
        SceneConfig(hand_spacing=0.31),
        SceneConfig(gravity_compensation=False),
        SceneConfig(primitive_fingertips=False),
        SceneConfig(sleeping_keys=False),
        SceneConfig(hand_collisions=False),
    ],
    ids=repr,
)
def test_another_scene_has_another_hash(other: SceneConfig) -> None:
    assert scene_digest(build_scene(other)) != frozen().scene


def test_a_key_that_is_easier_to_press_is_another_scene() -> None:
    scene = build_scene(SCENE)
    scene.model.jnt_stiffness[scene.model.jnt_stiffness > 0] *= 1.0001
    assert scene_digest(scene) != frozen().scene


@pytest.mark.parametrize("name", [name for name in PUBLIC_SETS if ":band" not in name])
def test_songs_have_the_notes_of_version_1(name: str) -> None:
    """Whoever changes a generator or a reader of files makes another benchmark."""
    for song in open_set(name).songs:
        with set_up_song(song) as setup:
            assert song_digest(setup.task.tracks[0]) == frozen().songs[song.name], song.name


@pytest.mark.parametrize("name", [name for name in PUBLIC_SETS if ":band" in name])
def test_songs_for_a_band_are_arranged_as_in_version_1(name: str) -> None:
    """The shortest of each split; the slow test has all."""
    song = min(open_set(name).songs, key=lambda song: len(song.load().notes))
    with set_up_song(song) as setup:
        assert song_digest(setup.task.tracks[0]) == frozen().songs[song.name]


@pytest.mark.slow
def test_all_songs_for_a_band_are_arranged_as_in_version_1() -> None:
    for name in PUBLIC_SETS:
        for song in open_set(name).songs if ":band" in name else ():
            with set_up_song(song) as setup:
                assert song_digest(setup.task.tracks[0]) == frozen().songs[song.name], song.name


def test_no_song_is_in_two_sets_and_splits_are_alike() -> None:
    songs = {name: [song.name for song in open_set(name).songs] for name in PUBLIC_SETS}
    everything = [song for of_set in songs.values() for song in of_set]
    assert len(everything) == len(set(everything)) == len(frozen().songs)
    sizes = {name.partition(":")[2]: len(of_set) for name, of_set in songs.items()}
    assert sizes == {"": 24, "etudes-train": 60, "etudes-valid": 20, "etudes-test": 20} | {
        "band-train": 36,
        "band-valid": 12,
        "band-test": 12,
    }
    test = [name.split("/")[1].rsplit("-", 2) for name in songs["benchmark:etudes-test"]]
    assert sorted(kind for kind, *_ in test) == sorted(KINDS * 2)
    assert sorted(int(grade) for _, grade, _ in test) == sorted([*range(1, HARDEST + 1)] * 2)


def test_a_song_of_a_public_set_with_other_notes_is_refused() -> None:
    song = replace(open_set("bundled").songs[0], read=lambda *_: Score((Note(0, 1, 60),)))
    with set_up_song(song) as setup, pytest.raises(CadenzaError, match="has other notes here"):
        check_frozen(song, setup)


@pytest.mark.parametrize("name", ["debug", "etudes:3", ".", "/etc", "mine/../mine", "nobody", ""])
def test_what_is_no_set(name: str) -> None:
    with pytest.raises(CadenzaError, match="choose from bundled"):
        open_set(name)


@pytest.mark.parametrize("name", ["bundled", "benchmark:etudes-valid"])
def test_an_imported_library_cannot_pass_for_a_public_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv("CADENZA_DATA", str(tmp_path))
    import_songs(PITCHES)
    (tmp_path / "libraries" / MINE).rename(tmp_path / "libraries" / name.partition(":")[0])
    with pytest.raises(CadenzaError, match="an imported library has its name"):
        open_set(name)


# Honest entries


def test_an_honest_entry_is_verified_to_the_bit(made: Path) -> None:
    verified = verify(made)
    assert (verified.problems, verified.exact, verified.words) == ([], True, "to the bit")
    assert len(verified.metrics) == 4
    assert all(0 < metrics["f1"] < 1 for metrics in verified.metrics.values())
    said = {(run["song"], run["seed"]): run["metrics"] for run in card_of(made)["runs"]}
    assert verified.metrics == said


def test_actions_beyond_the_range_of_a_servo_play_as_those_within(
    bench: Path, tmp_path: Path
) -> None:
    """Since an agent may return any, and the simulation limits them."""
    copy = Path(shutil.copytree(bench, tmp_path / "copy"))
    for path in copy.glob("runs/*/episode.npz"):
        with np.load(path) as file:
            arrays = dict(file)
        high = arrays["action_max"]
        arrays["action"] = np.where(arrays["action"] >= high, high + 1, arrays["action"])
        np.savez(path, **arrays)
    assert not enter(copy, tmp_path / "entry", ABOUT).problems


def test_another_engine_may_differ_a_little_but_gains_nothing(entry: Path) -> None:
    def embellish(card: dict[str, Any]) -> None:
        card["versions"]["mujoco"] = "3.18.0"
        for run in card["runs"]:
            run["metrics"]["f1"] += BOUND / 2

    honest = verify(entry).metrics
    change(entry, embellish)
    verified = verify(entry)
    assert (verified.problems, verified.exact) == ([], False)
    assert verified.metrics == honest
    change(entry, embellish)
    change(entry, embellish)
    assert "the mean of f1 is" in refusal(entry)


# Forged entries

Card = dict[str, Any]


def run_of(card: Card, number: int = 0) -> dict[str, Any]:
    run: dict[str, Any] = card["runs"][number]
    return run


FORGED_CARDS: dict[str, tuple[Callable[[Card], object], str]] = {
    "better F1": (lambda c: run_of(c)["metrics"].update(f1=0.9999), "f1 is"),
    "better onset F1": (lambda c: run_of(c, 3)["metrics"].update(note_onset_f1=0.5), "note_onset"),
    "better timing": (lambda c: run_of(c)["metrics"].update(onset_error_median=1e-6), "onset_err"),
    "better velocity": (lambda c: run_of(c)["metrics"].update(velocity_error=0.0), "velocity_err"),
    "F1 left out": (lambda c: run_of(c)["metrics"].update(f1=None), "f1 is"),
    "no such metric": (lambda c: run_of(c)["metrics"].update(taste=1.0), "metrics are not"),
    "metric missing": (lambda c: run_of(c)["metrics"].pop("f1"), "metrics are not"),
    "not finite": (lambda c: run_of(c)["metrics"].update(f1=float("nan")), "finite"),
    "song missing": (lambda c: c.update(runs=c["runs"][:2]), "is missing, as 2 of 4"),
    "seed missing": (lambda c: c["runs"].pop(), "is missing, as 1 of 4"),
    "song twice": (lambda c: run_of(c, 2).update(song=run_of(c)["song"]), "is there twice"),
    "run twice": (lambda c: c["runs"].append(run_of(c)), "is there twice"),
    "other song": (lambda c: run_of(c).update(song="OdeToJoy"), "is no run of this entry"),
    "other seed": (lambda c: run_of(c).update(seed=7), "is no run of this entry"),
    "chosen seeds": (
        lambda c: (c.update(seeds=[0, 7]), [r.update(seed=7) for r in c["runs"] if r["seed"]]),
        "leaves none out",
    ),
    "no seeds": (lambda c: c.update(seeds=[], runs=[]), "leaves none out"),
    "cut short": (lambda c: run_of(c).update(steps=9), "has 9 steps, but the song has"),
    "other notes": (lambda c: run_of(c).update(song_digest="0" * 16), "with other notes"),
    "other set": (lambda c: c.update(songs="bundled"), "is no run of this entry"),
    "folder as set": (lambda c: c.update(songs="."), "choose from bundled"),
    "no such track": (lambda c: c.update(track="telepathy"), "choose from one-song"),
    "other track": (lambda c: c.update(track="at-sight"), "belongs to the track planning"),
    "name with a space": (lambda c: c.update(track="at-sight", agent="planner "), "belongs to"),
    "other name": (
        lambda c: c.update(track="at-sight", agent="cadenza.agents.planner.planner:Planner"),
        "belongs to the track planning",
    ),
    "control characters": (lambda c: run_of(c).update(song="\x1b[2J"), "on one line"),
    "untrained": (lambda c: c.update(track="one-song", agent="m:A"), "how many steps"),
    "other version": (lambda c: c.update(benchmark=2), "Invalid"),
    "task of its own": (lambda c: c.update(task={"stretch": 4.0}), "Unknown field"),
    "negative time": (lambda c: run_of(c).update(cpu_seconds=-1.0), "negative"),
    "times beyond any sum": (
        lambda c: [run.update(cpu_seconds=1e308) for run in c["runs"]],
        "or over 1e+12",
    ),
    "steps that fill a page": (lambda c: c["effort"].update(steps=10**30), "or over 1e+12"),
    "two lines": (lambda c: c.update(name="a\nb"), "on one line"),
    "right to left": (lambda c: c.update(by="\u202e1.000"), "on one line"),
    "long name": (lambda c: c.update(name="x" * 100), "characters"),
    "large options": (lambda c: c.update(options={"x": "y" * 5000}), "4000"),
}


@pytest.mark.parametrize("forgery", FORGED_CARDS)
def test_a_forged_card_is_refused(entry: Path, forgery: str) -> None:
    forge, why = FORGED_CARDS[forgery]
    change(entry, forge)
    assert why in refusal(entry)


FORGED_ACTIONS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "others": (np.zeros_like, "is"),
    "not a number": (lambda a: np.where(a == a[0, 0], np.nan, a), "not finite"),
    "beyond the servos": (lambda a: a + 5.0, "is out of the servo's range"),
    "cut short": (lambda a: a[:-1], "of shape"),
    "too long": (lambda a: np.concatenate([a, a]), "needs no more"),
    "too narrow": (lambda a: a[:, :-1], "of shape"),
    "single precision": (np.float32, "float32; actions are float64"),
    "whole numbers": (lambda a: np.zeros(a.shape, np.int64), "expected floating-point"),
}


@pytest.mark.parametrize("forgery", FORGED_ACTIONS)
def test_forged_actions_are_refused_even_with_their_hash(entry: Path, forgery: str) -> None:
    forge, why = FORGED_ACTIONS[forgery]
    replace_actions(entry, forge)
    assert why in refusal(entry)


def test_a_single_other_bit_is_found_out(entry: Path) -> None:
    replace_actions(entry, lambda a: np.nextafter(a, 0), hashed=False)
    assert "holds other actions than the card says" in refusal(entry)


def test_actions_of_an_easier_song_are_refused(entry: Path) -> None:
    """Both songs are as long, so that only what is heard tells them apart."""
    card = card_of(entry)
    one, other = (next(r for r in card["runs"] if name in r["song"]) for name in PITCHES)
    paths = [actions_path(entry, run["song"], run["seed"]) for run in (one, other)]
    shutil.copy(*paths)
    other |= {name: one[name] for name in ("actions", "metrics")}
    (entry / CARD).write_text(json.dumps(card))
    assert ": f1 is" in refusal(entry)


@pytest.mark.parametrize("forgery", ["link to actions", "link to a folder", "link to a card"])
def test_links_are_refused(entry: Path, tmp_path: Path, forgery: str) -> None:
    path = {"link to actions": first_actions(entry), "link to a folder": entry / "actions"}
    linked = path.get(forgery, entry / CARD)
    os.symlink(linked.rename(tmp_path / "elsewhere"), linked)
    assert "is a link" in refusal(entry)


def test_files_that_belong_to_no_entry_are_refused(entry: Path) -> None:
    (entry / "actions" / "more.safetensors").write_bytes(b"")
    assert "does not belong to an entry" in refusal(entry)


def test_a_file_that_is_missing_is_named(entry: Path) -> None:
    first_actions(entry).unlink()
    assert "is missing" in refusal(entry)


@pytest.mark.parametrize("large", ["card", "actions"])
def test_files_of_any_size_are_refused_at_once(entry: Path, large: str) -> None:
    path = entry / CARD if large == "card" else first_actions(entry)
    with path.open("r+b") as file:
        file.truncate(2**40)  # a terabyte of nothing
    assert "bytes, but such a file needs no more" in refusal(entry)


def test_a_pipe_is_refused(entry: Path) -> None:
    path = first_actions(entry)
    path.unlink()
    os.mkfifo(path)
    assert "cannot be read" in refusal(entry)


def test_a_song_that_is_another_one_here_is_named(entry: Path) -> None:
    import_songs({"low": 60, "high": 65})
    try:
        assert "was recorded with other notes" in refusal(entry)
    finally:
        import_songs(PITCHES)


@pytest.mark.parametrize("seed", range(30))
def test_whatever_is_wrong_is_refused_or_changes_no_figure(entry: Path, seed: int) -> None:
    honest, rng = verify(entry).metrics if not seed else None, np.random.default_rng(seed)
    if seed % 3:
        (entry / CARD).write_bytes(mutations.json_bytes(mutations.other_json(rng, card_of(entry))))
    else:
        path = first_actions(entry)
        arrays = mutations.other_arrays(rng, {"action": read(path)})
        path.write_bytes(mutations.tensor_bytes(arrays))
    with mutations.at_most_refused():
        found = verify(entry)
        said = card_of(entry)["runs"]
        assert found.problems or all(
            found.metrics[run["song"], run["seed"]] == run["metrics"] for run in said
        )
        assert honest is None or found.problems or found.metrics == honest


def test_a_card_that_says_two_things_is_refused(entry: Path) -> None:
    """Since readers of JSON differ in which one they take."""
    path = entry / CARD
    path.write_text(path.read_text().replace('"track":', '"track": "at-sight", "track":', 1))
    assert "has a name twice" in refusal(entry)


# Entries of runs in another task


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize(
    ("task", "scene", "why"),
    [
        (replace(TASK, stretch=2.0), SCENE, "with stretch 2.0"),
        (replace(TASK, control_timestep=0.1), SCENE, "with control-timestep 0.1"),
        (replace(TASK, repeats="published"), SCENE, "give --repeats shortened"),
        (TASK, replace(SCENE, physics="fast"), "with physics fast"),
        (TASK, replace(SCENE, sleeping_keys=False), "with sleeping-keys False"),
    ],
    ids=str,
)
def test_runs_in_another_task_are_no_entry(
    tmp_path: Path, task: TaskConfig, scene: SceneConfig, why: str
) -> None:
    with pytest.raises(CadenzaError, match=why):
        enter(played(tmp_path / "bench", task, scene), tmp_path / "entry", ABOUT)
    assert not (tmp_path / "entry").exists()


@pytest.mark.usefixtures("bench")
def test_runs_that_hide_their_scene_are_found_out(tmp_path: Path) -> None:
    folder = played(tmp_path / "bench", scene=replace(SCENE, physics="fast"))
    for path in folder.glob(f"{RUNS}/*/{RESULT}"):
        result = json.loads(path.read_text())
        result["job"]["scene"]["physics"] = "published"
        write_json(path, result)
        name = path.parent.name.rpartition("--")[0]
        path.parent.rename(path.parent.with_name(f"{name}--{key_of(result['job'])}"))
    with pytest.raises(CadenzaError, match="does not play as it was recorded"):
        enter(folder, tmp_path / "entry", ABOUT)


def test_runs_of_several_agents_or_with_one_missing(bench: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(bench, tmp_path / "bench"))
    with pytest.raises(CadenzaError, match=r"were played by planner; name one"):
        enter(copy, tmp_path / "entry", replace(ABOUT, agent="zero"))
    shutil.rmtree(next((copy / RUNS).iterdir()))
    with pytest.raises(CadenzaError, match="is missing, as 1 of 4 runs"):
        enter(copy, tmp_path / "entry", ABOUT)


@pytest.mark.usefixtures("bench")
def test_an_agent_observes_the_same_in_all_songs(tmp_path: Path) -> None:
    """Or else a card could say that nobody gave it fingers, which were given in some songs."""
    bench = played(tmp_path / "bench", replace(TASK, fingering="robot"))
    for path in bench.glob(f"{RUNS}/{MINE}-high--*"):
        shutil.rmtree(path)
    played(tmp_path / "other")
    for path in (tmp_path / "other").glob(f"{RUNS}/{MINE}-high--*"):
        path.rename(bench / RUNS / path.name)
    with pytest.raises(CadenzaError, match="has other options than in other runs"):
        enter(bench, tmp_path / "entry", ABOUT)


# The table


def test_the_table_has_what_was_computed_and_says_what_was_not(made: Path, tmp_path: Path) -> None:
    for name in "a", "b", "c":
        shutil.copytree(made, tmp_path / "entries" / name)
    change(tmp_path / "entries" / "b", lambda c: run_of(c)["metrics"].update(f1=1.5))
    (tmp_path / "entries" / "d").mkdir()
    (tmp_path / "entries" / "d" / CARD).write_text("{}")
    rows = leaderboard([standing(folder) for folder in entries_in([tmp_path / "entries"])])
    verified = {Path(row["folder"]).name: row["verified"] for row in rows}
    assert verified["a"] == verified["c"] == "to the bit; plays every song as another entry does"
    assert "f1 is" in verified["b"]
    assert verified["b"].startswith("no: ")
    assert verified["d"].startswith("no: ")
    figures = {Path(row["folder"]).name: row["f1"] for row in rows}
    assert figures["c"] > 0
    assert np.isnan([figures["b"], figures["d"]]).all()


def test_folders_without_end_end_no_leaderboard(deep_folder: Path, made: Path) -> None:
    with pytest.raises(CadenzaError, match="deep: holds no entry"):
        entries_in([deep_folder])
    shutil.copytree(made, deep_folder.parent / "entry")
    assert entries_in([deep_folder.parent]) == [deep_folder.parent / "entry"]


@pytest.mark.parametrize("error", [RecursionError("too deep"), MemoryError(), ValueError("digits")])
def test_no_entry_ends_a_leaderboard_whatever_it_causes(
    entry: Path, made: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(folder: Path) -> Verified:
        if folder == entry:
            raise error
        return verify(folder)

    monkeypatch.setattr("cadenza.evaluation.benchmark.leaderboard.verify", fail)
    wrong, right = standing(entry), standing(made)
    assert wrong.why.startswith(f"{entry}: ")
    assert type(error).__name__ in wrong.why
    assert right.verified is not None


def test_a_copy_is_marked_whatever_bits_were_changed(entry: Path, made: Path) -> None:
    replace_actions(entry, lambda actions: np.nextafter(actions, 0.0))
    change(entry, lambda c: c["versions"].update(mujoco="3.16.0"))
    rows = leaderboard([standing(made), standing(entry)])
    assert all(row["verified"].endswith("; plays every song as another entry does") for row in rows)


def test_nobody_passes_for_a_copy_by_the_card_of_another(made: Path, tmp_path: Path) -> None:
    """A card alone, with the hashes of what others played, says nothing about these others."""
    (tmp_path / "card").mkdir()
    shutil.copy(made / CARD, tmp_path / "card")
    rows = leaderboard([standing(made), standing(tmp_path / "card")])
    assert [row["verified"][:10] for row in rows] == ["to the bit", "no: " + str(tmp_path)[:6]]
    assert "another" not in rows[0]["verified"]


def test_actions_of_one_seed_given_out_as_those_of_five_are_marked(
    entry: Path, tmp_path: Path
) -> None:
    one, five = (Path(shutil.copytree(entry, tmp_path / name)) for name in ("one", "five"))
    for folder, seeds in (one, [0]), (five, list(range(5))):
        runs = [run for run in card_of(folder)["runs"] if run["seed"] == 0]
        for seed in range(1, 5):
            for run in runs:
                path = actions_path(folder, run["song"], seed)
                path.unlink(missing_ok=True)
                if seed in seeds:
                    shutil.copy(actions_path(folder, run["song"], 0), path)
        copies = [run | {"seed": seed} for run in runs for seed in seeds]
        change(folder, lambda c, copies=copies, seeds=seeds: c.update(runs=copies, seeds=seeds))
    rows = leaderboard([standing(one), standing(five)])
    assert [row["verified"] for row in rows] == [
        "to the bit; plays every song as another entry does"
    ] * 2
    assert all(np.isnan(row["f1_low"]) for row in rows)


def test_entries_are_found_however_deep(made: Path, tmp_path: Path) -> None:
    """As in a folder of clones, each with an entry beside files of its own."""
    deep = Path(shutil.copytree(made, tmp_path / "others" / "ada" / "entry"))
    (deep.parent / ".git").mkdir()
    near = Path(shutil.copytree(made, tmp_path / "others" / "bob"))
    assert entries_in([tmp_path / "others"]) == [deep, near]


@pytest.mark.parametrize("command", ["verify", "leaderboard"])
def test_a_folder_without_an_entry_is_named(
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="1"):
        main([command, "missing"])
    assert "missing: holds no entry" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [b"\x1b[2J", b"\xff"])
def test_names_of_files_do_nothing_to_a_terminal(
    entry: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: bytes
) -> None:
    renamed = entry.rename(tmp_path / os.fsdecode(name))
    (renamed / os.fsdecode(name)).write_bytes(b"")
    main(["leaderboard", str(renamed), "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit, match="1"):
        main(["verify", str(renamed)])
    said = capsys.readouterr()
    assert "does not belong to an entry" in said.out
    assert all(line.isprintable() for line in (said.out + said.err).splitlines())
    assert said.err.count("\n") == 1
    table = (tmp_path / "out" / "leaderboard.csv").read_text()
    assert all(line.isprintable() for line in table.splitlines())


def test_the_files_of_the_table_take_text_as_text(
    entry: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change(entry, lambda c: c.update(name="a|b <script>alert(1)</script>", by="=1+1"))
    change(entry, lambda c: c.update(data="\uff1d1+1"))  # as wide as Chinese, and a formula there
    change(entry, lambda c: c["effort"].update(cpu_hours=-0.0))
    main(["leaderboard", str(entry), "-o", str(tmp_path / "out")])
    page = (tmp_path / "out" / "index.html").read_text()
    assert "<script>" not in page
    text = (tmp_path / "out" / "leaderboard.md").read_text()
    assert "a\\|b \\<script\\>" in text
    assert "-0.0" not in text
    assert text in capsys.readouterr().out
    (row,) = (tmp_path / "out" / "leaderboard.csv").read_text().splitlines()[1:]
    assert "a|b" in row
    assert "'=1+1" in row
    assert "'\uff1d1+1" in row


# The command line


def test_a_person_enters_and_verifies(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = str(tmp_path / "entry")
    chosen = ["--songs", MINE, "--track", "planning", "--by", "me", "-o", entry]
    main(["enter", str(bench), *chosen])
    main(["verify", entry])
    assert capsys.readouterr().out.count("verified to the bit") == 2
    change(Path(entry), lambda c: run_of(c)["metrics"].update(f1=1.0))
    with pytest.raises(SystemExit, match="1"):
        main(["verify", entry])
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n"), said.err[:9]) == ("", 1, "refused: ")


def test_the_list_names_all_tracks_and_sets(capsys: pytest.CaptureFixture[str]) -> None:
    main(["benchmark"])
    said = capsys.readouterr().out
    assert all(name in said for name in (*PUBLIC_SETS, "one-song", "at-sight", "planning"))
