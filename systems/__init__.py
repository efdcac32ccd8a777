"""The verbs of the game: one file a mechanic. A mechanic meets the others in components only."""

from .agents import Agents
from .boxes import Boxes
from .cameras import Cameras
from .drop import DeathDrop
from .drop_last import DropLast
from .ending import Ending
from .give import GiveLast
from .heals import Heals
from .health import Mortality
from .inventory import Inventory
from .melee import Melee
from .motors import Motors, Steering
from .physics import Contacts
from .pickup import AutoPickup
from .record import Record
from .rewards import Rewards
from .room import Room
from .sides import FreeForAll, Teams
from .spawn import SpawnGrid
from .zone import SafeZone

__all__ = [
    "Agents",
    "AutoPickup",
    "Boxes",
    "Cameras",
    "Contacts",
    "DeathDrop",
    "DropLast",
    "Ending",
    "FreeForAll",
    "GiveLast",
    "Heals",
    "Inventory",
    "Melee",
    "Mortality",
    "Motors",
    "Record",
    "Rewards",
    "Room",
    "SafeZone",
    "SpawnGrid",
    "Steering",
    "Teams",
]
