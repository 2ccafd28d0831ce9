"""`cadenza publish`: a policy or demonstrations, for others."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cadenza.cli.arguments import Quiet


@dataclass(frozen=True)
class Publish:
    """Upload a policy or demonstrations to the Hugging Face hub.

    Example: cadenza publish run/best me/twinkle; cadenza play --agent hub:me/twinkle
    """

    folder: tyro.conf.Positional[Path]
    """Folder of a policy or of "cadenza dataset collect"; a README.md in it is the card."""
    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="OWNER/NAME")]
    """Name on the hub."""
    quiet: Quiet = False


def run(command: Publish) -> None:
    from cadenza.learning.publishing import publish

    print(publish(command.folder, command.name))
