"""Checks of configurations: every field has the type of its annotation."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from cadenza.errors import CadenzaError, quoted, shortened

T = TypeVar("T")
Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]

MAX_SEED = 2**128  # numpy takes any
MAX_COUNT = 2**53  # where there is no other limit: the largest whole number of JSON in JavaScript

_FILE = "file"  # key in the metadata of a field

_WORDS = {
    bool: "give True or False",
    int: "give a whole number",
    float: "give a number",
    str: "give text",
}


def as_config(value: Any, kind: type[T]) -> T:
    """Check that `value` is a dataclass `kind` with fields of the right types; None has defaults.

    Only numbers of NumPy, lists as tuples and whole numbers as floats are converted. Raises
    CadenzaError if the value or one of its fields is of another type.
    """
    if value is None:
        return kind()
    if not isinstance(value, kind):
        raise CadenzaError(f"{quoted(value)}: give a {kind.__name__}")
    return _plain(value, kind)


def _plain(value: T, kind: type[T], prefix: str = "") -> T:
    hints = get_type_hints(kind)
    names = [each.name for each in fields(kind)]  # type: ignore[arg-type]
    values = {name: _as(getattr(value, name), hints[name], prefix + name) for name in names}
    return kind(**values)


def _nested(value: Any, kind: type[T], name: str) -> T:
    """A `kind` within another dataclass, given as such or as a dictionary of its fields."""
    if isinstance(value, Mapping):
        known = [each.name for each in fields(kind)]  # type: ignore[arg-type]
        if unknown := [key for key in value if key not in known]:
            raise CadenzaError(
                f"{name} has no {quoted(unknown[0])}: choose from {', '.join(known)}"
            )
        value = kind(**value)
    if not isinstance(value, kind):
        raise CadenzaError(f"{name} {quoted(value)}: give a {kind.__name__} or a dictionary")
    return _plain(value, kind, f"{name}.")


def wrong_types(value: Any) -> Iterator[str]:
    """Yield a line for each field of a dataclass whose value its annotation does not allow.

    Annotations may have bounds, as `Positive` has. Numbers have to be finite: as JSON, in which
    values are checked, they are null otherwise.
    """
    hints = get_type_hints(type(value), include_extras=True)
    for each in fields(value):
        try:
            plain = msgspec.json.encode(getattr(value, each.name), enc_hook=lambda v: v.tolist())
            msgspec.json.decode(plain, type=hints[each.name])
        except (msgspec.ValidationError, TypeError, AttributeError) as error:
            yield f"{each.name}: {shortened(str(error))}"


def in_short(config: Any) -> str:
    """A `__repr__` for a dataclass of options, of those with other values than their defaults."""
    default = type(config)()
    values = ((each.name, getattr(config, each.name)) for each in fields(config))
    changed = (f"{name}={value!r}" for name, value in values if value != getattr(default, name))
    return f"{type(config).__name__}({', '.join(changed)})"


def names_file() -> Mapping[str, Any]:
    """The metadata of a field that is the path of a file."""
    return {_FILE: True}


def files_named(config: Any) -> list[str]:
    """The paths of files in a configuration, which may be None; see `names_file`."""
    named = [each.name for each in fields(config) if _FILE in each.metadata] if config else []
    return [value for name in named if (value := getattr(config, name)) is not None]


def check_kind(kind: type) -> None:
    """Check that a user's dataclass of options is one that `as_config` takes.

    Raises CadenzaError if a field has no default, or its type is not allowed.
    """
    hints = get_type_hints(kind)
    for each in fields(kind):
        if each.default is each.default_factory is MISSING:
            raise CadenzaError(f"{each.name} of {kind.__name__}: give it a default")
        if not _is_plain(hints[each.name]):
            raise CadenzaError(
                f"{each.name} of {kind.__name__}: an option is a bool, int, float, str or "
                "Literal, a tuple of them, or None"
            )


def _is_plain(hint: Any) -> bool:
    if get_origin(hint) in (tuple, Union, UnionType):
        return all(each is ... or _is_plain(each) for each in get_args(hint))
    return hint in (*_WORDS, NoneType) or get_origin(hint) is Literal


def whole_number(value: Any, name: str, low: int, high: int) -> int:
    """`value` as an int from `low` to `high`; raises CadenzaError, which begins with `name`."""
    number: int = _as(value, int, name)
    _check_range(number, name, low, high)
    return number


def check_ranges(
    config: object, ranges: Mapping[str, tuple[float, float]], prefix: str = ""
) -> None:
    """Check that fields are in their ranges, by name -> (minimum, maximum).

    Raises CadenzaError if one is not; `prefix` stands before its name.
    """
    for name, (low, high) in ranges.items():
        _check_range(getattr(config, name), prefix + name, low, high)


def check_positive(config: object, names: Iterable[str]) -> None:
    """Raise a CadenzaError if one of these fields is not more than 0 and finite."""
    for name in names:
        if not 0 < (value := getattr(config, name)) < math.inf:
            raise CadenzaError(f"{name} {value}: choose more than 0")


def _check_range(value: float, name: str, low: float, high: float) -> None:
    if not low <= value <= high:
        limits = f"{low} or more" if high >= MAX_COUNT > value else f"{low} to {high}"
        raise CadenzaError(f"{name} {value}: choose {limits}")


def _as(value: Any, hint: Any, name: str) -> Any:
    if is_dataclass(hint):
        return _nested(value, hint, name)  # type: ignore[arg-type]
    try:
        return msgspec.convert(value.item() if isinstance(value, np.generic) else value, hint)
    except (msgspec.ValidationError, OverflowError) as error:
        raise CadenzaError(f"{name} {quoted(value)}: {_demand(hint)}") from error


def _demand(hint: Any) -> str:
    """The demand of a type, in words."""
    first, *others = get_args(hint) or (hint,)
    match get_origin(hint):
        case origin if origin is Literal:
            return f"choose from {', '.join([first, *others])}"
        case origin if origin is tuple and ... not in others:
            return f"give {len(others) + 1} of them; for each, {_demand(first)}"
        case origin if origin is tuple:
            return f"give a list; for each of it, {_demand(first)}"
        case origin if origin in (Union, UnionType):
            return f"{_demand(first)}, or None"
    return _WORDS[hint]


def flat(mapping: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings, each with the names that lead to it, joined by dots."""
    for name, value in mapping.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
