"""Numbers that are not the same everywhere: which ones there are, where they lie in memory, and which ones can differ.

A number of a mechanic is a value, or a distribution from which each world draws when an episode begins, or it has a
value or a distribution for each role of agents. Its value in an episode is, by rising precedence: the default, the
scenario's, the one drawn at the reset, the role's, the one that a level or a curriculum gives.

A number that differs has four-byte words in the state of its world, the bits of a float32 or an int32: for worlds one
(several for a tuple), for agents one for every row, of which those of other entities hold the scenario's value. Systems
get the number from there instead of from their argument blocks; without such numbers they compile to the same code as
ever. Prefab values that name the number by `ref` are written into the state at each reset.
"""

import dataclasses
import math
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Protocol

import numpy as np

from ..declarations.component import Clock, Component, Observation, Singleton, column
from ..declarations.declared import Declared, PrefabNumber, declare, entries
from ..declarations.distributions import (
    CHOICE,
    FREE,
    INTEGERS,
    LOG_UNIFORM,
    NAMES,
    UNIFORM,
    Distribution,
    in_python,
)
from ..declarations.fields import Field
from ..declarations.layout import Layout
from ..declarations.numbers import full_name, is_read, owners, rule_of
from ..declarations.roles import Roles, spread
from ..declarations.system import System
from ..kernels.errors import NumberError, meant
from ..kernels.jit import Array
from .column_places import Place

EXACT = 2**24  # float32 has all integers up to this one
CORNERS = 64  # the most combinations of extreme values; beyond, only all lowest, all highest, and each one by itself
AGENT = "agent"  # the archetype that has roles
WORDS, GIVEN_WORDS, ROLES, AGENT_WORDS = "varied words", "given words", "roles", "role words"  # dimensions
GIVEN = np.uint64(32)  # this bit of a word of Given says that a value is given
ONCE = np.uint64(33)  # this bit says that it is for one episode only
HERE, WORD = np.uint64(1) << GIVEN, np.uint64(0xFFFFFFFF)
KEY, AWAY = slice(-8, -4), slice(-4, None)  # words at the end of Given, see there
KEYS = 8  # the number of these words
NO_LEVELS = "no numbers, walls or roles are drawn here, so seeds decide: reset(seed=[...])"  # see NumbersLayout.keyed
Patch = tuple[int, int, int]  # a word, and the place in the state and the size in bytes of the prefab value that it is


class Varied(Singleton):
    """The engine's own component of worlds with varied numbers: their values in this episode."""

    words: Array = column("i4", WORDS)  # int32, or the bits of float32


class Given(Singleton):
    """The engine's own component of worlds whose episodes are levels: what users have given, and is not drawn.

    It outlasts episodes. The words of varied numbers are followed by a key of random numbers for the next episode (1 if
    there is one, seed, world and episode), and by the world's own key while it plays an episode with a given one.
    """

    words: Array = column("u8", GIVEN_WORDS)  # 0: drawn; else the word, bit 32, and maybe bit 33


class AgentRoles(Singleton):
    """The engine's own component in worlds with roles: the role of each agent in this episode."""

    role: Array = column("i4", "agents", below="roles")


class AgentNumbers(Singleton):
    """The engine's own component in worlds with roles that change numbers: their values in this episode."""

    words: Array = column("i4", AGENT_WORDS)  # int32, or the bits of float32: for each number, one for each row


class NumbersView(Observation):
    """What agents observe of varied numbers: the same for every agent that exists in the episode, dead or alive."""

    numbers: Array = column("f4", "agents", "numbers fields")


@dataclass(frozen=True)
class Number:
    """A number that differs from world to world, or from agent to agent.

    Attributes:
        name: "module_number".
        module: Index of the mechanic among layout.modules.
        field: Its name in the mechanic.
        kind: Its type in Python: int, float, bool, str or tuple.
        distributions: What it is drawn from: one, or one for each role. A single value is a choice of one.
        by_role: Whether it differs from agent to agent.
        start: The first of its words; if it differs by role, that of row 0.
        width: How many words a value has.
        kinds: For a count, the kinds of entities that it counts. Tables have room for its highest value; in a world
            with fewer of them, the last ones are absent.
        dims: For a count, the dimensions whose size it is.
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
        """What worlds draw it from."""
        return self.distributions[0]

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of its words."""
        return np.dtype("f4" if self.kind in (float, tuple) else "i4")

    @property
    def words(self) -> slice:
        """The range of its words in Varied and Given."""
        return slice(self.start, self.start + self.width)

    def as_field(self, start: int, module: Any) -> Field:
        """The field that shows it in NumbersView; for a number that is text, it shows the index among its choices.

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

    def decode(self, words: Array, module: Any) -> Array:
        """Its values in worlds, from their words.

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


class NumbersLayout(Layout, Protocol):
    """A layout with the numbers that differ in its worlds."""

    @property
    def modules(self) -> Sequence[Any]:
        """The mechanics, in order of their names."""

    @property
    def places(self) -> Sequence[Place]:
        """The places of all columns."""

    def columns(self, block: Array, component: type[Component]) -> Any:
        """Return the table of a packed component in `block`, uint8 (worlds, bytes of a world)."""

    @property
    def declared(self) -> Sequence[Declared]:
        """What each of the modules declares."""

    @property
    def varied(self) -> Mapping[str, Number]:
        """The numbers that differ from world to world, by name."""

    @property
    def per_agent(self) -> Mapping[str, Number]:
        """The numbers that differ from agent to agent, by name."""

    @property
    def systems(self) -> Sequence[System]:
        """The systems of all modules."""

    @property
    def varied_patches(self) -> Sequence[Patch]:
        """The prefab values that are varied numbers."""

    @property
    def agent_patches(self) -> Sequence[Patch]:
        """The prefab values that are numbers of agents."""

    @property
    def initial_image(self) -> Array:
        """The state of a world before numbers are drawn."""


class NumbersWorlds(Protocol):
    """Worlds with such a layout."""

    @property
    def layout(self) -> NumbersLayout:
        """Their layout."""

    def __getitem__(self, component: type[Component]) -> Any:
        """Return the table of a component."""


def place(modules: list[Any], distributions: Mapping[str, Distribution]) -> dict[str, Number]:
    """Assign words to varied numbers.

    Args:
        modules: The mechanics, in order; `hold` changes the list.
        distributions: By name, "module_number".

    Returns:
        The varied numbers by name.

    Raises:
        NumberError: There is no such number, or it cannot have the values.
    """
    known, start = owners(modules), 0
    found: dict[str, Number] = {}
    for name in sorted(distributions):
        if name not in known:
            raise NumberError(f"there is no number '{name}' to vary; {meant(name, known)}")
        k, field = known[name]
        kind, distribution = type(getattr(modules[k], field)), distributions[name]
        check_kind(name, kind, distribution, rule_of(modules[k], field).get("free", False))
        widths = {encode(modules[k], field, value).size for value in distribution.values}
        if len(widths) > 1:
            raise NumberError(f"{name} = {distribution}: tuples of one length are needed, as they size memory")
        declared = declare(modules[k])
        counts = declared.kinds.get(field, ()), declared.sizes.get(field, ())
        found[name] = Number(name, k, field, kind, (distribution,), False, start, width := widths.pop(), *counts)
        start += width
        hold(modules, [found[name]])
    return found


def hold(modules: list[Any], numbers: Iterable[Number]) -> None:
    """Give mechanics the highest value of varied counts, and of varied numbers whose own value no world can have.

    Args:
        modules: The mechanics, in order; they are replaced in this list.
        numbers: The varied numbers.
    """
    for number in numbers:
        module, highest = modules[number.module], number.distribution.extremes()[-1]
        value = getattr(module, number.field)
        if value != highest and (number.kinds or value not in number.distribution):
            modules[number.module] = module.replace(**{number.field: highest})


def place_by_role(layout: NumbersLayout, roles: Roles, every: bool) -> dict[str, Number]:
    """Assign words to the numbers that differ by role.

    Args:
        layout: The layout, of which the rows of agents are known.
        roles: The roles.
        every: Whether all roles have to find agents.

    Raises:
        NumberError: Roles do not fit the agents, or a number is unknown or cannot differ between agents.
    """
    if not (rows := layout.spans.get(AGENT, range(0))):
        raise NumberError("roles: this scenario has no agents to have them; add Agents")
    if every:
        roles.of_agents(len(rows))
    roles = checked_roles(layout.modules, roles)
    roles.check_apart(layout.varied)
    known, found = owners(layout.modules), dict[str, Number]()
    for name in roles.numbers:
        k, field = known[name]
        base = getattr(layout.modules[k], field)
        values = [dict(role.numbers).get(name, base) for role in roles.roles]
        drawn = tuple(each if isinstance(each, Distribution) else Distribution(CHOICE, (each,)) for each in values)
        found[name] = Number(name, k, field, type(base), drawn, True, len(found) * layout.dims["rows"])
    return found


def checked_roles(modules: Sequence[Any], roles: Roles) -> Roles:
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
                what = "is the same for all agents, as its mechanic declares it" if name in known else "does not exist"
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


def encode(module: Any, field: str, value: Any) -> np.ndarray[Any, Any]:
    """A number's value as int32 words. NumberError if the mechanic cannot have it."""
    kernels = module.replace(**{field: value}).value(field)
    real = isinstance(kernels, (float, tuple))
    return np.atleast_1d(np.array(kernels, np.float32).view(np.int32) if real else np.array(kernels, np.int32))


def check_kind(name: str, kind: type, distribution: Distribution, free: bool = False) -> None:
    """Raise NumberError unless a number of this type can have the distribution. free: whether it is declared free."""
    allowed = {float: (UNIFORM, LOG_UNIFORM, INTEGERS, CHOICE), int: (INTEGERS, CHOICE)}.get(kind, (CHOICE,))
    if distribution.kind == FREE and not free:
        raise NumberError(
            f"{name} = {distribution}: its mechanic does not declare that it may have any value, so take choice"
        )
    if kind is float and distribution.kind == INTEGERS and max(map(abs, distribution.values)) > EXACT:
        raise NumberError(f"{name} = {distribution}: it is a float32, which has no integer above {EXACT} exactly")
    if distribution.kind not in (*allowed, FREE):
        names = " or ".join(NAMES[k] for k in allowed)
        raise NumberError(f"{name} = {distribution}: it is of type {kind.__name__}, so take {names}")


# ---- which ones can differ


def patches(layout: NumbersLayout, number: Number) -> list[Patch]:
    """Return the prefab values that are a number.

    Raises:
        NumberError: The number cannot differ: something is declared by its value, rather than by `ref`, or it is a
            prefab value that cannot hold it; or nothing depends on it.
    """
    what = f"{number.name} cannot {'differ by role' if number.by_role else 'vary'}"
    if reason := _fixed(layout, number) or fixed_by(layout, number.module, number.field):
        raise NumberError(f"{what}: {reason}")
    places = {(each.component, each.name): each for each in layout.places}
    found = list[Patch]()
    for prefab in layout.declared[number.module].prefabs:
        if prefab.number == number.field:
            if reason := _misfit(layout, number, prefab):
                raise NumberError(f"{what}: {reason}")
            where = places[prefab.component, prefab.column]
            size = where.dtype.itemsize
            for row, k in entries(prefab, where.shape, layout.spans):
                found.append((number.start + row * number.by_role, where.offset + k * size, size))
    if not (found or number.kinds or is_read(layout.modules, layout.systems, number.name)):
        raise NumberError(f"{what}: no system of {layout.modules[number.module].name} gets it")
    return found


def _fixed(layout: NumbersLayout, number: Number) -> str:
    """Why a number cannot differ in this way, as it counts something or sizes rows, in words; "" if it does not."""
    declared = layout.declared[number.module]
    if number.by_role and (counted := declared.kinds.get(number.field)):
        return f"it counts the entities {counted[0]!r}"
    if (sized := declared.sizes.get(number.field)) and not number.kinds:
        return f"it decides how large the dimension {sized[0]!r} is, and counts no entities"
    if number.field in declared.observes:
        module = layout.modules[number.module]
        values = {value for drawn in number.distributions for value in drawn.values}
        if len({_field_sizes(module.replace(**{number.field: value})) for value in values}) > 1:
            return f"{type(module).__name__}.fields() reads it: it decides how long the rows of observations are"
    highest = number.distribution.extremes()[-1]
    if shared := [name for name in number.kinds if layout.archetypes[name].count > highest]:
        return f"it is not the only count of the entities {shared[0]!r}"
    return ""


def _field_sizes(module: Any) -> tuple[tuple[str, str, int | str], ...]:
    return tuple((key, field.name, field.size) for key, added in module.fields().items() for field in added)


def fixed_by(layout: NumbersLayout, k: int, field: str) -> str:
    """Why a number of the mechanic `k` is fixed when worlds are made, in words; "" if it is not."""
    declared, module = layout.declared[k], layout.modules[k]
    kind = type(module).__name__
    if method := declared.reads.get(field):
        cure = f"; a prefab value or a count that is the number itself can be ref({field!r})" * (method != "dims")
        return f"{kind}.{method}() reads it when worlds are made{cure}"
    if field in declared.selects and not rule_of(module, field).get("per_agent"):
        return f"{kind}.systems() reads it: it decides which systems run"
    if field in declared.scratch(layout.dims):
        return f"{kind}.scratch() reads it: it decides how much memory systems have"
    return ""


def _misfit(layout: NumbersLayout, number: Number, prefab: PrefabNumber) -> str:
    """Why a prefab value cannot be a number that differs, in words; "" if it can."""
    what, held = f"{prefab.component.__name__}.{prefab.column}", prefab.component.columns[prefab.column]
    if number.by_role and prefab.kind != AGENT:
        return f"{what}{f' of {prefab.kind!r}' * bool(prefab.kind)} is the number, and only agents have roles"
    if number.kind is tuple:
        return f"{what} is the number, and a tuple can only be given to systems"
    if not (held.dtype == number.dtype or (held.dtype.itemsize == 1 and number.kind is not float)):
        own = number.dtype.str[1:]
        return f"{what} is {held.dtype}, and the number {number.kind.__name__}: the column needs the type {own!r}"
    limits = np.iinfo(held.dtype) if held.dtype.kind in "iu" else None
    ends = held.range(layout.dims) or (limits and (limits.min, limits.max))
    for value in (value for drawn in number.distributions for value in drawn.extremes()):
        plain = encode(layout.modules[number.module], number.field, value)[0]
        if ends and not ends[0] <= plain <= ends[1]:
            return f"{what} has the range {ends[0]} to {ends[1]}, and the number can be {value}"
    return ""


def extremes(layout: NumbersLayout) -> Iterator[tuple[str, list[Any]]]:
    """Yield the mechanics with combinations of extreme values: what holds for all is taken to hold between them.

    If there are more than CORNERS combinations, only those with all lowest, all highest, and each one by itself. As the
    lowest value may stand for none, a value in the middle of each range follows.

    Yields:
        The name of the role whose numbers they are, "" for none, and the mechanics.
    """
    ways: list[list[tuple[str, dict[str, Any]]]] = [
        [("", {number.name: value}) for value in number.distribution.extremes()] for number in layout.varied.values()
    ]
    if layout.per_agent and layout.roles:
        ways.append([(role.name * bool(values), values) for role, values in spread(layout.roles)])
    combined: Iterable[Sequence[tuple[str, dict[str, Any]]]] = product(*ways)
    if math.prod(map(len, ways)) > CORNERS:
        lowest = [way[0] for way in ways]
        singles = [[*lowest[:k], each, *lowest[k + 1 :]] for k, way in enumerate(ways) for each in way]
        combined = [lowest, [way[-1] for way in ways], *singles]
    for chosen in combined:
        values = {name: value for _, named in chosen for name, value in named.items()}
        yield "".join(role for role, _ in chosen), replaced(layout.modules, values)
    for number in layout.varied.values():
        yield from (("", replaced(layout.modules, {number.name: value})) for value in number.distribution.between())


def replaced(modules: Sequence[Any], values: Mapping[str, Any]) -> list[Any]:
    """Return the mechanics with other numbers, by full name. Raises what the mechanics raise for them."""
    known, found = owners(modules), list(modules)
    own = [(*known[name], value) for name, value in values.items()]
    for k in {k for k, _, _ in own}:
        found[k] = found[k].replace(**{field: value for each, field, value in own if each == k})
    return found


def selecting(layout: NumbersLayout) -> Iterator[Any]:
    """Yield the mechanics whose systems depend on a number that differs, with each of its values."""
    for number in (*layout.per_agent.values(), *layout.varied.values()):
        if number.field in layout.declared[number.module].selects:
            for value in (value for drawn in number.distributions for value in drawn.values):
                yield layout.modules[number.module].replace(**{number.field: value})


def differing_numbers(layout: NumbersLayout, system: System) -> list[str]:
    """Return the parameters of a system that are numbers in which roles differ."""
    names = [parameter.name for parameter in system.parameters if parameter.kind == "number"]
    return [name for name in names if full_name(layout.modules, system.module, name) in layout.per_agent]


# ---- the values of worlds


def write_own(layout: NumbersLayout, block: Array) -> None:
    """Write the game's own values of the numbers into initial states, uint8 (worlds, world_bytes), for every row."""
    for number in layout.per_agent.values():
        words, module = layout.columns(block, AgentNumbers).words, layout.modules[number.module]
        own = encode(module, number.field, getattr(module, number.field))
        words[:, number.start : number.start + layout.dims["rows"]] = own


def initial_image(worlds: NumbersWorlds, w: int) -> Array:
    """Return the initial state of world `w` in its episode, with its and its agents' values: uint8 (world_bytes,)."""
    layout = worlds.layout
    image: Array = layout.initial_image.copy()
    own = [(Varied, layout.varied_patches), (AgentNumbers, layout.agent_patches)]
    for component, listed in own if worlds[Clock].episode[w, 0] else ():
        for word, offset, width in listed:
            image[offset : offset + width] = worlds[component].words[w].view(np.uint8)[4 * word : 4 * word + width]
    return image


def agent_values(worlds: NumbersWorlds, number: Number) -> Array:
    """Return a number of each agent, (worlds, agents): a copy."""
    rows = worlds.layout.spans[AGENT]
    words = worlds[AgentNumbers].words[:, number.start + rows.start : number.start + rows.stop]
    return words.copy().view(number.dtype)


def given_words(number: Number, layout: NumbersLayout, values: Any, count: int) -> Array:
    """Encode the values that a user gives to some worlds, for the column of Given.

    Args:
        number: The number.
        layout: A layout that varies it.
        values: One, or one for each of the worlds.
        count: How many worlds.

    Returns:
        uint64 (count, width).

    Raises:
        NumberError: The number of values is wrong, a value could not be drawn, or it is one of a free number that its
            mechanic does not take.
    """
    module = layout.modules[number.module]
    listed = list(values) if has_one_each(values) else [values] * count
    if len(listed) != count:
        raise NumberError(f"{number.name}: {len(listed)} values for {count} worlds; give one, or as many")
    keys, found = [in_python(value) for value in listed], dict[Any, Array]()
    for value in keys:
        if not isinstance(value, Hashable):
            number.distribution.check(number.name, value)
    for value in dict.fromkeys(keys):
        number.distribution.check(number.name, value)
        if number.distribution.kind == FREE:
            check_taken(number, layout, value)
        found[value] = encode(module, number.field, int(value) if number.kind is int else value).view(np.uint32)
    given: Array = np.array([found[value] for value in keys], np.uint64) | HERE
    return given


def has_one_each(values: Any) -> bool:
    """Whether these are values for several worlds, one each; a tuple is a single value."""
    return isinstance(values, list) or (not isinstance(values, tuple) and np.ndim(values) > 0)


def check_taken(number: Number, layout: NumbersLayout, value: tuple[float, ...]) -> None:
    """Raise NumberError unless the mechanic takes this value of a free number."""
    layout.modules[number.module].replace(**{number.field: value}).check(layout)


def _is_taken(number: Number, layout: NumbersLayout, value: tuple[float, ...]) -> bool:
    """Whether the mechanic takes this value of a free number."""
    try:
        check_taken(number, layout, value)
    except NumberError:
        return False
    return True


def misfits(number: Number, layout: NumbersLayout, words: Array) -> Array:
    """Which worlds have words that could not have been drawn: bool (worlds,).

    Args:
        number: The number.
        layout: A layout that varies it.
        words: int32 (worlds, width), the words of this number.
    """
    module = layout.modules[number.module]
    if number.distribution.kind == FREE:
        values, which = np.unique(np.ascontiguousarray(words).view(number.dtype), axis=0, return_inverse=True)
        fits = np.array([_is_taken(number, layout, tuple(value.tolist())) for value in values], bool)[which.reshape(-1)]
    elif number.distribution.kind == CHOICE:
        known = np.array([encode(module, number.field, value) for value in number.distribution.values])
        fits = (words[:, None] == known).all(2).any(1)
    else:
        values = np.ascontiguousarray(words).view(number.dtype)[:, 0]
        low, high = (number.dtype.type(end) for end in number.distribution.values)
        fits = (low <= values) & (values <= high)
    return ~np.asarray(fits)


def wrongly_given(layout: NumbersLayout, words: Array) -> str:
    """What is wrong with words of Given from a file, which kernels would use as indices unchecked; "" if nothing is.

    Args:
        layout: A layout with varied numbers.
        words: uint64 (worlds, words).
    """
    for name, number in layout.varied.items():
        own = words[:, number.words]
        there, low = (own != 0).any(1), (own & WORD).astype(np.uint32).view(np.int32)
        flags = own >> GIVEN
        wrong = (flags[:, :1] != flags).any(1) | ((flags != 1) & (flags != 3)).any(1)
        wrong[there] |= misfits(number, layout, low[there])
        if (wrong := wrong & there).any():
            w = int(wrong.argmax())
            return f"{name} in world {w} is not of {number.distribution!r:.80}"
    for part in (KEY, AWAY):
        if (wrong := words[:, part][:, 0] > 1).any():
            return f"the key of random numbers in world {int(wrong.argmax())} is none"
    if (wrong := (words[:, KEY][:, 0] == 1) & (words[:, KEY][:, 3] == 0)).any():
        return f"the key of random numbers in world {int(wrong.argmax())} is of episode 0: the first one is 1"
    return ""
