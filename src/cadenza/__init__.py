"""Two simulated Shadow Hands play the piano from any MIDI file."""

from importlib.metadata import version

__version__ = version("cadenza")
