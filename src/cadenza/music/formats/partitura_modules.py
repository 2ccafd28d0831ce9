"""Modules of partitura, imported without what it fetches."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any


def partitura_module(name: str) -> Any:
    """Imports `partitura.NAME`, but not the sound font that it fetches beside pyfluidsynth."""
    hidden = "fluidsynth"
    before = sys.modules.get(hidden)
    sys.modules[hidden] = None  # type: ignore[assignment]  # makes its import fail
    try:
        return import_module(f"partitura.{name}")
    finally:
        if before is None:
            del sys.modules[hidden]
        else:
            sys.modules[hidden] = before
