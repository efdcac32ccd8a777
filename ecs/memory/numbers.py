"""Numbers that are not the same everywhere: their places in memory, and checks that they can differ.

A number of a mechanic has a value, or a distribution from which each world draws when an episode begins, or a
value or a distribution for each role of agents. Its value in an episode is, by rising precedence: the default, the
scenario's, the one drawn at the reset, the role's, that of a level or a curriculum.

A number that differs has four-byte words in the state of its world, the bits of a float32 or an int32: for worlds one
(several for a tuple), for agents one for every row, where rows of other entities hold the scenario's value. Systems
get the number from there instead of from their argument blocks; without such numbers their code is
unchanged. Prefab values that name the number by `ref` are written into the state at each reset.
"""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..declarations.component import Observation, Singleton, column
from ..declarations.declared import Declared, declare
from ..declarations.distributions import CHOICE, FREE, INTEGERS, LOG_UNIFORM, NAMES, UNIFORM, Distribution
from ..declarations.fields import Field
from ..declarations.module import Module
from ..declarations.numbers import owners, rule_of
from ..declarations.roles import Roles, spread
from ..kernels.errors import NumberError, meant
from ..kernels.jit import Array

EXACT = 2**24  # float32 holds all integers up to this one
WORDS, GIVEN_WORDS, ROLES, AGENT_WORDS = "varied words", "given words", "roles", "role words"  # dimensions
GIVEN = np.uint64(32)  # this bit of a word of Given marks a given value
ONCE = np.uint64(33)  # this bit marks a value for one episode only
HERE, WORD = np.uint64(1) << GIVEN, np.uint64(0xFFFFFFFF)
KEY, AWAY = slice(-8, -4), slice(-4, None)  # words at the end of Given, see there
KEYS = 8  # the number of these words
NO_LEVELS = "this game does not draw numbers, walls or roles: take seeds, as in reset(seed=[...])"
Patch = tuple[int, int, int]  # a word, and the place in the state and the size in bytes of its prefab value


class Varied(Singleton):
    """A component of the engine, for worlds with varied numbers: their values in this episode."""

    words: Array = column("i4", WORDS)  # int32, or the bits of float32


class Given(Singleton):
    """A component of the engine, for worlds whose episodes are levels: values given by users, not drawn.

    It outlasts episodes. The words of varied numbers are followed by a key of random numbers for the next episode (1
    for a key, seed, world and episode), and by the world's own key while it plays an episode with a given one.
    """

    words: Array = column("u8", GIVEN_WORDS)  # 0: drawn; otherwise the word, bit 32, and maybe bit 33


class AgentRoles(Singleton):
    """A component of the engine, for worlds with roles: the role of each agent in this episode."""

    role: Array = column("i4", "agents", below="roles")


class AgentNumbers(Singleton):
    """A component of the engine, for worlds with roles that change numbers: their values in this episode."""

    words: Array = column("i4", AGENT_WORDS)  # int32, or the bits of float32: for each number, one for each row


class NumbersView(Observation):
    """The observation of varied numbers: the same for every agent of the episode, dead or alive."""

    numbers: Array = column("f4", "agents", "numbers fields")


@dataclass(frozen=True)
class Number:
    """A number that differs from world to world, or from agent to agent.

    Attributes:
        name: "module_number".
        module: Index of the mechanic among layout.modules.
        field: Its name in the mechanic.
        kind: Its type in Python: int, float, bool, str or tuple.
        distributions: Its distributions: one, or one for each role. A single value is a choice of one.
        by_role: Whether it differs from agent to agent.
        start: The first of its words; if it differs by role, that of row 0.
        width: Number of words of a value.
        kinds: For a count, the kinds of entities that it counts. Tables have room for its highest value; in a world
            with fewer of them, the last ones are absent.
        dims: For a count, the dimensions of that size.
    """

    name: str
    module: int
    field: str
    kind: type
    distributions: tuple[Distribution, ...]
    by_role: bool
    start: int
    width: int = 1
    kinds: tuple[str, ...] = ()
    dims: tuple[str, ...] = ()

    @property
    def distribution(self) -> Distribution:
        """Return the distribution of worlds."""
        return self.distributions[0]

    @property
    def values(self) -> list[Any]:
        """All values of choices, and the ends of ranges."""
        return [value for drawn in self.distributions for value in drawn.values]

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of its words."""
        return np.dtype("f4" if self.kind in (float, tuple) else "i4")

    @property
    def words(self) -> slice:
        """The range of its words in Varied and Given."""
        return slice(self.start, self.start + self.width)

    def as_field(self, start: int, module: Module) -> Field:
        """Return its field in NumbersView; a text is shown as its index among the choices.

        start: the field's first column. module: the mechanic.
        """
        ends = self.distribution.extremes()
        plain = [value for end in ends for value in (end if self.kind is tuple else (end,))]
        if self.kind is str:
            plain = [rule_of(module, self.field)["choices"].index(word) for word in plain]
        plain = [int(value) if isinstance(value, bool) else value for value in plain]
        low, high = min(0, *plain), max(0, *plain)  # 0 is in the rows of absent agents
        scale = max(abs(low), abs(high), 1e-3)
        if self.distribution.kind == FREE:
            low, high = -math.inf, math.inf
        return Field(self.name, low=low, high=high, scale=scale, size=self.width, start=start)

    def decode(self, words: Array, module: Module) -> Array:
        """Return its values in worlds, from their words.

        Args:
            words: int32 (all words, worlds), contiguous.
            module: The mechanic.

        Returns:
            int32, float32, bool or str (worlds,); for a tuple float32 (worlds, width). Numbers are views of `words`.
        """
        values: Array = words[self.words if self.kind is tuple else self.start].view(self.dtype)
        if self.kind is str:
            return np.array(rule_of(module, self.field)["choices"])[values]
        return values.astype(bool) if self.kind is bool else values.T


def place(modules: list[Module], distributions: Mapping[str, Distribution]) -> dict[str, Number]:
    """Assign words to varied numbers.

    Args:
        modules: The mechanics, in order; `hold` changes the list.
        distributions: By name, "module_number".

    Returns:
        The varied numbers by name.

    Raises:
        NumberError: The number does not exist, or cannot have the values.
    """
    known, start = owners(modules), 0
    found: dict[str, Number] = {}
    for name in sorted(distributions):
        if name not in known:
            raise NumberError(f"unknown number '{name}'; {meant(name, known)}")
        k, field = known[name]
        kind, distribution = type(getattr(modules[k], field)), distributions[name]
        check_kind(name, kind, distribution, rule_of(modules[k], field).get("free", False))
        widths = {encode(modules[k], field, value).size for value in distribution.values}
        if len(widths) > 1:
            raise NumberError(f"{name} = {distribution}: all tuples must have one length, which sizes memory")
        declared = declare(modules[k])
        counts = declared.kinds.get(field, ()), declared.sizes.get(field, ())
        found[name] = Number(name, k, field, kind, (distribution,), False, start, width := widths.pop(), *counts)
        start += width
        hold(modules, [found[name]])
    return found


def hold(modules: list[Module], numbers: Iterable[Number]) -> None:
    """Set varied counts of mechanics to their highest value, and other varied numbers if their own is never drawn.

    Args:
        modules: The mechanics, in order; they are replaced in this list.
        numbers: The varied numbers.
    """
    for number in numbers:
        module, highest = modules[number.module], number.distribution.extremes()[-1]
        value = getattr(module, number.field)
        if value != highest and (number.kinds or value not in number.distribution):
            modules[number.module] = module.replace(**{number.field: highest})


def place_by_role(modules: Sequence[Module], roles: Roles, rows: int) -> dict[str, Number]:
    """Assign words to the numbers that differ by role.

    Args:
        modules: The mechanics, in order.
        roles: The roles.
        rows: Number of rows.

    Raises:
        NumberError: A number is unknown or cannot differ between agents.
    """
    known, found = owners(modules), dict[str, Number]()
    for name in checked_roles(modules, roles).numbers:
        k, field = known[name]
        base = getattr(modules[k], field)
        values = [dict(role.numbers).get(name, base) for role in roles.roles]
        drawn = tuple(each if isinstance(each, Distribution) else Distribution(CHOICE, (each,)) for each in values)
        found[name] = Number(name, k, field, type(base), drawn, True, len(found) * rows)
    return found


def checked_roles(modules: Sequence[Module], roles: Roles) -> Roles:
    """Return the roles with numbers of the mechanics' types, each checked by itself.

    Raises:
        NumberError: A number is unknown, cannot differ between agents, or is out of its range: "role NAME: ...".
    """
    known = owners(modules)
    able = [name for name, (k, field) in known.items() if rule_of(modules[k], field).get("per_agent")]
    found = []
    for each in roles.roles:
        values = dict[str, Any]()
        for name, value in each.numbers:
            if name not in able:
                what = "is the same for all agents, by its declaration" if name in known else "does not exist"
                others = ", ".join(sorted(able)) or "none"
                raise NumberError(f"role {each.name}: the number {name} {what}; a role can have: {others}")
            k, field = known[name]
            try:
                if isinstance(value, Distribution):
                    check_kind(name, type(getattr(modules[k], field)), value)
                listed = value.values if isinstance(value, Distribution) else (value,)
                own = [getattr(modules[k].replace(**{field: one}), field) for one in listed]
            except NumberError as error:
                raise NumberError(f"role {each.name}: {error}") from None
            values[name] = value if isinstance(value, Distribution) else own[0]
        found.append(dataclasses.replace(each, numbers=tuple(values.items())))
    return dataclasses.replace(roles, roles=tuple(found))


def encode(module: Module, field: str, value: Any) -> np.ndarray[Any, Any]:
    """Return a number's value as int32 words. NumberError if the mechanic cannot have it."""
    kernels = module.replace(**{field: value}).value(field)
    real = isinstance(kernels, (float, tuple))
    return np.atleast_1d(np.array(kernels, np.float32).view(np.int32) if real else np.array(kernels, np.int32))


def check_kind(name: str, kind: type, distribution: Distribution, free: bool = False) -> None:
    """Raise NumberError unless a number of this type can have the distribution. free: Whether it is declared free."""
    allowed = {float: (UNIFORM, LOG_UNIFORM, INTEGERS, CHOICE), int: (INTEGERS, CHOICE)}.get(kind, (CHOICE,))
    if distribution.kind == FREE and not free:
        raise NumberError(f"{name} = {distribution}: its mechanic does not declare it as free, so take choice")
    if kind is float and distribution.kind == INTEGERS and max(map(abs, distribution.values)) > EXACT:
        raise NumberError(f"{name} = {distribution}: it is a float32, which cannot hold integers above {EXACT} exactly")
    if distribution.kind not in (*allowed, FREE):
        names = " or ".join(NAMES[k] for k in allowed)
        raise NumberError(f"{name} = {distribution}: it has type {kind.__name__}, so take {names}")


def extremes(
    modules: Sequence[Module], varied: Iterable[Number], roles: Roles | None
) -> Iterator[tuple[str, list[Module]]]:
    """Yield the mechanics with extreme values. Checks of these are taken to hold for values between them.

    All lowest, all highest, each one alone among the lowest, and among the highest. Since the lowest value may be
    special, such as none, a value in the middle of each range follows.

    Yields:
        The name of the role whose numbers they are, "" for none, and the mechanics.
    """
    ways = [[("", {number.name: value}) for value in number.distribution.extremes()] for number in varied]
    if roles and roles.numbers:
        ways.append([(role.name * bool(values), values) for role, values in spread(roles)])
    ends = [(0,) * len(ways), tuple(len(way) - 1 for way in ways)]
    singles = [(*end[:k], i, *end[k + 1 :]) for end in ends for k, way in enumerate(ways) for i in range(len(way))]
    for picks in dict.fromkeys((*ends, *singles)):
        chosen = [way[i] for way, i in zip(ways, picks, strict=True)]
        values = {name: value for _, named in chosen for name, value in named.items()}
        yield "".join(role for role, _ in chosen), replaced(modules, values)
    for number in varied:
        yield from (("", replaced(modules, {number.name: value})) for value in number.distribution.between())


def replaced(modules: Sequence[Module], values: Mapping[str, Any]) -> list[Module]:
    """Return the mechanics with other numbers, by full name. Raises the errors of the mechanics for them."""
    known, found = owners(modules), list(modules)
    own = [(*known[name], value) for name, value in values.items()]
    for k in {k for k, _, _ in own}:
        found[k] = found[k].replace(**{field: value for each, field, value in own if each == k})
    return found


def selecting(declared: Sequence[Declared], numbers: Iterable[Number]) -> Iterator[Module]:
    """Yield the mechanics whose systems depend on a number that differs, with each of its values."""
    for number in numbers:
        own = declared[number.module]
        for value in number.values if number.field in own.selects else ():
            yield own.module.replace(**{number.field: value})
