"""Registries of names: agents, hands, keyboards, song libraries, learners, setups.

A name is built in; or another installed package has added it by an entry point; or it is
`module:Name`. Its object is imported when it is loaded, so that a broken package does no harm where
it is not used.
"""

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from importlib import metadata
from operator import attrgetter, itemgetter
from typing import TypeVar

from cadenza.errors import CadenzaError, by_others, quoted

T = TypeVar("T")


def module_of(name: str) -> str | None:
    """The module of a `module:Name`, None for any other name."""
    return name.partition(":")[0] if ":" in name else None


@dataclass(frozen=True)
class Entry:
    """The object that a name stands for."""

    place: str  # the object's place, as `module:Name`
    about: str = ""  # a description in one line
    # The dataclass of its options, if it has any; help shows them without importing the object
    config: type | None = None


@dataclass(frozen=True)
class Registry:
    """The names of one kind.

        HANDS = Registry("hand", "cadenza.hands", {"shadow": Entry("cadenza.hands.shadow:SHADOW")})
        hand = HANDS.load("shadow", Hand)

    Another package adds to it in its `pyproject.toml`:

        [project.entry-points."cadenza.hands"]
        claw = "my_package:CLAW"
    """

    kind: str  # the kind, in words for errors, such as "agent"
    group: str  # the group of entry points by which other packages add names
    # Name -> built-in object. Built-in names precede those of other packages.
    own: Mapping[str, Entry] = field(default_factory=dict)
    otherwise: str = "module:Name"  # the alternative to a name, in words for errors

    def entries(self) -> dict[str, Entry]:
        """Name -> object: built-in names, then those of other packages in alphabetical order."""
        theirs = sorted(self._installed(), key=itemgetter(0))
        return {**self.own, **{name: entry for name, entry in theirs if name not in self.own}}

    def load(self, name: str, kind: type[T]) -> T:
        """Import the object of `name`.

        Raises CadenzaError if there is no such name, two packages have it, the object cannot be
        imported, or it is not a `kind`.
        """
        entry = self._find(name)
        module, _, attribute = entry.place.partition(":")
        what = f"{self.kind} {name}" + f" ({entry.about})" * (name not in (*self.own, entry.place))
        with by_others(f"{what}: cannot import {quoted(module)}"):
            imported = importlib.import_module(module)
        try:
            value = attrgetter(attribute)(imported)
        except AttributeError:
            raise CadenzaError(f"{what}: there is no {quoted(attribute)} in {module}") from None
        if not isinstance(value, kind):
            kind_name = "class" if kind is type else kind.__name__
            raise CadenzaError(
                f"{what}: {entry.place} is of type {type(value).__name__}; give a {kind_name}"
            )
        return value

    def _find(self, name: str) -> Entry:
        if name in self.own:
            return self.own[name]
        if module_of(name) is not None:
            return Entry(name)
        match [entry for known, entry in self._installed() if known == name]:
            case [entry]:
                return entry
            case []:
                raise self._unknown(name)
            case several:
                packages = " and ".join(entry.about for entry in several)
                places = " or ".join(entry.place for entry in several)
                raise CadenzaError(
                    f"{self.kind} {quoted(name)}: {packages} have this name; give {places}"
                )

    def _unknown(self, name: str) -> CadenzaError:
        names = list(self.entries())
        close = get_close_matches(name, names, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        choice = f"choose from {', '.join(names)}, or give " if names else "give "
        return CadenzaError(f"no {self.kind} {quoted(name)}: {hint}{choice}{self.otherwise}")

    def _installed(self) -> Iterator[tuple[str, Entry]]:
        """Yield names and entries of other packages from their metadata."""
        seen = set()
        for package in metadata.distributions():
            try:
                name, points = package.metadata["Name"], package.entry_points
            except Exception:  # its metadata is broken
                continue
            if name in seen:  # behind another version of it on the path
                continue
            seen.add(name)
            for point in points.select(group=self.group):
                yield point.name, Entry(point.value, f"from the package {name}")
