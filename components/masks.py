"""Action masks: mechanics with actions may mark those without effect."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from outlast.ecs import Array, Component, Singleton, WorldsView


class Idle(Singleton):
    """Base of components that mark actions without effect: an alternative to `idle_actions`.

        class Empty(Idle):
            grab: Array = column("u1", "agents")  # 1: no entity is in reach

    Each column has the name of an action. A system of phase END writes it, so a kernel can serve the rule and the mask.
    """


def of_agents(rule: Any, worlds: WorldsView, component: type[Component]) -> Array:
    """Return the result of a kernel (table, e) for each agent, so that a rule serves its systems and its mask.

    Args:
        rule: The kernel. It must only compare columns at `e`, which works for one row and for arrays.
        worlds: Worlds, between two ticks.
        component: The component of the table.

    Returns:
        (worlds, agents), a new array.
    """
    found: Array = getattr(rule, "py_func", rule)(worlds[component], (slice(None), worlds.span("agent")))
    return found


@runtime_checkable
class MasksActions(Protocol):
    """A mechanic that marks actions without effect in the next tick: any mechanic with this method."""

    def idle_actions(self, worlds: WorldsView) -> Mapping[str, Any]:
        """Return whether actions of each agent have no effect in the next tick, for action masks.

        Args:
            worlds: Worlds, between two ticks.

        Returns:
            By key of each action that the systems of this mechanic read, bool (worlds, agents): True only if all values
            of the action lead to exactly the same world. An action that several mechanics read is masked
            where all of them return True; an action without an entry is never masked.
        """
