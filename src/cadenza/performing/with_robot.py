"""Practice of a song with an unknown robot: ten plays, and one more that is scored."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.robot.practice import ScoredPlay, learn_in_ten_plays
from cadenza.agents.robot.protocol import CheckedRobot, Robot
from cadenza.agents.robot.simulated import SimulatedRobot
from cadenza.agents.rollout import begin_episodes, play_episode
from cadenza.errors import CadenzaError, by_others
from cadenza.files import write_json, write_tensors
from cadenza.performing.setup import Setup
from cadenza.registry import Registry
from cadenza.sim.threads import cpu_seconds
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.robots import PROFILES, Profile
from cadenza.tasks.unknown_robot import PLAYS, UnknownRobotEnv

ROBOTS = Registry("robot", "cadenza.robots", otherwise="a seed of a simulated one or module:Name")
"""Drivers of robots: classes without arguments, see `cadenza.agents.robot.protocol.Robot`."""
ABOUT, PLAYS_FILE = "robot.json", "plays.safetensors"


@dataclass(frozen=True)
class RobotPlays:
    """The plays of a song by a robot; content of robot.json."""

    song: str
    robot: str
    """The seed of a simulated robot, or the driver of another."""
    profile: Profile
    """The profile that it was drawn from, or resembles."""
    scores: tuple[tuple[float, float], ...]
    """F1 and note onset F1 of every play, by what was heard."""
    metrics: dict[str, float]
    """Metrics of the last play, which is scored: true ones of simulated robots, else as heard."""
    cpu_seconds: float
    """CPU time of planning, practice and simulation."""


def practise(
    setup: Setup, robot: str, profile: Profile
) -> Iterator[tuple[RobotPlays, NDArray[np.float64]]]:
    """Have a robot learn a song in ten plays, see `learn_in_ten_plays`.

    `robot` is the seed of a simulated one, drawn from the profile, or a driver as `module:Name`,
    about as late as the profile says. Yields after each play all plays so far and their actions
    (P, T, A). Raises CadenzaError if there is no such robot.
    """
    began = cpu_seconds()
    begin_episodes(setup.task, [setup.seed])
    view = setup.task.view()
    nominal = play_episode(setup.task, setup.agent, setup.seed)
    setup.agent.close()  # its processes end, and their time counts
    if nominal.plan is None:
        raise CadenzaError("a robot practises what the planner plays: choose no other agent")
    if robot.isdigit():
        device: Robot = simulated(setup, int(robot), profile)
    else:
        device = _driver(robot, len(setup.task.scene.hand_joint_names))
    plays = learn_in_ten_plays(device, view, nominal.plan, nominal.episode, PROFILES[profile])
    takes = list[ScoredPlay]()
    for number in range(1, PLAYS + 2):
        with by_others(f"robot {robot}: play {number} failed"):
            takes.append(next(plays))
        scores = tuple((take.f1, take.note_onset_f1) for take in takes)
        scored = device.scored if isinstance(device, SimulatedRobot) else {}
        metrics = dict(scored) or dict(zip(("f1", "note_onset_f1"), scores[-1], strict=True))
        song, seconds = str(setup.settings["song"]), cpu_seconds() - began
        actions = np.array([take.actions for take in takes])
        yield RobotPlays(song, robot, profile, scores, metrics, seconds), actions


def save(folder: Path, plays: RobotPlays, actions: NDArray[np.float64]) -> None:
    """Write robot.json, and plays.safetensors with the actions (P, T, A) of all plays."""
    folder.mkdir(parents=True, exist_ok=True)
    write_tensors(folder / PLAYS_FILE, {"action": actions})
    write_json(folder / ABOUT, asdict(plays))


def simulated(setup: Setup, robot: int, profile: Profile) -> SimulatedRobot:
    """A robot of this seed, in the task of a setup."""
    config, scene = setup.task.config, setup.task.scene.config
    options = {f.name: getattr(config, f.name) for f in fields(TaskConfig)}
    del options["randomization"]
    env = UnknownRobotEnv(setup.score, robot, profile, scene=scene, **options)
    return SimulatedRobot(env)


def _driver(name: str, num_joints: int) -> Robot:
    """The driver of this name; raises CadenzaError if there is none, or it cannot be made."""
    driver = ROBOTS.load(name, type)
    with by_others(f"robot {name}: cannot be made"):
        return CheckedRobot(driver(), name, num_joints)
