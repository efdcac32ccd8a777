"""Items, and the bags in which they are carried."""

from typing import Any

import numpy as np

from outlast.ecs import Action, Array, Component, Coupled, Event, WorldsView, column, kernel

from .masks import of_agents


class Item(Component):
    """An item can be picked up, given, dropped and used. It is alive on the ground; while carried, it has a holder.

    To make a kind of item, declare an archetype with this component, and a system in phase EFFECT that reads `user`.
    """

    holder: Array = column("i4", fill=-1, unit="entity")  # row of the agent that carries it, -1: none
    user: Array = column("i4", fill=-1, unit="entity")  # row of the agent that uses it in this tick, -1: none


CLOSED = -2  # in Bag.items: the agent lacks this slot
PUSH_POP = "put items in and take them out by push and pop of outlast.components.inventory"


class Bag(Component):
    """An inventory: a stack of item rows. Only its last item can be used, given or dropped, and only by agents."""

    coupled = (Coupled(("count",), ("items",), PUSH_POP),)
    items: Array = column("i4", "slots", fill=-1, low=CLOSED, unit="entity")  # -1: free
    count: Array = column("i4", below="slots + 1")


class Gift(Component):
    """The agent that gets an item in this tick."""

    taker: Array = column("i4", fill=-1, unit="entity")  # row of the taker, -1: none


class Use(Action, order=2):
    """The action of using the last item of the bag."""

    use: Array = column("i1", "agents", low=0, high=1)


class Give(Action, order=3):
    """The action of giving the last item of the bag to an agent in reach; `give_last_nearest` chooses the agent."""

    give: Array = column("i1", "agents", low=0, high=1)


class Drop(Action, order=4):
    """The action of dropping the last item of the bag on the ground."""

    drop: Array = column("i1", "agents", low=0, high=1)


class ItemPicked(Event, capacity=Item, whom="item"):
    """An item was picked up from the ground into a bag."""

    agent: Array = column("i4", unit="entity")
    item: Array = column("i4", unit="entity")


class ItemUsed(Event, capacity=Item, whom="item"):
    """An item was used, and has left the bag."""

    agent: Array = column("i4", unit="entity")
    item: Array = column("i4", unit="entity")


class ItemGiven(Event, capacity=Gift, who="giver", whom="taker"):
    """An item was given: it went from one bag to another."""

    giver: Array = column("i4", unit="entity")
    taker: Array = column("i4", unit="entity")
    item: Array = column("i4", unit="entity")


class ItemDropped(Event, capacity=Item, whom="item"):
    """An item was dropped from a bag to the ground, by an action or at a death."""

    agent: Array = column("i4", unit="entity")
    item: Array = column("i4", unit="entity")


@kernel
def empty(bag: Any, e: int) -> Any:
    """Return whether the bag of `e` is empty."""
    return bag.count[e] == 0


def empty_handed(worlds: WorldsView, received: Any) -> Array:
    """Return whether each agent cannot pass on an item in the next tick, because its bag is empty.

    Args:
        worlds: The worlds in their present state.
        received: Whether agents can pass on an item in the tick in which they receive it, bool or bool (worlds,). Then
            all bags of a world must be empty.

    Returns:
        bool (worlds, agents), a new array.
    """
    own = of_agents(empty, worlds, Bag)
    found: Array = np.where(np.reshape(received, (-1, 1)), own.all(1, keepdims=True), own)
    return found


@kernel
def last(bag: Any, e: int) -> int:
    """Return the row of the last item in the bag of agent `e`, -1 if it is empty."""
    return -1 if empty(bag, e) else int(bag.items[e, bag.count[e] - 1])


@kernel
def held(bag: Any, e: int, kind: Any) -> int:
    """Return the row of the last item in the bag of `e` if it is of a kind, a RowIndex of its component; or -1."""
    row = last(bag, e)
    return row if row >= 0 and kind[row] >= 0 else -1


@kernel
def full(bag: Any, e: int) -> bool:
    """Return whether the bag of agent `e` has no free slot."""
    return bool(bag.count[e] >= bag.items.shape[1] or bag.items[e, bag.count[e]] == CLOSED)


@kernel
def push(bag: Any, item: Any, e: int, row: int) -> bool:
    """Put the item in row `row` into the bag of `e` and return True. Do nothing and return False if it is full."""
    if full(bag, e):
        return False
    bag.items[e, bag.count[e]] = row
    bag.count[e] += 1
    item.holder[row] = e
    return True


@kernel
def pop(bag: Any, item: Any, e: int) -> int:
    """Take the last item out of the bag of `e`, and return its row; -1 if the bag is empty."""
    if empty(bag, e):
        return -1
    bag.count[e] -= 1
    row = int(bag.items[e, bag.count[e]])
    bag.items[e, bag.count[e]] = -1
    item.holder[row] = -1
    return row


@kernel
def place(body: Any, entities: Any, row: int, x: float, y: float) -> None:
    """Put the entity in row `row` into the world at (x, y)."""
    body.x[row], body.y[row] = x, y
    entities.alive[row] = 1
