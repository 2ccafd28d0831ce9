"""Files of results, and the verdict on a performance in print."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from cadenza.cli.printing import stages
from cadenza.errors import CadenzaError, counted
from cadenza.files import folder_name
from cadenza.music.formats.reading import SHEET, name_without_ending

if TYPE_CHECKING:
    from cadenza.music.score import Score
    from cadenza.performing.filming import Look
    from cadenza.performing.performance import Performance
    from cadenza.performing.setup import Setup
    from cadenza.report.tone import Tone

_SHEETS = (SHEET, ".pdf", ".svg", ".mid")  # endings of files of sheet music


def check_name(path: Path, suffix: str, what: str) -> None:
    """Check the name of an output file before anything is made for it.

    Raises CadenzaError if it has another ending than `suffix`, or is a folder; `what` explains.
    """
    if path.suffix != suffix:
        raise CadenzaError(f"{path}: {what}; choose a name with that ending")
    if path.is_dir():
        raise CadenzaError(f"{path}: is a folder; choose another name")


def check_sheet(path: Path, option: str) -> None:
    """Check the name of a file of sheet music and its folder, which this `option` chooses.

    Raises CadenzaError if it has none of the endings that `write_sheet` knows, or cannot be
    written.
    """
    endings = f"{', '.join(_SHEETS[:-1])} or {_SHEETS[-1]}"
    suffix = path.suffix if path.suffix in _SHEETS else SHEET
    check_name(path, suffix, f"sheet music is a {endings} file")
    check_writable(path.parent, option)


def write_sheet(score: Score, path: Path) -> None:
    """Write a score with its fingers by the ending of `path`, and print where it differs.

    Fingers of a .mid file are written beside it.
    """
    from cadenza.music.formats.fingering_file import SUFFIX, write_fingering
    from cadenza.music.formats.midi_sheet import write_midi_sheet
    from cadenza.music.formats.musicxml_writing import write_musicxml
    from cadenza.report.engraving import write_svg
    from cadenza.report.sheet_pdf import write_pdf

    remarks: tuple[str, ...] = ()
    if path.suffix == ".mid":
        write_midi_sheet(score, path)
        write_fingering(score, path.with_suffix(SUFFIX))
    elif path.suffix == ".pdf":
        remarks = write_pdf(score, path)
    else:
        remarks = (write_svg if path.suffix == ".svg" else write_musicxml)(score, path)
    for remark in remarks:
        print(f"{path}: {remark}")


def check_writable(folder: Path, option: str = "--output", mode: int = 0o777) -> None:
    """Check that results can be written to a folder, which is made with this `mode`.

    Raises CadenzaError if they cannot; `option` chooses another folder.
    """
    import tempfile

    try:
        folder.mkdir(mode, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise CadenzaError(
            f"{folder}: results cannot be written there ({error.strerror}); "
            f"choose another folder with {option}"
        ) from error


def default_folder(setup: Setup) -> Path:
    """The folder where the results of a song are written by default."""
    return Path("played") / folder_name(name_without_ending(setup.settings["song"]))


def agent_folder(setup: Setup) -> Path:
    """The folder in it for those of the agent; a policy's has its last two parts, as run-best."""
    parts = Path(setup.settings["agent"]).parts[-2:]
    return default_folder(setup) / folder_name("-".join(parts))


def save(
    performance: Performance,
    folder: Path,
    video: bool,
    voice: Tone | None = None,
    verbose: bool = False,
) -> None:
    """Write the results of a performance, print its verdict, and make its film.

    Without a `voice`, the built-in piano plays.
    """
    from cadenza.report.tone import tone

    voice = voice or tone
    with stages("playing") as progress:
        performance.save(folder, progress, voice=voice)
    print_verdict(performance, verbose)
    print(f"\nOpen {folder / 'report.html'}")
    if video:
        try:
            film(folder, voice)
        except CadenzaError as error:  # the other results are there all the same
            print(f"no film: {error}", file=sys.stderr)


def film(folder: Path, voice: Tone, path: Path | None = None, look: Look | None = None) -> None:
    """Make the film of the performance in a folder as `write_film` does, with progress."""
    from cadenza.performing.filming import write_film

    with stages("drawing") as progress:
        written = write_film(folder, path, look, voice, progress)
    print(f"Written to {written}")


def print_verdict(performance: Performance, verbose: bool) -> None:
    """Print the verdict and the advice, and if `verbose` all figures."""
    print(performance.verdict)
    if performance.advice:
        print(f"{performance.advice}.")
    if verbose:
        print()
        _print_figures(performance)
    if performance.metrics["unstable"]:
        print("the simulation became unstable and the episode ended early", file=sys.stderr)


def _print_figures(performance: Performance) -> None:
    """Print the metrics by their names in metrics.json, and why notes were missed."""
    from collections import Counter

    for name, value in performance.metrics.items():
        print(f"{name}: {value:.4g}" if isinstance(value, float) else f"{name}: {value}")
    causes = Counter((miss.sounded, miss.cause) for miss in performance.misses or ())
    for (sounded, cause), count in causes.most_common():
        print(f"{counted(count, 'note')} {'let go of early' if sounded else 'missed'}: {cause}")
    dropped = None if performance.track is None else performance.track.dropped
    for reason, count in Counter(reason for _, reason in dropped or ()).most_common():
        print(f"no finger for {counted(count, 'note')}: {reason}")
