"""The option --setup: a name for several options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, is_dataclass
from itertools import pairwise
from typing import Any

from cadenza.cli.arguments import option_names, option_parts, words_of
from cadenza.tasks.setups import setup_named

SETUP_HELP = 'Options by one name, such as allegro, see "cadenza info". Others override it.'


def with_options_of_setup(kind: type, words: Sequence[str]) -> list[str]:
    """The words of a command line, after those that the setup stands for which they name.

    Of options that are given twice, the last ones count.

    Raises:
        CadenzaError: there is no such setup.
    """
    before = words[: words.index("--")] if "--" in words else words
    parts = option_parts(before)
    names = [name for option, name in pairwise(parts) if option == "--setup"]
    known = {*option_names(kind)}
    if not names or "--setup" not in known:
        return [*words]
    from cadenza.configs import flat

    setup = setup_named(names[-1])
    given: dict[str, Any] = {**setup.options}
    if setup.agent is not None:
        given |= {"agent": setup.agent, "agents": (setup.agent,)}
    plain = {n: asdict(v) if is_dataclass(v) else v for n, v in given.items()}  # type: ignore[arg-type]
    options = [words_of(name, value) for name, value in flat(plain)]
    chosen = [word for option in options if option[0] in known for word in option]
    return [*chosen, "--setup", names[-1], *words]  # a list of values ends where an option begins
