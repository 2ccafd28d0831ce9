"""What is played does not depend on the processor."""

import os
import subprocess
import sys

import pytest

PIECES = (
    "CMajorChordProgressionTwoHands",
    "Greensleeves",
    "ChromaticScale",
    "CanonInDOpening",
    "SonataFacileOpening",
)
# Which processor OpenBLAS is told it runs on, and what NumPy is told that this one lacks.
PROCESSORS = {
    "this": {},
    "Haswell": {"OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V4"},
    "Zen": {"OPENBLAS_CORETYPE": "Zen", "NPY_DISABLE_CPU_FEATURES": "X86_V4"},
    "SkylakeX": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "Sandybridge": {
        "OPENBLAS_CORETYPE": "Sandybridge",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3,X86_V4",
    },
}
PLAY = """
import hashlib, sys
from dataclasses import replace
import cadenza
seconds, *pieces = sys.argv[1:]
for piece in pieces:
    score = cadenza.load_song(piece)
    notes = tuple(note for note in score.notes if note.start < float(seconds))
    for agent in ("planner", "generalist"):
        actions = cadenza.play(replace(score, notes=notes), agent).episode["action"]
        print(piece, agent, len(actions), hashlib.sha256(actions.tobytes()).hexdigest())
"""


def run(code: str, processor: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A process that begins as on another processor, as far as this one can be one."""
    choices = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES")
    choices += ("OPENBLAS_NUM_THREADS",)  # which the tests choose
    env = {name: value for name, value in os.environ.items() if name not in choices}
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=env | PROCESSORS[processor],
        capture_output=True,
        text=True,
        check=True,
    )


def played(processor: str, seconds: float, *pieces: str) -> list[str]:
    """Digests of all actions of the pieces' first notes, by planner and generalist."""
    process = run(PLAY, processor, str(seconds), *pieces)
    assert "Warning" not in process.stderr
    return process.stdout.splitlines()


def test_the_beginning_is_the_same_bits_on_other_processors():
    here = played("this", 0.4, "CanonInDOpening")
    assert len(here) == 2
    assert played("Sandybridge", 0.4, "CanonInDOpening") == here


@pytest.mark.slow
@pytest.mark.parametrize("piece", PIECES)
def test_whole_pieces_are_the_same_bits_on_other_processors(piece):
    here = played("this", 60.0, piece)
    for processor in PROCESSORS:
        assert played(processor, 60.0, piece) == here, processor


def test_who_imports_numpy_first_is_told():
    """Once, however often it plays."""
    two = "play = cadenza.play; score = cadenza.Score((cadenza.Note(0, .1, 60),)); "
    code = f"import numpy, cadenza; {two} play(score, 'generalist'); play(score, 'generalist')"
    process = run(code, "Sandybridge")
    assert process.stderr.count("import cadenza first") == 1
