"""Folders of facts and arrays that are replaced atomically: checkpoints and policies.

`manifest.json` has the SHA-256 of each file. A folder that was changed or damaged is refused, and
nothing in a file is executed.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict

from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import (
    ANY,
    MAX_JSON,
    Expected,
    read_json,
    read_tensors,
    sha256_of,
    tensor_bytes,
    write_atomically,
)

MANIFEST, _FACTS, _ARRAYS = "manifest.json", "facts.json", "arrays.safetensors"
FILES = (MANIFEST, _FACTS, _ARRAYS)
_MAX_ARRAYS = 2**30  # bytes: policies take a few million, checkpoints ten times as many
MAX_BYTES = _MAX_ARRAYS + 2 * MAX_JSON
"""Bytes that all files of a folder may take."""


class _Manifest(TypedDict):
    kind: str
    sha256: dict[str, str]


def write_checksummed(
    folder: Path, kind: str, facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Writes `facts` as JSON and `arrays` to `folder`, in place of what it held.

    Args:
        folder: a reader sees the old one or the whole new one, or for a moment none.
        kind: The kind of the content, which `read_checksummed` checks.
        facts: numbers, text, lists and dictionaries of them.
        arrays: without objects.

    Raises:
        CadenzaError: the arrays take more than can be read again.
    """
    new, old = _beside(folder, "new"), _beside(folder, "old")
    _remove(new)
    new.mkdir(parents=True)  # nobody else's
    files = {_FACTS: (json.dumps(facts, indent=1) + "\n").encode(), _ARRAYS: tensor_bytes(arrays)}
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    files[MANIFEST] = json.dumps({"kind": kind, "sha256": digests}, indent=1).encode()
    try:
        if (size := len(files[_ARRAYS])) > _MAX_ARRAYS:
            raise CadenzaError(
                f"{folder}: its arrays take {size >> 20:,} MiB; a {kind} holds up to "
                f"{_MAX_ARRAYS >> 20:,} MiB"
            )
        for name, content in files.items():
            with write_atomically(new / name) as file:
                file.write(content)
    except BaseException:
        _remove(new)
        raise
    if folder.exists():  # else the old one may be all that there is
        _remove(old)
        os.rename(folder, old)
    os.rename(new, folder)
    _remove(old)


def is_there(folder: Path) -> bool:
    """Returns whether there is something for `read_checksummed` to read."""
    return _current(folder).exists()


def _current(folder: Path) -> Path:
    """Returns the folder with the content.

    A writer may be between two renames, or may have stopped there.
    """
    old = _beside(folder, "old")
    return old if old.exists() and not folder.exists() else folder


def read_checksummed(
    folder: Path, kind: str, expected: Expected = ANY
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Returns the facts, and the `expected` arrays.

    Raises:
        CadenzaError: the folder is missing, of another kind, changed or damaged.
    """
    folder = _current(folder)
    if not (folder / MANIFEST).exists():
        raise CadenzaError(f"{folder}: holds no {MANIFEST}, so it is no {kind}; name another")
    manifest = read_json(folder / MANIFEST, _Manifest)
    if manifest["kind"] != kind:
        raise CadenzaError(f"{folder}: is not a {kind} written by Cadenza")
    for name, most in ((_FACTS, MAX_JSON), (_ARRAYS, _MAX_ARRAYS)):
        if not (folder / name).is_file():
            raise CadenzaError(f"{folder}: the {kind} is incomplete; use another copy")
        if manifest["sha256"].get(name) != sha256_of(folder / name, most=most):
            raise CadenzaError(f"{folder / name}: damaged or modified; use another copy")
    facts = read_json(folder / _FACTS, dict[str, Any])
    if not expected:
        return facts, {}
    return facts, read_tensors(folder / _ARRAYS, expected, _MAX_ARRAYS)[0]


def _remove(path: Path) -> None:
    """Deletes a file, a folder or a link, but not what it links to."""
    if path.is_symlink() or path.is_file():
        path.unlink()
    else:
        shutil.rmtree(path, ignore_errors=True)


def _beside(folder: Path, suffix: str) -> Path:
    return folder.with_name(f".{folder.name}.{suffix}")
