"""Policies and datasets on the Hugging Face hub, each with a card."""

from pathlib import Path
from typing import Any

from cadenza.demonstrations.dataset import DATASET, EPISODES, open_dataset
from cadenza.demonstrations.summary import summarize
from cadenza.errors import extra_packages
from cadenza.hub import upload
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.policy_folder import POLICY, load_policy, policy_folder, remarks_on

_TAGS = ["cadenza", "piano", "robotics", "mujoco"]
_MEASURED = {"f1": "F1", "note_onset_f1": "note onset F1"}
_POLICY = """
# A policy for {title}

A policy of [Cadenza](https://github.com/cadenza-piano/cadenza) for {title}: {hands} ({hand}) at
the keyboard {keyboard}.

    pip install 'cadenza[hub] @ git+https://github.com/cadenza-piano/cadenza'
    cadenza play {words}
"""
_DATASET = """
# Demonstrations of piano playing

Recorded with [Cadenza](https://github.com/cadenza-piano/cadenza), to learn from:

    pip install 'cadenza[hub] @ git+https://github.com/cadenza-piano/cadenza'
    cadenza dataset info {place}

{summary}
"""


def publish(folder: Path, repo: str) -> str:
    """Upload a policy or a dataset to the repository OWNER/NAME of the hub, and return where it is.

    The repository is made if there is none, and a card is written if the folder has no README.md.
    Raises CadenzaError if the folder holds neither or is damaged, or the hub refuses it.
    """
    with extra_packages("hub", "publishing"):
        import huggingface_hub  # noqa: F401 - before anything is read
    if (folder / EPISODES).is_dir():
        open_dataset(folder)
        return upload(folder, repo, DATASET, _dataset_card(folder, repo))
    folder = policy_folder(folder)
    learnt = load_policy(folder)
    return upload(folder, repo, POLICY, _policy_card(folder, learnt, repo))


def _policy_card(folder: Path, learnt: LearntPolicy, repo: str) -> str:
    from huggingface_hub import EvalResult, ModelCardData

    about = remarks_on(folder)
    title = "any song" if learnt.score is None else learnt.score.title or "a song"
    results = [
        EvalResult("robotics", "cadenza", title, metric, value, metric_name=name)
        for metric, name in _MEASURED.items()
        if isinstance(value := about.get(f"eval/{metric}"), float)
    ]
    data = ModelCardData(
        library_name="cadenza",
        pipeline_tag="robotics",
        tags=_TAGS,
        model_name=repo.partition("/")[2],
        eval_results=results or None,
    )
    scene = learnt.scene
    hands = "two hands" if scene.hands == "both" else f"the {scene.hands} hand"
    words = f"--agent hub:{repo}" if learnt.score else f"SONG --agent hub:{repo}"
    text = _POLICY.format(
        title=title, hands=hands, hand=scene.hand, keyboard=scene.keyboard, words=words
    )
    lines = [f"- {result.metric_name}: {result.metric_value:.3f}" for result in results]
    return _card(data, "\n".join([text, *lines, ""]))


def _dataset_card(folder: Path, repo: str) -> str:
    from huggingface_hub import DatasetCardData

    summary = "\n".join(f"- {line}" for line in summarize(folder))
    text = _DATASET.format(place=f"hub:{repo}", summary=summary)
    return _card(DatasetCardData(task_categories=["robotics"], tags=_TAGS), text)


def _card(data: Any, text: str) -> str:
    return f"---\n{data.to_yaml()}\n---\n{text}"
