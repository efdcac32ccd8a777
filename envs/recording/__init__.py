"""Recordings: the inputs of episodes, in about one byte per agent-step, and bit-identical replays of them.

Read in this order: recorder (the inputs of a tick, and digests, which detect differences), file_format, replay (the
ticks repeated).
"""

from .recorder import Recorder, record
from .replay import Recording, Replay

__all__ = ["Recorder", "Recording", "Replay", "record"]
