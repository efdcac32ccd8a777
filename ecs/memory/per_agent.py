"""Numbers that differ from agent to agent: where they lie, how they are set at resets, and how kernels read them.

Each has a four-byte word for every row in the state of its world: the bits of a float32, or an int32. That of an entity
that is no agent, such as a mechanic's animal, holds the game's own value. The systems of its mechanic get that array in
place of the number. `of` reads either, so a kernel is written once, and compiles to the same code as before if no role
changes the number. Prefab values that equal the number, such as the initial hit points, are written into the state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from ..declarations.component import Clock, Singleton, column
from ..declarations.distributions import CHOICE, Distribution
from ..declarations.numbers import full_name, is_read, owners, rule_of
from ..declarations.roles import ANYONE, NEVER, Roles, spread
from ..kernels.errors import NumberError
from ..kernels.jit import Array, intrinsic, kernel
from ..kernels.random import integer, stream_number
from .draw import draw_between, exists
from .made_once import differences, reasons
from .varied import Varied, check_kind, encode

AGENT = "agent"  # the archetype that has roles
ROLES, WORDS = "roles", "role words"  # dimensions
STREAM = stream_number("roles")
FLAG = ir.IntType(1)
OUTSIDE = "the row is out of bounds"


class AgentRoles(Singleton):
    """The engine's own component in worlds with roles: the role of each agent in this episode."""

    role: Array = column("i4", "agents", below="roles")


class AgentNumbers(Singleton):
    """The engine's own component in worlds with roles that change numbers: their values in this episode."""

    words: Array = column("i4", WORDS)  # int32, or the bits of float32: for each number, one for each row


@dataclass(frozen=True)
class AgentNumber:
    """A number that differs from agent to agent.

    Attributes:
        name: "module_number".
        module: Index of the mechanic among layout.modules.
        field: The number's name in the mechanic.
        start: The first of its words, which is that of row 0.
        dtype: The type of its words.
        values: For each role, a value or a Distribution.
    """

    name: str
    module: int
    field: str
    start: int
    dtype: np.dtype[Any]
    values: tuple[Any, ...]


def place_numbers(layout: Any, roles: Roles) -> dict[str, AgentNumber]:
    """Return where the words of numbers that differ by role lie, by name, and add their dimensions to the layout's.

    Raises:
        NumberError: Roles do not fit the agents, or a number is unknown or cannot differ between agents.
    """
    rows = layout.spans.get(AGENT, range(0))
    if not rows:
        raise NumberError("roles: this scenario has no agents to have them; add Agents")
    roles.of_agents(len(rows))
    roles = checked_roles(layout.modules, roles)
    known = owners(layout.modules)
    found, each = dict[str, AgentNumber](), layout.dims["rows"]
    roles.check_apart(layout.varied)
    for name in roles.numbers:
        k, field = known[name]
        base = getattr(layout.modules[k], field)
        values = tuple(dict(role.numbers).get(name, base) for role in roles.roles)
        dtype = np.dtype("f4" if isinstance(base, float) else "i4")
        found[name] = AgentNumber(name, k, field, len(found) * each, dtype, values)
    layout.dims[ROLES] = len(roles.roles)
    if found:
        layout.dims[WORDS] = len(found) * each
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
                probes = _probes(name, value, type(getattr(modules[k], field)))
                own = [getattr(modules[k].replace(**{field: probe}), field) for probe in probes]
            except NumberError as error:
                raise NumberError(f"role {each.name}: {error}") from None
            values[name] = value if isinstance(value, Distribution) else own[0]
        found.append(replace(each, numbers=tuple(values.items())))
    return replace(roles, roles=tuple(found))


def _probes(name: str, value: Any, kind: type) -> tuple[Any, ...]:
    """Values that stand for all values of a number. NumberError if its type cannot have the distribution."""
    if not isinstance(value, Distribution):
        return (value,)
    check_kind(name, kind, value)
    return value.probes()


def forms(layout: Any) -> list[Any]:
    """Return the layouts of worlds in which all agents have one role, for bounds and systems and to check its numbers.

    There is one with distributions at their lowest values, and one with them at their highest values.

    Raises:
        NumberError: A role's number is out of its range, or does not fit the other mechanics: "role NAME: ...".
    """
    found = []
    for role, values in spread(layout.roles):
        try:
            found.append(_form(layout, values))
        except NumberError as error:
            raise NumberError(f"role {role.name}: {error}") from None
    return found


def _form(layout: Any, values: dict[str, Any], checks: bool = True) -> Any:
    modules = list(layout.modules)
    for name, value in values.items():
        number = layout.per_agent[name]
        modules[number.module] = modules[number.module].replace(**{number.field: value})
    return layout.with_modules(modules, layout.roles.bare(), checks)


def differing_numbers(layout: Any, system: Any) -> list[str]:
    """Return the parameters of a system that are numbers in which roles differ."""
    names = [parameter.name for parameter in system.parameters if parameter.kind == "number"]
    return [name for name in names if full_name(layout.modules, system.module, name) in layout.per_agent]


def agent_values(worlds: Any, number: AgentNumber) -> Array:
    """Return a number of each agent, (worlds, agents): a copy."""
    rows = worlds.layout.spans[AGENT]
    words = worlds[AgentNumbers].words[:, number.start + rows.start : number.start + rows.stop]
    return words.copy().view(number.dtype)


def write_own(layout: Any, block: Array) -> None:
    """Write the game's own values of the numbers into initial states, uint8 (worlds, world_bytes), for every row."""
    for number in layout.per_agent.values():
        words, module = layout.columns(block, AgentNumbers).words, layout.modules[number.module]
        own = encode(module, number.field, getattr(module, number.field))
        words[:, number.start : number.start + layout.dims["rows"]] = own


def all_patches(layout: Any) -> list[tuple[int, int, int]]:
    """Return all patches; `Layout.agent_patches` keeps them."""
    return [each for number in layout.per_agent.values() for each in _patches(layout, number)]


def initial_image(worlds: Any, w: int) -> Array:
    """Return the initial state of world `w` in its episode, with its and its agents' values: uint8 (world_bytes,)."""
    layout = worlds.layout
    image: Array = layout.initial_image.copy()
    if worlds[Clock].episode[w, 0]:
        own = [(Varied, layout.varied_patches)] if layout.varied else []
        for component, patches in own + ([(AgentNumbers, layout.agent_patches)] if layout.per_agent else []):
            words = worlds[component].words[w].view(np.uint8)
            for word, offset, width in patches:
                image[offset : offset + width] = words[4 * word : 4 * word + width]
    return image


@dataclass(frozen=True)
class Plan:
    """The arrays by which `assign` sets the roles and numbers of the agents of one world.

    Attributes:
        rows: int32 (agents,), the rows of the agents.
        fixed: int8 (counts, agents), the role of each agent before any drawing, in worlds of the fewest agents, of one
            more and so on.
        groups: int32 (counts, groups + 1), where the groups of agents within which roles are drawn begin; 1 entry if
            there are none.
        real: int8 (numbers,), 1 if words are float32.
        starts: int32 (numbers,), the first word.
        streams: uint64 (numbers,), streams of random numbers.
        kinds: int8 (numbers, roles), kinds of distributions; a single value is a choice with one option.
        ends: float64 (numbers, roles, 2), lowest and highest value; 0 for choices.
        choices: int32 (words,), the words of all choices in a row.
        options: int32 (numbers, roles, 2), where choices begin, and how many there are.
        patches: int32 (patches, 3), for prefab values: the word, its place in the state, and its size in bytes.
    """

    rows: Array
    fixed: Array
    groups: Array
    real: Array
    starts: Array
    streams: Array
    kinds: Array
    ends: Array
    choices: Array
    options: Array
    patches: Array


def plan(layout: Any) -> Plan:
    """Return the arrays for `assign`, for a Layout with roles. Raises the errors of `_patches`."""
    numbers, choices = list(layout.per_agent.values()), list[int]()
    shape = (len(numbers), len(layout.roles.roles))
    kinds, ends, options = np.zeros(shape, np.int8), np.zeros((*shape, 2)), np.zeros((*shape, 2), np.int32)
    for n, number in enumerate(numbers):
        for r, value in enumerate(number.values):
            given = value if isinstance(value, Distribution) else Distribution(CHOICE, (value,))
            kinds[n, r] = given.kind
            if given.kind == CHOICE:
                options[n, r] = len(choices), len(given.values)
                for each in given.values:
                    choices += encode(layout.modules[number.module], number.field, each).tolist()
            else:
                ends[n, r] = given.values
    agents, counts = layout.spans[AGENT], layout.agent_counts
    return Plan(
        rows=np.array(agents, np.int32),
        fixed=np.array(layout.roles.of_counts(counts[0], counts[-1]), np.int8),
        groups=np.array([_groups(layout, count) for count in counts], np.int32),
        real=np.array([number.dtype.kind == "f" for number in numbers], np.int8),
        starts=np.array([number.start for number in numbers], np.int32),
        streams=np.array([stream_number(f"role {number.name}") for number in numbers], np.uint64),
        kinds=kinds,
        ends=ends,
        choices=np.array(choices or [0], np.int32),
        options=options,
        patches=np.array(layout.agent_patches, np.int32).reshape(-1, 3),
    )


def _groups(layout: Any, count: int) -> list[int]:
    """A row of Plan.groups, for worlds with `count` agents.

    Raises:
        NumberError: There are no sides to draw within, or the sizes of sides differ from world to world.
    """
    if layout.roles.drawn == NEVER:
        return [0]
    sizes = {(count,)} if layout.roles.drawn == ANYONE else layout.groupings(count)
    if sizes == {()}:
        raise NumberError('roles: drawn = "side", but agents are not in teams; add Teams, or take "anyone"')
    if len(sizes) > 1:
        raise NumberError('roles: drawn = "side", but the sizes of teams vary; let one of them be, or take "anyone"')
    starts: list[int] = np.minimum(np.cumsum([0, *sizes.pop()]), count).tolist()
    return starts


def _patches(layout: Any, number: AgentNumber) -> list[tuple[int, int, int]]:
    """Find the prefab values of agents that are the number, by comparing initial states for different values.

    Returns:
        Rows as in Plan.patches.

    Raises:
        NumberError: More than prefab values and systems depends on the number, or nothing does.
    """
    base = getattr(layout.modules[number.module], number.field)
    values = [value for each in number.values for value in _probes(number.name, each, type(base))]
    probes = sorted({base, *values})
    forms = [_form(layout, {number.name: value}, checks=False) for value in probes]  # a value alone may not fit
    for form in forms:
        if reason := next(reasons(forms[0], form, number.module, systems=False), ""):
            raise NumberError(f"{number.name} cannot differ by role: {reason}")
    here = {(each.component, each.name): each.offset for each in layout.places}
    found = []
    for where, k, values in differences(forms[0].places, [form.initial_image for form in forms]):
        dtype = values.dtype
        same = dtype == number.dtype and values.tolist() == np.array(probes).astype(dtype).tolist()
        if not same or where.shape != (layout.dims["rows"],) or k not in layout.spans[AGENT]:
            what = f"{where.component.__name__}.{where.name}"
            raise NumberError(f"{number.name} cannot differ by role: {what} is computed from it")
        found.append((number.start + k, here[where.component, where.name] + k * dtype.itemsize, dtype.itemsize))
    if len(probes) > 1 and not (found or is_read(layout.modules, layout.systems, number.name)):
        raise NumberError(f"{number.name} cannot differ by role: no system of its mechanic gets it")
    return found


@kernel
def assign(
    clock: Any,
    entities: Any,
    roles: Any,
    values: Any,
    reals: Any,
    state: Any,
    rows: Any,
    fixed: Any,
    groups: Any,
    real: Any,
    starts: Any,
    streams: Any,
    kinds: Any,
    ends: Any,
    choices: Any,
    options: Any,
    patches: Any,
) -> None:
    """Set roles and numbers of the agents of a world whose episode begins, and the prefab values set by these numbers.

    entities: the last agents may be absent. roles: the table of AgentRoles. values, reals: the words of AgentNumbers,
    as int32 and as float32. state: the whole state of the world, as int32. rows and all that follow: see Plan. Draws
    for a number are keyed by the agent's id in place of the tick.
    """
    key = (clock.seed[0], clock.world[0], clock.episode[0], np.uint64(0), np.uint64(STREAM))
    present = 0
    for e in rows:
        present += exists(entities, e)
    c = present - (rows.size - fixed.shape[0] + 1)
    for i in range(rows.size):
        roles.role[i] = fixed[c, i]
    for g in range(groups.shape[1] - 1):
        for i in range(groups[c, g + 1] - 1, groups[c, g], -1):  # Fisher-Yates shuffle
            o = groups[c, g] + integer(key, i, i - groups[c, g] + 1)
            roles.role[i], roles.role[o] = roles.role[o], roles.role[i]
    for n in range(starts.size):
        for i in range(rows.size):
            r, word = roles.role[i], starts[n] + rows[i]
            own = (clock.seed[0], clock.world[0], clock.episode[0], np.uint64(i), streams[n])
            if kinds[n, r] == CHOICE:
                values[word] = choices[options[n, r, 0] + integer(own, 0, options[n, r, 1])]
            else:
                draw_between(values, reals, word, real[n], kinds[n, r], ends[n, r, 0], ends[n, r, 1], own)
    for p in range(patches.shape[0]):
        state[patches[p, 1] >> 2] = values[patches[p, 0]]


def _is_array(number: Any) -> bool:
    return isinstance(number, np.ndarray)


def _element(number: Any, e: int) -> Any:
    if not _is_array(number):
        return number
    if not 0 <= e < len(number):
        raise IndexError(f"of(number, {e}): {OUTSIDE}")
    return number[e] if number.dtype.kind == "f" else np.int64(number[e])


@intrinsic(_element)
def of(typing: Any, number: Any, e: Any) -> Any:
    """Return the number for the entity in row `e`: that of its role if roles differ in it, else the game's own."""
    if not hasattr(number, "ndim"):  # not an array

        def same(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
            return arguments[0]

        return number(number, types.intp), same

    def element(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
        array = cgutils.create_struct_proxy(kinds.args[0])(context, builder, arguments[0])
        if not hasattr(number, "unchecked"):  # in a system from outside of outlast
            (size,) = cgutils.unpack_tuple(builder, array.shape)
            with builder.if_then(builder.icmp_unsigned(">=", arguments[1], size), likely=False):
                context.call_conv.return_user_exc(builder, IndexError, (f"of(number, row): {OUTSIDE}",))
        value = builder.load(builder.gep(array.data, [arguments[1]]))
        return value if kinds.return_type == types.float32 else builder.sext(value, ir.IntType(64))

    value = types.float32 if number.dtype == types.float32 else types.int64
    return value(number, types.intp), element


@intrinsic(_is_array)
def differs(typing: Any, number: Any) -> Any:
    """Whether roles differ in a number. Known at compile time, so the branch that is not taken costs nothing."""
    value = hasattr(number, "ndim")

    def constant(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
        return ir.Constant(FLAG, value)

    return types.boolean(number), constant
