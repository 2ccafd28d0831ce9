"""Sealed folders: whole, or refused; whatever happens while they are written."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import pickle
import shutil
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cadenza.errors import CadenzaError
from cadenza.learning.checksummed_folder import read_checksummed, write_checksummed

FACTS = {"number": 0.1 + 0.2, "big": 2**127 + 1, "text": "Für Elise", "list": [1, None, True]}
ARRAYS = {
    "a/kernel": np.arange(6, dtype=np.float32).reshape(2, 3),
    "b": np.array(7, np.int64),
    "none": np.zeros((0, 4), bool),
}
OTHER = {"a/kernel": np.ones(2)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "runs" / "policy"
    write_checksummed(folder, "thing", FACTS, ARRAYS)
    return folder


def assert_refused(folder: Path, saying: str = ".", kind: str = "thing") -> None:
    with pytest.raises(CadenzaError, match=saying) as error:
        read_checksummed(folder, kind)
    assert "\n" not in str(error.value)
    assert folder.name in str(error.value)


def test_gives_back_what_was_written(folder: Path) -> None:
    facts, arrays = read_checksummed(folder, "thing")
    assert facts == FACTS
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        assert_array_equal(arrays[name], array)
    assert [path.name for path in folder.parent.iterdir()] == ["policy"]


def test_can_be_moved_and_copied(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "elsewhere")
    assert read_checksummed(tmp_path / "elsewhere", "thing")[0] == FACTS


# What is not whole


@pytest.mark.parametrize("name", ["manifest.json", "facts.json", "arrays.safetensors"])
def test_a_file_that_is_far_too_large_is_not_read(folder: Path, name: str) -> None:
    os.truncate(folder / name, 3 * 2**30)  # takes no room
    tracemalloc.start()
    assert_refused(folder, "takes 3,221,225,472 bytes, but such a file needs no more")
    assert tracemalloc.get_traced_memory()[1] < 2**23
    tracemalloc.stop()


def test_what_could_not_be_read_again_is_not_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cadenza.learning.checksummed_folder._MAX_ARRAYS", 2**20)
    with pytest.raises(CadenzaError, match=r"its arrays take 8 MiB; a thing holds up to 1 MiB"):
        write_checksummed(folder, "thing", FACTS, {"a": np.zeros(2**20)})
    assert read_checksummed(folder, "thing")[0] == FACTS
    assert [path.name for path in folder.parent.iterdir()] == ["policy"]


def test_any_byte_that_was_changed_is_noticed(folder: Path) -> None:
    """In the manifest another blank may stand in for a blank; that changes nothing."""
    for path in sorted(folder.iterdir()):
        content = path.read_bytes()
        for i in range(0, len(content), 7 if path.suffix == ".safetensors" else 1):
            path.write_bytes(content[:i] + bytes([content[i] ^ 1]) + content[i + 1 :])
            if path.name == "manifest.json" and content[i : i + 1].isspace():
                continue
            assert_refused(folder)
        path.write_bytes(content)
    assert read_checksummed(folder, "thing")[0] == FACTS


@pytest.mark.parametrize("name", ["manifest.json", "facts.json", "arrays.safetensors"])
@pytest.mark.parametrize("keep", [0, 0.5, None])
def test_files_that_are_cut_off_or_missing_are_noticed(
    folder: Path, name: str, keep: float | None
) -> None:
    path = folder / name
    if keep is None:
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
    assert_refused(folder)


def test_folders_of_something_else_are_refused(folder: Path, tmp_path: Path) -> None:
    assert_refused(folder, "is not a policy written by Cadenza", kind="policy")
    assert_refused(tmp_path / "nowhere", r"holds no manifest\.json")
    (tmp_path / "empty").mkdir()
    assert_refused(tmp_path / "empty", r"holds no manifest\.json")
    (tmp_path / "file").write_text("no folder")
    assert_refused(tmp_path / "file")
    for content in (b"", b"[1, 2]", b"null", b'{"kind": 3}', b'{"kind": "thing"}', b"\xff\xfe"):
        (tmp_path / "empty" / "manifest.json").write_bytes(content)
        assert_refused(tmp_path / "empty")


# Sealed by someone else


def seal(folder: Path, **files: bytes) -> None:
    """Writes any content as `write_checksummed` would."""
    names = {"facts": "facts.json", "arrays": "arrays.safetensors"}
    digests = {}
    for name, content in files.items():
        (folder / names[name]).write_bytes(content)
    for name in names.values():
        digests[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    manifest = {"kind": "thing", "sha256": digests}
    (folder / "manifest.json").write_text(json.dumps(manifest))


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (Path(os.environ["BOMB"]),))


def test_nothing_that_a_file_says_is_carried_out(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even if its digests are right."""
    monkeypatch.setenv("BOMB", str(tmp_path / "went off"))
    objects = io.BytesIO()
    np.savez(objects, weights=np.array([Bomb()], object))
    array = io.BytesIO()
    np.save(array, np.array([Bomb()], object))
    contents = (objects.getvalue(), array.getvalue(), pickle.dumps(Bomb()), b"", b"PK")
    for content in contents:
        seal(folder, arrays=content)
        assert_refused(folder, r"arrays\.safetensors: not a readable \.safetensors file")
    assert not (tmp_path / "went off").exists()


def test_names_that_cannot_be_printed_are_refused(folder: Path) -> None:
    write_checksummed(folder, "thing", FACTS, {"a\nb": np.zeros(1)})
    assert_refused(folder, "names that cannot be printed")


def test_facts_that_are_no_json_are_refused(folder: Path) -> None:
    seal(folder, facts=b"{'a': 1}")
    assert_refused(folder, r"facts\.json: not JSON")


def test_digests_of_a_strange_shape_are_refused(folder: Path) -> None:
    for digests in ("[]", '"abc"', "null", "3", '{"facts.json": 1}'):
        (folder / "manifest.json").write_text(f'{{"kind": "thing", "sha256": {digests}}}')
        assert_refused(folder)


# Stopped while writing


class Killed(BaseException):
    """In place of SIGKILL: from then on, nothing on the disk changes."""


@contextmanager
def killed_at(step: int) -> Iterator[None]:
    """Kills at the disk operation of this number; the deletion of a folder is half done then."""
    done = 0

    def dying(operation: Callable[..., Any]) -> Callable[..., Any]:
        def instead(*args: Any, **options: Any) -> Any:
            nonlocal done
            done += 1
            if done < step:
                return operation(*args, **options)
            if done == step and operation is rmtree and (there := sorted(Path(args[0]).glob("*"))):
                there[0].unlink()
            raise Killed

        return instead

    rmtree = shutil.rmtree
    with pytest.MonkeyPatch.context() as patch:
        for module, name in ((os, "rename"), (os, "replace"), (os, "fsync"), (shutil, "rmtree")):
            patch.setattr(module, name, dying(getattr(module, name)))
        try:
            yield
        except Killed:
            pass
        else:
            assert done < step, "was killed and did not notice"


def test_after_a_kill_at_any_moment_the_old_or_the_new_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This also holds where the one who writes next is killed, too."""
    monkeypatch.setattr(os, "fsync", lambda _: None)  # takes long
    seen = set()
    for first in range(1, 13):
        for second in range(1, 13):
            folder = tmp_path / f"{first} {second}" / "policy"
            write_checksummed(folder, "thing", {"version": 0}, OTHER)
            for version, step in ((1, first), (2, second)):
                with killed_at(step):
                    write_checksummed(folder, "thing", {"version": version}, ARRAYS)
                found = read_checksummed(folder, "thing")[0]["version"]
                assert found in range(version + 1)
                seen.add((version, found))
            write_checksummed(folder, "thing", {"version": 3}, ARRAYS)
            assert read_checksummed(folder, "thing")[0] == {"version": 3}
            assert [path.name for path in folder.parent.iterdir()] == ["policy"]
    assert seen == {(1, 0), (1, 1), (2, 0), (2, 1), (2, 2)}


def test_no_link_is_written_through(folder: Path, tmp_path: Path) -> None:
    """Whichever of the names that it uses is one."""
    dear = tmp_path / "dear"
    dear.mkdir()
    (dear / "facts.json").write_text("dear")
    for name in (".policy.new", ".policy.old", "policy"):
        path = folder.with_name(name)
        shutil.rmtree(path, ignore_errors=True)
        path.symlink_to(dear)
        write_checksummed(folder, "thing", FACTS, ARRAYS)
        assert read_checksummed(folder, "thing")[0] == FACTS
        assert [path.name for path in folder.parent.iterdir()] == ["policy"]
    assert [path.read_text() for path in dear.iterdir()] == ["dear"]


def test_who_reads_moves_nothing(folder: Path) -> None:
    """The one who writes may be between the two renames that put the new folder in place."""
    old = folder.with_name(".policy.old")
    folder.rename(old)
    assert read_checksummed(folder, "thing")[0] == FACTS
    assert old.exists()
    assert not folder.exists()


def test_where_there_is_no_room_the_old_stays(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            write_checksummed(folder, "thing", {"version": 2}, OTHER)
    assert read_checksummed(folder, "thing")[0] == FACTS
    assert [path.name for path in folder.parent.iterdir()] == ["policy"]
