"""Etudes: practice pieces that are generated from a seed."""

from cadenza.music.etudes.band import Band, make_band, write_band
from cadenza.music.etudes.library import KINDS, etude_names, make_etude
from cadenza.music.etudes.scales import DRILLS

__all__ = [
    "DRILLS",
    "KINDS",
    "Band",
    "etude_names",
    "make_band",
    "make_etude",
    "write_band",
]
