"""Practice pieces without end, drawn from a seed."""

from cadenza.music.etudes.etude import KINDS, etude, etude_names, make_etude

__all__ = ["KINDS", "etude", "etude_names", "make_etude"]
