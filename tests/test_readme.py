"""What the README and the page of the command line tell people to run runs."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from cadenza.cli import main
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
SONGS = {
    *("OdeToJoy", "FurEliseOpening", "MinuetInG", "CMajorChordProgressionTwoHands"),
    *("CMajorScaleOneHand", "etudes/notes-6-0", "benchmark/band-1007"),
}
PLAYS = "play", "plan", "practice", "arrange", "train"
COMMANDS = (ROOT / "docs" / "command-line.md").read_text()


def blocks(language: str, page: str = README) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


def command_lines() -> list[str]:
    listed = [*blocks("sh"), blocks("sh", COMMANDS)[0]]
    lines = [line.split("#")[0].strip() for block in listed for line in block.splitlines()]
    commands = [line for line in lines if line.startswith("cadenza ")]
    assert len(commands) > 20
    return commands


def shortened(arguments: list[str]) -> list[str]:
    """What to add, so that a command does not take long: video and bench have own tests."""
    added = ["--no-video"] if arguments[0] in ("play", "practice", "train") else []
    if arguments[0] == "practice" and "--robot" not in arguments:
        added += ["--minutes", "0.02"]
    added += ["--first-seconds", "1"] if SONGS & set(arguments) and arguments[0] in PLAYS else []
    added += (
        ["--agents", "zero", "--seeds", "0", "--songs", "songs"] if arguments[0] == "bench" else []
    )
    learns = arguments[0] == "train" and "--resume" not in arguments
    return [*added, *(["--num-steps", "320", "--learning-starts", "300"] if learns else [])]


def test_the_python_examples_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    plays, steps = blocks("python")
    for example in (plays, steps):
        assert len([line for line in example.splitlines() if line.strip()]) <= 10
        exec(compile(example, "README.md", "exec"), {})
    assert float(capsys.readouterr().out.split()[0]) > 0.95
    assert (tmp_path / "joy" / "report.html").exists()


def test_the_commands_run_one_after_another(tmp_path, monkeypatch, capsys):
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    write_midi(Score((Note(0.0, 0.2, 60),)), tmp_path / "songs" / "one.mid")
    monkeypatch.chdir(tmp_path)
    for line in command_lines():
        arguments = shlex.split(line)[1:]
        if "--help" in arguments:
            with pytest.raises(SystemExit) as stop:
                main(arguments)
            assert stop.value.code == 0
        else:
            main([*arguments, *shortened(arguments)])
        assert capsys.readouterr().out, line


def test_the_make_targets_exist():
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    named = re.findall(r"^make ([a-z]+)", "\n".join(blocks("sh")), re.MULTILINE)
    assert {"play", "test"} <= set(named) <= set(targets)


def test_its_links_are_absolute_on_pypi():
    hooks = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["metadata"][
        "hooks"
    ]
    text = README
    for rule in hooks["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(rule["pattern"], rule["replacement"], text)
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert len(links) == len(re.findall(r"\]\(", README))
    assert all(link.startswith(("https://", "#")) for link in links)
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    assert all("raw.githubusercontent.com" in picture for picture in pictures)
