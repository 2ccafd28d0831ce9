"""What is peculiar to a hand stands in its folder: no other module names its joints.

The package is read, not run. Docstrings and comments may name what they like.
"""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

import cadenza
from cadenza.hands.registry import HANDS
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene

PACKAGE = Path(cadenza.__file__).parent
ELSEWHERE = [file for file in sorted(PACKAGE.rglob("*.py")) if file.parent.name != "hands"]


@cache
def literals(file: Path) -> tuple[tuple[object, int], ...]:
    """(value, line) of the literals in a file, but for docstrings."""
    tree = ast.parse(file.read_text())
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return tuple((node.value, node.lineno) for node in constants if id(node) not in alone)


@cache
def names_of_a_hand(hand: str) -> re.Pattern[str]:
    """Matches its joints and the prefixes of its sides and servos."""
    scene = build_scene(SceneConfig(hand=hand, reduced_action_space=False))
    joints = {name.split("_", 1)[1] for name in scene.hand_joint_names}
    sides = {name.split("_", 1)[0] + "_" for name in scene.hand_joint_names}
    return re.compile(rf"\b({'|'.join(joints)})\b|\b({'|'.join(sides)})|\bA_")


@pytest.mark.parametrize("hand", HANDS.own)
def test_joints_are_named_by_their_hand_only(hand):
    named = names_of_a_hand(hand)
    assert [
        f"{file}:{line}: {value}"
        for file in ELSEWHERE
        for value, line in literals(file)
        if isinstance(value, str) and named.search(value)
    ] == []
