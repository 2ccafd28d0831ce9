"""`cadenza etude`: a practice piece as a file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cadenza.cli.arguments import Output
from cadenza.cli.saving import check_name, check_writable
from cadenza.music.etudes import DRILLS, KINDS

_USUAL_DIFFICULTY = 3


@dataclass(frozen=True)
class Etude:
    """Write a practice piece to a MIDI file, a different one for every seed.

    Example: cadenza etude --kind arpeggios --difficulty 3 --seed 7 -o etude.mid
    """

    kind: Annotated[
        str | None,
        tyro.conf.arg(
            help=f"Kind of piece, by default drawn from {', '.join(KINDS)}. For one hand there are "
            f"also {', '.join(DRILLS)}."
        ),
    ] = None
    difficulty: int | None = None
    """The difficulty from 1 to 10, 3 by default; for one hand, the number of notes or chords."""
    seed: int | None = None
    """Random seed. By default one is drawn and printed."""
    output: Output[Path | None] = None
    """The file, KIND-DIFFICULTY-SEED.mid by default."""


def etude(command: Etude) -> None:
    import numpy as np

    from cadenza.configs import MAX_SEED, whole_number
    from cadenza.music.etudes.library import etude_name, make_etude
    from cadenza.music.formats.midi import write_midi

    if command.output is not None:
        check_name(command.output, ".mid", "an etude is a .mid file")
    seed = int(np.random.default_rng().integers(2**31)) if command.seed is None else command.seed
    rng = np.random.default_rng(whole_number(seed, "seed", 0, MAX_SEED))
    kind = KINDS[int(rng.integers(len(KINDS)))] if command.kind is None else command.kind
    difficulty = _USUAL_DIFFICULTY if command.difficulty is None else command.difficulty
    score = make_etude(kind, difficulty, seed)
    path = command.output or Path(f"{kind}-{difficulty}-{seed}.mid")
    check_writable(path.parent)
    write_midi(score, path)
    print(f"{path}: {score.title} ({score.total_time:.1f} s, {len(score.notes)} notes)")
    print(f"The same without a file: cadenza play {etude_name(kind, difficulty, seed)}")
