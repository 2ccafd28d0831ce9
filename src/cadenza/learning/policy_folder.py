"""Policies as folders, which can be copied to another machine and played there."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, by_others, errors_in, quoted
from cadenza.files import (
    ANY,
    FLOATS,
    NUMBERS,
    TENSORS,
    ArrayOf,
    check_arrays,
    checked,
    read_tensors,
    write_tensors,
)
from cadenza.hub import Kind, fetched
from cadenza.learning.actions import Reference
from cadenza.learning.learner import learner_config
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.observation import Inputs, ObservationSpec
from cadenza.learning.policy import Activation, Perceptron, Policy
from cadenza.learning.ranges import Ranges
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig, check_modules
from cadenza.tasks.config import TaskConfig

POLICY_FILE = f"policy{TENSORS}"  # the file of a policy: arrays, and facts as JSON in its header
_MAX_BYTES = 2**30  # policies take a few million
POLICY = Kind("policy", "model", (POLICY_FILE,), _MAX_BYTES)  # a policy as the hub keeps it
_FORMAT = 3
_REFERENCE, _RANGES, _POLICY = "reference/", "ranges/", "policy/"  # begin names of arrays
_COMMON_ARRAYS = {
    "reference/ctrl": ArrayOf(FLOATS, ("steps", "servos"), finite=True),
    "reference/gain": ArrayOf(FLOATS, ("steps", "servos", 2), finite=True),
    "reference/expected": ArrayOf(FLOATS, ("steps + 1", "servos", 2), finite=True),
    "reference/pedal": ArrayOf(FLOATS, ("steps",), finite=True),
    "reference/reach": ArrayOf(FLOATS, ("servos",), finite=True),
    "ranges/joints": ArrayOf(FLOATS, (2, "joints"), finite=True),
    "ranges/actions": ArrayOf(FLOATS, (2, "actions"), finite=True),
}
_OTHER_ARRAYS = _COMMON_ARRAYS | {"policy/*": ArrayOf(NUMBERS, None)}
_PERCEPTRON_ARRAYS = _COMMON_ARRAYS | {
    "mean/kernel": ArrayOf(FLOATS, ("features", "actions"), needed=True, finite=True),
    "mean/bias": ArrayOf(FLOATS, ("actions",), needed=True, finite=True),
    "log_std/kernel": ArrayOf(FLOATS, ("features", "actions"), needed=True, finite=True),
    "log_std/bias": ArrayOf(FLOATS, ("actions",), needed=True, finite=True),
    "hidden_*/kernel": ArrayOf(FLOATS, ("*", "*"), finite=True),
    "hidden_*/bias": ArrayOf(FLOATS, ("*",), finite=True),
}


@dataclass(frozen=True)
class _PolicyFacts:
    format: int
    observation: ObservationSpec
    inputs: Inputs
    task: TaskConfig
    scene: SceneConfig
    score: WrittenScore | None
    about: dict[str, Any]


@dataclass(frozen=True)
class _PerceptronFacts(_PolicyFacts):
    activation: Activation
    log_std_range: tuple[float, float]


@dataclass(frozen=True)
class _OtherFacts(_PolicyFacts):
    learner: str  # the name of the learner that reads the policy
    policy: dict[str, Any]  # the facts of `Policy.state`


def save_policy(folder: Path, learnt: LearntPolicy, about: dict[str, Any]) -> None:
    """Write a policy to a folder, with remarks `about` it.

    Raises CadenzaError if there is no room; what the folder held is still there.
    """
    metadata, arrays = learnt.policy.state()
    if learnt.learner is not None:
        metadata = {"learner": learnt.learner, "policy": metadata}
        arrays = {_POLICY + name: array for name, array in arrays.items()}
    facts = {
        "format": _FORMAT,
        "about": about,
        **metadata,
        "observation": asdict(learnt.observation),
        "inputs": asdict(learnt.inputs),
        "task": asdict(learnt.task),
        "scene": asdict(learnt.scene),
        "score": None if learnt.score is None else asdict(WrittenScore.of(learnt.score)),
    }
    try:
        parts = _with_prefix(_REFERENCE, learnt.reference) | _with_prefix(_RANGES, learnt.ranges)
        write_tensors(folder / POLICY_FILE, arrays | parts, facts, _MAX_BYTES)
    except OSError as error:
        raise CadenzaError(
            f"{folder}: could not be written ({error.strerror}); make room there"
        ) from error


def policy_folder(folder: str | Path) -> Path:
    """The folder of a policy, here or of the hub; of a training run, that of its best policy."""
    folder = fetched(folder, POLICY)
    return best if (best := folder / "best").is_dir() else folder


def load_policy(folder: str | Path) -> LearntPolicy:
    """Read the policy of a folder, the best policy of a training run, or a policy of the hub.

    Raises CadenzaError if there is no policy, or it is damaged or of another version.
    """
    folder = policy_folder(folder)
    where = folder / POLICY_FILE
    if not where.exists():
        latest = folder / "last"
        hint = f"its latest policy is {latest}" if latest.is_dir() else "name another"
        raise CadenzaError(f"{folder}: holds no {POLICY_FILE}, so it is no policy; {hint}")
    arrays, plain = read_tensors(where, ANY, _MAX_BYTES)
    if (number := plain.get("format")) != _FORMAT:
        raise CadenzaError(
            f"{folder}: this policy has format {quoted(number)}, but this version reads only "
            f"{_FORMAT}; install the version of Cadenza that wrote it"
        )
    is_perceptron = "learner" not in plain
    check_arrays(arrays, _PERCEPTRON_ARRAYS if is_perceptron else _OTHER_ARRAYS, folder)
    facts: _PolicyFacts = checked(plain, _PerceptronFacts if is_perceptron else _OtherFacts, where)
    check_modules(facts.scene, where)
    try:
        score = None if facts.score is None else facts.score.score
    except CadenzaError as error:
        raise CadenzaError(f"{where}: {error}; use another copy") from error
    with errors_in(folder), by_others("cannot be read"):
        learnt = _learnt(facts, score, arrays)
        fits = learnt is not None and _fits_together(learnt)
    if learnt is None or not fits:
        raise CadenzaError(
            f"{folder}: not a policy that this version can read (its arrays do not belong "
            "together); use another copy"
        )
    return learnt


def remarks_on(folder: Path) -> dict[str, Any]:
    """The remarks about a policy, such as its metrics; raises CadenzaError if it is damaged."""
    facts = read_tensors(folder / POLICY_FILE, ANY, _MAX_BYTES)[1]
    return checked(facts.get("about"), dict[str, Any], folder / POLICY_FILE)


def _with_prefix(prefix: str, part: Reference | Ranges | None) -> dict[str, NDArray[Any]]:
    return {} if part is None else {prefix + name: a for name, a in part._asdict().items()}


def _without_prefix(prefix: str, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {n.removeprefix(prefix): a for n, a in arrays.items() if n.startswith(prefix)}


def _learnt(
    facts: _PolicyFacts, score: Score | None, arrays: dict[str, NDArray[Any]]
) -> LearntPolicy | None:
    """The policy, or None if arrays of the reference or of the ranges are missing."""
    reference, ranges = _without_prefix(_REFERENCE, arrays), _without_prefix(_RANGES, arrays)
    for part, kind in ((reference, Reference), (ranges, Ranges)):
        if part and part.keys() != set(kind._fields):
            return None
    return LearntPolicy(
        policy=_policy(facts, arrays),
        observation=facts.observation,
        inputs=facts.inputs,
        reference=Reference(**reference) if reference else None,
        ranges=Ranges(**ranges) if ranges else None,
        task=facts.task,
        scene=facts.scene,
        score=score,
        learner=facts.learner if isinstance(facts, _OtherFacts) else None,
    )


def _policy(facts: _PolicyFacts, arrays: dict[str, NDArray[Any]]) -> Policy:
    if isinstance(facts, _OtherFacts):
        return learner_config(facts.learner).policy_of(
            facts.policy, _without_prefix(_POLICY, arrays)
        )
    assert isinstance(facts, _PerceptronFacts)
    weights = {n: a for n, a in arrays.items() if not n.startswith((_REFERENCE, _RANGES))}
    return Perceptron(weights, facts.activation, facts.log_std_range)


def _fits_together(learnt: LearntPolicy) -> bool:
    """Whether the shapes of the arrays are those of the observation and the actions."""
    observation, reference, ranges = learnt.observation, learnt.reference, learnt.ranges
    actions = observation.previous_action
    try:
        action = learnt.policy.mode(np.zeros((1, len(learnt.inputs.kept)), np.float32))
    except (KeyError, ValueError):  # layers that do not fit
        return False
    if action.shape != (1, actions) or learnt.inputs.total != observation.size:
        return False
    if ranges is not None and ranges.joints.shape[1] != observation.joints:
        return False
    if reference is None:
        return observation.reference == 0
    shape = (reference.ctrl.shape[1], len(reference.expected) - len(reference.ctrl))
    return observation.reference == actions and shape == (actions - 1, 1)
