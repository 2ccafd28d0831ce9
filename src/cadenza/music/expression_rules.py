"""The quantities of the rules of expression. Imports nothing heavy: the command line shows them."""

from dataclasses import dataclass

from cadenza.configs import in_short

MAX_QUANTITY = 10  # the most of a rule, and of the dose of all; 5 is a caricature already


@dataclass(frozen=True, slots=True)
class ExpressionRules:
    """The quantity k of each rule of the KTH rule system, 0 to 10; the dose multiplies all.

    The defaults are those of the default rule palette of Director Musices. Of the rules that it
    lacks, faster uphill and melody lead are 1, and inegales is off.
    """

    high_loud: float = 1.0
    """The higher, the louder: 1 is 3 dB an octave."""
    duration_contrast: float = 1.0
    """Notes shorter than 0.6 s become shorter and softer."""
    double_duration: float = 1.0
    """The shorter of two notes whose durations are 2:1 becomes longer."""
    faster_uphill: float = 1.0
    """Ascending notes follow each other sooner, at 1 by 2 ms."""
    phrase_arch: float = 1.5
    """Phrases begin and end slower and softer."""
    punctuation: float = 1.1
    """Small groups of notes are set apart by micropauses."""
    final_ritard: float = 1.0
    """The end slows down; at 1, the last 1.3 s to a quarter of the tempo."""
    melody_lead: float = 1.0
    """All else follows the melody, which is louder: 1 is 25 ms and 3 dB."""
    inegales: float = 0.0
    """The first of two short notes in a beat becomes longer."""

    __repr__ = in_short
