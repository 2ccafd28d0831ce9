"""What the version before this one wrote, as this one writes it. To go with the next version.

    python -m cadenza.learning.old_formats POLICY...

writes the folders of policies anew.
"""

from __future__ import annotations

import re
import sys
import warnings
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from cadenza.errors import CadenzaError, CadenzaWarning
from cadenza.files import checked
from cadenza.learning.sealed_folder import is_old, read_sealed
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

_UPDATES = "learner:.updates"


def renewed_checkpoint(facts: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """The facts of a checkpoint: the number of updates was the learner's own."""
    if "updates" in facts or _UPDATES not in arrays or arrays[_UPDATES].shape:
        return facts
    return facts | {"updates": int(arrays[_UPDATES])}


def is_old_policy(folder: Path, facts: dict[str, Any]) -> bool:
    """Whether it is one; warns, as once it can no longer be read it is too late."""
    old = is_old(folder) or facts.get("format") in (1, 2)
    if old:
        warnings.warn(
            f"{folder}: written by an older version, and the next one will not read it; to write "
            f"it anew: python -m {__spec__.name} {folder}",
            CadenzaWarning,
            stacklevel=4,
        )
    return old


def renewed_policy(
    facts: dict[str, Any], arrays: dict[str, NDArray[Any]], where: Path
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """What it observes was only known by its size; a reference was called a plan.

    Raises:
        CadenzaError: the facts are not what they were.
    """
    if facts.get("format") not in (1, 2):
        return facts, arrays
    from cadenza.learning.observation import ObservationSpec  # heavy
    from cadenza.tasks.piano_task import PianoTask

    task = checked(facts.get("task"), TaskConfig, where)
    scene = checked(facts.get("scene"), SceneConfig, where)
    with closing(PianoTask([Score((Note(0.0, 1.0, 60),))], task, scene)) as shown:
        spec = ObservationSpec.of(shown, residual=facts.get("residual") is True)
    named = {re.sub("^plan/", "reference/", name): array for name, array in arrays.items()}
    kept = {name: value for name, value in facts.items() if name != "residual"}
    return kept | {"format": 3, "observation": asdict(spec)}, named


def _main(folders: list[str]) -> None:
    from cadenza.learning.policy_folder import load_policy, save_policy

    for folder in map(Path, folders):
        try:
            facts, _ = read_sealed(folder, "policy", {})
            save_policy(folder, load_policy(folder), facts["about"])
        except (CadenzaError, OSError) as error:
            sys.exit(str(error))


if __name__ == "__main__":
    warnings.simplefilter("ignore", CadenzaWarning)
    _main(sys.argv[1:])
