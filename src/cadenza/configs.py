"""Configurations as they are to be: every field of the type that it says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from cadenza.errors import CadenzaError

T = TypeVar("T")

MOST_SEED = 2**128  # numpy takes any
MOST_COUNT = 2**53  # of what has no other limit: JSON of others knows no larger whole numbers

_BEFORE, _FILE = "before", "file"  # of the metadata of a field

_WORDS = {
    bool: "give True or False",
    int: "give a whole number",
    float: "give a number",
    str: "give text",
}


def as_config(value: Any, kind: type[T]) -> T:
    """`value`, which is to be a `kind`, a dataclass, with plain values; its defaults for None.

    Nothing is converted but numbers of numpy, lists to tuples and whole numbers to floats.

    Raises:
        CadenzaError: it is something else, or one of its fields is.
    """
    if value is None:
        return kind()
    if not isinstance(value, kind):
        raise CadenzaError(f"{value!r:.100}: give a {kind.__name__}")
    return _plain(value, kind)


def _plain(value: T, kind: type[T], prefix: str = "") -> T:
    hints = get_type_hints(kind)
    names = [each.name for each in fields(kind)]  # type: ignore[arg-type]
    values = {name: _as(getattr(value, name), hints[name], prefix + name) for name in names}
    return kind(**values)


def _nested(value: Any, kind: type[T], name: str) -> T:
    """A `kind` within another dataclass, from such a one or from a dictionary of its fields."""
    if isinstance(value, Mapping):
        known = [each.name for each in fields(kind)]  # type: ignore[arg-type]
        if unknown := [key for key in value if key not in known]:
            raise CadenzaError(f"{name} has no {unknown[0]!r:.100}: choose from {', '.join(known)}")
        value = kind(**value)
    if not isinstance(value, kind):
        given = " ".join(repr(value).split())
        raise CadenzaError(f"{name} {given:.100}: give a {kind.__name__} or a dictionary")
    return _plain(value, kind, f"{name}.")


def added(*, before: Any) -> Mapping[str, Any]:
    """The metadata of a field that a dataclass was given after results had been kept with it.

    `before` is the value that stands for what went without saying until there was the field. It
    never changes, whatever becomes of the default.
    """
    return {_BEFORE: before}


def names_file() -> Mapping[str, Any]:
    """The metadata of a field that is the path of a file."""
    return {_FILE: True}


def files_named(config: Any) -> list[str]:
    """The files that the options of a dataclass name, or of None."""
    named = [each.name for each in fields(config) if _FILE in each.metadata] if config else []
    return [value for name in named if (value := getattr(config, name)) is not None]


def identity(config: Any) -> dict[str, Any]:
    """Field -> value of a dataclass and of those in it: what tells results with it from others.

    An option counts with its value even where that is the default: with another default, another
    result is asked for. A field that was `added` is left out while it says what was so before:
    what is asked for then is what was asked for without it.
    """
    values = {
        each.name: value
        for each in fields(config)
        if (value := getattr(config, each.name)) != each.metadata.get(_BEFORE, MISSING)
    }
    return {name: identity(v) if is_dataclass(v) else v for name, v in values.items()}


def check_kind(kind: type) -> None:
    """That a dataclass of somebody else's is one that `as_config` takes.

    Raises:
        CadenzaError: a field has no default, or is of a type that no option has.
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


def whole_number(value: Any, name: str, least: int, most: int) -> int:
    """`value` as an int from `least` to `most`.

    Raises:
        CadenzaError: it is none; `name` is named.
    """
    number: int = _as(value, int, name)
    _check_range(number, name, least, most)
    return number


def check_ranges(
    config: object, ranges: Mapping[str, tuple[float, float]], prefix: str = ""
) -> None:
    """That the fields named are from the least to the most.

    Raises:
        CadenzaError: one is not; its name is told after `prefix`.
    """
    for name, (least, most) in ranges.items():
        _check_range(getattr(config, name), prefix + name, least, most)


def _check_range(value: float, name: str, least: float, most: float) -> None:
    if not least <= value <= most:
        wanted = f"{least} or more" if most >= MOST_COUNT > value else f"{least} to {most}"
        raise CadenzaError(f"{name} {value}: choose {wanted}")


def _as(value: Any, hint: Any, name: str) -> Any:
    if is_dataclass(hint):
        return _nested(value, hint, name)  # type: ignore[arg-type]
    try:
        return msgspec.convert(value.item() if isinstance(value, np.generic) else value, hint)
    except (msgspec.ValidationError, OverflowError) as error:
        given = " ".join(repr(value).split())
        raise CadenzaError(f"{name} {given:.100}: {_what(hint)}") from error


def _what(hint: Any) -> str:
    """To be given, in words."""
    first, *others = get_args(hint) or (hint,)
    match get_origin(hint):
        case origin if origin is Literal:
            return f"choose from {', '.join([first, *others])}"
        case origin if origin is tuple and ... not in others:
            return f"give {len(others) + 1} of them; for each, {_what(first)}"
        case origin if origin is tuple:
            return f"give a list; for each of it, {_what(first)}"
        case origin if origin in (Union, UnionType):
            return f"{_what(first)}, or None"
    return _WORDS[hint]


def flat(mapping: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the values of nested mappings, each with the names that lead to it, joined by dots."""
    for name, value in mapping.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
