"""Observed roles: every agent observes its own role, and the roles of the others that it sees."""

from collections.abc import Mapping
from dataclasses import dataclass

from outlast.components import Phase, SelfView, Side
from outlast.components.limits import MANY
from outlast.ecs import AgentRoles, Field, Layout, Module, NumberError, Offset, Read, Rows, Write, number


@dataclass(frozen=True)
class ObserveRoles(Module):
    """Adds the field "role" to rows of agents: a one-hot vector of `count` numbers. Added by Scenario.roles."""

    count: int = number(2, low=1, high=MANY, about="number of roles")

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        return {"own": (Field("role", low=0, high=1, size=self.count),)}

    def check(self, layout: Layout) -> None:
        roles = len(layout.roles.roles) if layout.roles else 0
        if roles != self.count:
            raise NumberError(
                f"observe_roles.count = {self.count}, but there are {roles} roles: say them by Scenario.roles(...), "
                'which brings it; for none, leave it out: without("observe_roles")'
            )


@ObserveRoles.system(Phase.OBSERVE)
def see_role(roles: Read[AgentRoles], view: Write[SelfView], agents: Rows[Side], own_role: Offset, count: int) -> None:
    """Write the role of each agent, dead or alive."""
    for i in range(agents.size):
        for k in range(count):
            view.own[i, own_role + k] = 1 if roles.role[i] == k else 0
