"""Songs for a band, generated from a seed, with the role of every note."""

from cadenza.music.etudes.band.making import make_band
from cadenza.music.etudes.band.parts import (
    ROLES,
    Band,
    BandPart,
    BandSection,
    Role,
    band_score,
    write_band,
)

__all__ = [
    "ROLES",
    "Band",
    "BandPart",
    "BandSection",
    "Role",
    "band_score",
    "make_band",
    "write_band",
]
