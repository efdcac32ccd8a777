"""Recordings: what decides an episode, in about one byte an agent-step, and replays of it that are the same bits.

Read in this order: recorder (what is kept of a run of the tick), file (how it lies on the disk), replay (how it is run
again), digests (how a difference is found), samples (what a learner wants of it).
"""

from .reader import Recording
from .recorder import Recorder
from .replay import Replay

__all__ = ["Recorder", "Recording", "Replay"]
