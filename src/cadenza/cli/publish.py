"""`cadenza publish`: a policy, demonstrations or an entry to the benchmark, for others."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cadenza.cli.arguments import Quiet


@dataclass(frozen=True)
class Publish:
    """Upload a policy, demonstrations or an entry to the benchmark to the Hugging Face hub.

    Example: cadenza publish run/best me/twinkle; cadenza play hub:me/twinkle
    """

    folder: tyro.conf.Positional[Path]
    """Folder of a policy (its README.md is the card), of "cadenza dataset collect", or an entry."""
    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="OWNER/NAME")]
    """Name on the hub."""
    quiet: Quiet = False


def run(command: Publish) -> None:
    from cadenza.evaluation.benchmark.card import CARD
    from cadenza.evaluation.benchmark.sharing import publish_entry
    from cadenza.learning.publishing import publish

    upload = publish_entry if (command.folder / CARD).is_file() else publish
    print(upload(command.folder, command.name))
