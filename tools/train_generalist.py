"""Fits the weights of the agent `generalist` to demonstrations of the planner.

    cadenza dataset collect --songs LIBRARY:train --excerpt 12 --least-f1 0.6 -o demonstrations
    python tools/train_generalist.py demonstrations -o trained

The answers are by how much the planner's search corrected the plan of a song in the states that
were recorded. They are fitted by ridge regression on inputs of equal spread; the penalty is the one
that does best on songs left out. docs/generalist.md has the rounds in which it plays itself.

In the folder `trained`, `weights.npz` is what has been learnt, and `lessons` what was made of the
episodes, each once: 0.7 MB for 10 s. Making one takes 3 s of a core, the fit half a minute.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.generalist.generalist import CorrectedHand
from cadenza.agents.generalist.weights import Weights
from cadenza.agents.planning.song_plan import plan_song
from cadenza.demonstrations.dataset import kept
from cadenza.demonstrations.recorded import Recorded
from cadenza.errors import CadenzaError
from cadenza.files import write_atomically
from cadenza.scene.scene import build_scene
from cadenza.sim.protocol import State
from cadenza.tasks.goal_track import GoalTrack

Array = NDArray[Any]

PENALTIES = (300.0, 1000.0, 3000.0, 10_000.0)  # of weights of inputs with a spread of 1
FOLDS = 5  # into which songs are divided to choose one
LEAST_SPREAD = 1e-3  # of an input that is not scaled up


class Lesson(NamedTuple):
    """What was recorded, for either hand."""

    inputs: Array
    """(N, D)"""
    answers: Array
    """(N, A) how the planner corrected the plan."""


def lesson_of(recorded: Recorded) -> Lesson:
    """That of an episode.

    Raises:
        CadenzaError: its plan was made by another version.
    """
    scene, rows = build_scene(recorded.about.scene), recorded.steps
    track = GoalTrack(recorded.score, (), recorded.about.task, scene)
    plan = plan_song(track, np.array(recorded.about.start))
    if not np.allclose(plan.nominal.tracking.expected, recorded.plan["reference"], atol=1e-3):
        raise CadenzaError(
            f"{recorded.folder}: the planner of another version had another plan; "
            "collect again, or train with that version"
        )
    nothing, inputs, answers = State.zeros(scene, 1), [], []
    for side in scene.sides:
        hand = CorrectedHand(plan, side)
        servos = hand.servos
        for step in range(recorded.about.num_steps):
            seen, planned = hand.see(step, state_of(rows[step : step + 1], nothing))
            inputs.append(seen)
            answers.append(hand.corrections.answer(rows["action"][step, servos] - planned))
            hand.played(rows["previous_action"][step + 1, servos], planned)
    return Lesson(np.array(inputs, np.float32), np.array(answers, np.float32))


def state_of(rows: Array, nothing: State) -> State:
    """What was recorded of a state."""
    names = ("hand_qpos", "hand_qvel", "key_qpos", "fingertip_xpos")
    return nothing._replace(**{name: rows[name].astype(np.float64) for name in names})


def kept_lesson(recorded: Recorded, folder: Path) -> Lesson:
    """That of an episode, made once."""
    path = folder / f"{recorded.folder.name}.npz"
    if not path.exists():
        lesson = lesson_of(recorded)
        folder.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as file:
            np.savez(file, **lesson._asdict())
    with np.load(path) as arrays:
        return Lesson(arrays["inputs"], arrays["answers"])


def joined(lessons: list[Lesson]) -> Lesson:
    return Lesson(*(np.concatenate(parts) for parts in zip(*lessons, strict=True)))


def fitted(lesson: Lesson, penalty: float) -> Weights:
    """By ridge regression (Hoerl & Kennard, Ridge Regression, 1970)."""
    x, y = lesson.inputs.astype(np.float64), lesson.answers.astype(np.float64)
    mean, spread, middle = x.mean(axis=0), x.std(axis=0), y.mean(axis=0)
    spread = np.where(spread < LEAST_SPREAD, 1.0, spread)
    x = (x - mean) / spread
    normal = x.T @ x + penalty * np.eye(x.shape[1])
    kernel = np.linalg.solve(normal, x.T @ (y - middle)) / spread[:, None]
    return Weights(kernel.astype(np.float32), (middle - mean @ kernel).astype(np.float32))


def unexplained(lessons: list[Lesson], penalty: float) -> float:
    """Share of the squared answers that is left on songs that were not learnt from."""
    left = total = 0.0
    for fold in range(FOLDS):
        weights = fitted(joined([x for i, x in enumerate(lessons) if i % FOLDS != fold]), penalty)
        others = joined(lessons[fold::FOLDS])
        left += np.square(weights(others.inputs) - others.answers).sum()
        total += np.square(others.answers).sum()
    return left / total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("datasets", nargs="+", type=Path, help="folders of demonstrations")
    parser.add_argument("-o", "--output", type=Path, required=True, help="a folder")
    given = parser.parse_args()
    episodes = [episode for folder in given.datasets for episode in kept(folder)]
    of_songs: dict[str, list[Lesson]] = {}
    for i, episode in enumerate(episodes, start=1):
        lesson = kept_lesson(episode, given.output / "lessons")
        of_songs.setdefault(Path(episode.about.song).name, []).append(lesson)
        print(f"\r{i} of {len(episodes)} episodes read", end="", flush=True)
    lessons = [joined(of_song) for of_song in of_songs.values()]
    print(f"\n{sum(len(x.inputs) for x in lessons)} states of a hand, of {len(lessons)} songs")
    left = {penalty: unexplained(lessons, penalty) for penalty in PENALTIES}
    for penalty, share in left.items():
        print(f"penalty {penalty:g}: explains {1 - share:.3f} on songs left out")
    weights = fitted(joined(lessons), min(PENALTIES, key=left.__getitem__))
    with write_atomically(given.output / "weights.npz") as file:
        np.savez(file, **weights._asdict())


if __name__ == "__main__":
    main()
