"""Heals: items that give hit points."""

from outlast.ecs import Array, Component, Observation, Statistic, column


class Heal(Component):
    """An item that adds hit points to its user."""

    amount: Array = column("i4", fill=75)


class HealView(Observation):
    """Heals on the ground (x, y), one row for each heal of the episode, and the last slot if it holds a heal."""

    heals: Array = column("f4", "agents", "heals", 2)
    heals_mask: Array = column("f4", "agents", "heals", low=0, high=1)
    heal_slot: Array = column("f4", "agents", 1, 1)  # hit points it gives
    heal_slot_mask: Array = column("f4", "agents", 1, low=0, high=1)


class HealsUsed(Statistic):
    """Heals used in this episode, by anybody."""

    heals_used: Array = column("i4")
