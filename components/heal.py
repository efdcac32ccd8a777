"""Heals: items that give hit points."""

from outlast.ecs import Array, Component, Field, Layout, Observation, Statistic, column

from .body import PLACE


class Heal(Component):
    """An item that adds hit points to its user."""

    amount: Array = column("i4", fill=75)


def usual_amount(layout: Layout) -> float:
    """Return the hit points that a heal gives, the scale of the observed last slot; 1 if that is 0."""
    return layout.numbers("heals").get("amount") or 1.0


class HealView(Observation):
    """Heals on the ground, a row for each heal of the episode, and the last slot of the bag if it holds a heal."""

    heals: Array = column("f4", "agents", "heals", fields=PLACE)
    heals_mask: Array = column("f4", "agents", "heals", low=0, high=1)
    heal_slot: Array = column("f4", "agents", 1, fields=(Field("amount", "hit points", scale=usual_amount),))
    heal_slot_mask: Array = column("f4", "agents", 1, low=0, high=1)


class HealsUsed(Statistic):
    """The number of heals that all agents have used in this episode."""

    heals_used: Array = column("i4")
