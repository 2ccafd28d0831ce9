"""The programs in examples/ run, and do what they say."""

import ast
import json
import re
import runpy
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import cadenza
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score

EXAMPLES = Path(__file__).parents[1] / "examples"
UP = Score((Note(0.0, 0.25, 60), Note(0.25, 0.5, 62)), title="Up")
DOWN = Score((Note(0.0, 0.25, 62), Note(0.25, 0.6, 60)), title="Down")


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run an example in a folder with two short songs; return the lines that it printed."""
    monkeypatch.chdir(tmp_path)
    for score in (UP, DOWN):
        write_midi(score, Path(f"{score.title}.mid"))

    def run(name: str, *arguments: str) -> list[str]:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return run


def test_every_example_is_run():
    tests = Path(__file__).read_text()
    for path in EXAMPLES.glob("*.py"):
        assert f'run("{path.stem}"' in tests


@pytest.fixture
def shown(tmp_path, monkeypatch):
    """Run the cells of a notebook as IPython does; return the display of each."""
    # Where only Stable-Baselines3 is tested, it is not there.
    from IPython.core.interactiveshell import InteractiveShell
    from traitlets.config import Config

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    shell = InteractiveShell.instance(config=Config({"HistoryManager": {"enabled": False}}))

    def shown(name: str) -> list[dict[str, str]]:
        cells = json.loads((EXAMPLES / name).read_text())["cells"]
        sources = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
        results = [shell.run_cell(source) for source in sources]
        for result in results:
            result.raise_error()
        return [shell.display_formatter.format(result.result)[0] for result in results]

    yield shown
    InteractiveShell.clear_instance()


def framed_in(html: str) -> str:
    """The page in a frame of it, as a browser reads it."""
    outputs: list[dict[str, str]] = []
    parser = HTMLParser()
    parser.handle_starttag = lambda _, attributes: outputs.append(dict(attributes))
    parser.feed(html)
    (frame,) = outputs
    return frame["srcdoc"]


def test_a_notebook_shows_a_page_with_sound(shown):
    played, metrics, shape, step, nothing = shown("play.ipynb")
    assert len(played["text/plain"]) < 100
    assert played["text/plain"].startswith("Performance('Twinkle, Twinkle, Little Star' by planner")
    page = framed_in(played["text/html"])
    assert page.startswith("<!doctype html>")
    assert page.rstrip().endswith("</html>")
    assert "Twinkle, Twinkle, Little Star" in page
    assert "audio/webm" in page
    assert 100_000 < len(page) < 3_000_000
    assert eval(metrics["text/plain"])["f1"] > 0.95
    assert eval(shape["text/plain"])[1] == 88
    assert step["text/plain"].startswith("((")
    assert nothing == {"text/plain": "None"}
    assert Path("played/notebook/report.html").exists()


def test_what_a_notebook_shows_is_bounded(monkeypatch):
    monkeypatch.setattr("cadenza.performing.performance._IN_A_NOTEBOOK", 2.0)
    long = cadenza.Score((*UP.notes, Note(2.0, 2.5, 60)), title="<Long>")
    performance = cadenza.play(long, "zero", task=cadenza.TaskConfig(control_timestep=0.5))
    html = performance._repr_html_()
    assert len(html) < 300
    assert "&lt;Long&gt;" in html


def test_a_random_agent(run):
    first, last = run("random_agent", "Up.mid")
    assert first.startswith("Up: observations (3412,), actions (39,)")
    assert float(last.split()[-1]) < 0.9


def test_a_loop_of_robopianist(run):
    lines = run("from_robopianist", "Up.mid")
    assert lines[0] == "39 actions, the last is sustain"
    metrics = [ast.literal_eval(line) for line in lines[2:]]
    assert len(metrics) == 2
    for each in metrics:
        assert each["length"] == 11
        assert 0 <= each["f1"] <= 1


def test_an_agent_of_ones_own(run):
    scores = dict(line.split(": F1 ") for line in run("own_agent", "Up.mid"))
    assert float(scores["planner"]) >= float(scores["Trembling"]) > 0.5
    assert Path("played/Trembling/report.html").exists()
    settings = json.loads(Path("played/Trembling/settings.json").read_text())
    assert settings["Trembling"] == {"noise": 0.02}


def test_a_reward_of_ones_own(run):
    rows = [line.rsplit("[", 1) for line in run("own_reward", "Up.mid")[1:]]
    sums = {name.strip(): np.fromstring(row.rstrip("]"), sep=" ") for name, row in rows}
    assert (sums["reward/wrong_keys"] <= 0).all()
    assert sums["reward/wrong_keys"].any()
    total = sums.pop("their sum")
    np.testing.assert_allclose(sum(sums.values()), total, atol=0.21)  # all rounded to a tenth


def test_a_new_hand(run, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)  # as for a program that is started there
    (line,) = run("claw", "Up.mid")
    assert float(line.removeprefix("F1 ")) > 0.9
    settings = json.loads(Path("played/claw/settings.json").read_text())
    assert settings["scene"]["hand"] == "claw:CLAW"


@pytest.mark.slow
def test_training(run):
    lines = run("train", "Up.mid", "400")
    metrics = json.loads(Path("played/metrics.json").read_text())
    assert lines == [f"F1 {metrics['f1']:.3f}"]
    rows = Path("run/metrics.jsonl").read_text().splitlines()
    steps = [json.loads(row)["step"] for row in rows]
    assert max(steps) >= 400
    with pytest.raises(cadenza.CadenzaError, match="already holds a run"):
        cadenza.train("Up.mid", "run")


@pytest.mark.slow
def test_training_with_stable_baselines3(run):
    pytest.importorskip("stable_baselines3", reason="make sb3 runs this")
    import torch

    torch.set_num_threads(1)  # more wait for each other where cores are busy
    # It learns from the 1000th step on, and the eight environments end an episode with the 1288th.
    lines = run("train_with_stable_baselines3", "--steps", "1288")
    for line, name in zip(lines, ("gym.make", "gym.make_vec"), strict=True):
        assert line.startswith(f"{name}: 1288 steps")
        first, last = re.findall(r"\[(.*?)\]", line)
        assert len(first.split(", ")) == len(last.split(", ")) == 3
        assert np.isfinite([float(number) for number in f"{first}, {last}".split(", ")]).all()


@pytest.mark.slow
def test_training_with_brax(run):
    """On the CPU, where the simulation alone compiles for minutes."""
    pytest.importorskip("brax")
    pytest.importorskip("mujoco_warp")
    lines = run("train_with_brax", "Up.mid", "80", "4")
    assert all(re.fullmatch(r"\d+ steps: return -?[\d.]+, F1 [\d.]+", line) for line in lines)


@pytest.mark.slow
def test_training_with_rsl_rl(run):
    pytest.importorskip("rsl_rl")
    run("train_with_rsl_rl", "Up.mid", "2", "4")
    assert Path("run/model_1.pt").exists()


def test_a_dataset(run):
    lines = run("make_dataset", "songs.npz", "Up.mid", "Down.mid")
    data = np.load("songs.npz")
    steps = [int(line.split()[1]) for line in lines[:2]]
    assert np.bincount(data["episode"]).tolist() == steps
    assert list(data["songs"]) == ["Up.mid", "Down.mid"]
    first = data["goal_keys"][data["episode"] == 1].argmax(axis=1).nonzero()[0][0]
    assert data["goal_keys"][steps[0] + first, 62 - 21]
    assert all(len(data[name]) == sum(steps) for name in data.files if name != "songs")
