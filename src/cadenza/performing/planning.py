"""Plans of songs: actions and fingers that can be saved and played again."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Progress, silent
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.practice.practised_planner import PractisedPlan
from cadenza.agents.playback import save_plan
from cadenza.agents.registry import PLANNER
from cadenza.errors import CadenzaError
from cadenza.files import TENSORS
from cadenza.fingers import Finger
from cadenza.music.arrangement import SomeSong
from cadenza.music.formats.fingering_file import SUFFIX, write_fingering
from cadenza.music.score import Score
from cadenza.performing.performance import Performance, perform
from cadenza.performing.setup import Setup, find_player, set_up
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig


@dataclass(frozen=True)
class Plan:
    """A plan of a song from beginning to end."""

    score: Score
    """The song, with the fingers that play it."""
    performance: Performance
    """The performance of the plan."""
    options: dict[str, Any]
    """Options that have to be the same for the plan to play the same, see `task_identity`."""
    practised: PractisedPlan | None = None
    """The feedback that leads back hands that are pushed off, if the song was practised."""

    def __repr__(self) -> str:
        count = sum(finger is not None for finger in self.fingering)
        return f"Plan({self.score!r}, fingers for {count}, F1 {self.metrics['f1']:.3f})"

    def _repr_html_(self) -> str:
        return self.performance._repr_html_()

    @property
    def actions(self) -> NDArray[np.float64]:
        """(T, A) in actuator units, the pedal last."""
        return self.performance.episode["action"]

    @property
    def fingering(self) -> tuple[Finger | None, ...]:
        """The finger of each note of the score."""
        return tuple(note.finger for note in self.score.notes)

    @property
    def score_played(self) -> Score:
        """The score in the tempo and the key in which it is played."""
        track = self.performance.track
        assert track is not None
        return self.score.stretched(track.config.stretch).transposed(track.config.transpose)

    @property
    def metrics(self) -> dict[str, Any]:
        """The scores of the plan: see `cadenza.agents.rollout.EpisodeResult`."""
        return self.performance.metrics

    def save(self, path: str | Path) -> None:
        """Write the actions to `path`, a .safetensors file, and the fingers beside it.

        `cadenza.play(song, "playback", plan=path)` plays the actions. The fingers go to a file
        whose name ends in .safetensors.fingering; call it `song.fingering`, and they go with
        `song.mid`. Raises CadenzaError if the name of `path` has another ending.
        """
        path = Path(path)
        if path.suffix != TENSORS:
            raise CadenzaError(
                f"{path}: a plan is a {TENSORS} file; choose a name with that ending"
            )
        save_plan(
            path,
            self.performance.episode,
            self.metrics,
            self.options,
            self.score,
            self.performance.scene.fingers,
            self.practised,
        )
        write_fingering(self.score, fingering_of(path))


def fingering_of(plan: Path) -> Path:
    """The file of a plan's fingers, which is not named as those of `song.mid` are."""
    return plan.with_name(plan.name + SUFFIX)


def plan(
    song: SomeSong,
    seed: int = 0,
    *,
    task: TaskConfig | None = None,
    scene: SceneConfig | None = None,
    config: PlannerConfig | None = None,
    progress: Progress = silent,
    num_threads: int | None = None,
) -> Plan:
    """Plan how to play a song, as `cadenza plan` does.

    Raises CadenzaError if the song is not there, an option makes no sense, or the hands could not
    play to the end.

    Args:
        song, seed, task, scene, progress, num_threads: as for `cadenza.play`.
        config: options of the planner.
    """
    player = find_player(PLANNER, configs={PLANNER: config}).playing_in(task, scene)
    with set_up(song, player, seed=seed, num_threads=num_threads, progress=progress) as setup:
        return plan_of(setup, perform(setup, progress))


def plan_of(setup: Setup, performance: Performance) -> Plan:
    """The plan that a planner performed; raises CadenzaError if it was not played to the end."""
    steps, length = performance.episode.num_steps, setup.num_steps
    if steps < length:
        raise CadenzaError(
            f"{setup.settings['song']}: ended after {steps} of {length} steps, because of a wrong "
            "key or an unstable simulation, so the plan is incomplete; try another seed"
        )
    planned = performance.track
    assert planned is not None
    # The notes are the same in the same order; times and pitches are again those of the song.
    score = setup.score.with_fingers(note.finger for note in planned.score.notes)
    return Plan(score, performance, setup.options)
