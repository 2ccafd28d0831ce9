"""One hand alone at the keyboard, with a plan of a song, for tests of its search and rehearsal."""

import numpy as np

from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.fingers import Side
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

DT = 0.05  # [s]


class OneHand:
    """The hand where the song begins, and a simulation of it."""

    def __init__(self, score: Score, side: Side = "right") -> None:
        task = PianoTask([score], TaskConfig(initial_buffer_time=0.5), SceneConfig(hands=side))
        (track,), start = task.tracks, task.state.hand_qpos[0]
        task.close()
        self.plan = plan_song(track if score.has_fingering else track.with_found_fingers(), start)
        self.scene = hand_alone(self.plan.scene, side).scene
        self.servos, self.keyboard = servos_of(self.scene), self.scene.keyboard
        self.goals, self.tracking = HandGoals(self.plan, side), self.plan.nominal.tracking
        self.simulator = HandRollouts(self.scene, DT)
        self.simulation = PlanningSimulation(self.scene, 1, DT)
        self.simulation.set_joints(start, np.zeros_like(start), np.zeros(88))

    @property
    def joint_state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions and velocities of the hand, and positions of the keys."""
        state = self.simulation.state
        return state.hand_qpos[0], state.hand_qvel[0], state.key_qpos[0]
