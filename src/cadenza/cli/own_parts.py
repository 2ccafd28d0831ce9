"""Hands and keyboards of modules, for commands that read what was recorded with them."""

from __future__ import annotations

from dataclasses import dataclass

from cadenza.cli.arguments import Advanced


@dataclass(frozen=True, kw_only=True)
class OwnParts:
    """Modules are imported only where a command says so: no file makes Cadenza import one."""

    hand: Advanced[str | None] = None
    """Import a hand of your own, module:NAME, with which the episodes were recorded."""
    keyboard: Advanced[str | None] = None
    """Import a keyboard of your own, module:NAME, with which they were recorded."""

    def import_them(self) -> None:
        """Raises: CadenzaError: there is no such hand or keyboard."""
        from cadenza.hands.registry import hand_named
        from cadenza.keyboards.registry import keyboard_named

        if self.hand is not None:
            hand_named(self.hand)
        if self.keyboard is not None:
            keyboard_named(self.keyboard)
