"""What is peculiar to a hand or a keyboard stands in its folder, and nowhere else in the package.

The package is read, not run: names of joints, counts of keys and fingers, and figures are looked
for among its literals. Docstrings and comments may name what they like.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import cadenza
from cadenza.hands.registry import HANDS
from cadenza.keyboards.piano import PIANO
from cadenza.keyboards.registry import KEYBOARDS, keyboard_named
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene

PACKAGE = Path(cadenza.__file__).parent
PECULIAR = ("hands", "keyboards")
COUNTS = {5, 10, 88}
# Where one of these numbers may stand, and what it counts there.
ALLOWED = {
    ("agents/planner/search/hand_search.py", 5): "steps that are simulated",
    ("arranging/likeness.py", 10): "different pitches",
    ("agents/planner/search/hand_rehearsal.py", 5): "rollouts of a rehearsal",
    ("learning/algorithms/generalist/cloning.py", 5): "folds of songs",
    ("music/formats/finger_numbers.py", 5): "the fingers of a hand, in the numbering of files",
    ("music/formats/musicxml/dynamics.py", 10): "a velocity, pppp",
    ("music/formats/musicxml/timeline.py", 10): "the base of powers",
    ("music/formats/midi_chunks.py", 88): "the kind of a time signature in MIDI",
    ("music/expression_rules.py", 10): "the largest quantity of a rule",
    ("music/notation/voices.py", 5): "semitones",
    ("music/notation/note_values.py", 10): "how strong the beginning of a bar is",
    ("music/notation/quantising.py", 5): "parts of a beat",
    ("music/notation/spelling.py", 5): "fifths above the tonic; semitones and letters",
    ("music/notation/spelling.py", 10): "notes; semitones",
    ("music/libraries/pig_dataset.py", 10): "lines of a file that are named",
    ("music/signs/ornaments.py", 5): "the step A",
    ("music/score.py", 5): "semitones from C to F",
    ("music/score.py", 88): "the keys of a piano, which is what music is written for",
    ("agents/planner/search/networks/inputs.py", 5): "steps ahead; a column of the inputs",
    ("agents/planner/config.py", 10): "candidates and step sizes",
    ("agents/planner/practice/hand_practice.py", 10): "the base of the sizes of variations",
    ("cli/dataset.py", 10): "the most noise",
    ("music/arrangement.py", 10): "the hardest grade",
    ("fingering/transitions.py", 5): "kinds of changes",
    ("fingering/pianist.py", 5): "semitones",
    ("fingering/pianist.py", 10): "semitones; costs",
    ("music/etudes/drills.py", 5): "degrees of a sixth",
    ("music/etudes/library.py", 10): "grades of difficulty; steps a second",
    ("music/etudes/keys.py", 5): "semitones of scales; flats",
    ("music/etudes/keys.py", 10): "semitones of scales",
    ("learning/config.py", 10): "gradient steps",
    ("report/results_pages.py", 5): "pixels; seeds; digits",
    ("report/results_pages.py", 10): "pixels",
    ("report/sound.py", 10): "seconds of sound; the base of decibels",
    ("report/sound.py", 88): "the seed of the room's noise",
    ("report/tone.py", 88): "the pitch of the last damper",
    ("scene/scene.py", 10): "MuJoCo's ratio of frictional to normal impedance",
    ("report/engraver.py", 5): "how nice a process is to others",
    ("studio/practice_process.py", 10): "how nice a process is to others",
    ("studio/page_server.py", 5): "seconds that a connection is kept",
    ("tasks/config.py", 10): "steps of the lookahead",
}
MUSICAL = "music/etudes/band"  # full of semitones, degrees, programs and percentages
COINCIDENCES = {
    ("cli/practice.py", 0.999): "almost a step",
    ("learning/algorithms/droq/config.py", 0.999): "Adam's decay of squares",
    ("music/signs/conventions.py", 1.15): "multiples of velocity and tempo",
    ("music/signs/conventions.py", 1.33): "the tempo after an accelerando",
}


@cache
def literals(file: Path) -> tuple[tuple[object, int], ...]:
    """(value, line) of the literals in a file, but for docstrings."""
    tree = ast.parse(file.read_text())
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return tuple((node.value, node.lineno) for node in constants if id(node) not in alone)


def files(peculiar: bool) -> Iterator[tuple[str, Path]]:
    """(name, file) of what is in the folders of hands and keyboards, or of what is not."""
    for file in sorted(PACKAGE.rglob("*.py")):
        name = file.relative_to(PACKAGE).as_posix()
        if name.startswith(PECULIAR) == peculiar:
            yield name, file


@cache
def names_of_a_hand(hand: str) -> re.Pattern[str]:
    """Matches its joints and the prefixes of its sides and servos."""
    scene = build_scene(SceneConfig(hand=hand, reduced_action_space=False))
    joints = {name.split("_", 1)[1] for name in scene.hand_joint_names}
    sides = {name.split("_", 1)[0] + "_" for name in scene.hand_joint_names}
    return re.compile(rf"\b({'|'.join(joints)})\b|\b({'|'.join(sides)})|\bA_")


@pytest.mark.parametrize("hand", HANDS.own)
def test_joints_are_named_by_their_hand_only(hand: str) -> None:
    named = names_of_a_hand(hand)
    assert [
        f"{name}:{line}: {value}"
        for name, file in files(peculiar=False)
        for value, line in literals(file)
        if isinstance(value, str) and named.search(value)
    ] == []


def counted() -> dict[tuple[str, int], list[int]]:
    found: dict[tuple[str, int], list[int]] = {}
    for name, file in files(peculiar=False):
        for value, line in literals(file):
            if type(value) is int and value in COUNTS and not name.startswith(MUSICAL):
                found.setdefault((name, value), []).append(line)
    return found


def test_keys_and_fingers_are_not_counted_elsewhere() -> None:
    assert {place: lines for place, lines in counted().items() if place not in ALLOWED} == {}


def test_what_is_allowed_is_there() -> None:
    assert ALLOWED.keys() <= counted().keys()


def stated() -> set[float]:
    """Figures of hands and keyboards that nobody would write by chance: of three digits or more."""
    return {
        value
        for _, file in files(peculiar=True)
        for value, _ in literals(file)
        if isinstance(value, float) and len(re.sub(r"\.|e.*", "", repr(value)).strip("0")) > 2
    }


def test_no_figure_of_a_hand_or_a_keyboard_is_copied() -> None:
    known = stated()
    assert {0.01125, PIANO.sound_tolerance} < known
    follow = [
        figure
        for keyboard in map(keyboard_named, KEYBOARDS.own)
        for figure in (
            keyboard.white.travel,
            keyboard.black.travel,
            keyboard.spacing,
            keyboard.half_length,
        )
    ]
    assert [
        f"{name}:{line}: {value}"
        for name, file in files(peculiar=False)
        for value, line in literals(file)
        if isinstance(value, float)
        and (name, value) not in COINCIDENCES
        and (value in known or any(math.isclose(value, f, rel_tol=1e-3) for f in follow))
    ] == []
