"""A yard in which agents walk about: what the small examples of physics are added to."""

from outlast import Scenario, systems
from outlast.ecs import Module


def yard(name: str, *mechanics: Module, agents: int = 1, size: float = 12.0, **physics: float) -> Scenario:
    """Return a game of agents that steer, in a square room, with these mechanics and numbers of physics."""
    return Scenario(
        name,
        (
            systems.Agents(count=agents),
            systems.FreeForAll(),
            systems.Room(size=size),
            systems.SpawnGrid(cells=4),
            systems.Motors(ahead=2.0, left=2.0),
            systems.Physics(**{"linear_damping": 3.0, "angular_damping": 3.0, **physics}),
            systems.Rewards(),
            systems.Ending(rule="never", limit=300),
            systems.Record(),
            *mechanics,
        ),
    )
