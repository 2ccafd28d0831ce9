"""Nobody ever sees half a file, and what a broken one holds is said in one line."""

import hashlib
import io
import json
import os
import re
import stat
import tracemalloc
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.files import (
    ANY,
    FLOATS,
    TEXT,
    ArrayOf,
    check_arrays,
    checked,
    content_of,
    folder_name,
    number_in,
    read_arrays,
    read_json,
    read_tensors,
    sha256_of,
    whole_number_in,
    write_atomically,
    write_json,
    write_tensors,
)

# Writing


@contextmanager
def umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_writes_into_folders_that_it_makes(tmp_path):
    path = tmp_path / "a" / "b" / "file.bin"
    with write_atomically(path) as file:
        file.write(b"whole")
    assert path.read_bytes() == b"whole"
    assert [p.name for p in path.parent.iterdir()] == ["file.bin"]


def test_the_old_file_stays_until_the_new_one_is_whole(tmp_path):
    path = tmp_path / "file.bin"
    path.write_bytes(b"old")
    with write_atomically(path) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("existed", [True, False])
def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path, error, existed):
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


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_a_new_file_may_be_read_by_whom_the_umask_says(tmp_path, mask):
    with umask(mask), write_atomically(tmp_path / "new"):
        pass
    assert mode(tmp_path / "new") == 0o666 & ~mask


def test_a_file_that_is_replaced_keeps_its_permissions(tmp_path):
    path = tmp_path / "private"
    path.touch()
    path.chmod(0o600)
    with umask(0o022), write_atomically(path):
        (unfinished,) = (each for each in tmp_path.iterdir() if each != path)
        assert mode(unfinished) == 0o600  # nobody else reads it meanwhile
    assert mode(path) == 0o600


def test_a_link_is_replaced_and_not_followed(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("dear")
    link.symlink_to(target)
    with write_atomically(link) as file:
        file.write(b"new")
    assert target.read_text() == "dear"
    assert link.read_text() == "new"
    assert not link.is_symlink()


@pytest.mark.parametrize("name", ["x" * 255, "ü" * 127 + "x"])
def test_a_name_may_be_as_long_as_the_system_allows(tmp_path, name):
    with write_atomically(tmp_path / name) as file:
        file.write(b"long")
    assert (tmp_path / name).read_bytes() == b"long"


# JSON


@dataclass(frozen=True)
class Part:
    size: float = 1.0
    sides: tuple[int, ...] = ()


@dataclass(frozen=True)
class Whole:
    name: str
    part: Part = field(default_factory=Part)
    kind: Literal["a", "b"] = "a"
    more: dict[str, Any] = field(default_factory=dict)


def assert_refused(path: Path, saying: str) -> None:
    with pytest.raises(CadenzaError, match=saying) as error:
        read_json(path, Whole)
    assert str(error.value).startswith(f"{path}: ")
    assert str(error.value).isprintable()


def test_json_becomes_what_was_asked_for(tmp_path):
    path = tmp_path / "file.json"
    path.write_text('{"name": "Für", "part": {"size": 2, "sides": [1, 2]}, "more": {"n": [null]}}')
    assert read_json(path, Whole) == Whole("Für", Part(2.0, (1, 2)), more={"n": [None]})
    path.write_text('{"name": ""}')
    assert read_json(path, Whole) == Whole("")


@pytest.mark.parametrize(
    ("content", "saying"),
    [
        (b"", "not JSON"),
        (b"{'name': 1}", "not JSON"),
        (b"\xff\xfe\x00", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b"1" * 5000, "not JSON"),
        (b"[]", "Expected `object`, got `array`"),
        (b"{}", "missing required field `name`"),
        (b'{"name": 3}', r"Expected `str`, got `int` - at `\$\.name`"),
        (b'{"name": "", "part": {"size": true}}', r"at `\$\.part\.size`"),
        (b'{"name": "", "part": {"sides": [1, 2.5]}}', r"at `\$\.part\.sides\[1\]`"),
        (b'{"name": "", "part": {"size": NaN}}', r"finite number, got nan - at `\$\.part\.size`"),
        (b'{"name": "", "more": {"n": [1e999]}}', r"finite number, got inf - at `\$\.more\.n\[0\]"),
        (b'{"name": "", "part": {"syze": 1}}', r"Unknown field 'syze' - at `\$\.part`"),
        (b'{"name": "", "kind": "a\\nb"}', r"at `\$\.kind`"),
        (b'{"name": "", "more": {"n": "\\ud800"}}', r"Expected text, got '\\ud800'"),
        (b'{"name": "", "part": {"size": "\\ud800"}}', r"Expected text.* at `\$\.part\.size`"),
    ],
)
def test_json_of_something_else_is_refused_in_one_line(tmp_path, content, saying):
    path = tmp_path / "file.json"
    path.write_bytes(content)
    assert_refused(path, saying)


def test_json_that_cannot_be_read_is_refused(tmp_path):
    assert_refused(tmp_path / "none", "there is no such file")
    assert_refused(tmp_path, r"cannot be read \(Is a directory\)")


def test_numbers_beyond_64_bits_are_kept():
    """The state of a random generator has 128."""
    assert checked({"n": 2**127 + 1}, dict[str, Any], "here") == {"n": 2**127 + 1}


# Arrays

EXPECTED = {
    "a": ArrayOf(FLOATS, ("T", 3), needed=True, finite=True),
    "b": ArrayOf(FLOATS, ("T",)),
    "name": ArrayOf(TEXT),
    "extra_*": ArrayOf(FLOATS, ("T",)),
}
ARRAYS = {"a": np.zeros((4, 3)), "b": np.ones(4, np.float32), "extra_x": np.zeros(4)}


@pytest.mark.parametrize(
    ("change", "saying"),
    [
        ({"a": np.zeros((4, 2))}, r"a is float64 of shape \(4, 2\); expected .* \(T, 3\)"),
        ({"a": np.zeros((4, 3), complex)}, "a is complex128"),
        ({"a": np.full((4, 3), np.inf)}, "a holds numbers that are not finite"),
        ({"b": np.zeros(5)}, r"b is float64 of shape \(5,\); .* shape \(T\), here T 4"),
        ({"b": np.array(["x"] * 4)}, "b is <U1"),
        ({"name": np.array(3)}, "name is int64"),
        ({"extra_x": np.zeros((4, 4))}, "extra_x is"),
    ],
)
def test_arrays_of_something_else_are_refused(tmp_path, change, saying):
    path = tmp_path / "file.npz"
    np.savez(path, **ARRAYS)
    assert read_arrays(path, EXPECTED).keys() == ARRAYS.keys()
    np.savez(path, **(ARRAYS | change))
    with pytest.raises(CadenzaError, match=saying) as error:
        read_arrays(path, EXPECTED)
    assert str(error.value).startswith(f"{path}: ")
    with pytest.raises(CadenzaError, match="no array named a"):
        check_arrays({}, EXPECTED, "here")


def npz(**contents: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in contents.items():
            file.writestr(f"{name}.npy", content)
    return buffer.getvalue()


def npy(shape: tuple[int, ...], data: bytes, dtype: str = "<f8") -> bytes:
    """An array file whose header may lie."""
    buffer = io.BytesIO()
    header = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, header)
    return buffer.getvalue() + data


def lying_directory(size: int) -> bytes:
    """A file whose directory says that its only member unpacks to `size` bytes."""
    content = npz(a=npy((10**7,), bytes(8 * 10**7)))
    at = content.index(b"PK\x01\x02") + 24
    return content[:at] + size.to_bytes(4, "little") + content[at + 4 :]


@contextmanager
def with_little_memory() -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("content", "saying"),
    [
        (npz(a=npy((10**7,), bytes(8 * 10**7))), "would take 76 MiB, .* no more than 1 MiB"),
        (npz(**{f"a{i}": bytes(10**6) for i in range(100)}), "would take 95 MiB"),
        (lying_directory(1000), "not a readable"),
        (npz(a=npy((-1, -1), bytes(8))), "not a readable"),
        (npz(a=npy((2**62, 4), b"")), "not a readable"),
        (npz(a=npy((1,), bytes(8), "|O")), "not a readable"),
        (npz(a=npy((1,), b"\xff" * 4, "<U1")), "not a readable"),
        (npz(a=npy((1,), b"\x00\xd8\x00\x00", "<U1")), "not a readable"),
        (npz(**{"a\nb": npy((1,), bytes(8))}), "not a readable"),
    ],
)
def test_what_a_file_unpacks_to_is_bounded(tmp_path, content, saying):
    path = tmp_path / "file.npz"
    path.write_bytes(content)
    with with_little_memory(), pytest.raises(CadenzaError, match=saying):
        read_arrays(path, ANY, 2**20)


@pytest.fixture
def huge(tmp_path):
    """A file of 3 GiB that takes no room."""
    path = tmp_path / "huge"
    path.touch()
    os.truncate(path, 3 * 2**30)
    return path


def test_what_is_too_large_is_not_read(huge):
    with with_little_memory():
        for read in (
            content_of,
            lambda path: read_json(path, dict),
            lambda path: read_arrays(path, ANY),
            lambda path: read_tensors(path, ANY, 2**30),
        ):
            with pytest.raises(CadenzaError):
                read(huge)
        with pytest.raises(
            CadenzaError, match=r"takes 3,221,225,472 bytes, .* no more than 1,048,576"
        ):
            sha256_of(huge, max_bytes=2**20)


@pytest.mark.parametrize(
    ("text", "number"),
    [("0", 0), ("007", 7), ("+3600", 3600), ("1.5", 1.5), (".5", 0.5), ("2.", 2), ("1e3", 1000)],
)
def test_numbers_are_read_within_their_bounds(text, number):
    assert number_in(text, "time", 0, 3600) == number
    with pytest.raises(CadenzaError, match=f"^time '{re.escape(text)}'; expected a number, 4,000 "):
        number_in(text, "time", 4000, 5000)
    if text.strip("+0123456789") == "":
        assert whole_number_in(text, "bar", 0, 3600) == number


@pytest.mark.parametrize(
    "text",
    [
        *("", "x", "1_000", " 1", "١", "0x10", "--1", "1e", "nan", "inf", "-inf", "-1", "3601"),
        *("1e999", "9" * 41, "9" * 5000, "1" * 5000 + "x"),
    ],
)
def test_what_is_no_number_within_them_is_refused(text):
    for read in (number_in, whole_number_in):
        with pytest.raises(CadenzaError, match=r"^bar '.*; expected a (whole )?number, 0 to 3,600"):
            read(text, "bar", 0, 3600)


def test_a_digest_is_that_of_all_files_together(tmp_path):
    parts = [b"a" * 3_000_000, b"", b"b"]
    paths = [tmp_path / str(number) for number in range(len(parts))]
    for path, part in zip(paths, parts, strict=True):
        path.write_bytes(part)
    assert sha256_of(*paths) == hashlib.sha256(b"".join(parts)).hexdigest()


def test_what_is_not_asked_for_is_not_unpacked(tmp_path):
    path = tmp_path / "file.npz"
    path.write_bytes(npz(b=npy((10**7,), bytes(8 * 10**7)), a=npy((3,), bytes(24))))
    assert read_arrays(path, {"a": ArrayOf(FLOATS, ("T",))}, 100 + 128).keys() == {"a"}


def test_a_file_that_is_not_compressed_holds_no_more_than_its_size(tmp_path):
    np.savez(tmp_path / "stored.npz", **ARRAYS)
    assert read_arrays(tmp_path / "stored.npz", ANY).keys() == ARRAYS.keys()
    np.savez_compressed(tmp_path / "packed.npz", a=np.zeros(10_000))
    with pytest.raises(CadenzaError, match="would take"):
        read_arrays(tmp_path / "packed.npz", ANY)


def test_the_text_of_json_in_an_array_may_be_long(tmp_path):
    text = json.dumps(["ü"] * 10_000, ensure_ascii=False)
    np.savez(tmp_path / "file.npz", text=np.str_(text))
    assert str(read_arrays(tmp_path / "file.npz", {"text": ArrayOf(TEXT)})["text"]) == text


def test_tensors_come_back_with_what_there_is_to_know(tmp_path):
    path, arrays = tmp_path / "file.safetensors", {"a": np.arange(6.0).reshape(2, 3).T}
    expected = {"a": ArrayOf(FLOATS, (3, 2), needed=True)}
    facts = {"song": "Für", "length": 2, "scores": {"f1": None}}
    write_tensors(path, arrays, facts)
    once = path.read_bytes()
    read, read_facts = read_tensors(path, expected, 2**20)
    np.testing.assert_array_equal(read["a"], arrays["a"])
    assert read_facts == facts
    write_tensors(path, arrays, facts)
    assert path.read_bytes() == once
    write_tensors(path, arrays)
    assert read_tensors(path, expected, 2**20)[1] == {}


@pytest.mark.parametrize(
    ("arrays", "saying"),
    [
        ({}, "no array named a"),
        ({"a": np.zeros(3), "b": np.zeros(3)}, "b is float64"),
        ({"a": np.array([np.inf])}, "not finite"),
        ({"a\n": np.zeros(3)}, "names that cannot be printed"),
        ({"a": np.zeros(2**18)}, r"takes 2,097,\d+ bytes, .* no more than 1,048,576"),
    ],
)
def test_tensors_of_something_else_are_refused(arrays, saying, tmp_path):
    path = tmp_path / "file.safetensors"
    write_tensors(path, arrays)
    with pytest.raises(CadenzaError, match=saying) as error:
        read_tensors(path, {"a": ArrayOf(FLOATS, ("T",), needed=True, finite=True)}, 2**20)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


def test_any_byte_of_tensors_that_was_changed_is_noticed(tmp_path):
    path = tmp_path / "file.safetensors"
    write_tensors(path, {"a": np.arange(6.0).reshape(2, 3)}, {"number": 0.5, "none": None})
    content = path.read_bytes()
    for i in range(len(content)):
        path.write_bytes(content[:i] + bytes([content[i] ^ 1]) + content[i + 1 :])
        if content[i : i + 1].isspace():
            continue  # another blank may stand in for it
        with pytest.raises(CadenzaError, match=r"file\.safetensors") as error:
            read_tensors(path, ANY, 2**20)
        assert "\n" not in str(error.value)


def test_tensors_of_another_program_are_refused(tmp_path):
    path = tmp_path / "file.safetensors"
    path.write_bytes(safetensors.numpy.save({"a": np.zeros(3)}))
    with pytest.raises(CadenzaError, match="written by another program"):
        read_tensors(path, ANY, 2**20)


def test_tensors_that_could_not_be_read_again_are_not_written(tmp_path):
    path = tmp_path / "file.safetensors"
    write_tensors(path, {"a": np.zeros(3)}, max_bytes=2**20)
    before = path.read_bytes()
    with pytest.raises(CadenzaError, match="would take 8 MiB; such a file holds up to 1 MiB"):
        write_tensors(path, {"a": np.zeros(2**20)}, max_bytes=2**20)
    assert path.read_bytes() == before


@pytest.mark.parametrize("header", ["[1]", "{", "nonsense", '{"a": NaN}'])
def test_a_header_that_says_nothing_sensible_is_refused(header, tmp_path):
    path = tmp_path / "file.safetensors"
    path.write_bytes(safetensors.numpy.save({}, {"facts": header}))
    with pytest.raises(CadenzaError, match=r"file\.safetensors, header: ") as error:
        read_tensors(path, ANY, 2**20)
    assert "\n" not in str(error.value)


# Names


@given(text=st.text() | st.sampled_from(["..", ".", "", "...mid", "a/../b", "CON:x", "\udcff"]))
def test_a_folder_name_is_one_name_below_its_folder(text):
    name = folder_name(text)
    assert name == folder_name(name)
    assert name not in ("", ".", "..")
    assert Path("played", name).parent == Path("played")
    assert not set(name) & set("/\\:\0\n")
    assert len(name.encode()) <= 255
    assert name.isprintable()


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Für Elise", "Für Elise"),
        ("own:Agent", "own_Agent"),
        ("a/b", "a_b"),
        (".mid", "mid"),
        ("..", "_"),
        ("ü" * 200, "ü" * 127),
    ],
)
def test_a_folder_name_says_what_it_can(text, name):
    assert folder_name(text) == name


def test_names_that_are_no_text_are_escaped(tmp_path):
    name = os.fsdecode(b"F\xfcr")
    write_json(tmp_path / "file", {"song": name, "path": Path(name)})
    written = read_json(tmp_path / "file", dict[str, str])
    assert written == {"song": "F\\udcfcr", "path": "F\\udcfcr"}
