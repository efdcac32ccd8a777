"""Auto pickup: agents take what lies within their reach."""

from dataclasses import dataclass

from outlast.components import Bag, Body, Item, Phase, Shape
from outlast.components.inventory import push
from outlast.ecs import Entity, Module, Read, Rows, Write, number


@dataclass(frozen=True)
class AutoPickup(Module):
    """Pick up every item in reach, as long as the bag has room (paper, section 3.2).

    touch: it is enough that the item's disc touches the circle of reach, as the paper says; otherwise its centre
    must lie inside, as in the paper's runs (reference rules, section 6, point 3).
    """

    reach: float = number(0.5, above=0)  # metres from the agent's centre
    touch: bool = number(True)


@AutoPickup.system(Phase.PICKUP)
def pick_up(
    bag: Write[Bag],
    item: Write[Item],
    entities: Write[Entity],
    body: Read[Body],
    shape: Read[Shape],
    agents: Rows[Bag],
    items: Rows[Item],
    reach: float,
    touch: bool,
) -> None:
    """In order of agents, then of items; what does not fit stays where it is."""
    for e in agents:
        if not entities.alive[e]:
            continue
        for thing in items:
            if not entities.alive[thing]:
                continue
            x, y = body.x[thing] - body.x[e], body.y[thing] - body.y[e]
            far = reach + shape.radius[thing] if touch else reach
            if x * x + y * y <= far * far and push(bag, item, e, thing):
                entities.alive[thing] = 0
