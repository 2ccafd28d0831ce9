"""The sets of the benchmark that Cadenza makes up: etudes and songs for a band, in three splits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

from cadenza.music.etudes.library import HARDEST, KINDS, band_name, etude_name, etude_song
from cadenza.music.libraries.songs import Library, Song

BENCHMARK = "benchmark"
"""The name of the library."""
_ETUDE_SEED = 1_000_000  # of all etudes, far from seeds that anybody is likely to have used
_ETUDE_SPLITS = ("test", "valid", "train", "train", "train")
_BAND_SEEDS = {"train": range(1000, 1036), "valid": range(1036, 1048), "test": range(1048, 1060)}


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
    for split, seeds in _BAND_SEEDS.items():
        for seed in seeds:
            yield replace(etude_song(band_name(seed)), split=f"band-{split}")
