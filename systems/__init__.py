"""The mechanics of the game, one per file. They share components, but do not import each other."""

from .agents import Agents
from .behaviour import Behaviour
from .boxes import Boxes
from .cameras import Cameras
from .contacts import Contacts
from .death_drop import DeathDrop
from .drop_last import DropLast
from .ending import Ending
from .free_for_all import FreeForAll
from .give_last import GiveLast
from .heals import Heals
from .inventory import Inventory
from .lidar import Lidar
from .maze import Maze
from .melee import Melee
from .mortality import Mortality
from .motors import FineMotors, Motors
from .observe_roles import ObserveRoles
from .physics import Physics
from .pickup import Pickup
from .pillars import Pillars
from .preparation import Preparation
from .record import Record
from .respawn import Respawn
from .rewards import Rewards
from .room import Room
from .rooms import Rooms
from .safe_zone import SafeZone
from .spawn_grid import SpawnGrid
from .steering import FineSteering, Steering
from .teams import Teams
from .walls import Walls

__all__ = [
    "Agents",
    "Behaviour",
    "Boxes",
    "Cameras",
    "Contacts",
    "DeathDrop",
    "DropLast",
    "Ending",
    "FineMotors",
    "FineSteering",
    "FreeForAll",
    "GiveLast",
    "Heals",
    "Inventory",
    "Lidar",
    "Maze",
    "Melee",
    "Mortality",
    "Motors",
    "ObserveRoles",
    "Physics",
    "Pickup",
    "Pillars",
    "Preparation",
    "Record",
    "Respawn",
    "Rewards",
    "Room",
    "Rooms",
    "SafeZone",
    "SpawnGrid",
    "Steering",
    "Teams",
    "Walls",
]
