"""Tests of runs of a bench that finish, fail, crash, end early, or belong to others."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cadenza.errors import CadenzaWarning
from cadenza.evaluation.bench import BenchState, bench
from cadenza.evaluation.jobs import BenchJob, Contender, bench_jobs
from cadenza.evaluation.processes import Ended
from cadenza.evaluation.results import RESULT, read_results
from cadenza.evaluation.run import carry_out
from cadenza.evaluation.run_status import write_failure
from cadenza.files import locked
from cadenza.music.arrangement import Arrangement
from cadenza.music.formats.midi import write_midi
from cadenza.music.libraries.library import open_library
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig


class OneByOne:
    """An executor of runs in this process, with given outcomes."""

    capacity = 1

    def __init__(self, instead: Sequence[Ended | None] = ()) -> None:
        self.begun: list[str] = []
        self._instead = list(instead)
        self._ended: list[Ended] = []

    def start(self, job: BenchJob, folder: Path) -> None:
        self.begun.append(job.spec.agent)
        instead = self._instead.pop(0) if self._instead else None
        if instead is None:
            carry_out(job, folder, num_threads=1)
        self._ended.append((instead or Ended(job))._replace(job=job))

    def ended(self, seconds: float) -> list[Ended]:
        ended, self._ended = self._ended, []
        return ended

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.fixture
def jobs(tmp_path):
    """Runs of agents with a song of one note."""
    write_midi(Score((Note(0.0, 0.2, 60),)), tmp_path / "songs" / "song.mid")
    library = open_library(tmp_path / "songs")

    def make(*agents: str, **task: Any) -> list[BenchJob]:
        who = [Contender(agent, TaskConfig(**task), SceneConfig()) for agent in agents]
        return bench_jobs(library, lambda _: who, [0], Arrangement(), "none")

    return make


def carried_out(
    jobs: list[BenchJob], folder: Path, instead: Sequence[Ended | None] = (), retry: bool = False
) -> tuple[BenchState, list[str]]:
    """The state at the end, and which agents began."""
    executor, reports = OneByOne(instead), list[str]()
    state = bench(
        jobs, folder, executor, lambda _, job: reports.append(job.spec.name), lambda _: True, retry
    )
    assert not state.left
    assert state.finished + len(state.failed) == len(jobs)
    return state, executor.begun


def test_a_song_that_cannot_be_read_is_left_out_with_a_line(tmp_path):
    write_midi(Score((Note(0.0, 0.2, 60),)), tmp_path / "song.mid")
    (tmp_path / "away.mid").symlink_to(tmp_path / "nowhere.mid")
    contender = Contender("zero", TaskConfig(), SceneConfig())
    with pytest.warns(CadenzaWarning, match=r"away.mid: there is no such file") as warned:
        jobs = bench_jobs(open_library(tmp_path), lambda _: [contender], [0], Arrangement())
    assert [job.spec.song for job in jobs] == [str(tmp_path / "song.mid")]
    assert len(warned) == 1


def test_a_folder_is_extended_and_what_is_finished_never_done_again(jobs, tmp_path):
    assert carried_out(jobs("zero"), tmp_path)[1] == ["zero"]
    assert carried_out(jobs("zero"), tmp_path)[1] == []
    assert carried_out(jobs("zero", "random"), tmp_path)[1] == ["random"]
    assert carried_out(jobs("zero", stretch=2.0), tmp_path)[1] == ["zero"]
    assert len(read_results(tmp_path).results) == 3


def test_what_has_finished_before_it_was_stopped_counts(jobs, tmp_path):
    class LateNews(OneByOne):
        def ended(self, seconds: float) -> list[Ended]:
            return []

    asked = iter([True, False])
    both = jobs("zero", "random")
    state = bench(both, tmp_path, LateNews(), lambda *_: None, lambda _: next(asked))
    assert (state.finished, state.left) == (1, 1)


def test_what_failed_is_told_and_carried_out_again_on_demand(jobs, tmp_path):
    both = jobs("bench_agents:Raises", "zero")
    for begun in ["bench_agents:Raises", "zero"], []:
        state, agents = carried_out(both, tmp_path)
        assert agents == begun
        (why,) = state.failed.values()
        assert why.startswith("agent Raises: act(): ValueError: not today (")
    assert carried_out(both, tmp_path, retry=True)[1] == ["bench_agents:Raises"]
    (unfinished,) = read_results(tmp_path).unfinished
    assert unfinished.reason == why


def after_a_result_that_was_not_good_enough(
    job: BenchJob, folder: Path, executor: OneByOne
) -> BenchState:
    """The state after a run is carried out again."""
    run = folder / "runs" / job.spec.name
    run.mkdir(parents=True)
    (run / RESULT).write_text("{}")
    return bench(
        [job], folder, executor, lambda *_: None, lambda _: True, is_complete=lambda *_: False
    )


def test_what_fails_now_counts_as_failed_whatever_it_has_left_before(jobs, tmp_path):
    class Fails(OneByOne):
        def start(self, job: BenchJob, folder: Path) -> None:
            write_failure(folder, "not today")
            self._ended.append(Ended(job))

    (job,) = jobs("zero")
    state = after_a_result_that_was_not_good_enough(job, tmp_path, Fails())
    assert (state.finished, state.failed) == (0, {job.spec.name: "not today"})


def test_a_process_that_dies_is_not_saved_by_a_result_that_was_not_good_enough(jobs, tmp_path):
    class Dies(OneByOne):
        def start(self, job: BenchJob, folder: Path) -> None:
            self._ended.append(Ended(job, "killed"))

    (job,) = jobs("zero")
    state = after_a_result_that_was_not_good_enough(job, tmp_path, Dies())
    assert (state.finished, list(state.failed)) == (0, [job.spec.name])


def test_songs_may_have_long_names(jobs):
    (job,) = jobs("zero")
    name = replace(job.spec, song="songs/" + "\N{KATAKANA LETTER A}" * 78).name
    assert len(name.encode()) < 200
    assert name != replace(job.spec, song="songs/" + "\N{KATAKANA LETTER A}" * 77).name


def test_a_run_whose_process_dies_is_taken_up_again_but_not_forever(jobs, tmp_path):
    dies, vanishes, lives = three = jobs("zero", "random", "bench_agents:Still")
    killed, gone = Ended(dies, "killed"), Ended(vanishes)
    state, begun = carried_out(three, tmp_path, [killed, gone, None, killed, gone, killed, None])
    assert begun == ["zero", "random", lives.spec.agent, "zero", "random", "zero", "random"]
    assert state.failed == {dies.spec.name: "killed; so it went 3 times"}
    assert state.finished == 2
    assert carried_out(three, tmp_path)[1] == []
    assert carried_out(three, tmp_path, [killed], retry=True)[0].finished == 3


def test_what_a_run_before_has_left_may_be_corrupt(jobs, tmp_path):
    (job,) = jobs("zero")
    failed = tmp_path / "runs" / job.spec.name / "failed.json"
    failed.parent.mkdir(parents=True)
    failed.write_text("{")
    assert "not JSON" in carried_out([job], tmp_path)[0].failed[job.spec.name]
    assert carried_out([job], tmp_path, retry=True)[0].finished == 1


def test_a_run_of_others_is_waited_for_and_taken_up_if_they_give_up(jobs, tmp_path):
    (job,) = jobs("zero")
    looks = 0
    with locked(tmp_path / "runs" / job.spec.name) as ours:
        assert ours

        def goes_on(_: BenchState) -> bool:
            nonlocal looks
            looks += 1
            return looks < 4

        executor = OneByOne()
        state = bench([job], tmp_path, executor, lambda *_: None, goes_on)
        assert (state.left, state.elsewhere) == (1, [job])
        assert executor.begun == ["zero"]  # which found it locked
    assert carried_out([job], tmp_path)[0].finished == 1


def test_a_song_that_has_changed_since_is_told(jobs, tmp_path):
    planned = jobs("zero")
    write_midi(Score((Note(0.0, 0.2, 62),)), tmp_path / "songs" / "song.mid")
    state, _ = carried_out(planned, tmp_path)
    assert "has other notes here and now" in next(iter(state.failed.values()))
