"""Entries on the Hugging Face hub, where `hub:OWNER/NAME` stands for the folder of one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory

from cadenza.evaluation.benchmark.card import ACTIONS, CARD, check_files, read_card
from cadenza.files import TENSORS
from cadenza.hub import Kind, fetched, is_on_hub, upload
from cadenza.learning.publishing import dataset_card

ENTRY = Kind(
    "entry",
    "dataset",
    (CARD, f"{ACTIONS}/*{TENSORS}"),
    most=2**33,  # some 20 hours of music with 20 seeds
)
"""An entry as the hub keeps it."""
_ABOUT = """
# {name}

An entry to the benchmark of [Cadenza](https://github.com/cadenza-piano/cadenza) by {by}: track
`{track}`, set `{songs}`. Whoever verifies it plays every action again:

    pip install 'cadenza[hub]'
    cadenza verify hub:{repo}
"""


@contextmanager
def at_hand(places: Iterable[str | Path]) -> Iterator[list[Path]]:
    """Yields the folders that are named, those of the hub as copies for the time being.

    The hub's cache holds links, and an entry may hold none.

    Args:
        places: folders, or `hub:OWNER/NAME`, maybe with `@REVISION`.

    Raises:
        CadenzaError: an entry cannot be fetched.
    """
    with ExitStack() as stack:
        yield [_copied(place, stack) if is_on_hub(place) else Path(place) for place in places]


def _copied(place: str | Path, stack: ExitStack) -> Path:
    """Fetches an entry of the hub into a folder that is there for as long as the stack."""
    here = Path(stack.enter_context(TemporaryDirectory())) / Path(place).name
    return copytree(fetched(place, ENTRY), here)


def publish_entry(entry: Path, repo: str) -> str:
    """Uploads an entry to the hub and returns where it is.

    Args:
        entry: its folder.
        repo: OWNER/NAME of the repository; it is made if there is none.

    Raises:
        CadenzaError: the folder is no entry, or the hub does not take it.
    """
    card = read_card(entry)
    check_files(entry, [(run.song, run.seed) for run in card.runs])
    about = _ABOUT.format(name=card.name, by=card.by, track=card.track, songs=card.songs, repo=repo)
    return upload(entry, repo, ENTRY, dataset_card(about))
