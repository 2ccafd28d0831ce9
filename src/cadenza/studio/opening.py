"""The first picture of the page, as a process: `python -m cadenza.studio.opening SONG`.

It prints what `cadenza.studio.state_stream` sends of a song before its first step: hands at rest,
and the notes that are to come.
"""

import os
import sys

from cadenza.agents.registry import PLANNER
from cadenza.performing.setup import find_player, set_up
from cadenza.studio.state_stream import StateStream

_NICENESS = 4  # the process that plays gets ready beside it


def main() -> None:
    """Print the picture of the song that the command line names."""
    os.nice(_NICENESS)
    with set_up(sys.argv[1], find_player(PLANNER)) as setup:
        StateStream(setup, lambda message: print(message.content.decode())).begin()


if __name__ == "__main__":
    main()
