"""The folder of the studio: uploads, and performances as `cadenza play` leaves them.

    FOLDER/uploads/ID.mid       a file that was dropped, and ID.json, facts about it
    FOLDER/ID/report.html ...   a performance, and studio.json, its entry in the list

Ids are made here. Names that a visitor gives are shown, and never part of a path.
"""

import hashlib
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.files import (
    TEMPORARY,
    content_of,
    modification_times,
    parsed_json,
    read_json,
    write_atomically,
    write_json,
)
from cadenza.music.formats.reading import MUSIC, ending_of
from cadenza.music.formats.source import printable
from cadenza.music.libraries.imported import imported, imported_libraries
from cadenza.music.libraries.songs import Song, bundled
from cadenza.music.score import Track
from cadenza.studio.broadcast import Broadcast
from cadenza.studio.request import HEADER_FILE, ROWS_FILE, PlayRequest

_ID_DIGITS = 16
_ID = re.compile(f"[0-9a-f]{{{_ID_DIGITS}}}")
ABOUT = "studio.json"  # file of a performance, with its entry in the list
MAX_UPLOADS = 200
_MAX_TITLE = 100
_ABANDONED = 3600.0  # [s] after which an unfinished file is deleted
FILES = {
    "report.html": "text/html; charset=utf-8",
    "played.mid": "audio/midi",
    "wanted.mid": "audio/midi",
}
"""Files of a performance that the page can fetch, and their types."""


@dataclass(frozen=True)
class Upload:
    """A file that was dropped."""

    id: str
    title: str
    ending: str
    seconds: float
    notes: int
    tracks: list[Track] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class KeptPerformance:
    """A performance that is kept, as the list shows it."""

    title: str
    request: PlayRequest
    verdict: str
    seconds: float
    finished: float  # the time [s] since 1970
    remarks: list[str] = field(default_factory=list)  # parts of the song that are not played


class Storage:
    """The folder of the studio, read and written."""

    def __init__(self, folder: Path) -> None:
        """Make the folder, where it is not there; raises OSError if that cannot be."""
        self.folder = folder.absolute()
        self.uploads = self.folder / "uploads"
        self.folder.mkdir(0o700, parents=True, exist_ok=True)
        self.uploads.mkdir(exist_ok=True)
        self._tidy()

    def _tidy(self) -> None:
        """Delete files that killed processes have left."""
        old = time.time() - _ABANDONED
        for path, changed in modification_times(self.folder.glob(".*")).items():
            is_ours = _ID.fullmatch(path.name[1:]) or _is_temporary(path)
            if changed < old and is_ours and path.is_dir():  # else rmtree waits for a pipe
                shutil.rmtree(path, ignore_errors=True)
        for path, changed in modification_times(self.uploads.glob("*")).items():
            unread = _ID.fullmatch(path.stem) and not self.is_listed(path.stem)
            if changed < old and (unread or _is_temporary(path)):
                with suppress(OSError):  # a folder of that name is somebody else's
                    path.unlink()

    # Songs

    def songs(self) -> list[dict[str, Any]]:
        """List uploads, the newest first, bundled pieces, and imported libraries."""
        uploaded = [asdict(upload) | {"uploaded": True} for upload in self._uploads()]
        return uploaded + [_about(song) for song in _library_songs()]

    def source(self, song: str) -> tuple[str, str, bool]:
        """Title, name or path, and whether it is an upload, or raise CadenzaError."""
        for library_song in _library_songs():
            if library_song.name == song:
                return library_song.title or song, song, False
        with suppress(CadenzaError):
            upload = self._upload(self.uploads / f"{song}.json")
            return upload.title, str(self.uploads / f"{song}{upload.ending}"), True
        raise CadenzaError("there is no such song; choose one from the list, or drop a file")

    def _uploads(self) -> list[Upload]:
        uploads = []
        for path in modification_times(self.uploads.glob("*.json")):
            with suppress(CadenzaError):  # somebody else's
                uploads.append(self._upload(path))
        return uploads

    def _upload(self, path: Path) -> Upload:
        """Read the facts of an upload. Raises CadenzaError if there is none."""
        upload = read_json(path, Upload) if _ID.fullmatch(path.stem) else None
        if upload is None or upload.id != path.stem or upload.ending not in MUSIC:
            raise CadenzaError("there is no such upload")
        return upload

    def write_upload(self, content: bytes, name: str) -> tuple[Path, str, str, str]:
        """Write an upload, which `list_upload` lists later.

        Raises CadenzaError if there are too many already. Returns its path, id, title and ending.
        """
        ending, id = ending_of(content), hashlib.sha256(content).hexdigest()[:_ID_DIGITS]
        path = self.uploads / f"{id}{ending}"
        if not self.is_listed(id) and len(self._uploads()) >= MAX_UPLOADS:
            raise CadenzaError(
                f"there are {MAX_UPLOADS} files of yours already; delete some by the × beside them"
            )
        with write_atomically(path) as file:
            file.write(content)
        return path, id, _title(name), ending

    def list_upload(self, upload: Upload) -> None:
        """List an upload."""
        write_json(self.uploads / f"{upload.id}.json", asdict(upload))

    def is_listed(self, id: str) -> bool:
        """Whether there is an upload of this id, which can be read."""
        return (self.uploads / f"{id}.json").exists()

    def remove_upload(self, id: str) -> None:
        """Delete an upload. Raises CadenzaError if there is none."""
        if not _ID.fullmatch(id) or not self.is_listed(id):
            raise CadenzaError("there is no such upload")
        for path in self.uploads.glob(f"{id}.*"):
            path.unlink(missing_ok=True)  # another page may delete it as well

    # Performances

    def performances(self) -> list[dict[str, Any]]:
        """List all complete performances, the newest first."""
        performances = []
        for path in self.folder.glob("*"):
            if not _ID.fullmatch(path.name) or path.is_symlink():
                continue
            with suppress(CadenzaError, OSError):
                kept = read_json(path / ABOUT, KeptPerformance)
                files = [name for name in FILES if _is_own(path / name)]
                facts = {"id": path.name, "files": files, "has_states": _has_states(path)}
                performances.append(asdict(kept) | facts)
        return sorted(performances, key=lambda kept: kept["finished"], reverse=True)

    def file(self, id: str, name: str) -> Path:
        """The path of one of `FILES` of a performance, or raise CadenzaError."""
        path = self._performance(id) / name
        if name not in FILES or not _is_own(path):
            raise CadenzaError("there is no such file")
        return path

    def broadcast(self, id: str) -> Broadcast:
        """The broadcast of a performance while it was played.

        Raises CadenzaError if there is no such performance, or it cannot be watched again.
        """
        folder = self._performance(id)
        kept = read_json(folder / ABOUT, KeptPerformance)
        status = {"state": "kept", "verdict": kept.verdict, "remarks": kept.remarks}
        if not _has_states(folder):
            raise CadenzaError("of this performance there is only the report")
        header, rows = content_of(folder / HEADER_FILE), content_of(folder / ROWS_FILE)
        parsed_json(header, dict[str, Any], folder / HEADER_FILE)  # else the page could not read it
        return Broadcast(kept.title, asdict(kept.request), status, [header], rows)

    def remove_performance(self, id: str) -> None:
        """Delete a performance. Raises CadenzaError if there is no such performance."""
        with suppress(FileNotFoundError):  # another page deletes it as well
            shutil.rmtree(self._performance(id))

    def _performance(self, id: str) -> Path:
        path = self.folder / id
        if not _ID.fullmatch(id) or path.is_symlink() or not _is_own(path / ABOUT):
            raise CadenzaError("there is no such performance")
        return path


def _is_own(path: Path) -> bool:
    """Whether a file lies here, and is no link to one that lies elsewhere."""
    return path.is_file() and not path.is_symlink()


def _is_temporary(path: Path) -> bool:
    """Whether a file or folder was being written."""
    return path.name.startswith(TEMPORARY)


def _has_states(folder: Path) -> bool:
    """Whether the states of a performance are there, so that it can be watched again."""
    return _is_own(folder / HEADER_FILE) and _is_own(folder / ROWS_FILE)


def _about(song: Song) -> dict[str, Any]:
    """The fields that the list shows of a song of a library."""
    return {
        "id": song.name,
        "title": song.title or song.name,
        "composer": song.composer,
        "grade": song.difficulty,
        "seconds": song.seconds or 0.0,
        "uploaded": False,
    }


def _library_songs() -> Iterator[Song]:
    """Yield the bundled songs, and those of the imported libraries, except damaged ones."""
    yield from bundled().songs
    for name in imported_libraries():
        with suppress(CadenzaError):
            yield from imported(name).songs


def _title(name: str) -> str:
    """A title that can be shown, made of the name of a file."""
    stem, dot, ending = name.strip().rpartition(".")
    bare = stem if f"{dot}{ending}".lower() in MUSIC else name
    return printable(bare)[:_MAX_TITLE] or "Untitled"
