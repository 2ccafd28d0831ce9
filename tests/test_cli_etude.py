"""`cadenza etude`, as a person types it."""

import re

import numpy as np
import pytest

from cadenza.cli import main
from cadenza.music.etudes import KINDS, make_etude
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Score
from refusals import refused_in_a_line


def check_same(read: Score, made: Score) -> None:
    """To half a tick of the file."""
    table = [[(n.start, n.end, n.pitch, n.velocity) for n in s.notes] for s in (read, made)]
    np.testing.assert_allclose(*table, atol=2e-5, rtol=0)


def test_an_etude_is_written_and_read_back(tmp_path, capsys):
    path = tmp_path / "new" / "etude.mid"
    main(["etude", "--kind", "arpeggios", "--difficulty", "3", "--seed", "7", "-o", str(path)])
    wanted = make_etude("arpeggios", 3, 7)
    said = capsys.readouterr().out
    assert f"{path}: {wanted.title} (" in said
    name = said.split("cadenza play ")[1].strip()
    assert load_score(name).notes == wanted.notes
    assert load_score(path).title == wanted.title
    check_same(load_score(path), wanted)


def test_what_is_not_given_is_drawn_and_said(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main(["etude"])
    found = re.match(r"([a-z-]+)-3-(\d+)\.mid: ", capsys.readouterr().out)
    assert found
    kind, seed = found[1], found[2]
    check_same(load_score(f"{kind}-3-{seed}.mid"), make_etude(kind, 3, int(seed)))
    main(["etude", "--seed", seed])
    assert capsys.readouterr().out.startswith(f"{kind}-3-{seed}.mid: ")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--kind", "waltz"], f"no etudes of kind 'waltz': choose from {', '.join(KINDS)}"),
        (["--difficulty", "11"], "difficulty 11: choose 1 to 10"),
        (["--seed", "-1"], "seed -1: choose 0 or more"),
        (["-o", "etude.mp3"], "etude.mp3: an etude is a .mid file"),
    ],
)
def test_what_cannot_be_made_is_said_in_a_line(arguments, said, capsys):
    assert said in refused_in_a_line(capsys, "etude", *arguments)
