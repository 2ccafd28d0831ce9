"""Folders on the Hugging Face hub, such as those of policies: `hub:OWNER/NAME` stands for one.

`hub:OWNER/NAME@REVISION` names a branch, a tag or a commit of it. Only files that Cadenza reads are
fetched, into the hub's own cache, and they are checked as all others when they are read: none of
them is executed.
"""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

from cadenza.errors import CadenzaError, extra_packages, is_full, shortened
from cadenza.files import files_in

_PREFIX = "hub:"
_NAME = re.compile(r"hub:([\w.-]+/[\w.-]+)(?:@([\w./-]+))?", re.ASCII)
_CARD = "README.md"


@dataclass(frozen=True)
class Kind:
    """A kind of folder on the hub."""

    name: str  # the kind in words
    repo_type: Literal["model", "dataset"]
    files: tuple[str, ...]  # patterns of the names of its files; `*` stands for any part of a name
    max_bytes: int  # of all files together


def is_on_hub(place: object) -> bool:
    """Whether the name of a folder is that of one on the hub."""
    return isinstance(place, str | Path) and str(place).startswith(_PREFIX)


def fetched(place: str | Path, kind: Kind) -> Path:
    """The folder that `place` names: a folder or `hub:OWNER/NAME`, maybe with `@REVISION`, fetched.

    Where the hub fails, an earlier copy is used. Raises CadenzaError if the folder does not exist
    on the hub, is of another kind or too large, or cannot be fetched.
    """
    if not is_on_hub(place):
        return Path(place)
    repo, revision = _parsed(str(place))
    if not sys.stderr.isatty():
        os.environ.setdefault("HF_HUB_DISABLE_PROGRESS_BARS", "1")  # read when it is imported
    with extra_packages("hub", str(place)):
        from huggingface_hub import HfApi
        from huggingface_hub.errors import RepositoryNotFoundError, RevisionNotFoundError
    where: dict[str, Any] = {"repo_type": kind.repo_type, "revision": revision}
    files = {"allow_patterns": list(kind.files), **where}
    api = HfApi()
    with _in_a_line(str(place), kind):
        try:
            info: Any = api.repo_info(repo, files_metadata=True, **where)
        except (RepositoryNotFoundError, RevisionNotFoundError):
            raise
        except Exception:  # the hub cannot be reached, or is down
            there = api.snapshot_download(repo, local_files_only=True, **files)
        else:
            _check_size(str(place), {f.rfilename: f.size for f in info.siblings or ()}, kind)
            there = api.snapshot_download(repo, **files)
    return Path(there)


def pinned(place: str, folder: Path) -> str:
    """The name on the hub of the very commit that was `fetched` to `folder`, or its path."""
    return f"{place.partition('@')[0]}@{folder.name}" if is_on_hub(place) else str(folder)


def upload(folder: Path, repo: str, kind: Kind, card: str) -> str:
    """Upload the files of a folder to the hub, as one commit; return where they are.

    The repository is made if there is none, with its owner's default visibility. Raises
    CadenzaError if the hub cannot be reached, or refuses the files.

    Args:
        folder: a folder of this kind. The card in it is uploaded, too.
        repo: OWNER/NAME.
        kind: what the folder is.
        card: a card for the repository, if the folder has none.
    """
    place = f"{_PREFIX}{repo}"
    if _parsed(place)[1] is not None:
        raise CadenzaError(f"{repo}: leave out the revision; each upload is a new commit")
    with extra_packages("hub", place):
        from huggingface_hub import CommitOperationAdd, HfApi
    names = [path for path in sorted(files_in(folder)) if _is_of(kind, path.as_posix())]
    own = folder / _CARD
    additions = [CommitOperationAdd(_CARD, str(own) if own.is_file() else card.encode())]
    additions += [CommitOperationAdd(name.as_posix(), str(folder / name)) for name in names]
    with _in_a_line(place, kind):
        api = HfApi()
        made = api.create_repo(repo, repo_type=kind.repo_type, exist_ok=True)
        api.create_commit(
            repo, additions, commit_message=f"Cadenza: {kind.name}", repo_type=kind.repo_type
        )
    return str(made)


def _parsed(place: str) -> tuple[str, str | None]:
    if (match := _NAME.fullmatch(place)) is None:
        raise CadenzaError(f"{place}: not a name on the hub; give hub:OWNER/NAME[@REVISION]")
    repo, revision = match.groups()
    return repo, revision


def _is_of(kind: Kind, name: str) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in kind.files)


def _check_size(place: str, sizes: dict[str, int | None], kind: Kind) -> None:
    """Raise a CadenzaError if no file is of the kind, or all of them are too large."""
    own = [size or 0 for name, size in sizes.items() if _is_of(kind, name)]
    if not own:
        raise CadenzaError(f"{place}: holds no {kind.name} of Cadenza; name another")
    if sum(own) > kind.max_bytes:
        raise CadenzaError(
            f"{place}: its files take {sum(own) / 2**20:,.0f} MiB, but no {kind.name} takes more "
            f"than {kind.max_bytes / 2**20:,.0f} MiB; name another"
        )


@contextmanager
def _in_a_line(place: str, kind: Kind) -> Iterator[None]:
    """Turn errors of the hub and its library into a `CadenzaError`."""
    from huggingface_hub import errors

    try:
        yield
    except errors.RepositoryNotFoundError as error:
        raise CadenzaError(
            f"{place}: there is no such {kind.name} on the hub, or it is private; check the name, "
            "or log in: hf auth login"
        ) from error
    except errors.RevisionNotFoundError as error:
        raise CadenzaError(f"{place}: there is no such revision; name another") from error
    except errors.LocalEntryNotFoundError as error:
        why = str(error.__context__ or error).strip().partition("\n")[0]
        raise CadenzaError(
            f"{place}: the hub cannot be reached ({why}), and no copy is here; try again later, or "
            "give a folder"
        ) from error
    except Exception as error:
        if isinstance(error, CadenzaError) or is_full(error):
            raise
        why = " ".join(str(error).split()) or type(error).__name__
        raise CadenzaError(f"{place}: the hub says: {shortened(why)}") from error
