"""The cards of the networks that come with the package."""

import re
from pathlib import Path

import pytest
from huggingface_hub import ModelCard

import cadenza
from cadenza.cli import COMMANDS, GROUPS
from cadenza.evaluation.summary import METRICS
from cadenza.learning.policy_folder import POLICY_FILE, remarks_on

ROOT = Path(__file__).parents[1]
PACKAGE = Path(cadenza.__file__).parent
WEIGHTS = sorted(path for ending in ("npz", "safetensors") for path in PACKAGE.rglob(f"*.{ending}"))
PAGES = "".join(page.read_text() for page in (ROOT / "docs").glob("*.md"))
LINKS = re.compile(r"\]\((?:https://github\.com/cadenza-piano/cadenza/blob/main/)?([^):]+)\)")


def test_there_are_networks():
    assert len(WEIGHTS) >= 5


@pytest.mark.parametrize("weights", WEIGHTS, ids=lambda path: path.parent.name)
def test_shipped_networks_have_a_card_with_figures_that_were_measured(weights):
    path = weights.with_name("README.md")
    card = ModelCard.load(path)
    parts = re.findall(r"^## (.+)$", card.text, re.MULTILINE)
    assert parts == ["Data", "Training", "Figures", "Limits"]
    for command in re.findall(r"^    cadenza (\w+)", card.text, re.MULTILINE):
        assert command in {*COMMANDS, *GROUPS}
    for target in LINKS.findall(card.text):
        assert any((at / target).exists() for at in (ROOT, path.parent)), target
    for result in card.data.eval_results or ():
        assert result.metric_type in METRICS
        assert f"{result.metric_value:.3f}" in card.text
        assert f"{result.metric_value:.3f}" in PAGES
        if weights.name == POLICY_FILE and result.metric_type == "f1":
            measured = remarks_on(weights.parent)["eval/f1"]
            assert result.metric_value == pytest.approx(measured, abs=5e-4)
