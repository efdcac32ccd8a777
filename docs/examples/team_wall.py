"""A wall that one team passes, and a pane of glass: filters decide who touches what, and what blocks sight."""

from dataclasses import dataclass

from yard import yard

from outlast import systems
from outlast.components import Body, Filter, Look, Phase, Shape, Side, Solid
from outlast.components.contact import ALL
from outlast.ecs import Archetype, Module, Read, Rows, Write

BLUE_ONLY = 2  # the layer of what side 0 passes


@dataclass(frozen=True)
class TeamWall(Module):
    """Side 0 passes the wall on the right; nobody passes the glass on the left, and all see through it."""

    def archetypes(self):
        """Both reach across the yard."""
        wall = Body(x=2.0), Shape(half_width=0.1, half_height=6.0), Solid(), Filter(layer=BLUE_ONLY)
        pane = Body(x=-2.0), Shape(half_width=0.05, half_height=6.0), Solid(), Filter(clear=1)
        return [Archetype("agent", (Filter(),)), Archetype("team_wall", wall, 1), Archetype("pane", pane, 1)]

    def looks(self):
        """The colour of the side that passes, and that of glass."""
        return {"team_wall": Look(color=(0, 114, 178)), "pane": Look(color=(190, 220, 230))}


@TeamWall.system(Phase.SPAWN)
def admit(filters: Write[Filter], side: Read[Side], agents: Rows[Side]) -> None:
    """Once an episode, as sides do not change."""
    for e in agents:
        filters.hits[e] = ALL & ~BLUE_ONLY if side.side[e] == 0 else ALL


TEAM_WALL = yard("team_wall", TeamWall(), systems.Cameras(depth=20.0), agents=2).with_(systems.Teams(count=2))
