"""The options of a task. Imports nothing heavy: the command line shows them."""

import json
import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from cadenza.configs import in_short
from cadenza.scene.config import SceneConfig

Fingering = Literal["auto", "robot", "human", "transport", "off"]
KeyPress = Literal["published", "graded"]
Repeats = Literal["published", "shortened"]


Range = tuple[float, float]  # a minimum and a maximum

SAME: Range = (1.0, 1.0)
NOISE_ON_OBSERVATIONS = "joint_noise", "slide_noise", "key_noise", "touch_noise"
"""The fields of `DomainRandomization` that are drawn anew for each observation."""


@dataclass(frozen=True)
class RewardWeights:
    """The weights of the terms whose sum is the reward, as in the published code."""

    key_press: float = 0.5
    """Weight of goal keys that are down."""
    no_wrong_key: float = 0.5
    """Weight of no other key sounding, which is a part of the term "key_press", too."""
    fingering: float = 1.0
    """Weight of fingers near the keys that they should press."""
    energy: float = 0.005
    """Weight of the power of all actuators, a penalty [1/W]; default `energy_coefficient`."""
    sustain: float = 1.0
    """Weight of the pedal as the score has it."""
    forearm: float = 0.5
    """Weight of forearms that do not touch."""


WEIGHTS = RewardWeights()


@dataclass(frozen=True)
class DomainRandomization:
    """Domain randomization, drawn for each environment and episode.

    A range is two numbers, minimum and maximum; each reset draws from it uniformly. Factors scale
    the nominal model, each body, joint, servo or key by a factor of its own. `cadenza.tasks.robots`
    has profiles of real ones.
    """

    mass: Range = SAME
    """Range of factors of the mass and inertia of each body, keys included."""
    friction: Range = SAME
    """Range of the factor of the friction of contacts, one for all."""
    joint_damping: Range = SAME
    """Range of factors of the damping of each joint, keys included."""
    joint_friction: Range = SAME
    """Range of factors of the dry friction of each joint, which the fast physics does not have."""
    armature: Range = SAME
    """Range of factors of the inertia that each joint's motor adds."""
    servo_gain: Range = SAME
    """Range of factors of the gains of each servo, for position and speed alike."""
    key_spring: Range = SAME
    """Range of factors of the stiffness of each key's spring."""
    key_travel: Range = SAME
    """Range of factors of each key's way down."""
    key_sounding: Range = SAME
    """Range of factors of the depth from which each key sounds."""
    force_limit: Range = SAME
    """Range of factors of the force of each servo that has a limit."""
    keyboard_offset: float = 0.0
    """The keyboard is off its place by up to this far along each axis [m]."""
    keyboard_tilt: float = 0.0
    """The keyboard is turned by up to this angle about each axis [rad]."""
    mount_offset: float = 0.0
    """The base of each hand is off its place by up to this far along each axis [m]."""
    mount_tilt: float = 0.0
    """The base of each hand is turned by up to this angle about each axis [rad]."""
    gravity_tilt: float = 0.0
    """Gravity is off what is compensated by up to this angle about both level axes [rad]."""
    push: float = 0.0
    """Greatest force of pushes on a palm [N], one a second on average, each for a control step."""
    joint_speed: Range = (0.0, 0.0)
    """Range of the speed at which each servo can turn its joints, 0 for any [rad/s]."""
    slide_speed: Range = (0.0, 0.0)
    """Range of the speed at which each servo can move its slide, 0 for any [m/s]."""
    joint_dead_band: Range = (0.0, 0.0)
    """Range of the change below which each servo of a joint ignores a control [rad]."""
    slide_dead_band: Range = (0.0, 0.0)
    """Range of the change below which each servo of a slide ignores a control [m]."""
    joint_backlash: Range = (0.0, 0.0)
    """Range of the play between each servo and its joint [rad]."""
    slide_backlash: Range = (0.0, 0.0)
    """Range of the play between each servo and its slide [m]."""
    latency: Range = (0.0, 0.0)
    """Range of the time that actions take to arrive [s], rounded to physics steps."""
    observation_latency: Range = (0.0, 0.0)
    """Range of the time that observations take to arrive [s], rounded to physics steps."""
    joint_noise: float = 0.0
    """Standard deviation of the normal noise on observed joint angles, drawn in each step [rad]."""
    slide_noise: float = 0.0
    """Standard deviation of the normal noise on observed positions of slides [m]."""
    key_noise: float = 0.0
    """Standard deviation of the normal noise on observed key states, which stay in 0 to 1."""
    touch_noise: float = 0.0
    """Standard deviation of the normal noise on observed forces of fingertips [N]."""
    joint_bias: float = 0.0
    """Standard deviation of what each observed joint angle is off in a whole episode [rad]."""
    slide_bias: float = 0.0
    """Standard deviation of what each observed position of a slide is off [m]."""
    touch_bias: float = 0.0
    """Standard deviation of what each observed force of a fingertip is off [N]."""
    drift: float = 0.0
    """How far biases wander in a minute, as a multiple of their standard deviations."""
    control_noise: float = 0.0
    """Standard deviation of the normal noise on controls, drawn in each step, as a fraction of half
    the control range. Controls stay in their range."""
    joint_control_noise: float = 0.0
    """Standard deviation of further noise on the controls of joints [rad]."""
    slide_control_noise: float = 0.0
    """Standard deviation of further noise on the controls of slides [m]."""
    seed: int | None = None
    """Seed of all that is drawn, the same in every episode. By default each reset draws a seed with
    the random numbers of its environment."""
    robot: int | None = None
    """Seed of what a robot is, the same in every episode: all but noise and pushes."""

    __repr__ = in_short

    @property
    def is_on(self) -> bool:
        """Whether anything may differ from the nominal model or its sensors."""
        return replace(self, seed=None, robot=None) != DomainRandomization()


@dataclass(frozen=True)
class TaskConfig:
    """The task: goals, observations, rewards and termination.

    By default all notes can begin in time, and when and how loud they are is observed and rewarded.
    The setup "published" (`cadenza.tasks.setups`) is the task of RoboPianist.
    """

    control_timestep: float = 0.05
    """Time between two actions [s]."""
    n_steps_lookahead: int = 10
    """Lookahead of the goal observation, in control steps."""
    n_seconds_lookahead: float | None = None
    """The lookahead in seconds, rounded up to control steps. Replaces --n-steps-lookahead."""
    trim_silence: bool = True
    """Remove silence before the first note and after the last."""
    stretch: float = 1.0
    """Scale all times by this factor: 2 is half the tempo."""
    transpose: int = 0
    """Transpose by this many semitones."""
    initial_buffer_time: float = 0.5
    """Silence before the first note [s]. The hands start 10 cm above the keys and need it to reach
    a note at time 0."""
    repeats: Repeats = "shortened"
    """Notes that repeat a key without a gap. shortened: the note before it ends one step early, so
    that the repeated note can begin in time, and a pedal that is lifted and pressed again within a
    step comes up; published: the repeated note starts one step late, as in RoboPianist."""
    wrong_press_termination: bool = False
    """End the episode when a wrong key sounds."""
    fingering: Fingering = "auto"
    """Fingers that are rewarded, and that planners use. auto: the fingers in the score, and for
    other notes the ones that suit the robot's hands. robot: the ones that suit the robot's hands,
    for all notes. human: a pianist's fingers. transport: rewards the shortest way from fingers to
    keys. off: rewards none."""
    hands_as_written: bool = False
    """Have each hand play what the score has for it, as far as it can."""
    fingering_margin: float = 0.1
    """Distance over which the fingering reward falls to a tenth, beyond a first centimetre that
    costs nothing [m]."""
    joint_velocities: bool = False
    """Observe the velocities of the hands' joints, too [m/s, rad/s]."""
    onset_goals: bool = True
    """Observe when within control steps notes begin and how loud they are, and when and how loud
    keys began to sound. Without it, the rewards for both have no effect."""
    onset_timing_coefficient: float = 1.0
    """Weight of the reward for each note that begins in time."""
    loudness_coefficient: float = 0.5
    """Weight of the reward for each note that is as loud as written."""
    key_press: KeyPress = "published"
    """Reward for the keys to press. published: hardly any for a key before it is nearly down, and
    as much for no wrong key; graded: for every touch, less for every wrong key."""
    energy_coefficient: float = WEIGHTS.energy
    """Weight of the energy penalty."""
    sustain_term: bool = False
    """Add the reward for the sustain pedal, as in the published code."""
    forearm_term: bool = False
    """Add the reward for forearms that do not collide, as in the published code: of Shadow hands,
    palms and some links of fingers count, too."""
    random_hand_position: float = 0.0
    """Randomise the initial position of both hands along the keyboard, up to this far either way
    [m]."""
    random_stretch: float = 0.0
    """Randomise the tempo per episode: times are scaled by a factor between 1 - r and 1 + r."""
    random_pitch_shift: int = 0
    """Randomise the transposition per episode, up to this many semitones."""
    random_octave_shift: int = 0
    """Randomise the transposition per episode, up to this many octaves."""
    randomization_probability: float = 1.0
    """Probability that each randomisation of the score is applied in an episode."""
    randomization: DomainRandomization = field(default_factory=DomainRandomization)
    """Randomisation of the simulation and its sensors by environment and episode."""

    @property
    def lookahead_steps(self) -> int:
        """The lookahead of the goal observation in control steps, however it is given."""
        if self.n_seconds_lookahead is None:
            return self.n_steps_lookahead
        return math.ceil(round(self.n_seconds_lookahead / self.control_timestep, 9))

    __repr__ = in_short


# Options that do not change how the same actions move keys and hands.
_WITHOUT_EFFECT_ON_MOTION = {
    "n_steps_lookahead",
    "n_seconds_lookahead",
    "fingering",
    "hands_as_written",
    "fingering_margin",
    "joint_velocities",
    "onset_goals",
    "onset_timing_coefficient",
    "loudness_coefficient",
    "key_press",
    "energy_coefficient",
    "sustain_term",
    "forearm_term",
    "touch",
    "engine",  # up to 1e-4 rad
    "randomization",  # plans are tried against it
}


def task_identity(task: TaskConfig, scene: SceneConfig, seed: int, **song: Any) -> dict[str, Any]:
    """The options, as in JSON, that decide how a plan of a song is played.

    A plan's file keeps them, practice continues only with equal ones, and comparisons show where
    they differ. The seed is left out if the task draws nothing at random.
    """
    options = asdict(task) | asdict(scene)
    drawn = any(value for name, value in asdict(task).items() if name.startswith("random_"))
    decisive = {
        name: value for name, value in options.items() if name not in _WITHOUT_EFFECT_ON_MOTION
    }
    return dict(json.loads(json.dumps(decisive | song | ({"seed": seed} if drawn else {}))))
