"""Folders of files that are whole or not there: checkpoints and policies.

A folder lists the digests of its files in `manifest.json`. What was changed or damaged since is
refused; nothing that a file says is carried out.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import write_atomically

_MANIFEST = "manifest.json"


def write_sealed(
    folder: Path, kind: str, facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Writes `facts` as JSON and `arrays` to `folder`, in place of what it held.

    Args:
        folder: a reader sees the old one or the whole new one, or for a moment none.
        kind: what it is, for `read_sealed`.
        facts: numbers, text, lists and dictionaries of them.
        arrays: without objects.
    """
    new, old = _beside(folder, "new"), _beside(folder, "old")
    shutil.rmtree(new, ignore_errors=True)
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    files = {
        "facts.json": (json.dumps(facts, indent=1) + "\n").encode(),
        "arrays.npz": buffer.getvalue(),
    }
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    files[_MANIFEST] = json.dumps({"kind": kind, "sha256": digests}, indent=1).encode()
    try:
        for name, content in files.items():
            with write_atomically(new / name) as file:
                file.write(content)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    if folder.exists():  # else the old one may be all that there is
        shutil.rmtree(old, ignore_errors=True)
        os.rename(folder, old)
    os.rename(new, folder)
    shutil.rmtree(old, ignore_errors=True)


def read_sealed(folder: Path, kind: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Facts and arrays as they were written.

    Raises:
        CadenzaError: the folder is not there, of another kind, or was changed or damaged.
    """
    if not folder.exists() and _beside(folder, "old").exists():
        folder = _beside(folder, "old")  # whoever writes is between two renames, or stopped there
    manifest = _manifest(folder)
    if manifest.get("kind") != kind:
        raise CadenzaError(f"{folder}: is no {kind} that Cadenza wrote")
    try:
        digests = manifest["sha256"]
        contents = {name: (folder / name).read_bytes() for name in ("facts.json", "arrays.npz")}
        changed = [n for n, c in contents.items() if digests[n] != hashlib.sha256(c).hexdigest()]
    except (OSError, KeyError, TypeError) as error:
        raise CadenzaError(f"{folder}: the {kind} is not whole; take another copy") from error
    if changed:
        raise CadenzaError(f"{folder / changed[0]}: damaged or changed; take another copy")
    try:
        return json.loads(contents["facts.json"]), _arrays(contents["arrays.npz"])
    except Exception as error:  # not what `write_sealed` writes, though sealed: see `read_arrays`
        raise CadenzaError(f"{folder}: is no {kind} that Cadenza wrote") from error


def _arrays(content: bytes) -> dict[str, NDArray[Any]]:
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _manifest(folder: Path) -> dict[str, Any]:
    try:
        manifest = json.loads((folder / _MANIFEST).read_bytes())
    except OSError as error:
        raise CadenzaError(f"{folder}: there is no {_MANIFEST} to say what it is") from error
    except ValueError as error:
        raise CadenzaError(f"{folder / _MANIFEST}: damaged or changed") from error
    return manifest if isinstance(manifest, dict) else {}


def _beside(folder: Path, suffix: str) -> Path:
    return folder.with_name(f".{folder.name}.{suffix}")
