"""Roles: agents with numbers of their own, as data.

A role has a name, selects its agents, and changes some numbers of mechanics for them: to other values, or to
distributions, from which each agent draws when an episode begins. memory.numbers places the values in memory.
"""

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..kernels.errors import NumberError
from ..kernels.integers import is_whole
from .distributions import Distribution, in_python

NEVER, ANYONE, SIDE = DRAWN = ("never", "anyone", "side")
OPTIONS = ("drawn", "observed")  # options of Scenario.roles
LONGEST = 64  # maximum characters of a name, and maximum roles of a scenario


@dataclass(frozen=True)
class Role:
    """A role; made by `role`.

    Attributes:
        count: Number of its agents, after those of the previous role. None: all remaining agents.
        agents: The ids of the agents that have it, instead of a count; empty: `count` decides.
        numbers: (name, value or Distribution) of each number that the role changes, in order of names.
        without: Names of actions and observations that it lacks. The engine only stores them.
        name: Its name in the scenario.
    """

    count: int | None
    agents: tuple[int, ...]
    numbers: tuple[tuple[str, Any], ...]
    without: tuple[str, ...] = ()
    name: str = ""

    def values(self, corner: int) -> dict[str, Any]:
        """Return its numbers by name, with distributions at their lowest (corner 0) or highest (corner -1) value."""
        return {
            name: value.extremes()[corner] if isinstance(value, Distribution) else value for name, value in self.numbers
        }


def role(count: int | None = None, *, agents: Sequence[int] = (), without: Sequence[str] = (), **numbers: Any) -> Role:
    """Return a role of agents, for `Scenario.roles`.

    >>> hunted = scenario.roles(hunter=outlast.role(1, melee_damage=20, agents_health=200), prey=outlast.role(3))

    Args:
        count: Number of its agents. Roles take agents in order of their ids, starting with the first role. One role
            may leave the count out, and gets the remaining agents.
        agents: The ids of its agents, instead of a count.
        without: Actions and observations that its agents lack, by their keys: ("attack", "boxes"). For all
            choices, such an action is that of `noop`, and masked; such an observation, with its mask, is 0.
        **numbers: By name, "module_number": the value for these agents, or a distribution, such as
            outlast.distributions.uniform(5, 20), from which each of them draws its own value when an episode begins.
            Numbers that a role does not name are those of the scenario.

    Raises:
        NumberError: The count is below 1, the ids are not distinct integers from 0, or both are given; or `without`
            does not hold names.
    """
    count, ids = in_python(count), in_python(agents)
    if not isinstance(ids, Iterable) or isinstance(ids, str):
        raise NumberError(f"role(agents={agents!r}): a list of ids is needed, as in agents=[{agents!r}]")
    ids = tuple(map(in_python, ids))
    if count is not None and ids:
        raise NumberError(f"role({count!r}, agents={ids!r}): give a count or ids, not both")
    if count is not None and not is_whole(count, 1):
        raise NumberError(f"role({count!r}): the count must be an integer >= 1; leave it out for all remaining agents")
    if not all(is_whole(i, 0) for i in ids) or len({*ids}) != len(ids):
        raise NumberError(f"role(agents={ids!r}): distinct ids of agents are needed, integers >= 0")
    if isinstance(without, str) or not all(isinstance(name, str) for name in without):
        raise NumberError(f'role(without={without!r:.60}): a list of names is needed, as in without=["attack"]')
    return Role(count, ids, tuple(sorted(numbers.items())), tuple(sorted({*without})))


@dataclass(frozen=True)
class Roles:
    """The roles of a scenario.

    Attributes:
        roles: The roles, in the order in which they take agents; a role's number is its index here.
        drawn: "never": agents keep the roles that their ids give them. "anyone": each episode draws the role of each
            agent, among all agents. "side": the same, among the agents of each side. Each world draws by the random
            numbers of (seed, world, episode).

    Raises:
        NumberError: Roles are empty, a name is not a word or occurs twice, `drawn` is invalid, or an agent
            has two roles.
    """

    roles: tuple[Role, ...]
    drawn: str = NEVER

    def __post_init__(self) -> None:
        if not self.roles:
            raise NumberError("roles: at least one is needed, as in roles(hunter=role(1), prey=role(3))")
        for each in self.roles:
            if not isinstance(each, Role):
                raise NumberError(f"roles: {each!r:.60} is not a role; write role(...), as in roles(hunter=role(1))")
            if not each.name.isidentifier() or len(each.name) > LONGEST:
                raise NumberError(f"roles: {each.name!r:.80} is not a role's name; letters, digits and _ are allowed")
            if each.name in OPTIONS:
                raise NumberError(f"roles: {each.name!r} is not a name of a role, but an option of Scenario.roles")
        names = [each.name for each in self.roles]
        if len({*names}) < len(names) or len(names) > LONGEST:
            raise NumberError(f"roles: {', '.join(names)}: different names are needed, at most {LONGEST}")
        if self.drawn not in DRAWN:
            raise NumberError(f"roles: drawn = {self.drawn!r:.60}; allowed are {', '.join(map(repr, DRAWN))}")
        ids = [i for each in self.roles for i in each.agents]
        if len({*ids}) < len(ids):
            raise NumberError(f"roles: agent {next(i for i in ids if ids.count(i) > 1)} is in two roles")
        if len([each for each in self.roles if each.count is None and not each.agents]) > 1:
            raise NumberError("roles: only one role can leave out its count, and gets the remaining agents")

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the roles, by number."""
        return tuple(each.name for each in self.roles)

    @property
    def random(self) -> bool:
        """Return whether each episode draws its roles, or numbers of a role."""
        values = [value for each in self.roles for _, value in each.numbers]
        return self.drawn != NEVER or any(isinstance(value, Distribution) for value in values)

    @property
    def numbers(self) -> list[str]:
        """The names of all numbers that some role changes, in order."""
        return sorted({name for each in self.roles for name, _ in each.numbers})

    @property
    def in_all(self) -> list[str]:
        """The names of the numbers that every role changes, so that their values in the scenario have no effect."""
        return [name for name in self.numbers if all(name in dict(each.numbers) for each in self.roles)]

    def check_apart(self, varied: Iterable[str]) -> None:
        """Raise NumberError if a number that differs by role also varies between worlds."""
        if both := sorted({*self.numbers} & {*varied}):
            raise NumberError(
                f"{both[0]} is varied from world to world and differs by role: choose one, as in "
                f"role({both[0]}=uniform(...)), from which each agent draws"
            )

    def check_others(self, names: Iterable[str]) -> None:
        """Raise NumberError if every role sets one of these numbers: it then has no effect in the scenario."""
        if found := [name for name in names if name in self.in_all]:
            raise NumberError(f"{found[0]}: every role sets it here, so another value has no effect; change the roles")

    def __str__(self) -> str:
        counts = [(len(each.agents) or each.count or "other", each.name) for each in self.roles]
        drawn = {NEVER: "", ANYONE: " drawn", SIDE: " drawn by side"}[self.drawn]
        return " and ".join(f"{count} {name}" for count, name in counts) + drawn

    def only(self, known: Container[str]) -> "Roles":
        """Return the same roles without numbers that are not among `known`."""
        kept = [tuple((name, value) for name, value in each.numbers if name in known) for each in self.roles]
        return replace(self, roles=tuple(replace(r, numbers=own) for r, own in zip(self.roles, kept, strict=True)))

    def bare(self) -> "Roles":
        """Return the same roles without any numbers."""
        return self.only(())

    def of_agents(self, agents: int) -> list[int]:
        """Return each agent's role by id, before any drawing. NumberError if roles do not fit that many agents."""
        found: list[int | None] = [None] * agents
        for number, each in enumerate(self.roles):
            for i in each.agents:
                if i >= agents:
                    raise NumberError(f"role {each.name}: agent {i} does not exist, only 0 to {agents - 1}")
                found[i] = number
        free = iter([i for i in range(agents) if found[i] is None])
        left = found.count(None) - sum(each.count or 0 for each in self.roles)
        rest = next((each for each in self.roles if each.count is None and not each.agents), None)
        if left < (rest is not None) or (left and rest is None):
            raise NumberError(self._misfit(agents, rest))
        for number, each in enumerate(self.roles):
            for _ in range(left if each is rest else each.count or 0):
                found[next(free)] = number
        return [number for number in found if number is not None]

    def of_counts(self, fewest: int, most: int) -> list[list[int]]:
        """Return each agent's role by id in worlds with `fewest`, ..., `most` agents; each list has `most` entries.

        A world has the roles of a game with its number of agents. If roles do not fit so few agents, the last ones are
        missing.
        """
        largest, found = self.of_agents(most), list[list[int]]()
        for count in range(fewest, most + 1):
            try:
                there = self.of_agents(count)
            except NumberError:
                there = largest[:count]
            found.append(there + largest[count:])
        return found

    def _misfit(self, agents: int, rest: Role | None) -> str:
        sizes = [(each.count or len(each.agents), each.name) for each in self.roles if each is not rest]
        needed = sum(size for size, _ in sizes) + (rest is not None)
        listed = " + ".join(f"{size} {name}" for size, name in sizes) + (f" + at least 1 {rest.name}" if rest else "")
        return f"roles: {listed} are {needed} agents, but n_agents is {agents}: take replace(n_agents={needed}) or more"


def spread(roles: Roles) -> Iterator[tuple[Role, dict[str, Any]]]:
    """Return each role with its numbers, once with all distributions at their lowest values, once at their highest."""
    for each in roles.roles:
        drawn = any(isinstance(value, Distribution) for _, value in each.numbers)
        yield from ((each, each.values(corner)) for corner in ((0, -1) if drawn else (0,)))
