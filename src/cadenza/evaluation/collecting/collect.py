"""Collection of a demonstration: an episode is played, and recorded if it is good enough."""

import hashlib
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Progress
from cadenza.agents.lateness import Lateness
from cadenza.agents.planner.plan.song_plan import SongPlan, plan_song
from cadenza.agents.registry import is_folder
from cadenza.agents.rollout import EpisodeResult, play_episode
from cadenza.demonstrations.recorded_episode import (
    FORMAT,
    PLAN,
    RESULT,
    STEPS,
    EpisodeFacts,
    plan_type,
    read_facts,
    steps_type,
    write,
    write_facts,
)
from cadenza.evaluation.collecting.performed_agent import PerformedAgent
from cadenza.evaluation.collecting.perturbed_agent import PerturbedAgent, Shown, shown_by
from cadenza.evaluation.collecting.variation import Variation, as_drawn
from cadenza.evaluation.jobs import BenchJob, JobSpec, digest_of_files, songs_of
from cadenza.evaluation.run import check_song, versions
from cadenza.evaluation.run_status import claimed_run, progress_writer
from cadenza.keyboards.registry import keyboard_named
from cadenza.learning.policy_folder import POLICY_FILE
from cadenza.music.arrangement import Arrangement, load
from cadenza.music.libraries.songs import Library
from cadenza.performing.setup import Setup, find_player, set_up
from cadenza.scene.config import SceneConfig
from cadenza.scene.servos import servos_of
from cadenza.sim.threads import cpu_seconds
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.reward import key_state
from cadenza.tasks.view import View, observed_touch

Array = NDArray[Any]

PERFORMANCES = "performances"  # the folder beside that of the episodes


@dataclass(frozen=True)
class EpisodeSpec(JobSpec):
    """All inputs of an episode; `seed` is its number among the episodes of its song."""

    variation: Variation = field(default_factory=Variation)
    student_config: Any = None  # the options of the student, if there is one and it has any

    @property
    def pitches(self) -> range:
        """Pitches of notes that have keys after transposition."""
        pitches, transpose = keyboard_named(self.scene.keyboard).pitches, self.task.transpose
        return range(pitches.start - transpose, pitches.stop - transpose)


@dataclass(frozen=True)
class EpisodeJob(BenchJob):
    """An episode to be played, and recorded if it is good enough."""

    command: ClassVar[str] = "cadenza dataset collect"
    spec: EpisodeSpec
    page: bool = False
    least_f1: float = 0.0  # minimum F1 and note onset F1 of an episode to be recorded


class Demonstrator(NamedTuple):
    """The agent that plays the episodes, its task and scene, and their variation."""

    agent: str
    config: Any
    task: TaskConfig
    scene: SceneConfig
    arrangement: Arrangement
    variation: Variation
    student_config: Any = None


def episodes(
    library: Library, demonstrator: Demonstrator, numbers: Sequence[int], least_f1: float
) -> list[EpisodeJob]:
    """All episodes to be collected: the first of every song, then the second and so on."""
    songs = songs_of(library)
    student = demonstrator.variation.student
    policy = [Path(student) / POLICY_FILE] if student is not None and is_folder(student) else []
    files = digest_of_files(demonstrator.config, demonstrator.student_config, others=policy)
    return [
        EpisodeJob(
            EpisodeSpec(
                song=song.name,
                song_digest=digest,
                seed=number,
                agent_digest=files,
                **demonstrator._asdict(),
            ),
            song,
            least_f1=least_f1,
        )
        for number in numbers
        for song, digest in songs
    ]


def is_complete(job: EpisodeJob, folder: Path) -> bool:
    """Whether an episode is recorded, or was not good enough."""
    if not (folder / RESULT).exists():
        return False
    facts = read_facts(folder)
    return facts.kept or not _is_good(facts.metrics, job)


def record(
    job: EpisodeJob, folder: Path, num_threads: int, _stop: Callable[[], bool] = lambda: False
) -> None:
    """Play and record an episode in `folder`, as `cadenza.evaluation.run.carry_out` a run."""
    with claimed_run(job, folder, is_complete) as ours:
        if ours:
            _record(job, folder, num_threads, progress_writer(folder))


def _record(job: EpisodeJob, folder: Path, num_threads: int, progress: Progress) -> None:
    spec, cpu_before = job.spec, cpu_seconds()
    check_song(spec)
    seed, rng = _randomness(spec)
    configs = {spec.agent: spec.config}
    as_written = replace(spec.arrangement, arrange="off", level=None)
    player = find_player(spec.agent, configs=configs)
    loaded = load(spec.song, as_written)
    song = loaded.score
    if not player.agent.keeps_fingering:  # the task is to find the same fingers as the agent
        song = song.without_fingers()
    score, drawn = spec.variation.draw(song, spec.pitches, rng)
    with (
        set_up(
            replace(loaded, score=score),
            player.playing_in(spec.task, spec.scene),
            seed=seed,
            num_threads=num_threads,
            progress=progress,
        ) as setup,
        closing(_perturbed_agent(setup, drawn["noise"], spec, folder)) as perturbed,
    ):
        result = play_episode(setup.task, perturbed, seed, progress)
        is_good = _is_good(result.metrics, job)
        plan = _plan(setup, result, perturbed) if is_good else None
        last_view = setup.task.view()  # after the last step
    facts = EpisodeFacts(
        format=FORMAT,
        job=spec.as_json(),
        song=spec.song,
        kept=is_good,
        metrics=result.metrics,
        drawn=drawn,
        task=_without_randomness(spec.task, result),
        scene=spec.scene,
        start=tuple(result.episode["hand_qpos0"].tolist()),
        cpu_seconds=cpu_seconds() - cpu_before,
        versions=versions(),
        files={},
    )
    if plan is None:
        write_facts(folder, facts)
    else:
        (track,) = setup.task.goals.tracks
        track = plan.track if track.dropped is None else track  # with the rewarded fingers, if any
        write(folder, facts, song, track.score, _arrays(result, perturbed, last_view, plan))


def _perturbed_agent(setup: Setup, noise: float, spec: EpisodeSpec, folder: Path) -> PerturbedAgent:
    name, agent = spec.variation.student, setup.agent
    student = None if name is None else find_player(name, configs={name: spec.student_config}).agent
    if student is not None:
        student.num_threads = agent.num_threads
    if Lateness.expected(spec.task.randomization) is None:  # else it plays early, or filters
        facts = spec.agent, spec.as_json()["config"], digest_of_files(spec.config)
        agent = PerformedAgent(agent, folder.parent.parent / PERFORMANCES, facts)
    return PerturbedAgent(agent, setup.task.scene, noise, student)


def _is_good(metrics: dict[str, Any], job: EpisodeJob) -> bool:
    scores = (metrics[name] or 0.0 for name in ("f1", "note_onset_f1"))
    return min(scores) >= job.least_f1 and not metrics["unstable"]


def _randomness(spec: EpisodeSpec) -> tuple[int, np.random.Generator]:
    """The seed of an episode and a generator; both depend on its song and number."""
    content = hashlib.sha256(f"{spec.song_digest} {spec.seed}".encode()).digest()
    seed, other = (int.from_bytes(content[at : at + 8], "big") for at in (0, 8))
    return seed, np.random.default_rng(other)


def _plan(setup: Setup, result: EpisodeResult, perturbed: PerturbedAgent) -> SongPlan:
    """The plan of the agent, or one for the same song and start.

    Learners correct plans without timed strikes, which the planner's plans have. If the planner
    plays early, its plan has fewer steps than the episode.
    """
    (track,) = setup.task.goals.tracks
    steps = track.goals.num_steps
    if result.plan is not None and result.plan.complete and result.plan.goals.num_steps == steps:
        if not len(result.plan.strikes.step):
            return result.plan
        track = result.plan.track
    assert perturbed.start is not None
    return plan_song(track, perturbed.start.hand_qpos[0])


def _without_randomness(task: TaskConfig, result: EpisodeResult) -> TaskConfig:
    """The task of a replay, whose seed determines the draws of `DomainRandomization`."""
    seed = result.episode.arrays.get("randomization_seed")
    randomization = replace(task.randomization, seed=None if seed is None else int(seed))
    return replace(as_drawn(task), randomization=randomization)


def _arrays(
    result: EpisodeResult, perturbed: PerturbedAgent, last: View, plan: SongPlan
) -> dict[str, Array]:
    """The arrays of a recorded episode, see `cadenza.demonstrations.recorded_episode`."""
    episode, start, scene = result.episode, perturbed.start, plan.scene
    assert start is not None
    count = episode.num_steps
    steps = np.zeros(count + 1, steps_type(scene))
    for name in ("hand_qpos", "hand_qvel", "fingertip_xpos"):
        steps[name][0], steps[name][1:] = getattr(start, name)[0], episode[name]
    travel = scene.keyboard.travel
    steps["key_state"][0] = key_state(start.key_qpos[0], travel)
    steps["key_state"][1:] = key_state(episode["key_qpos"], travel)
    if scene.config.touch:
        touch = np.concatenate([start.touch[:1], episode["touch"]])
        steps["touch"] = observed_touch(touch[:, scene.present_fingers])
    steps["sounding"][1:] = np.packbits(episode["key_activation"], axis=1)
    steps["played"][1:] = perturbed.played
    shown = Shown._make(zip(*perturbed.shown, shown_by(last), strict=True))
    for name, values in shown._asdict().items():
        steps[name] = values
    steps["previous_reward"][1:] = episode["reward_total"]
    steps["action"][:-1] = perturbed.chosen
    tracking, servos = plan.nominal.tracking, servos_of(scene)
    states = servos.state(steps["hand_qpos"][:-1], steps["hand_qvel"][:-1])
    steps["tracked"][:-1] = tracking.controls(servos, np.arange(count), states)
    rows = np.zeros(count + 1, plan_type(scene))
    rows["reference"] = tracking.expected[: count + 1]
    present = scene.present_fingers
    rows["fingertips"][:, present] = plan.nominal.fingertips[: count + 1]
    return {STEPS: steps, PLAN: rows}
