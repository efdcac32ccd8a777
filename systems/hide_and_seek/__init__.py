"""The mechanics of hide and seek, a game beside the survival game (arXiv 1909.07528), in two dimensions.

Its scenarios are in envs/scenarios/hide_and_seek.py. "Published" and names of files are of its environments,
github.com/openai/multi-agent-emergence-environments, folder mae_envs.
"""

from .climbing import Climbing
from .hiding import Hiding
from .quadrant import Quadrant
from .things import Handling, Things
from .transfer import Blueprint, Counting, Locking, Shelter

__all__ = ["Blueprint", "Climbing", "Counting", "Handling", "Hiding", "Locking", "Quadrant", "Shelter", "Things"]
