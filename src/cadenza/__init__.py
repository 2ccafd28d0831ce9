"""Two simulated Shadow Hands play the piano from any MIDI file.

Importing the package registers its environments with Gymnasium as `cadenza/<Song>-v0`.
"""

from cadenza.tasks.registration import register_envs

__version__ = "0.1.0"

register_envs()
