"""The problem of a training run: songs as a task, observations of a policy, and its actions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from cadenza.agents.agent import Progress, silent
from cadenza.learning.actions import ActionMapping, Reference, reference_of
from cadenza.learning.config import TrainingConfig, check
from cadenza.learning.observation import GoalTable, Inputs, ObservationSpec, Observer, pruned
from cadenza.learning.ranges import Ranges, ranges_of
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.sim.threads import available_cores
from cadenza.tasks.augmentation import draws_pitch
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.reward import RewardTerm


@dataclass(frozen=True)
class Problem:
    """The songs of a run and the environments that play them."""

    config: TrainingConfig
    scores: tuple[Score, ...]  # the songs; each episode draws one
    task: PianoTask  # the environments in C, or one of them where policies learn on a device
    goals: GoalTable
    observation: ObservationSpec
    inputs: Inputs  # the entries of the observation that the policy is given
    reference: Reference | None  # the performance that a residual policy corrects
    ranges: Ranges | None  # the scale of joints and actions, if not the task's
    reward_terms: Mapping[str, RewardTerm] | None  # the user's own

    @property
    def scene(self) -> SceneConfig:
        """The scene in which policies are evaluated: what is learnt on a GPU plays in C."""
        return replace(self.config.scene, engine="c")

    @property
    def mapping(self) -> ActionMapping:
        """The map from the policy's actions to controls."""
        return ActionMapping(self.task.spec, self.reference, self.ranges)

    @property
    def observer(self) -> Observer:
        """The maker of the policy's observations."""
        reference = self.mapping.reference
        return Observer(self.task.spec, self.goals, self.inputs, reference, self.ranges)

    def evaluation_task(self, score: Score, num_envs: int) -> PianoTask:
        """Environments that all play this song."""
        terms = self.reward_terms
        return PianoTask([score], self.config.task, self.scene, num_envs, reward_terms=terms)


def problem_of(
    config: TrainingConfig,
    scores: Sequence[Score],
    progress: Progress = silent,
    reference: Reference | None = None,
    reward_terms: Mapping[str, RewardTerm] | None = None,
) -> Problem:
    """The problem of a run with these options, whose task the caller must close.

    A residual policy corrects the `reference`, or else a new plan, whose progress is reported.
    `reward_terms` are as of `PianoTask`.

    Raises CadenzaError if a song cannot be played, or an option makes no sense.
    """
    check(config)
    scores = tuple(score.without_fingers() if config.residual else score for score in scores)
    on_policy, on_device = config.learner.on_policy, config.scene.engine == "warp"
    num_envs = 1 if on_device else config.num_envs
    threads = available_cores() if on_policy else 1
    scene = replace(config.scene, engine="c")
    task = PianoTask(scores, config.task, scene, num_envs, threads, reward_terms)
    goals = GoalTable(task.spec, task.tracks)
    if config.residual and reference is None:
        reference = reference_of(task, config.seed, config.plan_effort, progress)
    observation = ObservationSpec.of(task.spec, config.residual)
    prune = config.prune_inputs and not draws_pitch(config.task)  # keys are the same each time
    inputs = pruned(observation, *goals.goals_used()) if prune else observation.inputs
    if on_policy:  # the previous action tells little that the state does not
        layout = observation.layout
        previous = range(layout["previous_action"].start, layout["previous_reward"].stop)
        inputs = Inputs(tuple(i for i in inputs.kept if i not in previous), inputs.total)
    return Problem(
        config,
        scores,
        task,
        goals,
        observation,
        inputs,
        reference=reference,
        ranges=ranges_of(task) if config.song_range and task.scene.sides else None,
        reward_terms=reward_terms,
    )
