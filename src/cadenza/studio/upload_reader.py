"""Reader of an upload, as a process of its own: `python -m cadenza.studio.upload_reader FILE`.

It prints facts about any file as JSON, or `{"error": ...}` in one line.
"""

import json
import sys
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.music.formats.reading import read_score
from cadenza.music.formats.source import title_of
from cadenza.music.score import Score
from cadenza.studio.limits import MAX_NOTES, MAX_SECONDS, READING, limit

_MAX_TRACKS, _MAX_REMARKS = 256, 20  # of a file on the page


def describe(path: Path) -> dict[str, Any]:
    """The fields that the page shows of a file.

    Raises CadenzaError if it is no music, or too much of it.
    """
    score = read_score(path)
    check_size(score)
    return {
        "title": _title(score, path),
        "seconds": score.total_time,
        "notes": len(score.notes),
        "tracks": [asdict(track) for track in score.tracks][:_MAX_TRACKS],
        "remarks": list(score.remarks)[:_MAX_REMARKS],
    }


def _title(score: Score, path: Path) -> str:
    """The title in a file; empty without one, or where it is rather the name of a part."""
    parts = [track.name for track in score.tracks] if len(score.tracks) > 1 else []
    return "" if score.title in (title_of(path), *parts) else score.title


def check_size(score: Score) -> None:
    """Raise a CadenzaError if there is nothing to play, or more than the studio takes."""
    if not score.notes:
        raise CadenzaError("there is nothing to play: the file has no notes")
    if score.total_time > MAX_SECONDS:
        minutes = f"{score.total_time / 60:.0f} minutes"
        raise CadenzaError(f"the music lasts {minutes}; the studio plays up to half an hour")
    if len(score.notes) > MAX_NOTES:
        raise CadenzaError(f"{len(score.notes)} notes; the studio plays up to {MAX_NOTES}")


def error_without_path(error: BaseException, path: Path | None) -> str:
    """An error in one line that does not say where a file lies on this machine."""
    text = str(error)
    if path is not None:
        text = text.removeprefix(f"{path}: ").replace(str(path), "the file")
    return " ".join(text.split()) or type(error).__name__


def main() -> None:
    """Read the file that the command line names."""
    path = Path(sys.argv[1])
    warnings.simplefilter("ignore")
    try:
        limit(READING)
        answer = describe(path)
    except (CadenzaError, OSError) as error:
        answer = {"error": error_without_path(error, path)}
    except MemoryError:
        answer = {"error": "the file needs too much memory"}
    except Exception:  # of a library that reads formats
        answer = {"error": "the file is damaged or not music"}
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
