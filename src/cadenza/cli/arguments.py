"""The command line, read by tyro: options are fields of dataclasses, their docstrings the help.

tyro is called twice. `choose` finds the options on which other options and their defaults depend;
`parse` reads the whole command.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, make_dataclass, replace
from inspect import getdoc
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar, Union, cast

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from cadenza.agents.planner.config import PlannerConfig
from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.config import TrainingConfig
from cadenza.learning.learner import Preset
from cadenza.music.expression_rules import ExpressionRules
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import DomainRandomization, TaskConfig

T = TypeVar("T")

Flat = Annotated[T, tyro.conf.arg(name="")]
"""A configuration whose options have no prefix, as in `task: Flat[TaskConfig]`."""

Output = Annotated[T, tyro.conf.arg(aliases=["-o"])]
"""The option of where results go, as in `output: Output[Path]`."""

Quiet = Annotated[
    tyro.conf.FlagCreatePairsOff[bool],
    tyro.conf.arg(aliases=["-q"], help="Print nothing but warnings and errors."),
]
"""The option of all commands that show their progress."""

Verbose = Annotated[
    tyro.conf.FlagCreatePairsOff[bool],
    tyro.conf.arg(
        help="Print metrics, rewards, all remarks on the file, and why notes were missed."
    ),
]
"""The option of commands that print a verdict."""

SoundFont = Annotated[
    Path | None, tyro.conf.arg(help="A sound font (SF2) in place of the built-in piano.")
]
"""The option of commands that make sound."""

SETTINGS = (tyro.conf.DisallowNone,)
"""Settings of tyro: an option whose default is None cannot be given None."""

HELP_ALL = "--help-all"  # the option that lists what `--help` leaves out
_RARELY_SET = (
    *(TaskConfig, SceneConfig, DomainRandomization, ExpressionRules),
    *(PlannerConfig, TrainingConfig, DroQConfig),
)
"""Configurations whose options `--help` leaves out, except `_OFTEN_SET`."""
_OFTEN_SET = (
    *("hand", "hands", "keyboard", "stretch", "transpose", "initial_buffer_time"),
    *("num_steps", "residual", "num_envs", "seed"),
)
_FLAT_IN_OTHERS = "learner", "task", "scene"  # fields of the configurations of learning


@dataclass(frozen=True)
class Chosen:
    """The options on which other options and their defaults depend."""

    agent: str | None = None
    agents: tuple[str, ...] = ()
    student: str | None = None
    setup: str | None = None
    hand: str | None = None
    keyboard: str | None = None
    learner: str | None = None
    preset: Preset = "fast"
    residual: tyro.conf.FlagCreatePairsOff[bool] = False
    no_residual: tyro.conf.FlagCreatePairsOff[bool] = False
    resume: Path | None = None


def choose(prog: str, words: Sequence[str]) -> Chosen:
    """The options among the `words` after `prog` on which others depend."""
    chosen, _ = tyro.cli(
        Chosen, prog=prog, args=words, add_help=False, return_unknown_args=True, config=SETTINGS
    )
    return chosen


def parse(kind: type[T], prog: str, words: Sequence[str], default: T | None = None) -> T:
    """Read a command of the type `kind`, or print its help or an error and exit.

    `words` stand after `prog`, as "cadenza play"; options begin with those of `default`.
    """
    about = getdoc(kind) or ""
    if any(field.name in ("scene", "training") for field in fields(cast(Any, kind))):
        about += f"\n\nFor the options of task, scene, agent and training: {prog} {HELP_ALL}"
    return tyro.cli(
        kind,
        prog=prog,
        description=about,
        args=["--help" if word == HELP_ALL else word for word in words],
        default=cast(Any, tyro.MISSING_NONPROP if default is None else default),
        config=SETTINGS,
        registry=_registry(
            is_short_help=(asks := "--help" in words or "-h" in words),
            is_help=asks or HELP_ALL in words,
        ),
    )


def _registry(is_short_help: bool = False, is_help: bool = True) -> ConstructorRegistry:
    """The rules by which tyro makes options of a dataclass, which differ from its own in four ways.

    Configurations of learning have a task, a scene and a learner, whose options are flat. The
    docstring of a field becomes a paragraph. Help leaves out a default of None, which docstrings
    explain. Short help has no options that are rarely set, as tyro cannot read options that help
    does not list. Headings of groups, which take long, are left out except for help.
    """
    registry, asking = ConstructorRegistry(), False

    @registry.struct_rule
    def spec_of(info: StructTypeInfo) -> StructConstructorSpec | None:
        nonlocal asking
        if asking or not is_dataclass(info.type):
            return None
        asking = True
        spec: Any = ConstructorRegistry.get_struct_spec(info)
        asking = False
        hides = is_short_help and info.type in _RARELY_SET
        shown = () if info.type is DomainRandomization else _OFTEN_SET
        options = [_option(each, hides and each.name not in shown) for each in spec.fields]
        if not is_help:
            options = [replace(o, helptext="") if is_dataclass(o.default) else o for o in options]
        return replace(spec, fields=tuple(options))

    return registry


def _option(field: StructFieldSpec, hidden: bool) -> StructFieldSpec:
    kind: Any = field.type
    if hidden and not is_dataclass(kind):
        suppressed: Any = tyro.conf.Suppress
        kind = suppressed[kind]
    if field.default is None or field.default == ():
        kind = Annotated[kind, tyro.conf.arg(help_behavior_hint="")]
    if field.name in _FLAT_IN_OTHERS and is_dataclass(kind):
        kind = Annotated[kind, tyro.conf.arg(name="")]
    return replace(field, type=kind, helptext=lambda: _unwrapped(field.helptext))


def _unwrapped(helptext: str | Callable[[], str | None] | None) -> str | None:
    text = helptext() if callable(helptext) else helptext
    return None if text is None else " ".join(text.split())


def print_commands(
    commands: Mapping[str, type],
    groups: Mapping[str, str],
    prog: str,
    about: str,
    words: Sequence[str],
) -> NoReturn:
    """Print the list of commands, a shell's completion, or why `words` are no command, and exit.

    Names of commands may begin with one of `groups` (name -> purpose).
    """
    several = dict(commands)
    for group, purpose in groups.items():
        within = {name: several.pop(name) for name in commands if name.startswith(f"{group} ")}
        union = _any_of({name.split()[1]: kind for name, kind in within.items()})
        several[group] = make_dataclass(group, [("command", union)], namespace={"__doc__": purpose})
    tyro.cli(
        _any_of(several),
        prog=prog,
        description=about,
        args=words,
        config=SETTINGS,
        registry=_registry(),
    )
    raise AssertionError(f"{words} are a command")


def _any_of(commands: Mapping[str, type]) -> Any:
    """The union of the types of commands, each with its name and a line of help."""
    kinds = [
        Annotated[
            kind, tyro.conf.subcommand(name, description=str(kind.__doc__).partition("\n")[0])
        ]
        for name, kind in commands.items()
    ]
    return Annotated[Union[tuple(kinds)], tyro.conf.OmitSubcommandPrefixes]  # noqa: UP007
