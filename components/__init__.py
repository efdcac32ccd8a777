"""The components of the game: its state. The systems that change it are in systems/."""

from .agent import OthersView, SelfView, Side, Sides
from .behaviour import Aggression, Care, Condition, Cover, Encounters, Exposure, Track, Travelled
from .body import Body, Fault, Floor, Push, Shape, Solid, Spawned
from .box import Box, BoxBroken, BoxesPlaced, BoxItem, BoxItemView, BoxPlaced, BoxView
from .contact import Driven, Filter, Material, Touch, Touching
from .heal import Heal, HealsUsed, HealView
from .health import DamageType, Death, Died, Guard, Health, Hit
from .inventory import Bag, Drop, Gift, Give, Item, ItemDropped, ItemGiven, ItemPicked, ItemUsed, Use
from .joint import Rope, RopeBroken, Weld, WeldBroken
from .lidar import LidarView, Rays
from .look import Look
from .melee import Attack, Strike, Weapon
from .motor import Drive, Steer, Throttle
from .phase import Phase, Seconds
from .polygon import Polygon
from .respawn import Respawned, Respawns, Return
from .score import End, Episode, Kills, Outcome, Reward, Score
from .sight import ObservationMasks, Sight
from .wall import Before, StartAreas, Unplaced, Wall
from .zone import Zone, ZoneView

__all__ = [
    "Aggression",
    "Attack",
    "Bag",
    "Before",
    "Body",
    "Box",
    "BoxBroken",
    "BoxItem",
    "BoxItemView",
    "BoxPlaced",
    "BoxView",
    "BoxesPlaced",
    "Care",
    "Condition",
    "Cover",
    "DamageType",
    "Death",
    "Died",
    "Drive",
    "Driven",
    "Drop",
    "Encounters",
    "End",
    "Episode",
    "Exposure",
    "Fault",
    "Filter",
    "Floor",
    "Gift",
    "Give",
    "Guard",
    "Heal",
    "HealView",
    "HealsUsed",
    "Health",
    "Hit",
    "Item",
    "ItemDropped",
    "ItemGiven",
    "ItemPicked",
    "ItemUsed",
    "Kills",
    "LidarView",
    "Look",
    "Material",
    "ObservationMasks",
    "OthersView",
    "Outcome",
    "Phase",
    "Polygon",
    "Push",
    "Rays",
    "Respawned",
    "Respawns",
    "Return",
    "Reward",
    "Rope",
    "RopeBroken",
    "Score",
    "Seconds",
    "SelfView",
    "Shape",
    "Side",
    "Sides",
    "Sight",
    "Solid",
    "Spawned",
    "StartAreas",
    "Steer",
    "Strike",
    "Throttle",
    "Touch",
    "Touching",
    "Track",
    "Travelled",
    "Unplaced",
    "Use",
    "Wall",
    "Weapon",
    "Weld",
    "WeldBroken",
    "Zone",
    "ZoneView",
]
