"""Names of views, for the command line: "+vision,-ids" is the usual picture with vision cones and without numbers."""

import difflib

from ...errors import FilmError
from .agents import Agents
from .boxes import Boxes, BoxItems
from .cameras import Cameras
from .feed import KillFeed
from .heals import Heals
from .health import HealthBars
from .ids import Ids
from .inventory import Inventory
from .melee import Hits, Melee
from .room import Room, Walls
from .steps import StepCounter
from .view import View
from .zone import SafeZone

NAMES: dict[str, View] = {
    "room": Room(),
    "zone": SafeZone(),
    "vision": Cameras(lines=False),
    "lines": Cameras(cones=False),
    "heals": Heals(),
    "items": BoxItems(),
    "boxes": Boxes(),
    "walls": Walls(),
    "melee": Melee(),
    "agents": Agents(),
    "ids": Ids(),
    "hits": Hits(),
    "health": HealthBars(),
    "inventory": Inventory(),
    "steps": StepCounter(),
    "feed": KillFeed(),
}
"""Every view by its short name."""

OPTIONAL = ("vision", "lines")

VIEWS: tuple[View, ...] = tuple(view for name, view in NAMES.items() if name not in OPTIONAL)
"""What is drawn unless somebody says otherwise."""


def select(changes: str) -> tuple[View, ...]:
    """The views that a text like "+vision,-ids" asks for: VIEWS with additions and removals.

    A name without a sign is added. Raises FilmError for an unknown name.
    """
    shown = {name: name not in OPTIONAL for name in NAMES}
    for change in filter(None, (part.strip() for part in changes.split(","))):
        name = change[1:] if change[0] in "+-" else change
        if name not in NAMES:
            near = difflib.get_close_matches(name, NAMES, 1)
            hint = f"did you mean '{near[0]}'? " if near else ""
            raise FilmError(f"there is no view '{name}'; {hint}There are: {', '.join(NAMES)}")
        shown[name] = change[0] != "-"
    return tuple(view for name, view in NAMES.items() if shown[name])
