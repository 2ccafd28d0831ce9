"""Runs side by side keep to cores of their own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cadenza.learning.cpu_affinity import claimed_cores

pytestmark = pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="this system does not keep processes to cores"
)
CLAIM = """
import os, sys
from cadenza.learning.cpu_affinity import claimed_cores
with claimed_cores(int(sys.argv[1])) as cores:
    print(sorted(cores), sorted(os.sched_getaffinity(0)), flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def claims(tmp_path, monkeypatch):
    """The folder of claims of this test alone."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)


def claim(number: int) -> tuple[subprocess.Popen[str], list[int], list[int]]:
    command = [sys.executable, "-c", CLAIM, str(number)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    claimed, kept_to = process.stdout.readline().strip().split("] [")
    return process, eval(claimed + "]"), eval("[" + kept_to)


def test_no_two_runs_claim_the_same_core():
    cores = sorted(os.sched_getaffinity(0))
    runs = [claim(1) for _ in cores]
    assert sorted(core for _, own, _ in runs for core in own) == cores
    assert all(own == kept_to for _, own, kept_to in runs)
    more = [claim(2) for _ in range(2 * len(cores))]  # none is left: they share them evenly
    assert not any(own for _, own, _ in more)
    assert sorted(core for _, _, kept_to in more for core in kept_to) == sorted(cores * 2)
    for process, _, _ in [*runs, *more]:
        process.kill()
        process.wait()


def spoil(tmp_path: Path, how: str) -> None:
    folder = tmp_path / f"cadenza-cores-{os.getuid()}"
    match how:
        case "link to a folder":
            (tmp_path / "elsewhere").mkdir()
            folder.symlink_to(tmp_path / "elsewhere")
        case "link to nothing":
            folder.symlink_to(tmp_path / "elsewhere")
        case "file":
            folder.touch()
        case "others may write":
            folder.mkdir()
            folder.chmod(0o777)
        case "links within":
            folder.mkdir(mode=0o700)
            for core in os.sched_getaffinity(0):
                (folder / f"{core}.0").symlink_to(tmp_path / "dear")


@pytest.mark.parametrize(
    "how", ["link to a folder", "link to nothing", "file", "others may write", "links within"]
)
def test_where_others_could_write_nothing_is_claimed(how, tmp_path, capsys):
    (tmp_path / "dear").write_text("dear")
    spoil(tmp_path, how)
    before = os.sched_getaffinity(0)
    with claimed_cores(1) as cores:
        assert cores == set()
        assert os.sched_getaffinity(0) == before
    message = capsys.readouterr().err
    assert message.startswith("parallel runs may share cores (")
    assert message.count("\n") == 1
    assert (tmp_path / "dear").read_text() == "dear"
    assert not list((tmp_path / "elsewhere").glob("*"))


def test_a_folder_of_another_user_is_not_used(monkeypatch, capsys):
    with claimed_cores(1):
        pass
    real = Path.lstat

    def of_another(path: Path) -> os.stat_result:
        there = list(real(path))
        there[4] += 1  # st_uid
        return os.stat_result(there)

    monkeypatch.setattr(Path, "lstat", of_another)
    with claimed_cores(1) as cores:
        assert cores == set()
    assert "may share cores (not a folder that only you can write to" in capsys.readouterr().err


def test_a_killed_run_gives_its_cores_back():
    process, own, _ = claim(10_000)
    assert own == sorted(os.sched_getaffinity(0))
    process.kill()
    process.wait()
    before = os.sched_getaffinity(0)
    with claimed_cores(1) as cores:
        assert len(cores) == 1
        assert os.sched_getaffinity(0) == cores
    assert os.sched_getaffinity(0) == before
