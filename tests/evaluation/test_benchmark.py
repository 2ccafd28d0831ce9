"""The benchmark: what is frozen, and that forged entries are found out."""

import csv
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mutations
from cadenza.agents.planner.config import PlannerConfig
from cadenza.cli import main
from cadenza.errors import CadenzaError
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
from cadenza.evaluation.benchmark.entering import enter
from cadenza.evaluation.benchmark.entry import ACTIONS, ENTRY, actions_path
from cadenza.evaluation.benchmark.leaderboard import row_of, write_leaderboard
from cadenza.evaluation.benchmark.verification import PlayedAgain, verify
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
from refusals import refused

OWN = "mine"
QUICK = PlannerConfig(num_candidates=4, iterations=1)
LEAP = 17  # semitones in a tenth of a second, which no hand plays without a fault
PITCHES = {"low": 60, "high": 67}
ABOUT = {"songs": OWN, "track": "planning", "about": "learnt from nothing", "by": "us"}
NESTED = 1300  # folders, or lists: deeper than Python calls functions


def import_songs(pitches: dict[str, int]) -> None:
    """Import the library `mine`, of songs of three notes."""
    with new_library(OWN, replace=True) as library:
        for name, pitch in pitches.items():
            score = Score(tuple(Note(i / 10, (i + 1) / 10, pitch + i * LEAP) for i in range(3)))
            write_midi(score, library.folder / f"{name}.mid")
            library.add(f"{name}.mid", score, {})


def played(folder: Path, scene: SceneConfig = SCENE, agent: str = "planner") -> Path:
    """A bench of the songs with two seeds, played in this process."""
    config = QUICK if agent == "planner" else None
    contender = Contender(agent, TASK, scene, config)
    jobs = bench_jobs(open_library(OWN), lambda _: [contender], [0, 1], Arrangement(), "none")
    for job in jobs:
        carry_out(job, folder / RUNS / job.spec.name, 1)
    return folder


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:  # no other test finds the songs
        patch.setenv("CADENZA_DATA", str(tmp_path_factory.mktemp("data")))
        import_songs(PITCHES)
        yield played(tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def made(bench, tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "entry"
    enter(bench, folder, **ABOUT)
    return folder


@pytest.fixture
def entry(made, tmp_path):
    """An honest entry, to be forged."""
    return Path(shutil.copytree(made, tmp_path / "entry"))


def content_of(entry: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((entry / ENTRY).read_text())
    return content


def first_actions(entry: Path) -> Path:
    run = content_of(entry)["runs"][0]
    return actions_path(entry, run["song"], run["seed"])


def read(path: Path) -> Any:
    return read_tensors(path, ANY, 2**24)[0]["action"]


# What is frozen


def test_the_scene_is_that_of_version_1():
    assert scene_digest(build_scene(SCENE)) == frozen().scene


@pytest.mark.parametrize(
    "other",
    [
        SceneConfig(physics="fast"),
        SceneConfig(reduced_action_space=False),
        SceneConfig(gravity_compensation=False),
    ],
    ids=repr,
)
def test_another_scene_has_another_hash(other):
    assert scene_digest(build_scene(other)) != frozen().scene


def test_a_key_that_is_easier_to_press_is_another_scene():
    scene = build_scene(SCENE)
    scene.model.jnt_stiffness[scene.model.jnt_stiffness > 0] *= 1.0001
    assert scene_digest(scene) != frozen().scene


SLOW = "benchmark:etudes-train", "benchmark:band-train"  # others are of the same kinds


def sets(kind: Callable[[str], bool]) -> list[Any]:
    marks = {True: [pytest.mark.slow], False: []}
    return [pytest.param(name, marks=marks[name in SLOW]) for name in PUBLIC_SETS if kind(name)]


@pytest.mark.parametrize("name", sets(lambda name: ":band" not in name))
def test_songs_have_the_notes_of_version_1(name):
    """Whoever changes a generator or a reader of files makes another benchmark."""
    for song in open_set(name).songs:
        with set_up_song(song) as setup:
            assert song_digest(setup.task.tracks[0]) == frozen().songs[song.name], song.name


@pytest.mark.parametrize("name", sets(lambda name: ":band" in name))
def test_songs_for_a_band_are_arranged_as_in_version_1(name):
    """The shortest of each split; the slow test has all."""
    song = min(open_set(name).songs, key=lambda song: len(song.load().notes))
    with set_up_song(song) as setup:
        assert song_digest(setup.task.tracks[0]) == frozen().songs[song.name]


@pytest.mark.slow
def test_all_songs_for_a_band_are_arranged_as_in_version_1():
    for name in PUBLIC_SETS:
        for song in open_set(name).songs if ":band" in name else ():
            with set_up_song(song) as setup:
                assert song_digest(setup.task.tracks[0]) == frozen().songs[song.name], song.name


def test_no_song_is_in_two_sets_and_splits_are_alike():
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


def test_a_song_of_a_public_set_with_other_notes_is_refused():
    song = replace(open_set("bundled").songs[0], read=lambda *_: Score((Note(0, 1, 60),)))
    with set_up_song(song) as setup, pytest.raises(CadenzaError, match="has other notes here"):
        check_frozen(song, setup)


@pytest.mark.parametrize("name", ["debug", "etudes:3", ".", "/etc", "mine/../mine", "nobody", ""])
def test_what_is_no_set(name):
    with pytest.raises(CadenzaError, match="choose from bundled"):
        open_set(name)


@pytest.mark.parametrize("name", ["bundled", "benchmark:etudes-valid"])
def test_an_imported_library_cannot_pass_for_a_public_set(tmp_path, monkeypatch, name):
    monkeypatch.setenv("CADENZA_DATA", str(tmp_path))
    import_songs(PITCHES)
    (tmp_path / "libraries" / OWN).rename(tmp_path / "libraries" / name.partition(":")[0])
    with pytest.raises(CadenzaError, match="an imported library has its name"):
        open_set(name)


# Honest entries


def test_an_honest_entry_is_verified_to_the_bit(made):
    played = verify(made)
    assert played.differences == []
    assert len(played.metrics) == 4
    assert all(0 < metrics["f1"] < 1 for metrics in played.metrics.values())
    assert played.metrics == {
        (r["song"], r["seed"]): r["metrics"] for r in content_of(made)["runs"]
    }


def test_actions_beyond_the_range_of_a_servo_play_as_those_within(bench, tmp_path):
    """Since an agent may return any, and the simulation limits them."""
    copy = Path(shutil.copytree(bench, tmp_path / "copy"))
    for path in copy.glob("runs/*/episode.npz"):
        with np.load(path) as file:
            arrays = dict(file)
        high = arrays["action_max"]
        arrays["action"] = np.where(arrays["action"] >= high, high + 1, arrays["action"])
        np.savez(path, **arrays)
    assert not enter(copy, tmp_path / "entry", **ABOUT).differences


# Forged entries

Forge = Callable[[Path], object]


def says(do: Callable[[dict[str, Any]], object]) -> Forge:
    """Changes what an entry says."""

    def forge(entry: Path) -> None:
        content = content_of(entry)
        do(content)
        (entry / ENTRY).write_text(json.dumps(content))

    return forge


def run_says(number: int = 0, **changed: Any) -> Forge:
    return says(lambda entry: entry["runs"][number].update(changed))


def metric(name: str, value: float | None, number: int = 0) -> Forge:
    return says(lambda entry: entry["runs"][number]["metrics"].update({name: value}))


def acts(changed: Callable[[Any], Any]) -> Forge:
    """Changes the actions of the first run."""
    return lambda e: write_tensors(first_actions(e), {"action": changed(read(first_actions(e)))})


def moved(name: str) -> Forge:
    """A link takes the place of a file or a folder, which lies elsewhere."""

    def forge(entry: Path) -> None:
        path = next(entry.rglob(name))
        os.symlink(path.rename(entry.parent / "elsewhere"), path)

    return forge


def grown(name: str) -> Forge:
    """A file takes a terabyte of nothing."""
    return lambda entry: os.truncate(next(entry.rglob(name)), 2**40)


def piped(entry: Path) -> None:
    first_actions(entry).unlink()
    os.mkfifo(first_actions(entry))


def easier_song(entry: Path) -> None:
    """Both songs are as long, so that only what is heard tells them apart."""
    content = content_of(entry)
    one, other = (next(r for r in content["runs"] if name in r["song"]) for name in PITCHES)
    shutil.copy(*(actions_path(entry, run["song"], run["seed"]) for run in (one, other)))
    other["metrics"] = one["metrics"]
    (entry / ENTRY).write_text(json.dumps(content))


def another_engine(entry: Path) -> None:
    says(lambda content: content["versions"].update(mujoco="warp 9"))(entry)
    metric("f1", content_of(entry)["runs"][0]["metrics"]["f1"] + 0.001)(entry)


def with_a_name_twice(entry: Path) -> None:
    """Since readers of JSON differ in which one they take."""
    text = (entry / ENTRY).read_text()
    (entry / ENTRY).write_text(text.replace('"track":', '"track": "at-sight", "track":', 1))


TENSORS = "*.safetensors"
PLANNER = "cadenza.agents.planner.planner:Planner"
FORGERIES: list[tuple[str, Forge, str]] = [
    # Metrics
    ("better F1", metric("f1", 0.9999), "f1 is"),
    ("better onset F1", metric("note_onset_f1", 0.5, 3), "note_onset_f1 is"),
    ("metric missing", says(lambda s: s["runs"][0]["metrics"].pop("f1")), "metrics are not"),
    ("not finite", metric("f1", float("nan")), "finite"),
    # Runs
    ("song missing", says(lambda s: s.update(runs=s["runs"][:2])), "seed 0: is missing"),
    ("other song", run_says(song="OdeToJoy"), "OdeToJoy: is no song of mine"),
    ("chosen seeds", says(lambda s: [r.update(seed=r["seed"] * 7) for r in s["runs"]]), "leaves"),
    ("other notes", run_says(song_digest="0" * 16), "with other notes"),
    ("other set", says(lambda s: s.update(songs="bundled")), "is missing"),
    ("easier song", easier_song, ": f1 is"),
    # The agent
    ("no such track", says(lambda s: s.update(track="telepathy")), "choose from one-song"),
    ("other track", says(lambda s: s.update(track="at-sight")), "belongs to the track planning"),
    ("other name", says(lambda s: s.update(track="at-sight", agent=PLANNER)), "belongs to"),
    # What else an entry says
    ("other version", says(lambda s: s.update(benchmark=2)), "Invalid"),
    ("task of its own", says(lambda s: s.update(task={"stretch": 4.0})), "Unknown field"),
    ("negative time", run_says(cpu_seconds=-1.0), "CPU time is not"),
    ("two lines", says(lambda s: s.update(name="a\nb")), "on one line"),
    ("long name", says(lambda s: s.update(name="x" * 1000)), "characters"),
    ("two tracks", with_a_name_twice, "has a name twice"),
    ("nested", lambda e: (e / ENTRY).write_text("[" * NESTED + "]" * NESTED), "not JSON"),
    # Actions
    ("other actions", acts(np.zeros_like), " is "),
    ("not a number", acts(lambda a: np.where(a == a[0, 0], np.nan, a)), "not finite"),
    ("beyond the servos", acts(lambda a: a + 5.0), "is out of the servo's range"),
    ("cut short", acts(lambda a: a[:-1]), "of shape"),
    ("too long", acts(lambda a: np.concatenate([a, a])), "needs no more"),
    ("whole numbers", acts(lambda a: np.zeros(a.shape, np.int64)), "expected floating-point"),
    # Files
    ("linked actions", moved(TENSORS), "is a link"),
    ("linked entry", moved(ENTRY), "is a link"),
    ("more files", lambda e: (e / ACTIONS / "more").write_bytes(b""), "does not belong"),
    ("no actions", lambda e: first_actions(e).unlink(), "is missing"),
    ("nothing", shutil.rmtree, "there is no such file"),
    ("a pipe", piped, "cannot be read"),
    ("huge actions", grown(TENSORS), "needs no more"),
]


@pytest.mark.parametrize(
    ("forge", "why"), [forgery[1:] for forgery in FORGERIES], ids=[name for name, *_ in FORGERIES]
)
def test_a_forged_entry_is_not_verified(entry, forge, why):
    forge(entry)
    try:
        (reason, *_) = verify(entry).differences
    except CadenzaError as error:
        reason = str(error)
    assert why in reason
    assert reason.isprintable()


@pytest.mark.parametrize("seed", range(9))
def test_whatever_is_wrong_is_refused_or_changes_no_metric(entry, seed):
    rng = np.random.default_rng(seed)
    if seed % 3:
        content = mutations.json_bytes(mutations.other_json(rng, content_of(entry)))
        (entry / ENTRY).write_bytes(content)
    else:
        path = first_actions(entry)
        arrays = mutations.other_arrays(rng, {"action": read(path)})
        path.write_bytes(mutations.tensor_bytes(arrays))
    with mutations.at_most_refused():
        played = verify(entry)
        facts = {(run["song"], run["seed"]): run["metrics"] for run in content_of(entry)["runs"]}
        assert played.differences or played.metrics == facts


# Entries of runs in another task


def rewritten(bench: Path, copy: Path, songs: str, do: Callable[[dict[str, Any]], object]) -> Path:
    """A copy of a bench in which runs of songs say something else of what was asked for."""
    shutil.copytree(bench, copy)
    for path in copy.glob(f"{RUNS}/{songs}/{RESULT}"):
        result = json.loads(path.read_text())
        do(result["job"])
        write_json(path, result)
        name = path.parent.name.rpartition("--")[0]
        path.parent.rename(path.parent.with_name(f"{name}--{key_of(result['job'])}"))
    return copy


@pytest.mark.parametrize(
    ("part", "option", "value", "why"),
    [
        ("task", "stretch", 2.0, "with stretch 2.0"),
        ("task", "repeats", "published", "give --repeats shortened"),
        ("scene", "physics", "fast", "with physics fast"),
    ],
)
def test_runs_in_another_task_are_no_entry(bench, tmp_path, part, option, value, why):
    copy = rewritten(bench, tmp_path / "bench", "*", lambda job: job[part].update({option: value}))
    with pytest.raises(CadenzaError, match=why):
        enter(copy, tmp_path / "entry", **ABOUT)
    assert not (tmp_path / "entry").exists()


@pytest.mark.usefixtures("bench")
def test_runs_that_hide_their_scene_are_found_out(tmp_path):
    published = json.loads(json.dumps(asdict(SCENE)))
    fast = played(tmp_path / "fast", replace(SCENE, physics="fast"), "random")
    hidden = rewritten(fast, tmp_path / "b", "*", lambda job: job.update(scene=published))
    with pytest.raises(CadenzaError, match="does not play as it was recorded"):
        enter(hidden, tmp_path / "entry", **ABOUT)


def test_runs_of_several_agents_or_with_one_missing(bench, tmp_path):
    copy = Path(shutil.copytree(bench, tmp_path / "bench"))
    with pytest.raises(CadenzaError, match=r"were played by planner; name one"):
        enter(copy, tmp_path / "entry", **ABOUT, agent="zero")
    shutil.rmtree(next((copy / RUNS).iterdir()))
    with pytest.raises(CadenzaError, match="is missing"):
        enter(copy, tmp_path / "entry", **ABOUT)


def test_an_agent_observes_the_same_in_all_songs(bench, tmp_path):
    """Or else an entry could say that nobody gave it fingers, which were given in some songs."""
    hides = {"fingering": "robot"}
    copy = rewritten(bench, tmp_path / "b", f"{OWN}-high--*", lambda job: job["task"].update(hides))
    with pytest.raises(CadenzaError, match="has other options than in other runs"):
        enter(copy, tmp_path / "entry", **ABOUT)


# The table


def table_of(folder: Path, *entries: Path) -> tuple[list[dict[str, str]], str]:
    """The rows of the CSV file that `cadenza leaderboard` writes, and the Markdown."""
    main(["leaderboard", *map(str, entries), "-o", str(folder)])
    text = (folder / "leaderboard.csv").read_text()
    return list(csv.DictReader(text.splitlines())), (folder / "leaderboard.md").read_text()


def test_what_is_not_computed_to_the_bit_is_ranked_as_unverified(made, entry, tmp_path):
    """Below all that is, with metrics that were computed here, whatever engine it names."""
    another_engine(entry)
    says(lambda content: content.update(name="A warp"))(entry)
    rows, text = table_of(tmp_path / "out", entry, made)
    assert [row["status"] for row in rows] == ["verified", "unverified"]
    assert rows[0]["f1"] == rows[1]["f1"] != ""
    assert "f1 is" in rows[1]["why"]
    assert [line.split(" | ")[:2] for line in text.splitlines()[4:6]] == [
        ["| verified", "planner"],
        ["| unverified", "A warp"],
    ]


def test_whole_notes_rank_entries_and_f1_those_that_are_equal(made, tmp_path):
    row = row_of(made)
    scores = {"frames": (0.9, 0.99), "notes": (0.95, 0.9), "both": (0.95, 0.91)}
    rows = [
        row | {"name": name, "note_onset_f1": onsets, "f1": f1}
        for name, (onsets, f1) in scores.items()
    ]
    table, _ = write_leaderboard(tmp_path, rows)
    names = [row["name"] for row in csv.DictReader(table.read_text().splitlines())]
    assert names == ["both", "notes", "frames"]


@pytest.fixture
def deep(tmp_path, monkeypatch):
    """A folder in a folder, and so on, deeper than Python calls functions."""
    monkeypatch.chdir(tmp_path)
    for _ in range(NESTED):
        os.mkdir("deep")
        os.chdir("deep")
    os.chdir(tmp_path)
    yield tmp_path / "deep"
    subprocess.run(["rm", "-r", tmp_path / "deep"], check=True)  # which shutil.rmtree cannot


def test_one_bad_entry_does_not_end_the_table(made, deep, tmp_path, monkeypatch):
    def verify_or_fail(folder: Path) -> PlayedAgain:
        if folder.name == "strange":
            raise ZeroDivisionError("which nobody has thought of")
        return verify(folder)

    monkeypatch.setattr("cadenza.evaluation.benchmark.leaderboard.verify", verify_or_fail)
    entries = tmp_path / "entries"
    for name in "good", "strange":
        shutil.copytree(made, entries / name)
    (entries / "empty").mkdir()
    (entries / "empty" / ENTRY).write_text("{}")
    rows, _ = table_of(tmp_path / "out", deep, entries)
    status = {row["folder"]: row["status"] for row in rows}
    bad = ("deep", "empty", "strange")
    assert status == {"good": "verified", **dict.fromkeys(bad, "refused")}
    assert [row["f1"] != "" for row in rows] == [row["folder"] == "good" for row in rows]
    why = " ".join(row["why"] for row in rows)
    assert "there is no such file" in why
    assert "ZeroDivisionError: which nobody has thought of" in why


@pytest.mark.parametrize("name", [b"\x1b[2J", b"\xff"])
def test_names_of_files_do_nothing_to_a_terminal(entry, tmp_path, capsys, name):
    renamed = entry.rename(tmp_path / os.fsdecode(name))
    (renamed / os.fsdecode(name)).write_bytes(b"")
    rows, _ = table_of(tmp_path / "out", renamed)
    with pytest.raises(SystemExit, match="1"):
        main(["verify", str(renamed)])
    output = capsys.readouterr()
    assert "does not belong to an entry" in output.out
    assert all(line.isprintable() for line in (output.out + output.err).splitlines())
    assert output.err.count("\n") == 1
    assert all(cell.isprintable() for row in rows for cell in row.values())


def test_the_files_of_the_table_take_text_as_text(entry, tmp_path):
    """Also in a spreadsheet that splits lines at semicolons, where quotation marks do not help."""
    says(lambda s: s.update(name="a|b <script>;=1+1", by='=1+1;"=1+1"', about="\uff1d1+1"))(entry)
    (row,), text = table_of(tmp_path / "out", entry)
    assert (row["name"], row["by"]) == ("a|b <script>,=1+1", '\'=1+1,"=1+1"')
    assert row["about"] == "'\uff1d1+1"  # as wide as Chinese, and a formula there
    assert ";" not in (tmp_path / "out" / "leaderboard.csv").read_text()
    assert "a\\|b \\<script\\>" in text


# The command line


def test_a_person_enters_and_verifies(bench, tmp_path, capsys):
    entry = str(tmp_path / "entry")
    chosen = ["--songs", OWN, "--track", "planning", "--about", "nothing", "-o", entry]
    main(["enter", str(bench), *chosen])
    main(["verify", entry])
    verified = ": verified, planner in planning on mine, 4 runs: note onset F1 "
    assert capsys.readouterr().out.count(verified) == 2
    metric("f1", 1.0)(Path(entry))
    with pytest.raises(SystemExit, match="1"):
        main(["verify", entry])
    output = capsys.readouterr()
    assert output.out.startswith(f"{entry}: unverified, ")
    assert output.err.startswith("unverified: ")
    assert output.err.count("\n") == 1


def test_a_folder_that_is_not_there_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert "missing: there is no such folder" in refused(capsys, "leaderboard", "missing")
    assert not list(tmp_path.iterdir())


def test_the_list_names_all_tracks_and_sets(capsys):
    main(["benchmark"])
    output = capsys.readouterr().out
    assert all(name in output for name in (*PUBLIC_SETS, "one-song", "at-sight", "planning"))
