"""Action masks: mechanics that have actions may say which of these would do nothing."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from outlast.ecs import Singleton, WorldsView


class Idle(Singleton):
    """Base of components that say which actions would do nothing: another way to say what `idle_actions` does.

        class Empty(Idle):
            grab: Array = column("u1", "agents")  # 1: nobody is in reach

    Each column is called like an action. A system of phase END writes it, so a kernel can serve the rule and the mask.
    """


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
