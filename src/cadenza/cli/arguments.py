"""Reads the command line with tyro: options are fields of dataclasses, errors are one line.

Every field is an option, and always accepted. --help shows what most need, --help-all the rest:
of a command's own dataclass all fields but those marked `Advanced[...]`; of the configurations in
it (task, scene, planners, learner) only those named in `COMMON`.

tyro is called twice. The first call finds the options that decide which others there are, and what
these begin with (`choose`); the second reads the whole command (`parse`).
"""

from __future__ import annotations

import difflib
import inspect
import io
import re
import shlex
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass, is_dataclass, make_dataclass, replace
from itertools import groupby, takewhile
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from cadenza.cli.runs import Execution
from cadenza.errors import CadenzaError
from cadenza.evaluation.collecting.variation import Variation
from cadenza.learning.config import ImitationConfig, TrainingConfig
from cadenza.learning.learner import Preset
from cadenza.music.arrangement import Arrangement
from cadenza.music.expression_rules import ExpressionRules
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import DomainRandomization, TaskConfig

T = TypeVar("T")
Command = TypeVar("Command")

_ADVANCED = object()
Advanced = Annotated[T, _ADVANCED]
"""Marks a field of a command that only --help-all shows, as in `wandb: Advanced[str | None]`."""

Shell = Literal["bash", "zsh", "fish"]

_Flag = tyro.conf.FlagCreatePairsOff[bool]
_VERSION = Annotated[_Flag, tyro.conf.arg(help="Print the version and exit.")]
_COMPLETION = Annotated[
    Shell,
    tyro.conf.arg(
        help="Print a shell's completion script, see docs/command-line.md.", help_behavior_hint=""
    ),
]

Output = Annotated[T, tyro.conf.arg(aliases=["-o"])]
"""The option of where results go, as in `output: Output[Path]`."""

Quiet = Annotated[
    _Flag, tyro.conf.arg(aliases=["-q"], help="Print nothing but warnings and errors.")
]
"""The option of all commands that show their progress."""

SoundFont = Annotated[
    Path | None, tyro.conf.arg(help="A sound font (SF2) in place of the built-in piano.")
]
"""The option of commands that make sound."""

COMMON: dict[type, tuple[str, ...]] = {
    Arrangement: ("tracks", "plain", "level", "expression"),
    TaskConfig: ("stretch", "transpose"),
    SceneConfig: ("hands",),
    Execution: ("retry", "jobs", "executor"),
    Variation: ("noise", "mirror", "excerpt"),
    TrainingConfig: ("num_steps", "residual", "seed"),
    ImitationConfig: ("songs", "num_updates", "seed"),
}
"""The fields that --help shows of the configurations in a command."""

_GROUPS: dict[type, str] = {DomainRandomization: "randomization", ExpressionRules: "rules"}
"""Configurations in others without a prefix whose options have one nevertheless."""


@dataclass(frozen=True)
class Chosen:
    """The options that decide which others there are, and what these begin with."""

    help: Annotated[_Flag, tyro.conf.arg(aliases=["-h"])] = False
    help_all: _Flag = False
    agent: str | None = None
    agents: tuple[str, ...] = ()
    setup: str | None = None
    hand: str | None = None
    keyboard: str | None = None
    learner: str | None = None
    preset: Preset = "fast"
    residual: bool = False
    resume: Path | None = None


def choose(prog: str, words: Sequence[str]) -> Chosen:
    """Finds in the words of a command line what the options of the command depend on.

    Args:
        prog: the program and the command, as in "cadenza play".
        words: the words after them.

    Raises:
        CadenzaError: such an option has no value.
    """
    with _rules() as registry, _errors_in_a_line(prog):
        chosen, _ = tyro.cli(
            Chosen,
            prog=prog,
            args=words,
            registry=registry,
            add_help=False,
            return_unknown_args=True,
        )
    return chosen


def parse(
    kind: type[Command], prog: str, words: Sequence[str], default: Command | None, chosen: Chosen
) -> Command:
    """Reads a command of the type `kind`, or prints its help and exits.

    Args:
        kind: the dataclass of the command.
        prog: the program and the command, as in "cadenza play".
        words: the words after them.
        default: where the options begin, if not with the defaults of `kind`.
        chosen: says whether help is asked for, and how much of it.

    Raises:
        CadenzaError: something is missing, unknown or cannot be read.
    """
    begun: Any = tyro.MISSING_NONPROP if default is None else default
    if chosen.help or chosen.help_all:
        refused = getattr(kind, "refused", ())
        words, rules = ["--help"], _rules([kind], not chosen.help_all, refused)
    else:
        _check_names(prog, words, ["--help", "--help-all", *_option_names(kind, begun)])
        rules = _rules()
    with rules as registry, _errors_in_a_line(prog):
        command, unknown = tyro.cli(
            kind,
            prog=prog,
            description=_about(kind),
            args=words,
            default=begun,
            registry=registry,
            return_unknown_args=True,
        )
    if unknown:
        raise CadenzaError(f"one argument too many: {unknown[0]}; see {prog} --help")
    return command


def print_commands(
    commands: Mapping[str, Any], prog: str, about: str, completion: Shell | None = None
) -> None:
    """Prints what commands there are, or the script that completes them, and exits.

    Args:
        commands: name -> the dataclass of a command; or, for several commands under one name, what
            these are for and such a mapping of them.
        prog: what stands before the name of a command.
        about: what the help says first.
        completion: the shell for which to print the script.
    """
    kinds: Any = Annotated[_any_of(commands), tyro.conf.OmitSubcommandPrefixes]
    overall: list[Any] = [("command", kinds)]
    if " " not in prog:
        overall += [("version", _VERSION, False), ("completion", _COMPLETION, "bash")]
    words = ["--help"] if completion is None else ["--tyro-write-completion", completion, "-"]
    with _rules([*_flattened(commands)]) as registry:
        kind = make_dataclass("Overall", overall)
        tyro.cli(kind, prog=prog, description=about, args=words, registry=registry)


def _any_of(commands: Mapping[str, Any]) -> Any:
    """Returns the union of the types of commands, each with its name and a line of help."""
    kinds = []
    for name, kind in commands.items():
        if isinstance(kind, tuple):
            line, several = kind
            union: Any = Annotated[_any_of(several), tyro.conf.OmitSubcommandPrefixes]
            kind = make_dataclass(name.capitalize(), [("command", union)])
            line = f"{line}: {', '.join(several)}."
        else:
            line = _about(kind).split("\n")[0]
        kinds.append(Annotated[kind, tyro.conf.subcommand(name, description=line)])
    return Union[tuple(kinds)]  # noqa: UP007


def _flattened(commands: Mapping[str, Any]) -> Iterator[type]:
    for kind in commands.values():
        yield from _flattened(kind[1]) if isinstance(kind, tuple) else [kind]


def _about(kind: type) -> str:
    """Returns the docstring; empty under `python -OO`, where it is a list of the fields."""
    return "" if sys.flags.optimize > 1 else inspect.getdoc(kind) or ""


# Options

_NUMBERS = {int: "whole number", float: "number"}
_BETWEEN_NUMBERS = re.compile(r",|(?<=\d)x(?=\d)")
_HELP_ALL = StructFieldSpec("help_all", _Flag, False, "show all options and exit")


@contextmanager
def _rules(
    commands: Collection[type] = (), short: bool = False, refused: Collection[str] = ()
) -> Iterator[ConstructorRegistry]:
    """Yields the rules by which tyro makes options of dataclasses, for the block only.

    Under `python -O`, tyro's registries stay in force once they were used, and one would change
    the options of the next command line, too.

    Args:
        commands: those whose options are listed; empty to read a command line.
        short: whether only common options are listed.
        refused: names of options that are not listed.
    """
    registry = ConstructorRegistry()
    asking = False

    def by_tyro(own_rule: Callable[[Any], Any], info: Any) -> Any:
        nonlocal asking
        asking = True
        try:
            return own_rule(info)
        finally:
            asking = False

    @registry.primitive_rule
    def value(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
        if asking or commands or (wanted := _wanted(info.type)) is None:
            return None
        return _read_value(by_tyro(ConstructorRegistry.get_primitive_spec, info), info.type, wanted)

    @registry.struct_rule
    def options(info: StructTypeInfo) -> StructConstructorSpec | None:
        if asking or not is_dataclass(info.type):
            return None
        spec = by_tyro(ConstructorRegistry.get_struct_spec, info)
        fields = [field for field in spec.fields if field.name not in refused]
        if commands:
            fields = _listed(fields, info.type, info.type in commands, short)
        else:  # errors would repeat the help
            fields = [replace(field, helptext="") for field in fields]
        group = _GROUPS.get(info.type)
        return replace(spec, fields=tuple(_option(field, group, short) for field in fields))

    try:
        yield registry
    finally:
        asking = True


def _listed(
    fields: list[StructFieldSpec], kind: type, is_command: bool, short: bool
) -> list[StructFieldSpec]:
    """Returns the fields of the dataclass `kind` that help lists, --help-all first if needed."""
    common = COMMON.get(kind, ())
    listed = [
        field
        for field in fields
        if not short
        or _is_config(field)
        or field.name in common
        or (is_command and not _is_more(field))
    ]
    has_more = is_command and any(_is_more(field) for field in fields)
    return [_HELP_ALL, *listed] if has_more else listed


def _is_config(field: StructFieldSpec) -> bool:
    """Returns whether a field holds a configuration, each of whose fields is an option."""
    return is_dataclass(_parts(field.type)[0])


def _is_more(field: StructFieldSpec) -> bool:
    """Returns whether --help leaves out an option of this field of a command."""
    return _is_config(field) or _ADVANCED in _parts(field.type)


def _option(field: StructFieldSpec, group: str | None, in_one_list: bool) -> StructFieldSpec:
    """Returns the field with our help, and with its group in its name.

    If options are shown `in_one_list`, those of configurations have no prefix and no heading.
    """
    kind, *marks = _parts(field.type)
    if is_dataclass(kind):
        unprefixed: Any = Annotated[kind, tyro.conf.arg(name="")]
        return replace(field, type=unprefixed) if in_one_list else field
    behaviour = "" if tyro.conf.FlagCreatePairsOff in marks else _default_hint
    name = f"{group}.{field.name}" if group else None
    ours = tyro.conf.arg(name=name, metavar=_metavar(kind), help_behavior_hint=behaviour)
    return replace(
        field,
        type=Annotated[(kind, ours, *marks)],  # type: ignore[arg-type]
        helptext=lambda: _unwrapped(field.helptext),
    )


def _option_names(kind: Any, default: Any, prefix: str = "", bare: bool = False) -> Iterator[str]:
    """Yields the names of all options of a dataclass, as in "--randomization.mass".

    Args:
        kind: the dataclass.
        default: an instance with its defaults.
        prefix: what its options begin with.
        bare: whether the configurations in it have no prefix.
    """
    info = StructTypeInfo.make(kind, default, in_union_context=False)
    spec: Any = ConstructorRegistry.get_struct_spec(info)
    prefix = f"{_GROUPS[info.type]}." if info.type in _GROUPS else prefix
    for field in spec.fields:
        value, *marks = _parts(field.type)
        name = prefix + field.name.replace("_", "-")
        if is_dataclass(value):
            within = bare or tyro.conf.OmitArgPrefixes in marks
            yield from _option_names(value, field.default, "" if within else f"{name}.", within)
        elif tyro.conf.Positional not in marks:
            yield f"--{name}"
            if value is bool and tyro.conf.FlagCreatePairsOff not in marks:
                yield f"--{prefix}no-{name.removeprefix(prefix)}"
            for mark in marks:
                yield from getattr(mark, "aliases", None) or ()


def _parts(hint: Any) -> tuple[Any, ...]:
    """Returns a type, and the marks on it."""
    return get_args(hint) if get_origin(hint) is Annotated else (hint,)


def _unwrapped(helptext: Any) -> str:
    """Returns a docstring as one line."""
    text = helptext() if callable(helptext) else helptext
    return " ".join((text or "").split())


def _default_hint(default: str) -> str:
    if default in ("None", "", "''"):
        return ""
    return f"(default: {({'True': 'yes', 'False': 'no'}).get(default, default)})"


def _given(kind: Any) -> Any:
    """Returns the type of a value that is given: int for int | None."""
    kinds = [k for k in get_args(kind) if k is not NoneType]
    optional = get_origin(kind) in (Union, UnionType) and len(kinds) == 1
    return kinds[0] if optional else kind


def _single(kind: Any) -> Any:
    """Returns the type of a value or of each of several: int for int | None, tuple[int, ...]."""
    kind = _given(kind)
    kinds = {k for k in get_args(kind) if k is not ...}
    return kinds.pop() if get_origin(kind) is tuple and len(kinds) == 1 else kind


def _metavar(kind: Any) -> str | None:
    """Returns PATH for Path | None, {a,b} ... for several choices; None for tyro's own text."""
    single, given = _single(kind), _given(kind)
    several = " ..." if ... in get_args(given) else ""
    if get_origin(single) is Literal:
        return "{" + ",".join(map(str, get_args(single))) + "}" + several
    if single is kind or (get_origin(kind) is tuple and not several):
        return None
    count = len(get_args(given)) if get_origin(given) is tuple and not several else 1
    return " ".join([single.__name__.upper()] * count) + several


def _wanted(kind: Any) -> str | None:
    """Returns what an error tells to give for this type; None where any text will do."""
    single = _single(kind)
    if get_origin(single) is Literal:
        return f"choose from {', '.join(map(str, get_args(single)))}"
    if single is Path:
        return "give a name, or . for this folder"
    if single not in _NUMBERS:
        return None
    given = _given(kind)
    if get_origin(given) is not tuple:
        return f"give a {_NUMBERS[single]}"
    count = "" if ... in get_args(given) else f"{len(get_args(given))} "
    return f"give {count}{_NUMBERS[single]}s"


def _read_value(
    spec: PrimitiveConstructorSpec[Any], kind: Any, wanted: str
) -> PrimitiveConstructorSpec[Any]:
    """Returns `spec` with errors that say what is `wanted`.

    Several whole numbers may stand in one word: 1,2 or 640x360.
    """
    numbers = get_origin(_given(kind)) is tuple and _single(kind) is int

    def read(words: list[str]) -> Any:
        given = words
        if numbers:
            given = [n for word in words for n in _BETWEEN_NUMBERS.split(word) if n]
        try:
            if "" in words or (isinstance(spec.nargs, int) and len(given) != spec.nargs):
                raise ValueError
            return spec.instance_from_str(given)
        except ValueError:
            raise ValueError(f"{shlex.join(words)}: {wanted}") from None

    nargs = "*" if numbers else spec.nargs
    return replace(spec, instance_from_str=read, choices=None, nargs=nargs)


# Errors

_MEANT = (
    ("tempo bpm speed rate slow slower fast faster", "--stretch", "2 plays half as fast"),
    ("out folder dir save", "--output", "a folder for the results"),
    ("open show view browser gui render live", "--watch", "shows the hands on a page"),
    ("no-sound no-audio mute sound audio", "", "the page has sound, which can be turned off there"),
    ("model policy checkpoint player", "--agent", "the folder of a policy, or a name"),
    ("track channel channels instrument instruments", "--tracks", "numbers as in cadenza info"),
    ("start end length duration seconds max-seconds", "--first-seconds", "from the first note on"),
    ("key pitch semitones octave", "--transpose", "in semitones"),
    ("left right one-hand left-hand right-hand", "--hands", "left, right or both"),
    ("fingers finger pianist human", "--fingering", "human: as a pianist would"),
    ("volume velocity dynamics loudness", "", "keys are as loud as they are struck"),
    ("cores cpus jobs workers parallel", "--num-threads", "of a planner"),
    ("steps epochs timesteps total-timesteps", "--num-steps", "how long to train"),
    ("song file input midi mid i f", "", "name the song alone, as in cadenza play song.mid"),
    ("mp3 wav", "", "report.html has the sound, and played.mid the notes"),
    ("verbose v debug", "", "it prints all there is"),
    ("gpu cuda device cpu", "", "it runs on the CPU, without a choice"),
    ("force overwrite yes y", "", "it replaces its own results without asking"),
)
"""Names that people try, the option that does what they want, and what it takes or does."""

_WORDING = (
    (r"Missing from .*?: (.*) \(required\)", r"\1 is missing"),
    (r" \(required\) (.*) is missing", r" and \1 are missing"),
    (r"-\w \w+, (--[\w-]+) \w+ is missing", r"\1 is missing"),
    (r"Missing value for argument '(.*?)'.*", r"\1 needs a value"),
    (r"Error parsing (\S+): ", r"\1 "),
)
"""Patterns of errors of tyro, and how they are said in a line; others keep its words."""


@contextmanager
def _errors_in_a_line(prog: str) -> Iterator[None]:
    """Raises errors of tyro, which it prints in a box, as a CadenzaError of one line."""
    box = io.StringIO()
    try:
        with redirect_stderr(box):
            yield
    except SystemExit as end:
        if end.code in (0, None):  # it has printed help
            raise
        raise CadenzaError(f"{_in_a_line(box.getvalue())}; see {prog} --help") from None


def _check_names(prog: str, words: Sequence[str], known: Sequence[str]) -> None:
    """Raises a CadenzaError if `words` have an unknown option; it says which may be meant."""
    for word in takewhile(lambda word: word != "--", words):
        name = word.split("=")[0].replace("_", "-")
        if re.match("--?[a-z]", name) and name not in known:
            hint = _meant(name, known) or similar(name, known)
            raise CadenzaError(
                f"there is no option {name}{hint or f'; {prog} --help-all lists them'}"
            )


def _in_a_line(box: str) -> str:
    """Returns an error of tyro as one line: the text of its box between the title and a rule.

    It draws boxes of lines or, where the terminal has no such characters, rules of hyphens only.
    """
    lines = (line.strip("│ ") for line in box.splitlines()[1:])
    parts = groupby(lines, key=lambda line: line.strip("─╰╯-") != "")
    said = next((" ".join(part) for has_text, part in parts if has_text), "")
    for pattern, wording in _WORDING:
        said = re.sub(pattern, wording, said)
    return said.rstrip(".")


def _meant(word: str, known: Collection[str]) -> str:
    """Returns a hint from `_MEANT` for an unknown option; empty if there is none."""
    bare = word.lstrip("-")
    if any(name == f"{word}s" or name.endswith(f".{bare}") for name in known):
        return ""
    for tried, option, about in _MEANT:
        if bare in tried.split() and (not option or option in known):
            return f"; there is {option}: {about}" if option else f"; {about}"
    return ""


def similar(word: str, known: Sequence[str]) -> str:
    """Returns a question whether one of `known` was meant; empty if none is like `word`."""
    bare = {name.lstrip("-"): name for name in known}
    close = [name for name in known if name.endswith("." + word.lstrip("-"))]
    close = close or [bare[each] for each in difflib.get_close_matches(word.lstrip("-"), bare, 1)]
    return f"; did you mean {' or '.join(close)}?" if close else ""
