"""Folders by the conventions of the Hugging Face hub, with a hub of our own."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from huggingface_hub import constants
from huggingface_hub.utils import disable_progress_bars

from cadenza.cli import main
from cadenza.errors import CadenzaError
from cadenza.installing import install_line
from cadenza.learning.policy_folder import load_policy, save_policy
from cadenza.learning.pretrained import pretrained_folder
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from hub_server import running
from learnt import from_nothing
from refusals import refused_in_a_line

ODE = pretrained_folder("OdeToJoy")
REPO = "someone/ode"
TWO_NOTES = Score((Note(0.0, 0.5, 60), Note(0.5, 1.0, 64)))


def ask(monkeypatch: pytest.MonkeyPatch, url: str) -> None:
    """Put another address in place of the hub's, here and in processes that are started."""
    monkeypatch.setenv("HF_ENDPOINT", url)
    template = url + constants.HUGGINGFACE_CO_URL_TEMPLATE.removeprefix(constants.ENDPOINT)
    monkeypatch.setattr(constants, "ENDPOINT", url)
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """A hub without repositories, in whose place nothing else is asked."""
    with running() as hub:
        ask(monkeypatch, hub.url)
        monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "cache"))
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
        monkeypatch.setenv("HF_TOKEN", "hf_of_nobody")
        monkeypatch.chdir(tmp_path)
        disable_progress_bars()
        yield hub


def files_of(folder: Path) -> dict[str, bytes]:
    there = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in there}


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What a command prints."""
    main(words)
    return capsys.readouterr().out


def test_a_policy_is_published_and_played(hub, tmp_path, capsys):
    own = tmp_path / "mine"
    shutil.copytree(ODE, own, ignore=shutil.ignore_patterns("README.md"))
    (own / "notes.txt").write_text("nobody else's business")
    assert hub.url in printed(capsys, "publish", "mine", REPO)
    (kept,) = hub.commits["models", REPO].values()
    assert kept.keys() == {"README.md", "policy.safetensors"}
    card = kept["README.md"].decode()
    assert card.startswith("---\nlibrary_name: cadenza\n")
    assert f"cadenza play --agent hub:{REPO}" in card
    assert "- F1: 1.000" in card

    main(["play", "--agent", f"hub:{REPO}", "-o", "played", "--quiet"])
    assert json.loads(Path("played", "metrics.json").read_text())["f1"] > 0.95
    hub.down = True  # what was fetched before is used
    assert load_policy(f"hub:{REPO}").score.title == "Ode to Joy"


def test_a_policy_of_the_hub_takes_part_in_many_runs(hub, tmp_path, capsys):
    write_midi(TWO_NOTES, tmp_path / "songs" / "two.mid")
    save_policy(tmp_path / "own", from_nothing(TWO_NOTES), {})
    commit = hub.commit("models", REPO, files_of(tmp_path / "own"))
    printed(capsys, "bench", "--songs", "songs", "--agents", f"hub:{REPO}", "-o", "bench")
    assert f"hub:{REPO}@{commit}" in printed(capsys, "results", "bench")


def test_a_commit_stays_what_it_was(hub):
    first = hub.commit("models", REPO, files_of(ODE))
    hub.commit("models", REPO, {"policy.safetensors": b"of another time"})
    assert load_policy(f"hub:{REPO}@{first}").score.title == "Ode to Joy"
    with pytest.raises(CadenzaError, match=r"not a readable \.safetensors file"):
        load_policy(f"hub:{REPO}")
    with pytest.raises(CadenzaError, match="@gone: there is no such revision"):
        load_policy(f"hub:{REPO}@gone")


def test_what_cannot_be_had_is_one_line(hub, monkeypatch, capsys):
    place = f"hub:{REPO}"

    def said(*words: object) -> str:
        return refused_in_a_line(capsys, *words)

    assert f"{place}: there is no such policy on the hub" in said("play", "--agent", place)
    why = "hub:ode: not a name on the hub; give hub:OWNER/NAME"
    assert why in said("play", "--agent", "hub:ode")
    hub.commit("models", REPO, {"model.pkl": b"code", "config.json": b"{}"})
    assert f"{place}: holds no policy of Cadenza" in said("play", "--agent", place)
    hub.commit("models", REPO, files_of(ODE))
    hub.pretended_sizes["policy.safetensors"] = 2**40
    assert f"{place}: its files take 1,048,576 MiB" in said("play", "--agent", place)
    assert "so it is no policy; name another" in said("publish", ODE.parent, REPO)
    hub.commit("datasets", REPO, {"runs/../../../../../elsewhere/result.json": b"{}"})
    assert f"{place}: the hub says: " in said("dataset", "info", place)
    ask(monkeypatch, "http://127.0.0.1:1")
    assert f"{place}: the hub cannot be reached" in said("play", "--agent", place)


def test_fetching_in_a_pipe_prints_no_progress(hub):
    hub.commit("models", REPO, files_of(ODE))
    command = [sys.executable, "-c", f"import cadenza; cadenza.load_policy('hub:{REPO}')"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_without_its_library_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(CadenzaError, match=re.escape(install_line("hub"))):
        load_policy(f"hub:{REPO}")


def test_a_dataset_is_published_and_read(hub, tmp_path, capsys):
    write_midi(TWO_NOTES, tmp_path / "songs" / "two.mid")
    main(["dataset", "collect", "--songs", "songs", "--episodes", "1", "-o", "mine", "--quiet"])
    assert "/datasets/" in printed(capsys, "publish", "mine", "someone/scales")
    (kept,) = hub.commits["datasets", "someone/scales"].values()
    assert "1 episode of 1 song kept" in kept["README.md"].decode()
    place = "hub:someone/scales"
    assert printed(capsys, "dataset", "info", place).startswith("1 episode of 1 song kept")
    why = "there is no such policy on the hub"
    assert why in refused_in_a_line(capsys, "play", "--agent", place)
