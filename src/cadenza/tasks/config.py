"""What can be chosen about the task. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Fingering = Literal["auto", "transport", "off"]


@dataclass(frozen=True)
class TaskConfig:
    """What is asked for, what is observed, what is rewarded, when an episode ends."""

    control_timestep: float = 0.05
    """Time between actions [s]."""
    n_steps_lookahead: int = 10
    """How many control steps of the score ahead are observed."""
    n_seconds_lookahead: float | None = None
    """The same in seconds, rounded up to steps; if given it takes the place of the steps."""
    trim_silence: bool = True
    """Begin with the first note and end with the last."""
    stretch: float = 1.0
    """Multiply all times by this: 2 is half as fast."""
    transpose: int = 0
    """Move all notes by this many semitones."""
    initial_buffer_time: float = 0.0
    """Silence before the first note, in which the hands can get into place [s]; they begin 10 cm
    above the keys, and a note at time 0 cannot be played in time."""
    wrong_press_termination: bool = False
    """End the episode when a key sounds that should not."""
    fingering: Fingering = "auto"
    """Reward fingers near their keys: auto: those that the score names, and where it names none
    those that a search finds; transport: whichever get there by the least way; or off."""
    energy_coefficient: float = 0.005
    """Weight of the energy term."""
    sustain_term: bool = False
    """Reward the pedal too, as the published code does."""
    forearm_term: bool = False
    """Reward forearms that do not touch, as the published code does."""
    random_hand_position: float = 0.0
    """Start both hands up to this far to the left or right, drawn per episode [m]."""
    random_stretch: float = 0.0
    """Draw the tempo per episode: times multiplied by 1 - r to 1 + r."""
    random_pitch_shift: int = 0
    """Draw a transposition per episode, up to this many semitones."""
    random_octave_shift: int = 0
    """Draw a transposition per episode, up to this many octaves."""
    randomization_probability: float = 1.0
    """How likely each of the random changes of the score happens."""


def with_time_to_begin() -> TaskConfig:
    """What is played unless something else is chosen: half a second of silence comes first.

    From where they start, the hands cannot sound a note at time 0.
    """
    return TaskConfig(initial_buffer_time=0.5)
