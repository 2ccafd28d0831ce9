"""The sets of the benchmark that come with Cadenza: etudes and songs for a band, in splits."""

from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from zipfile import ZipFile

from cadenza.music.etudes.library import HARDEST, KINDS, etude_name, etude_song
from cadenza.music.formats.midi import score_of
from cadenza.music.formats.midi_messages import parsed
from cadenza.music.libraries.songs import Library, Song
from cadenza.music.score import Score

BENCHMARK = "benchmark"  # the name of the library
_ETUDE_SEED = 1_000_000  # seed of all etudes, far from seeds in common use
_ETUDE_SPLITS = ("test", "valid", "train", "train", "train")
_BANDS = {"train": range(1000, 1036), "valid": range(1036, 1048), "test": range(1048, 1060)}
_BAND_FILES = Path(__file__).with_name("bands.zip")  # made up for Cadenza, and free of rights


def benchmark_sets() -> Library:
    """The 100 etudes and 60 songs for a band of version 1 of the benchmark.

    The splits are `etudes-train` (60 etudes), `etudes-valid` and `etudes-test` (20 each),
    `band-train` (36 songs), `band-valid` and `band-test` (12 each). Each split of etudes has as
    many of every kind as of every other, and as many of every difficulty.
    """
    return Library(BENCHMARK, (*_etudes(), *_bands()))


def _etudes() -> Iterator[Song]:
    """Yield an etude of each kind and difficulty; the splits lie diagonally in that table."""
    for kind, difficulty in product(range(len(KINDS)), range(1, HARDEST + 1)):
        split = _ETUDE_SPLITS[(kind + difficulty) % len(_ETUDE_SPLITS)]
        song = etude_song(etude_name(KINDS[kind], difficulty, _ETUDE_SEED))
        yield replace(song, split=f"etudes-{split}")


def _bands() -> Iterator[Song]:
    for split, numbers in _BANDS.items():
        for number in numbers:
            file = f"band-{number}.mid"
            yield Song(
                f"{BENCHMARK}/band-{number}",
                partial(_read_band, file),
                source="made-up song",
                split=f"band-{split}",
            )


def _read_band(file: str, tracks: Collection[int], _plain: bool) -> Score:
    with ZipFile(_BAND_FILES) as files:
        return score_of(parsed(files.read(file)), tracks, "")
