"""Damage of every kind is told in a line that names the file and says what to do."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadenza.cli import main
from cadenza.demonstrations.checking import problems
from cadenza.demonstrations.recorded import PLAN, RESULT, SCORE, STEPS, digest


def test_nothing_is_wrong(made: Path) -> None:
    assert list(problems(made, replays=2)) == []


def first(folder: Path) -> Path:
    return min((folder / "runs").iterdir())


def changed(folder: Path, name: str, change: Callable[[np.ndarray], None]) -> None:
    """An array that was written wrongly: its checksum is right."""
    array = np.load(first(folder) / name)
    change(array)
    np.save(first(folder) / name, array)
    path = first(folder) / RESULT
    result = json.loads(path.read_text())
    result["files"][name] = digest(first(folder) / name)
    path.write_text(json.dumps(result))


@pytest.mark.parametrize("name", [STEPS, PLAN, SCORE])
@pytest.mark.parametrize("damage", ["bit", "cut", "gone"])
def test_damaged_files(copied: Path, name: str, damage: str) -> None:
    path = first(copied) / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes(content if damage == "bit" else content[: len(content) // 2])
    (line,) = problems(copied, replays=0)
    assert line.startswith(f"{path}: ")
    assert line.endswith("delete its folder and collect again")


def test_a_result_that_is_cut_off(copied: Path) -> None:
    path = first(copied) / RESULT
    path.write_text(path.read_text()[:-20])
    (line,) = problems(copied, replays=0)
    assert str(path) in line
    assert "\n" not in line


def test_values_that_cannot_be(copied: Path) -> None:
    def spoil(steps: np.ndarray) -> None:
        steps["hand_qvel"][3, 2] = np.nan
        steps["action"][2, 5] = 10.0

    changed(copied, STEPS, spoil)
    lines = list(problems(copied, replays=0))
    assert len(lines) == 2
    assert "hand_qvel is not finite" in lines[0]
    assert "action beyond the actions' limits" in lines[1]


def test_rows_that_are_missing(copied: Path) -> None:
    path = first(copied) / STEPS
    np.save(path, np.load(path)[:-3])
    result = json.loads((first(copied) / RESULT).read_text())
    result["files"][STEPS] = digest(path)
    (first(copied) / RESULT).write_text(json.dumps(result))
    (line,) = problems(copied, replays=0)
    assert f"{path}: not the" in line


def test_what_was_not_played_so(copied: Path) -> None:
    def spoil(steps: np.ndarray) -> None:
        steps["previous_action"][5, 6] *= 0.99

    changed(copied, STEPS, spoil)
    (line,) = problems(copied, replays=2)
    assert "played again it differs: hand_qpos by" in line


def test_the_command_tells_all_and_fails(
    copied: Path, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["dataset", "check", str(made), "--replays", "0"])
    assert "nothing is wrong" in capsys.readouterr().out
    (first(copied) / PLAN).unlink()
    with pytest.raises(SystemExit, match="2"):
        main(["dataset", "check", str(copied), "--replays", "0"])
    told = capsys.readouterr().err.splitlines()
    assert "plan.npy: missing" in told[0]
    assert told[1] == f"cadenza: {copied}: 1 problem"
