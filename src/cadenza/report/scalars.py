"""Metrics of a training run for TensorBoard and Weights & Biases, row by row.

The step of a row is `eval_step`, or else `step`.
"""

import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cadenza.errors import extra_packages


class TensorBoard:
    """Event files of TensorBoard in a folder."""

    def __init__(self, folder: Path, step: int) -> None:
        """Resume at `step`, and hide later ones; raises CadenzaError without tensorboardX."""
        with extra_packages("train", "training"):
            from tensorboardX import SummaryWriter
        # A name that nobody can know before: the file is opened through links.
        suffix = f".{secrets.token_hex(4)}"
        self._writer = SummaryWriter(str(folder), purge_step=step or None, filename_suffix=suffix)

    def add(self, row: Mapping[str, float]) -> None:
        for name, value in _metrics(row).items():
            self._writer.add_scalar(name, value, _step(row))

    def close(self) -> None:
        self._writer.close()


def need_wandb() -> Any:
    """Import the package wandb. Raises CadenzaError if it is not installed."""
    with extra_packages("wandb", "--wandb"):
        import wandb
    return wandb


class WeightsAndBiases:
    """A run on wandb.ai, or wherever its environment variables say."""

    def __init__(self, project: str, folder: Path, run: str, settings: Mapping[str, Any]) -> None:
        """Resume the run of that id in the project, if any; wandb keeps files in the folder.

        Raises CadenzaError if wandb is not installed.
        """
        self._run = need_wandb().init(
            project=project, dir=str(folder), id=run, resume="allow", config=dict(settings)
        )

    def add(self, row: Mapping[str, float]) -> None:
        self._run.log({**_metrics(row), "control_steps": _step(row)})

    def close(self) -> None:
        self._run.finish()


def _step(row: Mapping[str, float]) -> int:
    return int(row.get("eval_step", row["step"]))


def _metrics(row: Mapping[str, float]) -> dict[str, float]:
    return {n: v for n, v in row.items() if n not in ("step", "eval_step")}
