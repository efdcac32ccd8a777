"""Action masks: mechanics that have actions may say which of these would do nothing."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from outlast.ecs import Array, Component, Singleton, WorldsView


class Idle(Singleton):
    """Base of components that say which actions would do nothing: another way to say what `idle_actions` does.

        class Empty(Idle):
            grab: Array = column("u1", "agents")  # 1: nobody is in reach

    Each column is called like an action. A system of phase END writes it, so a kernel can serve the rule and the mask.
    """


def of_agents(rule: Any, worlds: WorldsView, component: type[Component]) -> Array:
    """Return what a kernel (table, e) returns for each agent, so that a rule serves its systems and its mask.

    Args:
        rule: The kernel. It must do nothing but compare columns at `e`, which is the same for one row and for arrays.
        worlds: Worlds, between two ticks.
        component: The component of the table.

    Returns:
        (worlds, agents), a new array.
    """
    found: Array = getattr(rule, "py_func", rule)(worlds[component], (slice(None), worlds.span("agent")))
    return found


@runtime_checkable
class MasksActions(Protocol):
    """A mechanic that says which agents' actions would do nothing in the next tick; any one with this method does."""

    def idle_actions(self, worlds: WorldsView) -> Mapping[str, Any]:
        """Return which agents' actions would do nothing in the next tick, for action masks.

        Args:
            worlds: Worlds, between two ticks.

        Returns:
            By key of each action that the systems of this mechanic read, bool (worlds, agents): True only if all values
            of the action would leave exactly the same world behind. An action that several mechanics read is masked
            where all of them say so; one that is not named here is never masked.
        """
