"""What commands that are refused say to a person."""

import pytest

from cadenza.cli import main


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """All that a command says on stderr, which exits with status 1."""
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    assert stop.value.code == 1
    output = capsys.readouterr()
    assert "Traceback" not in output.out + output.err
    return output.err


def refused_in_a_line(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The only line that it says there."""
    (line,) = refused(capsys, *words).splitlines()
    assert line.startswith("cadenza: ")
    return line
