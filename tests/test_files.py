"""Nobody ever sees half a file."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from cadenza.files import write_atomically


def test_writes_into_folders_that_it_makes(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "file.bin"
    with write_atomically(path) as file:
        file.write(b"whole")
    assert path.read_bytes() == b"whole"
    assert [p.name for p in path.parent.iterdir()] == ["file.bin"]
    assert stat.S_IMODE(path.stat().st_mode) == 0o644  # others may read it


def test_the_old_file_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "file.bin"
    path.write_bytes(b"old")
    with write_atomically(path) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("existed", [True, False])
def test_an_error_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, error: type[BaseException], existed: bool
) -> None:
    path = tmp_path / "file.bin"
    if existed:
        path.write_bytes(b"old")
    with pytest.raises(error):
        write_half(path, error)
    assert [p.read_bytes() for p in tmp_path.iterdir()] == ([b"old"] if existed else [])


def write_half(path: Path, error: type[BaseException]) -> None:
    with write_atomically(path) as file:
        file.write(b"half of")
        raise error
