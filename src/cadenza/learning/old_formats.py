"""What the version before this one wrote, as this one writes it. To go with the next version."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

_UPDATES = "learner:.updates"


def renewed_checkpoint(facts: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """The facts of a checkpoint: the number of updates was the learner's own."""
    if "updates" in facts or _UPDATES not in arrays or arrays[_UPDATES].shape:
        return facts
    return facts | {"updates": int(arrays[_UPDATES])}
