"""What the version before this one wrote, as this one writes it. To go with the next version.

    python -m cadenza.learning.old_formats POLICY...

writes the folders of policies anew.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from cadenza.errors import CadenzaError, CadenzaWarning
from cadenza.learning.sealed_folder import is_old, read_sealed, write_sealed

_UPDATES = "learner:.updates"


def renewed_checkpoint(facts: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """The facts of a checkpoint: the number of updates was the learner's own."""
    if "updates" in facts or _UPDATES not in arrays or arrays[_UPDATES].shape:
        return facts
    return facts | {"updates": int(arrays[_UPDATES])}


def warn_of_old_policy(folder: Path) -> None:
    """Once it can no longer be read it is too late."""
    if is_old(folder):
        warnings.warn(
            f"{folder}: written by an older version, and the next one will not read it; to write "
            f"it anew: python -m {__spec__.name} {folder}",
            CadenzaWarning,
            stacklevel=3,
        )


def _main(folders: list[str]) -> None:
    for folder in map(Path, folders):
        try:
            write_sealed(folder, "policy", *read_sealed(folder, "policy"))
        except (CadenzaError, OSError) as error:
            sys.exit(str(error))


if __name__ == "__main__":
    _main(sys.argv[1:])
