"""Songs for a band, generated from a seed, with the role of every note."""

from cadenza.music.etudes.band.file import band_score, write_band
from cadenza.music.etudes.band.making import make_band
from cadenza.music.etudes.band.parts import ROLES, Band, Part, Role, Section

__all__ = ["ROLES", "Band", "Part", "Role", "Section", "band_score", "make_band", "write_band"]
