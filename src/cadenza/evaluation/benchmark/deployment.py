"""The track of unknown robots: the play on each after ten plays, repeated to verify it."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.robot.protocol import in_turn, play
from cadenza.errors import CadenzaError
from cadenza.evaluation.benchmark.definition import METRICS, ROBOTS
from cadenza.evaluation.benchmark.entry import EnteredRun, Metrics, actions_path
from cadenza.files import ANY, read_json, read_tensors, write_tensors
from cadenza.music.metrics import expressive_metrics
from cadenza.performing.setup import Setup
from cadenza.performing.with_robot import ABOUT, PLAYS_FILE, RobotPlays, simulated
from cadenza.tasks.robots import Profile
from cadenza.tasks.unknown_robot import PLAYS

AGENT = "practice-with-robots"
_PROFILE: Profile = "realistic"
_MAX_BYTES = 2**28  # bytes of eleven plays of a song


def played_on_robot(actions: NDArray[np.float64], robot: int, setup: Setup) -> Metrics:
    """The metrics of actions (T, A) in the eleventh play of a robot of this seed."""
    driver = simulated(setup, robot, _PROFILE)
    for _ in range(PLAYS):
        driver.start()  # the actions show what was learnt in these plays
    play(driver, len(actions), in_turn(actions))
    task = driver.env.task
    metrics = expressive_metrics(task.played(0), task.score(0)) | task.episode_metrics(0)
    values = {name: metrics[name] for name in METRICS}
    return {n: None if v is None or math.isnan(v) else float(v) for n, v in values.items()}


def robot_runs(bench: Path, entry: Path, digest: str, setup: Setup) -> list[EnteredRun]:
    """Write the actions of the last play of a song on each robot, from the folders in `bench`.

    Raises CadenzaError if a robot is missing, or its play does not repeat as recorded.
    """
    song, runs = str(setup.settings["song"]), list[EnteredRun]()
    plays_by_folder = {
        path.parent: read_json(path, RobotPlays) for path in sorted(bench.glob(f"*/{ABOUT}"))
    }
    low, high = setup.task.spec.action_low, setup.task.spec.action_high
    for robot in range(ROBOTS):
        key = (song, str(robot), _PROFILE)
        folders = [f for f, p in plays_by_folder.items() if (p.song, p.robot, p.profile) == key]
        if not folders:
            raise CadenzaError(
                f"{bench}: {song} was not played on robot {robot}; cadenza practice {song} "
                f"--robot {robot} -o {bench / f'{song}-{robot}'}"
            )
        plays = read_tensors(folders[0] / PLAYS_FILE, ANY, _MAX_BYTES)[0]["action"]
        actions = plays[-1].clip(low, high)
        metrics, about = played_on_robot(actions, robot, setup), plays_by_folder[folders[0]]
        if any(metrics[name] != about.metrics.get(name) for name in ("f1", "note_onset_f1")):
            raise CadenzaError(f"{folders[0]}: does not play as it was recorded; practise it again")
        write_tensors(actions_path(entry, song, robot), {"action": actions})
        runs.append(EnteredRun(song, robot, digest, metrics, about.cpu_seconds))
    return runs
