"""Accents where drums are struck."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadenza.music.score import CHORD_TOLERANCE, LOUDEST, Note, Score

_ACCENTING = {35, 36, 38, 40, 49, 57}  # bass drums, snares, crashes; others mark every beat
_MOST = 16  # velocities, as from mezzo-forte to forte, that the loudest stroke adds; a choice


def accented(score: Score) -> Score:
    """The score with louder notes where bass drums, snares or crash cymbals are struck.

    A note is louder by up to 16 velocities, in proportion to the loudest of these strokes.
    """
    strokes = [stroke for stroke in score.drums if stroke.pitch in _ACCENTING]
    time = np.array([stroke.start for stroke in strokes])
    velocity = np.array([stroke.velocity for stroke in strokes])

    def louder(note: Note) -> Note:
        stroke = velocity[np.abs(time - note.start) <= CHORD_TOLERANCE].max(initial=0)
        accent = round(_MOST * int(stroke) / LOUDEST)
        return replace(note, velocity=min(note.velocity + accent, LOUDEST))

    return replace(score, notes=tuple(map(louder, score.notes)))
