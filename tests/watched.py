"""What functions of the program are called with, and what they return."""

from typing import Any, NamedTuple

import pytest


class Call(NamedTuple):
    args: tuple[Any, ...]
    result: Any


def watched(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> list[Call]:
    """The calls from now on of a function in a module, or of a method, which works as before."""
    calls, real = list[Call](), getattr(owner, name)

    def call(*args: Any, **options: Any) -> Any:
        calls.append(Call(args, real(*args, **options)))
        return calls[-1].result

    monkeypatch.setattr(owner, name, call)
    return calls
