"""The melee: a segment ahead of the agent."""

from typing import Any

from outlast.ecs import Action, Array, Component, Event, column, kernel


class Attack(Action, order=1):
    """Strike with the melee."""

    attack: Array = column("i1", "agents", low=0, high=1)


class Weapon(Component):
    """A melee weapon. Agents strike with it by their action; other kinds need a system of their own."""

    target: Array = column("i4", fill=-1, unit="entity")  # row hit by this tick's strike, -1: none
    cooldown: Array = column("i4")  # ticks until it can strike again


@kernel
def cooling(weapon: Any, e: int) -> Any:
    """Return whether the weapon of `e` cannot strike in the next tick."""
    return weapon.cooldown[e] > 0


class Strike(Event, capacity=Weapon):
    """An agent struck, with or without a hit. Damage to entities with health is a `Hit`."""

    agent: Array = column("i4", unit="entity")
    target: Array = column("i4", unit="entity")  # the row that it hits, -1: none
