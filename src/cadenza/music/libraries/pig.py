"""The PIG dataset of piano fingerings, which its authors do not allow to be passed on.

The published benchmark plays it: all of it as `repertoire-150`, and twelve pieces as `etude-12`.
"""

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import replace

from cadenza.errors import CadenzaError
from cadenza.music.libraries.imported import imported, is_imported
from cadenza.music.libraries.songs import Library, Song

ALL = "repertoire-150"
TWELVE = "etude-12"
WEBSITE = "https://beam.kisarazu.ac.jp/~saito/research/PianoFingeringDataset/"
_ETUDES = (
    "French Suite No. 1 Allemande",
    "French Suite No. 5 Sarabande",
    "Piano Sonata D. 845 1st mov.",
    "Partita No. 2 (6)",
    "Waltz Op. 64 No. 1",
    "Bagatelle Op. 3 No. 4",
    "Kreisleriana Op. 16 No. 8",
    "French Suite No. 5 Gavotte",
    "Piano Sonata No. 23 2nd mov.",
    "Golliwogg's Cakewalk",
    "Piano Sonata No. 2 1st mov.",
    "Piano Sonata K. 279 1st mov.",
)
_UNSAID = re.compile(r"\bin [a-h]\b([ -]?(flat|sharp))?( (major|minor))?|\b(no|mov|movement|mvt)\b")


def repertoire_150() -> Library:
    """The pieces of the dataset. Raises CadenzaError if the dataset has not been imported."""
    if not is_imported(ALL):
        raise CadenzaError(
            f"{ALL} and {TWELVE} are made of the PIG dataset, which may not be passed on: register "
            f"at {WEBSITE}, download it, and run `cadenza import pig FILE.zip`"
        )
    return imported(ALL)


def etude_12() -> Library:
    """Twelve pieces of the dataset, in the order of the published benchmark.

    Raises CadenzaError if the dataset has not been imported, or has none of them.
    """
    songs = etudes_among(repertoire_150().songs)
    if not songs:
        raise CadenzaError(
            f"{TWELVE}: none of its pieces is in {ALL}; import all of the PIG dataset, with "
            "`cadenza import pig FILE.zip --replace`"
        )
    return Library(TWELVE, tuple(replace(s, name=s.name.replace(ALL, TWELVE, 1)) for s in songs))


def etudes_among(songs: Sequence[Song]) -> tuple[Song, ...]:
    """The songs that are among the twelve etudes, by their titles."""
    by_work = {_work(song.title): song for song in reversed(songs)}
    return tuple(by_work[work] for work in map(_work, _ETUDES) if work in by_work)


def published_name(title: str) -> str:
    """The name of a piece in the published benchmark, such as PianoSonataD8451StMov."""
    words = re.sub(r"[\W_]+", " ", re.sub("[.,'’]", "", title))
    return words.title().replace(" ", "") or "Piece"


def _work(title: str) -> str:
    """The words and numbers of a title without "in C", "no.", "mov.": equal for equal works."""
    plain = unicodedata.normalize("NFKD", title).lower().replace("'", "").replace("’", "")
    words = " ".join(re.findall(r"[a-z]+|\d+", plain))
    return " ".join(_UNSAID.sub("", words).split())
