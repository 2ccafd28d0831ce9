"""Data flows one way: which folder may import which, and only a hand's own names its joints."""

import ast
import re
import sys
from collections.abc import Collection, Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import cadenza
from cadenza.hands.registry import HANDS
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene

PACKAGE = Path(cadenza.__file__).parent
EVERYWHERE = {
    "cameras",
    "fingers",
    "errors",
    "files",
    "configs",
    "episode",
    "hub",
    "installing",
    "registry",
    "resumable",
    "rounding",
}
# What a folder stands on; it may import that, and what that stands on.
STANDS_ON: dict[str, set[str]] = {
    "music": set(),
    "keyboards": set(),
    "hands": set(),
    "scene": {"keyboards", "hands"},
    "fingering": {"music", "keyboards", "hands"},
    "sim": {"scene"},
    "arranging": {"fingering"},
    "tasks": {"fingering", "sim"},
    "agents": {"tasks"},
    "demonstrations": {"agents"},
    "learning": {"demonstrations"},
    "report": {"music"},
    "performing": {"learning", "report", "arranging"},
    "evaluation": {"performing"},
    "studio": {"performing"},
    "cli": {"evaluation", "studio"},
}
LIBRARIES: dict[str, set[str]] = {
    "music": {"numpy", "scipy", "mido", "filelock", "platformdirs", "verovio"},
    "keyboards": {"numpy", "mujoco"},
    "hands": {"numpy", "mujoco"},
    "scene": {"numpy", "mujoco", "threadpoolctl"},
    "fingering": {"numpy"},
    "arranging": {"numpy"},
    "sim": {"numpy", "mujoco", "jax", "mujoco_warp", "warp"},
    "tasks": {"numpy", "scipy", "gymnasium", "dm_env", "jax", "rsl_rl", "tensordict", "torch"},
    "agents": {"numpy", "scipy", "threadpoolctl"},
    "demonstrations": {"numpy", "av", "gymnasium", "minari", "pyarrow"},
    "learning": {
        "numpy",
        "scipy",
        "jax",
        "flax",
        "optax",
        "filelock",
        "huggingface_hub",
        "msgspec",
        "threadpoolctl",
    },
    "report": {
        "numpy",
        "scipy",
        "av",
        "symusic",
        "jinja2",
        "markupsafe",
        "threadpoolctl",
        "tensorboardX",
        "verovio",
        "wandb",
    },
    "evaluation": {"numpy", "scipy"},
    "studio": {"anyio", "numpy", "starlette", "uvicorn"},
}


def allowed(folder: str) -> set[str]:
    below = STANDS_ON[folder]
    return below | {folder} | EVERYWHERE | {name for part in below for name in allowed(part)}


def imports(file: Path) -> Iterator[str]:
    """Full names of all modules that `file` imports, also inside functions."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{file}: a relative import"
            # `from cadenza.music import goals` names a module, too.
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def imported_parts(folder: str) -> set[tuple[str, str]]:
    """(file, part of cadenza or library) for all that a folder imports."""
    names = set()
    for file in sorted((PACKAGE / folder).rglob("*.py")):
        for name in imports(file):
            parts = name.split(".")
            of_ours = parts[0] == "cadenza"
            names.add((str(file.relative_to(PACKAGE)), parts[1] if of_ours else f"lib {parts[0]}"))
    return names


def test_every_folder_has_its_place():
    folders = {path.name for path in PACKAGE.iterdir() if any(path.glob("*.py"))}
    assert folders == STANDS_ON.keys()


@pytest.mark.parametrize("folder", STANDS_ON)
def test_imports_only_what_it_stands_on(folder):
    ours = {(f, part) for f, part in imported_parts(folder) if not part.startswith("lib ")}
    assert [(f, part) for f, part in ours if part not in allowed(folder)] == []


@pytest.mark.parametrize("folder", LIBRARIES)
def test_imports_only_the_libraries_it_is_about(folder):
    """MuJoCo stays below tasks: tasks and agents see arrays."""
    libraries = {(f, part[4:]) for f, part in imported_parts(folder) if part.startswith("lib ")}
    known = LIBRARIES[folder] | sys.stdlib_module_names
    assert [(f, name) for f, name in libraries if name not in known] == []


def test_what_all_may_import_stands_on_nothing():
    for name in EVERYWHERE:
        parts = {
            n.split(".")[1] for n in imports(PACKAGE / f"{name}.py") if n.startswith("cadenza.")
        }
        assert parts <= EVERYWHERE


def test_no_module_imports_itself_by_way_of_others():
    """Not behind functions and not for names of types either.

    Python would bear these, but files of a circle can only be understood and changed together.
    """
    files = {module_of(file): file for file in PACKAGE.rglob("*.py")}
    graph = {
        module: {nearest(name, files) for name in imports(file)} - {module, None}
        for module, file in files.items()
    }
    TopologicalSorter(graph).prepare()  # whose error names a circle


def module_of(file: Path) -> str:
    """Its full name."""
    path = file.relative_to(PACKAGE.parent)
    return ".".join((path.parent if path.stem == "__init__" else path.with_suffix("")).parts)


def nearest(name: str, modules: Collection[str]) -> str | None:
    """The module that `name` is, or is in."""
    while name and name not in modules:
        name = name.rpartition(".")[0]
    return name or None


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
