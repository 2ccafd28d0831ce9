"""Etudes: practice pieces that are generated from a seed."""

from cadenza.music.etudes.library import KINDS, etude_names, make_etude
from cadenza.music.etudes.scales import DRILLS

__all__ = ["DRILLS", "KINDS", "etude_names", "make_etude"]
