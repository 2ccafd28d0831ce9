"""Files with something wrong in them, drawn at random."""

import copy
import io
import json
import math
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

from cadenza import files
from cadenza.errors import CadenzaError

Arrays = dict[str, np.ndarray]

MAX_LETTERS = 1000
"""More than a message of one line has, whatever it quotes."""
_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2.5, 10**6, -(10**30), 10**30, 10**400, 1e308, 1e-320),
    *(math.nan, math.inf, "", "x", "\ud800", "a\nb", "long" * 2000),
    *("../../etc/passwd", [], {}, [[]], {"": 0}),
)


@contextmanager
def at_most_refused() -> Iterator[None]:
    """Whatever is done in it may end in one line for a person, and in nothing else."""
    refused = ""
    with warnings.catch_warnings(action="ignore"):  # of numpy, about numbers that are none
        try:
            yield
        except CadenzaError as error:
            refused = str(error)
    assert refused.isprintable(), refused
    assert len(refused) < MAX_LETTERS, refused


def other_json(rng: np.random.Generator, value: Any) -> Any:
    """A copy of `value` with one of its parts, or itself, replaced, removed, or added to."""
    value = copy.deepcopy(value)
    places = list(_places(value))
    where, name = places[rng.integers(len(places))] if places else (None, None)
    new = copy.deepcopy(_VALUES[rng.integers(len(_VALUES))])
    if where is None or rng.random() < 0.05:
        return new
    match rng.integers(5):
        case 0:
            del where[name]
        case 1 if isinstance(where, dict):
            where["strange"] = new
        case 1:
            where.insert(name, new)
        case 2:
            for _ in range(2000):
                new = [new]
            where[name] = new
        case _:
            where[name] = new
    return value


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every container with every name in it; of a long list its ends."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield value, name
            yield from _places(part)
    elif isinstance(value, list):
        for i in sorted({*range(min(len(value), 3)), len(value) - 1} - {-1}):
            yield value, i
            yield from _places(value[i])


def json_bytes(value: Any) -> bytes:
    """JSON, also of what `json.dumps` cannot nest."""
    try:
        return json.dumps(value).encode()
    except RecursionError:
        return b"[" * 5000
    except ValueError:
        return b"1" * 5000


def other_arrays(rng: np.random.Generator, arrays: Arrays) -> Arrays:
    """The same with one of them changed, or missing."""
    arrays = dict(arrays)
    name = list(arrays)[rng.integers(len(arrays))]
    array = arrays.pop(name)
    if rng.random() < 0.1:
        return arrays
    if rng.random() < 0.05:
        return arrays | {name + "x": array}
    return arrays | {name: _other_array(rng, array)}


def _other_array(rng: np.random.Generator, array: np.ndarray) -> np.ndarray:
    match rng.integers(9):
        case 0:
            kinds = ("f2", "f8", "c16", "i1", "i8", "u8", "?", "U3", "S3", "M8[s]", "V4")
            return np.zeros(array.shape, kinds[rng.integers(len(kinds))])
        case 1:
            return np.array([{}, []], object)
        case 2:
            return np.zeros(array.shape, [("a", "f8"), ("b", "U2")])
        case 3:
            return array[None]
        case 4 if array.ndim:
            return array[:-1]
        case 5 if array.ndim:
            return np.concatenate([array, array[-1:]])
        case 6 if array.ndim > 1:
            return array.T
        case 7:
            return np.zeros((0, *array.shape[1:]), array.dtype)
    if array.dtype.kind == "U" and array.ndim == 0:
        texts = ("", "x", "a\nb", "[1]", "{", "null", "NaN", json.dumps({"n": [1e999]}))
        return np.str_(texts[rng.integers(len(texts))])  # type: ignore[return-value]
    array = array.copy()
    values = (-1, 0, 1, 2**31 - 1, 2**62, 1e30, 1e308, math.nan, math.inf, -math.inf)
    with np.errstate(all="ignore"):
        new = np.array(values[rng.integers(len(values))]).astype(array.dtype, casting="unsafe")
    array[tuple(rng.integers(size) for size in array.shape)] = new
    return array


def npz_bytes(arrays: Arrays, compressed: bool = False) -> bytes:
    buffer = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(buffer, allow_pickle=True, **arrays)
    return buffer.getvalue()


def tensor_bytes(arrays: Arrays, facts: Any = None) -> bytes:
    """A .safetensors file with the right digest, without what such a file cannot hold."""
    kinds = {name: array for name, array in arrays.items() if array.dtype.kind in "fiub"}
    try:
        return files.tensor_bytes(kinds, facts)
    except (RecursionError, TypeError, ValueError):  # facts that are none
        return safetensors.numpy.save(kinds, {"facts": json_bytes(facts).decode()})


def other_bytes(rng: np.random.Generator, content: bytes) -> bytes:
    """Cut off, with bytes changed, inserted or left out."""
    start = int(rng.integers(len(content)))
    match rng.integers(4):
        case 0:
            return content[:start]
        case 1:
            return content[:start] + rng.bytes(4) + content[start + 4 :]
        case 2:
            return content[:start] + rng.bytes(9) + content[start:]
        case _:
            return content[:start] + content[start + 9 :]


def other_members(rng: np.random.Generator, content: bytes) -> bytes:
    """A zip file with a member more that is no array, twice the same, or in another way packed."""
    buffer = io.BytesIO()
    packing = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA)[rng.integers(3)]
    with (
        warnings.catch_warnings(action="ignore"),
        zipfile.ZipFile(io.BytesIO(content)) as old,
        zipfile.ZipFile(buffer, "w", packing) as new,
    ):
        for member in old.namelist():
            new.writestr(member, old.read(member))
        names = ("strange", "strange.npy", "../strange.npy", old.namelist()[0])
        new.writestr(names[rng.integers(4)], b"strange")
    return buffer.getvalue()


def other_tensors(rng: np.random.Generator, path: Path) -> bytes:
    """A .safetensors file with its arrays changed, or facts in its header, or bytes."""
    arrays, facts = files.read_tensors(path, files.ANY, 2**28)
    match rng.integers(4):
        case 0:
            return other_bytes(rng, path.read_bytes())
        case 1:
            return tensor_bytes(arrays, other_json(rng, facts))
        case _:
            return tensor_bytes(other_arrays(rng, arrays), facts)
