"""How the command line is read: options from the fields of dataclasses, their help, plain errors.

Every field is an option, and always accepted. --help shows what most need, --help-all the rest:
of a command's own dataclass all fields but those marked `Advanced[...]`; of the configurations in
it (task, scene, planners, learner) only those named in `COMMON`.
"""

from __future__ import annotations

import difflib
import inspect
import re
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, make_dataclass, replace
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from cadenza.errors import CadenzaError
from cadenza.evaluation.collecting.variation import Variation
from cadenza.learning.config import ImitationConfig, TrainingConfig
from cadenza.music.arrangement import Arrangement
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import DomainRandomization, TaskConfig

try:
    from tyro import _errors as errors
except ImportError:  # it may go in any version of tyro
    errors = None  # type: ignore[assignment]

T = TypeVar("T")
Command = TypeVar("Command")

_ADVANCED = object()
Advanced = Annotated[T, _ADVANCED]
"""Marks a field of a command that only --help-all shows, as in `wandb: Advanced[str | None]`."""

Shell = Literal["bash", "zsh", "fish"]

_Flag = tyro.conf.FlagCreatePairsOff[bool]
_COMPLETION = tyro.conf.arg(
    help="Print a shell's completion script, see docs/command-line.md.",
    help_behavior_hint="",
)

Quiet = Annotated[
    _Flag, tyro.conf.arg(aliases=["-q"], help="Print nothing but warnings and errors.")
]
"""The option of all commands that show how far they are."""

COMMON: dict[type, tuple[str, ...]] = {
    Arrangement: ("tracks", "reduce"),
    TaskConfig: ("stretch", "transpose"),
    SceneConfig: ("hands",),
    Variation: ("noise", "mirror", "excerpt"),
    TrainingConfig: ("num_steps", "residual", "seed"),
    ImitationConfig: ("songs", "num_updates", "seed"),
}
"""The fields that --help shows of configurations whose options have no prefix."""

_GROUPS: dict[type, str] = {DomainRandomization: "randomization"}
"""Configurations within others whose options have a prefix nevertheless."""


def parse(
    kind: type[Command], prog: str, arguments: Sequence[str], default: Command | None = None
) -> Command:
    """Reads a command of the type `kind`, or prints its help and exits.

    Args:
        prog: what stands before the arguments, as in "cadenza play".
        default: where the options begin, if not with the defaults of `kind`.

    Raises:
        CadenzaError: something is missing, unknown or cannot be read.
    """
    words = arguments[: arguments.index("--")] if "--" in arguments else arguments
    asked = {"-h", "--help", "--help-all"}.intersection(words)
    options = _registry(
        [kind],
        short=bool(asked) and "--help-all" not in asked,
        left_out=getattr(kind, "refused", ()) if asked else (),
    )
    with _plain_errors(kind, default, prog, words), options as registry:
        return tyro.cli(
            kind,
            prog=prog,
            description=_about(kind),
            args=["--help"] if asked else arguments,
            default=tyro.MISSING_NONPROP if default is None else default,
            registry=registry,
        )


def help_or_completion(
    commands: Mapping[str, Any],
    about: Mapping[str, str],
    prog: str,
    description: str,
    arguments: Sequence[str],
) -> None:
    """Prints what there is, for --help, or what completes it, and exits.

    Args:
        commands: by name a type, or such a mapping for several commands under one name.
        about: what these several are for, in a line.
        prog: what stands before the name of a command.
        description: of all of them.
        arguments: --help, or what asks for the completion of a shell.
    """
    kinds: Any = _any_of(commands, about)
    overall = make_dataclass(
        "Overall",
        [
            ("command", Annotated[kinds, tyro.conf.OmitSubcommandPrefixes]),
            ("version", Annotated[_Flag, tyro.conf.arg(help="Print the version and exit.")], False),
            ("completion", Annotated[Shell, _COMPLETION], "bash"),
        ],
    )
    if arguments[0] == "--completion":
        arguments = ["--tyro-write-completion", *arguments[1:], "-"]
    with _registry([*_all(commands)], short=False) as registry:
        tyro.cli(overall, prog=prog, description=description, args=arguments, registry=registry)


def _any_of(commands: Mapping[str, Any], about: Mapping[str, str]) -> Any:
    kinds = (_subcommand(name, kind, about) for name, kind in commands.items())
    return Union[tuple(kinds)]  # noqa: UP007


def _all(commands: Mapping[str, Any]) -> Iterator[type]:
    for kind in commands.values():
        if isinstance(kind, Mapping):
            yield from _all(kind)
        else:
            yield kind


def _subcommand(name: str, kind: Any, about: Mapping[str, str]) -> Any:
    """With the first line of what the help of the command says."""
    if isinstance(kind, Mapping):
        several: Any = Annotated[_any_of(kind, {}), tyro.conf.OmitSubcommandPrefixes]
        line = f"{about[name]}: {', '.join(kind)}."
        kind = make_dataclass(name.capitalize(), [("command", several)])
    else:
        line = about_in_a_line(kind)
    return Annotated[kind, tyro.conf.subcommand(name, description=line)]


def about_in_a_line(kind: type) -> str:
    """The first line of what the help of a command says."""
    return _about(kind).split("\n")[0]


def _about(kind: type) -> str:
    """Empty under `python -OO`, where a dataclass has a list of its fields for a docstring."""
    return "" if sys.flags.optimize > 1 else inspect.getdoc(kind) or ""


_MEANT = (
    ("tempo bpm speed rate slow slower fast faster", "--stretch", "2 plays half as fast"),
    ("out folder dir save", "--output", "a folder for the results"),
    ("open show view browser gui render live", "--watch", "shows the hands on a page"),
    ("no-sound no-audio mute sound audio", "--no-video", "the page has sound anyway"),
    ("model policy checkpoint player", "--agent", "the folder of a policy, or a name"),
    ("track channel channels instrument instruments", "--tracks", "numbers as in cadenza info"),
    ("start end length duration seconds max-seconds", "--first-seconds", "from the first note on"),
    ("key pitch semitones octave", "--transpose", "in semitones"),
    ("left right one-hand left-hand right-hand", "--hands", "left, right or both"),
    ("resolution width height", "--video-size", "such as 1280 720"),
    ("volume velocity dynamics", "--loudness", "struck or score"),
    ("cores cpus jobs workers parallel", "--num-threads", "of a planner"),
    ("steps epochs timesteps total-timesteps", "--num-steps", "how long to train"),
    ("song file input midi mid i f", "", "name the song alone, as in cadenza play song.mid"),
    ("mp3 wav", "", "report.html has the sound, and played.mid the notes"),
    ("verbose v debug", "", "it prints all there is"),
    ("gpu cuda device cpu", "", "it runs on the CPU, without a choice"),
    ("force overwrite yes y", "", "it replaces its own results without asking"),
)
"""Names that people try, the option that does what they want, and what it takes."""


def _meant(word: str, known: Collection[str]) -> str:
    """What to do instead of giving an option that there is not; empty where that is unclear."""
    bare = word.lstrip("-")
    if any(name == f"{word}s" or name.endswith(f".{bare}") for name in known):
        return ""
    for tried, option, about in _MEANT:
        if bare in tried.split() and (not option or option in known):
            return f"; there is {option}: {about}" if option else f"; {about}"
    return ""


def similar(word: str, known: Sequence[str]) -> str:
    """Asks whether one of `known` was meant; empty where none is like `word`."""
    bare = {name.lstrip("-"): name for name in known}
    close = [name for name in known if name.endswith("." + word.lstrip("-"))]
    close = close or [bare[each] for each in difflib.get_close_matches(word.lstrip("-"), bare, 1)]
    return f"; did you mean {' or '.join(close)}?" if close else ""


# Options

_HELP_ALL = StructFieldSpec("help_all", _Flag, False, "show all options and exit")


@contextmanager
def _registry(
    commands: Collection[type], short: bool, left_out: Collection[str] = ()
) -> Iterator[ConstructorRegistry]:
    """How tyro makes options of the fields of `commands` and of their configurations.

    It does so within the block only. Under `python -O`, tyro's registries stay in force once they
    were used, and one would change the options of the next command line, too.
    """
    registry = ConstructorRegistry()
    asking = False

    @registry.struct_rule
    def described(info: StructTypeInfo) -> StructConstructorSpec | None:
        nonlocal asking
        if asking or not is_dataclass(info.type):
            return None
        asking = True  # tyro for its own rule, of which we change the fields
        try:
            spec: Any = ConstructorRegistry.get_struct_spec(info)
        finally:
            asking = False
        group = _GROUPS.get(info.type)
        fields = [_option(field, group) for field in spec.fields if field.name not in left_out]
        if info.type not in commands:
            return replace(spec, fields=tuple(fields))
        leaves = list(_leaves(info.type, fields))
        common = [
            field
            for owner, field in leaves
            if (field.name in COMMON.get(owner, ()))
            or (owner is info.type and _ADVANCED not in _parts(field.type))
        ]
        if len(common) == len(leaves):
            return replace(spec, fields=tuple(fields))

        def instantiate(**values: Any) -> Any:
            del values[_HELP_ALL.name]
            return spec.instantiate(**values)

        options = common if short else fields
        return StructConstructorSpec(instantiate, (_option(_HELP_ALL), *options))

    try:
        yield registry
    finally:
        asking = True


def _option(field: StructFieldSpec, group: str | None = None) -> StructFieldSpec:
    """With our help, and with its group in its name."""
    kind, *marks = _parts(field.type)
    if is_dataclass(kind):
        return field
    behaviour = "" if tyro.conf.FlagCreatePairsOff in marks else _default_hint
    name = f"{group}.{field.name}" if group else None
    ours = tyro.conf.arg(name=name, metavar=_metavar(kind), help_behavior_hint=behaviour)
    return replace(
        field,
        type=Annotated[(kind, ours, *marks)],  # type: ignore[arg-type]
        helptext=lambda: _unwrapped(field.helptext),
    )


def _leaves(
    owner: type, fields: Sequence[StructFieldSpec]
) -> Iterator[tuple[type, StructFieldSpec]]:
    """The options of `owner`, and then those of its configurations, each with whose it is."""
    nested: list[tuple[Any, Any]] = []
    for field in fields:
        kind, *_ = _parts(field.type)
        if is_dataclass(kind):
            nested.append((kind, field.default))
        else:
            yield owner, field
    for kind, default in nested:
        info = StructTypeInfo.make(kind, default, in_union_context=False)
        spec: Any = ConstructorRegistry.get_struct_spec(info)
        yield from _leaves(kind, spec.fields)


def _parts(hint: Any) -> tuple[Any, ...]:
    """A type, and the marks on it."""
    return get_args(hint) if get_origin(hint) is Annotated else (hint,)


def _unwrapped(helptext: Any) -> str:
    """Without the line breaks of the source."""
    text = helptext() if callable(helptext) else helptext
    return " ".join((text or "").split())


def _default_hint(default: str) -> str:
    if default in ("None", ""):
        return ""
    return f"(default: {({'True': 'yes', 'False': 'no'}).get(default, default)})"


def _metavar(kind: Any) -> str | None:
    """PATH for Path | None, {a,b} ... for any number of choices; None for what tyro says."""
    kinds = [k for k in get_args(kind) if k not in (NoneType, ...)]
    match get_origin(kind):
        case origin if origin in (Union, UnionType) and len(kinds) == 1:
            return _metavar(kinds[0]) or kinds[0].__name__.upper()
        case origin if origin is tuple and ... in get_args(kind):
            return f"{_metavar(kinds[0]) or kinds[0].__name__.upper()} ..."
        case origin if origin is Literal:
            return "{" + ",".join(map(str, kinds)) + "}"
    return None


# Errors


@contextmanager
def _plain_errors(kind: type, default: Any, prog: str, arguments: Sequence[str]) -> Iterator[None]:
    """Raises what tyro finds wrong as a CadenzaError of a line; it prints a box if it cannot."""

    if errors is None:
        yield
        return

    def raise_error(event: errors.ParseErrorEvent) -> None:
        if (what := _what_is_wrong(event, kind, default, prog, arguments)) is not None:
            raise CadenzaError(what)

    with errors.on_parse_error(raise_error):
        yield


def _what_is_wrong(
    event: errors.ParseErrorEvent, kind: type, default: Any, prog: str, arguments: Sequence[str]
) -> str | None:
    """In a line; None where tyro should say it."""
    known = ["--help", "--help-all", *option_names(kind, default=default)]
    names = [word.split("=")[0].replace("_", "-") for word in arguments]
    unknown = [name for name in names if name.startswith("--") and name not in known]
    match event:
        case errors.UnrecognizedArgs() | errors.MissingArgs() | errors.BadValue() if unknown:
            hint = _meant(unknown[0], known) or similar(unknown[0], known)
            return f"there is no option {unknown[0]}{hint or f'; {prog} --help-all lists them'}"
        case errors.UnrecognizedArgs(tokens=tokens):
            about = "there is no option" if tokens[0].startswith("-") else "one argument too many:"
            return f"{about} {tokens[0]}{_meant(tokens[0], known) or f'; see {prog} --help'}"
        case errors.MissingArgs(missing_arguments=missing):
            names, verb = [_name(m.arg) for m in missing], "is" if len(missing) == 1 else "are"
            return f"{' and '.join(names)} {verb} missing; see {prog} --help"
        case errors.BadValue(argument=argument):
            return f"{_name(argument)} needs a value; see {prog} --help"
        case errors.InvalidChoice(argument=argument, value=value, choices=choices):
            # tyro names those of an option that may be left out in any order, and None.
            named = sorted({*choices} - {"None"}, key=str(argument.lowered.metavar).find)
            return f"{_name(argument)} {value}: choose from {', '.join(named)}"
        case errors.InstantiationFailure(argument=argument, message=message) if argument:
            metavar, *_ = str(argument.lowered.metavar).split()
            wanted = {"INT": "a whole number", "FLOAT": "a number"}.get(metavar, metavar)
            given = re.findall("'([^']*)'", message)[-1:]
            return f"{' '.join([_name(argument), *given])}: give {wanted}"
    return None


def _name(argument: Any) -> str:
    return argument.lowered.metavar if argument.is_positional() else argument.display_name()


_OF_NUMBERS = ("--tracks", "--video-size")


def with_numbers_apart(words: Sequence[str]) -> list[str]:
    """With `--tracks 1,2` as `--tracks 1 2`, and `--video-size 640x360` as two numbers, too."""
    parted: list[str] = []
    option = ""
    for word in words:
        if word.startswith("-"):
            option = word.partition("=")[0].replace("_", "-")
        joined = option in _OF_NUMBERS and re.fullmatch(r"(--[\w-]+=)?\d+([,x]\d*)+", word)
        parted += filter(None, re.split("[=,x]", word)) if joined else (word,)
    return parted


def option_parts(words: Sequence[str]) -> list[str]:
    """The words of a command line, where `--name=value` is two."""
    return [
        part
        for word in words
        for part in (word.split("=", 1) if word.startswith("--") else (word,))
    ]


def words_of(name: str, value: Any) -> list[str]:
    """What gives an option this value on a command line."""
    option = name.replace("_", "-")
    if isinstance(value, bool):
        return [f"--{'' if value else 'no-'}{option}"]
    values = value if isinstance(value, tuple) else (value,)
    return [f"--{option}", *map(str, values)]


def option_names(kind: Any, prefix: str | None = "", default: Any = None) -> Iterator[str]:
    """The names of all options of a command; with the prefix None also those nested have none.

    As for tyro, a `default` of a subclass brings the options of that.
    """
    kind = kind if default is None else type(default)
    hints = get_type_hints(kind, include_extras=True)
    for name in (each.name for each in fields(kind)):
        field, *marks = _parts(hints[name])
        option = name.replace("_", "-")
        if is_dataclass(field):
            bare = prefix is None or tyro.conf.OmitArgPrefixes in marks
            within = None if bare else f"{prefix}{option}."
            within = f"{_GROUPS[field]}." if field in _GROUPS else within
            yield from option_names(field, within, getattr(default, name, None))
        elif tyro.conf.Positional not in marks:
            yield f"--{prefix or ''}{option}"
            if field is bool:
                yield f"--{prefix or ''}no-{option}"
