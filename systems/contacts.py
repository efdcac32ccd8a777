"""Contacts: touches between solids, as events."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Touch, Touching
from outlast.ecs import Module, Singleton, number


@dataclass(frozen=True)
class Contacts(Module):
    """Contacts of solids as the event Touch: the solids, point, impulse, and whether the contact is new."""

    most: int = number(
        256, low=1, high=100_000, unit="pairs", about="how many may touch in a tick of a world; more are an error"
    )

    def singletons(self) -> Iterable[Singleton]:
        return [Touch(), Touching()]

    def dims(self) -> dict[str, int | str]:
        return {"touches": self.most}
