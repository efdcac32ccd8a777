"""The components of the game: its state. What changes it is in systems/."""

from .agent import OthersView, SelfView, Side, Sides
from .body import Body, Fault, Floor, Push, Shape, Solid, Spawned
from .box import Box, BoxesPlaced, BoxItem, BoxItemView, BoxView
from .heal import Heal, HealsUsed, HealView
from .health import Death, Guard, Health
from .inventory import Bag, Drop, Gift, Give, Item, Use
from .melee import Attack, Weapon
from .motor import Drive, Steer
from .phase import Phase
from .score import End, Episode, Reward, Score
from .sight import ObservationMasks, Sight
from .zone import Zone, ZoneView

__all__ = [
    "Attack",
    "Bag",
    "Body",
    "Box",
    "BoxItem",
    "BoxItemView",
    "BoxView",
    "BoxesPlaced",
    "Death",
    "Drive",
    "Drop",
    "End",
    "Episode",
    "Fault",
    "Floor",
    "Gift",
    "Give",
    "Guard",
    "Heal",
    "HealView",
    "HealsUsed",
    "Health",
    "Item",
    "ObservationMasks",
    "OthersView",
    "Phase",
    "Push",
    "Reward",
    "Score",
    "SelfView",
    "Shape",
    "Side",
    "Sides",
    "Sight",
    "Solid",
    "Spawned",
    "Steer",
    "Use",
    "Weapon",
    "Zone",
    "ZoneView",
]
