"""Each command has the options, types and defaults that tests/data/command_line.txt lists.

To renew that file after a change: python -m tests.test_cli_options
"""

import io
import os
import re
from contextlib import redirect_stdout, suppress
from functools import partial
from itertools import zip_longest
from pathlib import Path
from unittest import mock

import tyro

from cadenza.cli import COMMANDS, main

RECORDED = Path(__file__).parent / "data" / "command_line.txt"


def help_of(command: str) -> str:
    """What --help-all prints of its arguments without descriptions, sorted, each on a line."""
    output = io.TextIOWrapper(io.BytesIO(), "utf-8")
    with (
        mock.patch("tyro.cli", partial(tyro.cli, compact_help=True)),
        mock.patch.dict(os.environ, COLUMNS="1000"),
        redirect_stdout(output),
        suppress(SystemExit),
    ):
        main([*command.split(), "--help-all"])
    output.seek(0)
    boxes = (re.split("(?<=[│╮╯])(?=[│╭╰])", line) for line in output)  # side by side
    columns = zip_longest(*boxes, fillvalue="")
    text = "\n".join(cell.strip("│ \n") for column in columns for cell in column)
    text = text.replace("\n(default: ", " (default: ")  # of an option with a long name
    options = re.findall(r"^(?:-(?!h, |H, ).+|\[.+|.+ \(required\))$", text, re.MULTILINE)
    return "".join(f"    {option}\n" for option in sorted(options))


def listed() -> str:
    return "\n".join(f"{command}\n{help_of(command)}" for command in COMMANDS)


def test_the_options_of_all_commands_are_as_recorded():
    assert listed() == RECORDED.read_text()


if __name__ == "__main__":
    RECORDED.write_text(listed())
