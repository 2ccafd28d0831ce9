"""The summary of a bench, against figures worked out by hand and plain loops."""

import csv
import math
import statistics
from pathlib import Path

import numpy as np
import pytest

from cadenza.errors import CadenzaError
from cadenza.evaluation.results import read_results
from cadenza.evaluation.summary import (
    METRICS,
    SHARES,
    WRONG_NOTES,
    BenchSummary,
    summarize,
    wrong_notes,
)
from cadenza.evaluation.tables import write_tables
from evaluation.made_up import result, write_bench, write_result


def write(bench: Path, f1: dict[tuple[str, str, int], float], **song: str) -> None:
    """A run each of (piece, agent, seed)."""
    for (piece, agent, seed), value in f1.items():
        content = result(piece, agent, seed, {"f1": value}, **song)
        write_result(bench, f"{piece}-{Path(agent).name}-{seed}", content)


def summary_of(bench: Path) -> BenchSummary:
    return summarize(read_results(bench), "made up")


def caveats(bench: Path) -> dict[str, list[str]]:
    return {line: list(cases) for line, cases in summary_of(bench).caveats}


DIFFER = "Versions, settings or notes differ from run to run."
TWO_AGENTS = {
    ("a", "good", 0): 0.9, ("a", "good", 1): 0.7, ("b", "good", 0): 0.5, ("b", "good", 1): 0.5,
    ("a", "bad", 0): 0.3, ("a", "bad", 1): 0.2, ("b", "bad", 0): 0.1, ("b", "bad", 1): 0.0,
}  # fmt: skip


def test_figures_worked_out_by_hand(tmp_path):
    write(tmp_path, TWO_AGENTS)
    summary = summary_of(tmp_path)
    assert summary.agents == ["good", "bad"]
    assert [piece.name for piece in summary.pieces] == ["a", "b"]
    (group,) = summary.groups
    good = group.agents["good"]
    assert (group.name, good.pieces, good.runs) == ("made-up", 2, 4)
    assert good.mean["f1"].value == pytest.approx(0.65)
    # A quarter of the samples have piece a alone, a quarter b alone.
    assert good.mean["f1"].low == pytest.approx(0.5)
    assert 0.8 <= good.mean["f1"].high <= 0.9
    # On a by 0.55, on b by 0.45; each sample has the same pieces of both.
    difference = group.differences["bad"]["f1"]
    assert difference.value == pytest.approx(-0.5)
    assert -0.7 <= difference.low <= -0.55
    assert -0.45 <= difference.high <= -0.35
    assert list(group.differences) == ["bad"]
    value, low, high = (part[0] for part in summary.by_piece["f1"])
    assert value == pytest.approx([0.8, 0.5])
    # Student's t of one degree of freedom is 12.7: from below 0 to above 1, where no F1 can be.
    assert (low[0], high[0]) == (0, 1)
    assert np.isnan([low[1], high[1]]).all()  # both seeds gave the same
    assert np.isnan(summary.by_piece["recall"].value).all()


def test_an_agent_with_one_piece_has_the_interval_of_the_piece(tmp_path):
    write(tmp_path, {("a", "good", seed): f1 for seed, f1 in enumerate((0.5, 0.6, 0.7))})
    summary = summary_of(tmp_path)
    of_agent, of_piece = summary.groups[0].agents["good"].mean["f1"], summary.by_piece["f1"]
    assert of_agent == (of_piece.value[0, 0], of_piece.low[0, 0], of_piece.high[0, 0])
    assert of_agent.low == pytest.approx(0.6 - 4.303 * 0.1 / math.sqrt(3), abs=1e-3)  # t of 2


def test_rewards_for_different_fingers_stand_apart(tmp_path):
    for agent, fingers in (("planner", "score"), ("learnt", "search")):
        metrics = {"f1": 0.9, "return": 5.0, "reward/energy": -1.0, "rewarded_fingers": fingers}
        write_result(tmp_path, agent, result("a", agent, 0, metrics))
    (line,) = caveats(tmp_path)[DIFFER]
    assert line == "a: rewarded_fingers: search in 1 run (learnt); score in 1 run (planner)"
    write_tables(tmp_path / "out", summary_of(tmp_path))
    with (tmp_path / "out" / "runs.csv").open() as file:
        planner, learnt = sorted(csv.DictReader(file), key=lambda row: row["agent"], reverse=True)
    assert (planner["return, fingers: score"], planner["return, fingers: search"]) == ("5.0", "")
    assert (learnt["return, fingers: score"], learnt["return, fingers: search"]) == ("", "5.0")
    assert planner["reward/energy"] == learnt["reward/energy"] == "-1.0"


def test_onset_errors_are_told_in_milliseconds(tmp_path):
    metrics = {"f1": 0.5, "onset_error_median": 0.0125, "velocity_error": 3.5}
    write_result(tmp_path, "a", result("a", "planner", 0, metrics))
    (run,) = summary_of(tmp_path).runs
    assert run.metrics["onset_error"] == 12.5
    assert run.metrics["velocity_error"] == 3.5


def test_kinds_of_wrong_notes_are_means_of_what_is_known(tmp_path):
    for seed, silent in enumerate((2.0, 5.0, None)):
        kinds = {f"{kind}_per_100": 1.0 for kind in WRONG_NOTES} | {"missed_silent_per_100": silent}
        write_result(tmp_path, f"a{seed}", result("a", "planner", seed, {"f1": 0.5} | kinds))
    (values,) = wrong_notes(summary_of(tmp_path)).values()
    assert dict(zip(WRONG_NOTES, values, strict=True)) == {
        kind: "3.5" if kind == "missed_silent" else "1.0" for kind in WRONG_NOTES
    }


def test_times_and_energy_are_told_for_a_second_of_music(tmp_path):
    content = result("a", "planner", 0, {"f1": 0.5, "energy": 300.0})
    content["timing"] = {"wall_seconds": 15.0, "music_seconds": 20.0, "threads": 1}
    write_result(tmp_path, "a", content)
    content["timing"]["cpu_seconds"] = 10.0
    write_result(tmp_path, "b", content)
    before, run = summary_of(tmp_path).runs
    assert math.isnan(before.metrics["cpu_per_music"])
    assert run.metrics["cpu_per_music"] == 0.5
    assert run.metrics["wall_per_music"] == 0.75
    assert run.metrics["power"] == 15.0
    assert math.isnan(run.metrics["precision"])


def test_who_played_the_most_pieces_comes_first_and_of_these_who_played_best(tmp_path):
    write(tmp_path, TWO_AGENTS | {("a", "brilliant", 0): 1.0})
    summary = summary_of(tmp_path)
    assert summary.agents == ["good", "bad", "brilliant"]
    assert list(summary.groups[0].agents) == summary.agents


def test_whole_notes_count_before_frames(tmp_path):
    for name, f1, onsets in (("frames", 0.9, 0.5), ("notes", 0.8, 0.7)):
        write_result(tmp_path, name, result("a", name, 0, {"f1": f1, "note_onset_f1": onsets}))
    assert summary_of(tmp_path).agents == ["notes", "frames"]


def test_agents_are_compared_on_the_pieces_that_all_played(tmp_path):
    write(tmp_path, TWO_AGENTS | {("b", "third", 0): 0.6})
    summary = summary_of(tmp_path)
    _, common = summary.groups
    assert (common.name, common.pieces) == ("Played by all", [1])
    assert common.agents["good"].mean["f1"].value == pytest.approx(0.5)
    assert "third: 1 run of 1 piece" in caveats(tmp_path)["Some agents have fewer runs."][0]


def test_policies_are_named_by_the_end_of_their_path(tmp_path):
    write(tmp_path, {("a", f"{tmp_path}/elise/best", 0): 0.9, ("a", "run/good", 0): 0.8})
    assert summary_of(tmp_path).agents == ["elise/best", "run/good"]


def test_policies_that_would_be_called_the_same_keep_their_whole_path(tmp_path):
    agents = ["/home/one/run/best", "/home/two/run/best"]
    for i, agent in enumerate(agents):
        write_result(tmp_path, f"run {i}", result("a", agent, 0, {"f1": 0.9}))
    assert sorted(summary_of(tmp_path).agents) == agents


def test_every_library_and_split_is_summed_up(tmp_path):
    write(tmp_path, {("a", "planner", 0): 0.9}, library="etudes")
    write(tmp_path, {("b", "planner", 0): 0.5}, library="mine", split="valid")
    write(tmp_path, {("c", "planner", 0): 0.1})
    groups = {group.name: list(group.pieces) for group in summary_of(tmp_path).groups}
    assert groups == {"All pieces": [0, 1, 2], "etudes": [0], "mine:valid": [1], "made-up": [2]}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    write_bench(folder, pieces=7, agents=("planner", "ilqg"), seeds=3, libraries=2)
    return folder


def test_all_figures_are_those_of_plain_loops(bench):
    summary = summary_of(bench)
    for group in summary.groups:
        for agent, own in group.agents.items():
            runs = [r for r in summary.runs if r.agent == agent and r.piece in group.pieces]
            assert own.runs == len(runs) == 3 * own.pieces
            for name in METRICS:
                values = [run.metrics[name] for run in runs]
                value, low, high = own.mean[name]
                assert value == pytest.approx(statistics.fmean(values))
                if name in SHARES:  # the others are the same with every seed
                    assert low <= value <= high


def test_the_tables_have_the_same_figures(bench, tmp_path):
    results = read_results(bench)
    summary = summarize(results, "made up")
    names = write_tables(tmp_path, summary)
    assert names == ["agents.csv", "pieces.csv", "runs.csv", "differences.csv"]
    agents, pieces, runs, differences = (
        list(csv.DictReader((tmp_path / name).read_text().splitlines())) for name in names
    )
    assert len(runs) == 42
    assert (tmp_path / runs[0]["folder"] / "result.json").exists()
    of_one = [
        float(r["f1"]) for r in runs if (r["piece"], r["agent"]) == ("repertoire/003", "ilqg")
    ]
    (row,) = (r for r in pieces if (r["piece"], r["agent"]) == ("repertoire/003", "ilqg"))
    assert float(row["f1"]) == pytest.approx(statistics.fmean(of_one))
    assert float(row["f1_low"]) < float(row["f1"]) < float(row["f1_high"])
    assert row["runs"] == "3"
    everything = summary.groups[0].agents["planner"]
    assert (agents[0]["group"], agents[0]["agent"]) == ("All pieces", "planner")
    assert float(agents[0]["f1"]) == pytest.approx(everything.mean["f1"].value)
    assert [len(agents), len(pieces)] == [6, 14]
    ilqg = summary.groups[0].differences["ilqg"]["f1"]
    assert (differences[0]["agent"], differences[0]["than"]) == ("ilqg", "planner")
    assert float(differences[0]["f1"]) == pytest.approx(ilqg.value)


def test_what_is_not_known_is_an_empty_cell(tmp_path):
    write(tmp_path, {("a", "planner", 0): 0.5})
    results = read_results(tmp_path)
    write_tables(tmp_path / "out", summarize(results, "made up"))
    (row,) = csv.DictReader((tmp_path / "out" / "pieces.csv").read_text().splitlines())
    assert (row["f1"], row["f1_low"], row["recall"]) == ("0.5", "", "")


# Caveats


def test_runs_alike_need_no_caveat(bench):
    assert summary_of(bench).caveats == []


def test_music_that_was_changed_is_told(tmp_path):
    for seed in range(2):
        content = result("a", "planner", seed, {"f1": 0.5}, seconds=200.0)
        content["job"]["arrangement"] = {"tracks": [], "first_seconds": 20.0}
        content["job"]["task"] = {"stretch": 2.0, "transpose": 0}
        write_result(tmp_path, f"run {seed}", content)
    assert caveats(tmp_path) == {
        "Pieces were not played whole and as written.": [
            "arrangement.first_seconds 20.0: 2 runs (planner)",
            "task.stretch 2.0: 2 runs (planner)",
        ]
    }
    (piece,) = summary_of(tmp_path).pieces
    assert piece.seconds == 20.0  # that were played


@pytest.mark.parametrize("content", ["", "{", "[]", '{"format": 2}', '{"format": 1}'])
def test_a_corrupt_run_is_reported_and_left_out(tmp_path, content):
    write(tmp_path, TWO_AGENTS)
    (run,) = (tmp_path / "runs").glob("a-good-0--*")
    (run / "result.json").write_text(content)
    (case,) = caveats(tmp_path)["1 run cannot be read, and is left out."]
    assert case.startswith(f"{run.name}: ")
    assert len(summary_of(tmp_path).runs) == len(TWO_AGENTS) - 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"job": {"agent": "a"}}, "Expected `int`, got `null` - at `$.seed`"),
        ({"job": {"agent": ["a"], "seed": 0}}, "Expected `str`, got `array` - at `$.agent`"),
        ({"metrics": {"f1": "high"}}, "its result holds no F1"),
        ({"metrics": {"f1": None}}, "its result holds no F1"),
    ],
)
def test_a_run_of_nobody_or_of_no_number_is_left_out(tmp_path, change, message):
    write(tmp_path, TWO_AGENTS)
    write_result(tmp_path, "odd", result("c", "good", 0, {"f1": 0.5}) | change)
    (case,) = caveats(tmp_path)["1 run cannot be read, and is left out."]
    assert message in case
    assert len(summary_of(tmp_path).runs) == len(TWO_AGENTS)


def test_runs_that_are_not_finished_are_named(tmp_path):
    write(tmp_path, TWO_AGENTS)
    (tmp_path / "runs" / "begun").mkdir()
    (case,) = caveats(tmp_path)["1 run is not finished."]
    assert case.startswith("begun: ")


def test_without_a_finished_run_there_is_nothing_to_tell(tmp_path):
    (tmp_path / "runs" / "begun").mkdir(parents=True)
    with pytest.raises(CadenzaError, match="no run is finished"):
        summary_of(tmp_path)


def test_the_seed_of_training_is_to_differ(tmp_path):
    for seed in range(2):
        trained = result("a", "train:fast", seed, {"f1": 0.5})
        trained["job"]["config"] = {"seed": seed, "num_steps": 100}
        trained["training"] = {"steps": 100, "seconds": 1.0}
        write_result(tmp_path, f"s{seed}", trained)
    assert summary_of(tmp_path).caveats == []


def test_versions_and_settings_that_differ_are_named(tmp_path):
    write(tmp_path, TWO_AGENTS)
    other = result("c", "good", 0, {"f1": 0.5})
    other["versions"]["mujoco"] = "3.18"
    other["job"]["task"]["control_timestep"] = 0.1
    other["job"]["config"] = {"samples": 10}
    other["timing"]["threads"] = 8
    write_result(tmp_path, "other", other)
    again = result("c", "good", 1, {"f1": 0.5})
    again["job"]["song_digest"] = "1" * 12
    again["job"]["config"] = {"samples": 20}
    write_result(tmp_path, "again", again)
    assert caveats(tmp_path)[DIFFER] == [
        "mujoco: 3.17 in 9 runs (bad, good); 3.18 in 1 run (good)",
        "threads: 2 in 9 runs (bad, good); 8 in 1 run (good)",
        "task.control_timestep: 0.05 in 9 runs (bad, good); 0.1 in 1 run (good)",
        "good: config.samples: not set in 4 runs (good); 20 in 1 run (good); 10 in 1 run (good)",
        "c: notes: 111111111111 in 1 run (good); 000000000000 in 1 run (good)",
    ]
