"""Limits of roles: actions and observations that a role is `without` are disabled for its agents."""

import functools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from outlast.components import Phase, Side
from outlast.ecs import (
    Action,
    AgentRoles,
    Module,
    NumberError,
    Observation,
    Read,
    Roles,
    Rows,
    Singleton,
    WorldsView,
    Write,
)
from outlast.ecs.kernels.errors import did_you_mean

OWN = "own"  # key of the rows that others also observe
Limit = tuple[type[Singleton], int, int]  # the component, the index of its column, and a bitset of roles without it


def limits(modules: Sequence[Module], roles: Roles | None) -> tuple[Module, ...]:
    """Return the mechanic that disables the missing parts of roles; () if they have everything.

    Raises:
        NumberError: A role is without an unknown key, or without its own row.
    """
    wanted = {name for each in roles.roles for name in each.without} if roles else set()
    if not wanted or roles is None:
        return ()
    published = list(_published(modules))
    known = {key for key, *_ in published if not key.endswith("_mask")} - {OWN}
    found = dict[tuple[type[Singleton], int], int]()
    for number, each in enumerate(roles.roles):
        for name in each.without:
            if name not in known:
                hint = did_you_mean(name, known) or f"known: {', '.join(sorted(known))}"
                why = "others see it, too" if name == OWN else f"unknown action or observation; {hint}"
                raise NumberError(f"role {each.name} is without {name!r}: {why}")
            for key, component, k in published:
                if key in (name, f"{name}_mask"):
                    found[component, k] = found.get((component, k), 0) | 1 << number
    return (_limiter(tuple((component, k, bits) for (component, k), bits in found.items())),)


def without(roles: Roles, key: str) -> list[bool]:
    """Return whether each role is without an action."""
    return [key in each.without for each in roles.roles]


def _published(modules: Iterable[Module]) -> Iterable[tuple[str, type[Singleton], int]]:
    """Yield the key, the component and the index of its column for all actions and observations."""
    for module in modules:
        for singleton in module.singletons():
            if isinstance(singleton, (Action, Observation)):
                for k, (name, column) in enumerate(singleton.columns.items()):
                    yield column.key or name, type(singleton), k


@functools.lru_cache(maxsize=64)
def _limiter(found: tuple[Limit, ...]) -> Module:
    """Return a mechanic with a system for each column that a role is without."""
    keys = [[*part.columns.values()][k].key or [*part.columns][k] for part, k, _ in found if issubclass(part, Action)]

    def idle_actions(_: Module, worlds: WorldsView) -> dict[str, Any]:
        """Return {}: only the mechanics that use the actions mark idle agents."""
        return dict.fromkeys(keys, np.ones((worlds.count, worlds.layout.dims["agents"]), bool))

    own = {"__module__": __name__, "__doc__": "Takes from roles what they lack.", "idle_actions": idle_actions}
    kind: Any = type("RoleLimits", (Module,), own)
    order = list[tuple[type[Singleton], str]]()
    for component, k, bits in found:
        system = _limit(component, k, bits)
        system.__name__ = system.__qualname__ = f"limit_{[*component.columns][k]}"
        earlier = tuple(label for other, label in order if other is component)
        # actions before they are read; observations after all have been written, and before they are returned
        kind.system(Phase.RESPAWN if issubclass(component, Action) else Phase.REWARD, after=earlier)(system)
        order.append((component, f"role_limits.{system.__name__}"))
    made: Module = kind()
    return made


def _limit(component: Any, k: int, bits: int) -> Any:
    def limit(view: Write[component], roles: Read[AgentRoles], agents: Rows[Side]) -> None:
        for i in range(agents.size):
            if roles.role[i] >= 0 and bits >> roles.role[i] & 1:
                view[k][i] = 0

    return limit
