"""Keyboards by name."""

from cadenza.keyboards.keyboard import Keyboard
from cadenza.registry import Entry, Registry

KEYBOARDS = Registry(
    "keyboard",
    "cadenza.keyboards",
    {
        "piano": Entry("cadenza.keyboards.piano:PIANO", "the 88 keys of a piano"),
        "mini": Entry("cadenza.keyboards.mini:MINI", "25 mini keys"),
    },
)


def keyboard_named(name: str) -> Keyboard:
    """The keyboard called `name`. Raises CadenzaError if there is no such keyboard."""
    return KEYBOARDS.load(name, Keyboard)
