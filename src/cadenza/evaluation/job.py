"""What a run is: a pure value, whose hash names the folder of its results."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from cadenza.configs import files_named, identity
from cadenza.files import folder_name, plain, sha256_of
from cadenza.learning.config import TrainingConfig
from cadenza.music.arrangement import Arrangement
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

_MOST_OF_A_NAME = 80  # bytes of a song or an agent in the name of a folder
_HASH = 12  # hexadecimal digits


@dataclass(frozen=True)
class JobSpec:
    """All that the result of a run depends on, but for the versions of programs."""

    song: str
    """As `cadenza play` takes it."""
    song_digest: str
    """Of what is played, see `cadenza.evaluation.songs`."""
    agent: str
    """As `cadenza play` takes it, or train:PRESET(-residual) for a policy that is trained first."""
    seed: int
    task: TaskConfig
    scene: SceneConfig
    arrangement: Arrangement = field(default_factory=Arrangement)
    config: Any = None
    """The agent's options, a dataclass; a `TrainingConfig` for one that is trained first."""
    agent_digest: str = ""
    """Of the files of a policy, or of those that options name."""

    @property
    def training(self) -> TrainingConfig | None:
        """How a policy is trained before it plays; None for all others."""
        return self.config if isinstance(self.config, TrainingConfig) else None

    def as_json(self) -> dict[str, Any]:
        """The same as JSON has it; without options that came later and that nobody has used."""
        content: dict[str, Any] = plain(identity(self))
        return content

    @cached_property
    def key(self) -> str:
        """A hash, the same on every machine. See `identity` for what counts.

        Folders go on being filled by later versions only while it stays what it is.
        """
        return key_of(self.as_json())

    @property
    def name(self) -> str:
        """SONG--AGENT--sSEED--HASH, the name of its folder."""
        song, agent = (
            _end_of(folder_name("-".join(path.split("/")[-2:]))) for path in (self.song, self.agent)
        )
        return f"{song}--{agent}--s{self.seed}--{self.key}"


@dataclass(frozen=True)
class SongFacts:
    """What is worth knowing about a song; a result does not depend on it."""

    name: str
    title: str = ""
    composer: str = ""
    library: str = ""
    split: str = ""
    difficulty: float | None = None
    """1 to 10."""
    seconds: float | None = None
    """Of all of it."""
    notes: int | None = None
    """That were to be played."""


@dataclass(frozen=True)
class Job:
    """A run to be carried out."""

    spec: JobSpec
    song: SongFacts
    page: bool = True
    """Whether it leaves a page to watch and hear."""


def key_of(content: Mapping[str, Any]) -> str:
    """The hash of a run that is known as JSON, see `JobSpec.as_json`."""
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_HASH]


def digest_of_files(*configs: Any) -> str:
    """A hash of what is in the files that these options name; nothing if they name none.

    Raises:
        CadenzaError: a file is not there, or cannot be read.
    """
    paths = [Path(path) for config in configs for path in files_named(config)]
    return sha256_of(*paths)[:_HASH] if paths else ""


def _end_of(name: str) -> str:
    return name.encode()[-_MOST_OF_A_NAME:].decode(errors="ignore")
