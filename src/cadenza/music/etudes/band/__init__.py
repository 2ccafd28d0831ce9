"""Songs for a band, generated from a seed, with the role of every note."""

from cadenza.music.etudes.band.making import make_band
from cadenza.music.etudes.band.parts import ROLES, Band, Part, Role, Section, band_score, write_band

__all__ = ["ROLES", "Band", "Part", "Role", "Section", "band_score", "make_band", "write_band"]
