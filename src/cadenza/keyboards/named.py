"""The keyboards that come with Cadenza, by name."""

from __future__ import annotations

from cadenza.keyboards.keyboard import Keyboard
from cadenza.keyboards.piano import PIANO

KEYBOARDS: dict[str, Keyboard] = {keyboard.name: keyboard for keyboard in (PIANO,)}
