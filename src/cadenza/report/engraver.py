"""Engraving of a score by a process of its own, so that nothing need wait for it.

`python -m cadenza.report.engraver` reads a score on stdin, as `WrittenScore` has it, and prints
what `engraving_of` makes of it.
"""

import json
import os
import subprocess
import sys
from dataclasses import asdict
from functools import lru_cache
from tempfile import TemporaryFile

from cadenza.files import parsed_json
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.score import Score
from cadenza.report.engraving import engraving_of

_NICENESS = 5  # behind what plays
_MAX_KEPT = 4  # engravings


class Engraver:
    """The engraving of a score, which takes up to seconds."""

    def __init__(self, score: Score) -> None:
        """Begin to engrave a score."""
        self._output = TemporaryFile()  # noqa: SIM115  # closed with this
        command = [sys.executable, "-P", "-m", "cadenza.report.engraver"]
        with TemporaryFile() as file:
            file.write(json.dumps(asdict(WrittenScore.of(score))).encode())
            file.seek(0)
            self._process = subprocess.Popen(command, stdin=file, stdout=self._output)

    def __del__(self) -> None:
        self._process.kill()
        self._process.wait()

    def engraving(self, patience: float = 0.0) -> str | None:
        """Return the engraving; "" where there is none, None if not yet after `patience` [s]."""
        try:
            failed = self._process.wait(patience) != 0
        except subprocess.TimeoutExpired:
            return None
        self._output.seek(0)
        return "" if failed else self._output.read().decode()


@lru_cache(_MAX_KEPT)
def engraving_within(patience: float, score: Score) -> str:
    """Engraving of a score, see `Engraver`; the last ones are kept, as songs are played again.

    Raises TimeoutError if it takes longer than `patience` [s].
    """
    engraving = Engraver(score).engraving(patience)
    if engraving is None:
        raise TimeoutError
    return engraving


def main() -> None:
    """Engrave the score on stdin."""
    os.nice(_NICENESS)
    written = parsed_json(sys.stdin.buffer.read(), WrittenScore, "score")
    sys.stdout.write(engraving_of(written.score))


if __name__ == "__main__":
    main()
