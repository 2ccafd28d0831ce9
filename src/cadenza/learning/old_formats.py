"""What the version before this one wrote, as this one writes it. To go with the next version."""

from __future__ import annotations

import re
import warnings
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from cadenza.errors import CadenzaWarning
from cadenza.files import checked
from cadenza.learning.sealed_folder import is_old
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

Arrays = dict[str, NDArray[Any]]

RENAMED = {
    "seed_steps": "learning_starts",
    "steps_per_round": "train_freq",
    "updates_per_round": "gradient_steps",
    "replay_capacity": "buffer_size",
    "actor_average": "actor_ema",
    "actor_update_period": "policy_delay",
    "final_learning_rates": "final_learning_rate_fraction",
}
"""Options of training, as they were called and as they are called."""

_KEPT, _PRUNED = "keep_zero_inputs", "prune_inputs"  # the one is not the other
_UPDATES = "learner:.updates"


def renewed_config(config: Any) -> Any:
    """The options of a run, if they are some."""
    if not isinstance(config, dict):
        return config
    renewed = {RENAMED.get(name, name): value for name, value in config.items()}
    if isinstance(renewed.get(_KEPT), bool):
        renewed[_PRUNED] = not renewed.pop(_KEPT)
    return renewed


def renewed_checkpoint(facts: dict[str, Any], arrays: Arrays) -> tuple[dict[str, Any], Arrays]:
    """The number of updates was the learner's own, and some arrays had other names."""
    if "updates" not in facts and _UPDATES in arrays and not arrays[_UPDATES].shape:
        facts = facts | {"updates": int(arrays[_UPDATES])}
    renamed = {"learner:.averaged_actor": "learner:.actor_ema", "figures:": "metrics:"}
    for old, new in renamed.items():
        arrays = {re.sub(f"^{re.escape(old)}", new, name): a for name, a in arrays.items()}
    return facts, arrays


def renewed_chunk(arrays: Arrays) -> Arrays:
    """What the simulation showed had another name."""
    return {"proprioception" if name == "rest" else name: a for name, a in arrays.items()}


def is_old_policy(folder: Path, facts: dict[str, Any]) -> bool:
    """Whether it is one; warns, as once it can no longer be read it is too late."""
    old = is_old(folder) or facts.get("format") in (1, 2)
    if old:
        warnings.warn(
            f"{folder}: written by an older version, and the next one will not read it; to write "
            f"it anew: python -m cadenza.learning.renew {folder}",
            CadenzaWarning,
            stacklevel=4,
        )
    return old


def renewed_policy(
    facts: dict[str, Any], arrays: Arrays, where: Path
) -> tuple[dict[str, Any], Arrays]:
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
        spec = ObservationSpec.of(shown.spec, residual=facts.get("residual") is True)
    named = {re.sub("^plan/", "reference/", name): array for name, array in arrays.items()}
    kept = {name: value for name, value in facts.items() if name != "residual"}
    return kept | {"format": 3, "observation": asdict(spec)}, named
