"""Where there is too little memory, one line says so, whatever a library makes of it."""

import re

import mujoco
import numpy as np
import pytest

from cadenza.cli import main
from cadenza.errors import CadenzaError, by_others, extra_packages, quoted, shortened
from cadenza.installing import install_line

MUJOCO = mujoco.FatalError("Could not allocate memory")
LOADER = ImportError("libjax_common.so: failed to map segment from shared object")


@pytest.mark.parametrize("error", [MemoryError(), MUJOCO, LOADER], ids=["own", "mujoco", "loader"])
def test_a_command_without_memory_says_so(error, monkeypatch, capsys):
    def fail(_: str) -> None:
        raise error

    monkeypatch.setattr("cadenza.music.libraries.library.open_library", fail)
    with pytest.raises(SystemExit) as stop:
        main(["songs", "bundled"])
    assert stop.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("cadenza: there is not enough memory (")


@pytest.mark.parametrize("error", [MemoryError(), MUJOCO, LOADER], ids=["own", "mujoco", "loader"])
def test_code_of_others_without_memory_is_not_to_blame(error):
    with pytest.raises(CadenzaError, match="there is not enough memory"), by_others("agent own"):
        raise error


class WithoutRepr:
    def __repr__(self) -> str:
        raise RecursionError


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("Für Elise", "'Für Elise'"),
        ("one\ntwo\x1b[31m\u202e", r"'one\ntwo\x1b[31m\u202e'"),
        ("five thousand " * 400, f"'{('five thousand ' * 7)[:96]}..."),
        (np.zeros((3, 3)), "array([[0., 0., 0.], [0., 0., 0.], [0., 0., 0.]])"),
        pytest.param(10**5000, "a value of type int", id="digits"),
        (WithoutRepr(), "a value of type WithoutRepr"),
    ],
)
def test_what_was_read_is_quoted_in_a_short_line(value, message):
    assert quoted(value) == message


def test_an_argument_of_any_length_is_told_in_a_short_line(capsys):
    for words in ["results", "x" * 5000], ["play", "x" * 5000]:
        with pytest.raises(SystemExit) as stop:
            main(words)
        assert stop.value.code == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert len(line) < 1600


def test_words_of_others_become_a_short_line():
    assert shortened(" no\tsuch\n  \x07table ") == r"no such \x07table"
    assert shortened("word " * 1000, 12) == "word word..."


def test_a_package_without_memory_need_not_be_installed():
    with (
        pytest.raises(CadenzaError, match="there is not enough memory"),
        extra_packages("train", "training"),
    ):
        raise LOADER
    with (
        pytest.raises(CadenzaError, match=re.escape(install_line("train"))),
        extra_packages("train", "training"),
    ):
        raise ImportError("No module named 'jax'")


def test_what_is_blamed_on_a_file_may_be_a_lack_of_memory(monkeypatch, capsys):
    def read(_: str) -> None:
        try:
            raise MemoryError
        except MemoryError as error:
            raise CadenzaError("song.mxl: cannot be read as MusicXML") from error

    monkeypatch.setattr("cadenza.music.libraries.library.open_library", read)
    with pytest.raises(SystemExit):
        main(["songs", "bundled"])
    assert "there is not enough memory (MemoryError)" in capsys.readouterr().err
