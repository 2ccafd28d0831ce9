"""For tests of music."""

import pytest


@pytest.fixture
def saved(tmp_path):
    def save(text, name="song.musicxml"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return save
