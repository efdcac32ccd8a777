"""Observed roles: every agent observes its own role, and the roles of the others that it sees."""

from collections.abc import Mapping
from dataclasses import dataclass

from outlast.components import SelfView, Side
from outlast.components.limits import MANY
from outlast.ecs import AgentRoles, Array, Field, Layout, Module, NumberError, Read, kernel, number

from .observation_rows import observe


@dataclass(frozen=True)
class ObserveRoles(Module):
    """The field "role" in rows of agents: a one-hot vector of `count` numbers. Added by Scenario.roles."""

    count: int = number(2, low=1, high=MANY, about="number of roles")

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        return {"own": (Field("role", low=0, high=1, size=self.count),)}

    def check(self, layout: Layout) -> None:
        roles = len(layout.roles.roles) if layout.roles else 0
        if roles != self.count:
            raise NumberError(
                f"observe_roles.count = {self.count}, but there are {roles} roles: set them by Scenario.roles(...), "
                'which brings it; for none, leave it out: without("observe_roles")'
            )


@kernel
def one_hot(i: int, e: int, into: Array, roles: Read[AgentRoles], count: int) -> None:
    """Write the role of an agent, dead or alive."""
    for k in range(count):
        into[k] = 1 if roles.role[i] == k else 0


observe(ObserveRoles, SelfView, "own", Side, role=one_hot)
