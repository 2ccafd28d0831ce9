"""For tests of music."""

import pytest

from cadenza.music.libraries.library import load_score
from musicxml_documents import document


@pytest.fixture
def saved(tmp_path):
    def save(text, name="song.musicxml"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return save


@pytest.fixture
def read(saved):
    """Read a MusicXML file of one part, given its bars."""
    return lambda *bars: load_score(saved(document(bars)))
