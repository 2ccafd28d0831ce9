"""Results are read as they were written; what is corrupt is told and left out."""

import json
from typing import Any

import pytest

from cadenza.errors import CadenzaError
from cadenza.evaluation.jobs import BenchJob, Contender, JobSpec, bench_jobs, songs_of
from cadenza.evaluation.results import is_finished, read_results, write_plan
from cadenza.evaluation.run import carry_out
from cadenza.music.arrangement import Arrangement
from cadenza.music.libraries.library import find_song
from cadenza.music.libraries.songs import Library
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

SCALE = Library("debug", (find_song("CMajorScaleOneHand"),))


def job(agent: str = "zero", seed: int = 0, page: bool = False, seconds: float = 0.4) -> BenchJob:
    ((song, digest),), beginning = songs_of(SCALE), Arrangement(first_seconds=seconds)
    spec = JobSpec(song.name, digest, agent, seed, TaskConfig(), SceneConfig(), beginning)
    return BenchJob(spec, song, page)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    carry_out(job(), folder, num_threads=1)
    return (folder / "result.json").read_text()


def content(text: str, **changes: Any) -> str:
    return json.dumps(json.loads(text) | changes)


def test_a_result_says_what_was_played_and_how_well(tmp_path):
    run = tmp_path / "runs" / job().spec.name
    carry_out(job(page=True), run, num_threads=1)
    (result,) = read_results(tmp_path).results
    metrics = json.loads((run / "metrics.json").read_text())
    assert result.metrics == metrics
    assert metrics["energy"] == pytest.approx(-metrics["reward/energy"] / 0.005 * 0.05)  # [J]
    assert {"f1", "pooled_f1", "note_onset_f1"} <= metrics.keys()
    assert (result.agent, result.seed, result.song.title) == ("zero", 0, SCALE.songs[0].title)
    assert result.song.notes == 1  # in 0.4 s
    assert result.timing.music_seconds == pytest.approx(0.5 + 0.45)  # after a silence
    assert result.timing.cpu_seconds is not None
    assert 0 < result.timing.cpu_seconds < 10
    assert (run / "report.html").exists()
    assert {"cadenza", "mujoco", "numpy", "python", "platform"} <= result.versions.keys()
    assert result.job == job().spec.as_json()


@pytest.mark.parametrize("text", ["", "{}", "[]", "\xff", '{"format": 1}'])
def test_what_is_corrupt_is_told_and_left_out(tmp_path, finished, text):
    key = job().spec.key
    names = [f"{run}--{key}" for run in "abc"]
    for name, written in zip(names, (text, finished, finished[:-30]), strict=True):
        (tmp_path / "runs" / name).mkdir(parents=True)
        (tmp_path / "runs" / name / "result.json").write_text(written)
    results = read_results(tmp_path)
    assert [result.folder.name for result in results.results] == [names[1]]
    assert [without.name for without in results.broken] == [names[0], names[2]]
    assert all("\n" not in run.reason for run in results.broken)


def test_a_run_that_was_copied_does_not_count_twice(tmp_path, finished):
    for name in job().spec.name, f"{job().spec.name} copy":
        (tmp_path / "runs" / name).mkdir(parents=True)
        (tmp_path / "runs" / name / "result.json").write_text(finished)
    results = read_results(tmp_path)
    assert [result.folder.name for result in results.results] == [job().spec.name]
    (broken,) = results.broken
    assert "does not belong to its folder" in broken.reason


@pytest.mark.parametrize("text", ["", "{}", '{"format": 1}'])
def test_a_run_whose_result_is_corrupt_is_carried_out_again(tmp_path, text):
    run = tmp_path / job().spec.name
    run.mkdir()
    (run / "result.json").write_text(text)
    assert not is_finished(None, run)
    carry_out(job(), run, num_threads=1)
    assert is_finished(None, run)


def test_what_is_not_of_this_format_is_told(tmp_path, finished):
    changes: dict[str, Any] = {
        "a": {"format": 2},
        "b": {"metrics": {"f1": "good"}},
        "c": {"job": {"song": "x"}},
        "d": {"song": {}},
    }
    for name, change in changes.items():
        (tmp_path / "runs" / name).mkdir(parents=True)
        (tmp_path / "runs" / name / "result.json").write_text(content(finished, **change))
    results = read_results(tmp_path)
    assert not results.results
    assert [without.name for without in results.broken] == list(changes)


def test_what_is_missing_is_told(tmp_path, finished):
    jobs = [job(seed=seed) for seed in range(3)]
    write_plan(tmp_path, "cadenza bench", jobs)
    first, second, third = (tmp_path / "runs" / job.spec.name for job in jobs)
    for run in first, second:
        run.mkdir(parents=True)
    (first / "result.json").write_text(finished)
    (second / "failed.json").write_text('{"format": 1, "error": "out of luck"}')
    (tmp_path / "runs" / ".DS_Store").touch()  # as file managers leave it
    results = read_results(tmp_path)
    assert len(results.results) == 1
    assert {(run.name, run.reason) for run in results.unfinished} == {
        (second.name, "out of luck"),
        (third.name, "not finished"),
    }
    with pytest.raises(CadenzaError, match="holds no runs"):
        read_results(first)


def test_a_run_is_named_by_all_that_its_result_depends_on():
    one = job().spec
    others = [job("random").spec, job(seed=1).spec, job(seconds=0.5).spec]
    assert job(page=True).spec == one
    assert one.name.startswith("CMajorScaleOneHand--zero--s0--")
    assert len({spec.key for spec in [one, *others]}) == 4


def test_a_bench_names_every_run_once_and_the_first_seed_first():
    def who(_: str) -> list[Contender]:
        return [Contender(name, TaskConfig(), SceneConfig()) for name in ("zero", "random", "zero")]

    jobs = bench_jobs(SCALE, who, [4, 2, 4], Arrangement())
    runs = [(job.spec.agent, job.spec.seed, job.page) for job in jobs]
    assert runs == [
        ("zero", 4, True),
        ("random", 4, True),
        ("zero", 2, False),
        ("random", 2, False),
    ]
