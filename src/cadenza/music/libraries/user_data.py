"""Where Cadenza keeps what a user has given it."""

from __future__ import annotations

import os
from pathlib import Path

FOLDER = "CADENZA_DATA"
"""The environment variable that says where."""


def libraries_folder() -> Path:
    """Where imported song libraries are, a folder each."""
    from platformdirs import user_data_path

    chosen = os.environ.get(FOLDER)
    return (Path(chosen) if chosen else user_data_path("cadenza", appauthor=False)) / "libraries"
