"""The agents of every world as arrays: whether it is alive, its side, and its share of a statistic."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from outlast.components import Side
from outlast.ecs import Entity, Worlds

from .spaces import statistic_dims
from .validation import Array


def alive(worlds: Worlds, where: Any = slice(None)) -> Array:
    """Return whether agents live: bool (worlds, agents), a new array. where: index of worlds; 0 gives (agents,)."""
    return worlds[Entity].alive[where, worlds.span("agent")].astype(bool)


def present(worlds: Worlds, where: Any = slice(None)) -> Array:
    """Return whether agents are present, dead or alive: bool (worlds, agents), a new array. where: see `alive`."""
    return worlds[Entity].identity[where, worlds.span("agent")] >= 0


class Presence:
    """The entries of infos about agents: `alive` and, only if the number of agents varies, `present`."""

    def __init__(self, worlds: Worlds) -> None:
        entity, rows = worlds[Entity], worlds.span("agent")
        self._alive = entity.alive[:, rows]  # views: looking them up takes longer than a small world's copy
        self._identity = entity.identity[:, rows] if counts_vary(worlds) else None

    def __call__(self, where: Any = slice(None)) -> dict[str, Array]:
        """Return the entries, new arrays. where: see `alive`."""
        found: dict[str, Array] = {"alive": self._alive[where].astype(bool)}
        return found if self._identity is None else found | {"present": self._identity[where] >= 0}


def counts_vary(worlds: Worlds) -> bool:
    """Return whether worlds have different numbers of agents."""
    return fewest_agents(worlds) < worlds.dims["agents"]


def fewest_agents(worlds: Worlds) -> int:
    """Return the minimum number of agents of a world, over all draws."""
    return worlds.layout.agent_counts[0]


def fewest_sides(worlds: Worlds) -> int:
    """Return the number of sides with an agent in every world and draw; the last of unequal teams may lack one."""
    agents = fewest_agents(worlds)
    if not (sizes := worlds.layout.groups(agents)):
        return min(worlds.dims["sides"], agents)
    starts = np.cumsum((0, *sizes[:-1]))
    return int(((np.array(sizes) > 0) & (starts < agents)).sum())


def counted(worlds: Worlds) -> dict[str, Array]:
    """Return whether entries of statistics belong to an agent, or to a side with agents, of the episode.

    That is by key, for each statistic with an entry per agent or side, bool (worlds, n); {} if all agents always play.
    """
    if not counts_vary(worlds):
        return {}
    sides = side(worlds)
    inhabited = (sides[:, :, None] == np.arange(worlds.dims["sides"])).any(1)
    by_dims = {("agents",): present(worlds), ("sides",): inhabited}
    return {key: by_dims[dims] for key, dims in statistic_dims(worlds).items() if dims in by_dims}


def side(worlds: Worlds, where: Any = slice(None)) -> Array:
    """Return each agent's side, -1 if it is absent: int32 (worlds, agents), a new array. where: see `alive`."""
    return worlds[Side].side[where, worlds.span("agent")].copy()


def agent_statistics(worlds: Worlds, statistics: Mapping[str, Array], agents: slice = slice(None)) -> dict[str, Array]:
    """Return each agent's share of what `spaces.statistics` returned, or of info["statistics"].

    That is by key, (worlds, agents): the agent's own entry if there is one per agent, its side's if there is one per
    side, and its world's otherwise; 0 for absent agents. agents: Which agents of a world to return.
    """
    known, sides, own = statistic_dims(worlds), side(worlds)[:, agents], dict[str, Array]()
    of_sides = np.arange(len(sides))[:, None], np.maximum(sides, 0)
    for key, values in statistics.items():
        match known.get(key, ()):
            case ("agents",):
                own[key] = values[:, agents].copy()
            case ("sides",):
                own[key] = values[of_sides]
            case _:
                own[key] = np.repeat(values[:, None], sides.shape[1], axis=1)
        own[key][sides < 0] = 0
    return own
