"""Spaces and statistics, from the declarations of the scenario's components; the agents of every world as arrays."""

import itertools
from collections.abc import Mapping
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from outlast.components import Side
from outlast.ecs import (
    Action,
    Column,
    Component,
    DeclarationError,
    Entity,
    Event,
    Field,
    Label,
    MemoryLayout,
    Observation,
    Signal,
    Statistic,
    Worlds,
)
from outlast.ecs.declarations.fields import column_names
from outlast.ecs.kernels.errors import did_you_mean
from outlast.ecs.kernels.frozen_values import is_outside
from outlast.ecs.memory.numbers import NumbersView

from .validation import Array

Ends = tuple[Array, Array]  # low, high
Dims = tuple[int | str, ...]
TAKEN = (
    *("world", "episode", "against", "own_side", "result"),  # columns of tables that identify the episode of a row
    *("wins", "wins_first", "wins_second", "life", "zone_distance", "heals_held"),  # columns of tables of matches
    *("near", "attack_near", "attack_far", "episodes", "steps", "reward"),  # entries of training logs
)  # names that statistics cannot have, as tables and logs use them already
BOUNDS: WeakKeyDictionary[MemoryLayout, dict[str, Ends]] = WeakKeyDictionary()  # see bounds
STATISTICS: WeakKeyDictionary[Worlds, dict[str, tuple[Dims, Array]]] = WeakKeyDictionary()  # of _statistic_columns


def published(worlds: Worlds, base: type[Component]) -> list[tuple[str, type[Component], str, Column]]:
    """Return (key, component, column name, column) of all columns of a kind: actions as declared, others by keys."""
    found = [
        (column.key or name, component, name, column)
        for component in worlds.components
        if issubclass(component, base)
        for name, column in component.columns.items()
    ]
    if base is Action:
        return sorted(found, key=lambda entry: worlds.layout.actions.index((entry[1], entry[2])))
    return sorted(found, key=lambda entry: entry[0])


USES = {Observation: ("write", "add"), Action: ("read", "write")}  # a system has to do one of these with the component
NEEDS: dict[type[Component], tuple[str, str]] = {
    Observation: ("writes the observation {}, so agents would see zeros", "Write"),
    Action: ("reads the action {}, so choosing it would do nothing", "Read"),
    Statistic: ("writes the statistic {}, so it would be 0 in every episode", "Write"),
    Event: ("emits the event {}, so it would never happen", "Write"),
}
INFO = ("alive", "present", "action_mask", "final_obs", "final_info")  # entries of infos other than statistics


def check_published(worlds: Worlds) -> None:
    """Raise DeclarationError unless learners can use all declarations, and each has an effect."""
    systems = worlds.layout.systems
    for base in (Observation, Action):
        for key, component, name, column in published(worlds, base):
            if column.dims[:1] != ("agents",):
                raise DeclarationError(
                    f"{component.__qualname__}.{name}: the {base.__name__.lower()} '{key}' has the dimensions "
                    f'{column.dims}: the first one is "agents", as each agent has a row of its own'
                )
            if base is Observation and len(column.dims) < 2:
                raise DeclarationError(
                    f"{component.__qualname__}.{name}: the observation '{key}' is a number for each agent; make it "
                    'a row of one, as in column("f4", "agents", 1)'
                )
            if component is not NumbersView and not any(s.touches(component, *USES[base]) for s in systems):
                raise _unused(base, component, f".{name}")
    _check_fields(worlds)
    _check_signals(worlds)
    names = [*INFO, *worlds.layout.varied]
    for key, component, name, column in published(worlds, Statistic):
        names += _reported(worlds, key, column.dims)
        if key in TAKEN or key[-1:].isdigit():
            taken = key in TAKEN
            why = "is in tables and logs already" if taken else "ends in a digit, which marks sides in these"
            raise DeclarationError(f"{component.__name__}.{name}: the statistic '{key}' {why}; rename it")
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise DeclarationError(f"two entries of info are called '{twice[0]}'; rename a column of a Statistic")
    for _, component, name, _ in published(worlds, Statistic):
        if not any(system.touches(component, *USES[Observation]) for system in systems):
            raise _unused(Statistic, component, f".{name}")
    for event in filter(is_outside, worlds.layout.events):
        # reading is enough, as the mechanic that emits it may be left out
        if not any(system.touches(event, "read", "write") for system in systems):
            raise _unused(Event, event)


def _unused(base: type[Component], component: type[Component], column: str = "") -> DeclarationError:
    """Return the error for what no system writes, reads or emits."""
    text, access = NEEDS[base]
    cure = f"its mechanic needs a system with a parameter {access}[{component.__name__}]"
    return DeclarationError(f"no system {text.format(component.__qualname__ + column)}; {cure}")


def _check_signals(worlds: Worlds) -> None:
    """Raise DeclarationError if a user's system sets rewards or ends, and one of outlast's later overwrites them."""
    for component in worlds.components:
        if issubclass(component, Signal):
            writing = [system for system in worlds.schedule.systems if system.touches(component, *USES[Observation])]
            for early, late in itertools.pairwise(writing):
                if early.outside and not late.outside:
                    raise DeclarationError(
                        f"{early.label} writes {component.__name__} in vain: {late.label} comes after it and sets "
                        f"all of it; write it in Phase.{late.phase.name}, after={component.__name__}"
                    )


def _check_fields(worlds: Worlds) -> None:
    """Raise DeclarationError if no system writes a field that a mechanic adds to another mechanic's observation."""
    for key, component, column, _ in published(worlds, Observation):
        writing = [system for system in worlds.layout.systems if system.touches(component, *USES[Observation])]
        offsets = [system.offsets().get((component, column), set()) for system in writing]
        for module in worlds.layout.modules if all(offsets) else ():  # a system without an Offset writes complete rows
            added = [field.name for field in module.fields().get(key, ())]
            own = [system.offsets().get((component, column), set()) for system in module.all_systems()]
            # the Offset of an earlier field will do; `own` has systems that a number switches off, too
            for k, name in enumerate(added):
                if not any(f"{key}_{each}" in found for found in (*offsets, *own) for each in added[: k + 1]):
                    raise DeclarationError(
                        f"no system writes the field '{name}' that {module.name} adds to '{key}', so agents "
                        f"would see zeros; write it in a system with the parameters Write[{component.__name__}] and "
                        f"{key}_{name}: Offset"
                    )


def bounds(worlds: Worlds) -> dict[str, Ends]:
    """Return the bounds of all observations of one world, by key: float32 (agents, ...), possibly infinite.

    The range of a field (or of a key without fields) is what its column declares, narrowed to what modules return for
    it (see ecs.Module.bounds, whose mistakes are a DeclarationError). A range of a single value is extended by 1, as
    wrappers that rescale divide by the width of the range.
    """
    if worlds.layout not in BOUNDS:
        BOUNDS[worlds.layout] = _bounds(worlds)
    return {key: (low.copy(), high.copy()) for key, (low, high) in BOUNDS[worlds.layout].items()}


def _bounds(worlds: Worlds) -> dict[str, Ends]:
    layout, found = worlds.layout, {}
    extremes = layout.at_extremes()
    stated = [(module.name, module.bounds(there)) for there in extremes for module in there.modules]
    for module, ends in stated:
        if unknown := sorted(ends.keys() - Observation.keys()):
            hint = did_you_mean(unknown[0], Observation.keys()) or "fields are in the bounds of their key"
            raise DeclarationError(f"{module}.bounds() has the key '{unknown[0]}', which no observation has; {hint}")
    for key, component, column_name, column in published(worlds, Observation):
        fields, shape = layout.fields.get(key, {}), component.row_shape(column_name, worlds.dims)
        keys = {key, column.fields} if isinstance(column.fields, str) else {key}
        given = [(np.full(shape, np.nan), np.full(shape, np.nan))]  # as without any
        given += [
            _checked(name, k, ends[k], fields, shape) for name, ends in stated for k in sorted(keys & ends.keys())
        ]
        sizes = [field.size for field in fields.values()] or 1
        declared = [
            [(field.low, field.high) for field in there.fields.get(key, {}).values()] or [(-np.inf, np.inf)]
            for there in extremes
        ]
        least, most = (np.repeat(each, sizes) for each in (np.min(declared, 0)[:, 0], np.max(declared, 0)[:, 1]))
        with np.errstate(over="ignore"):  # values beyond float32 become infinite
            low = np.fmax(np.fmin.reduce([ends[0] for ends in given]), np.fmax(least, column.low))
            high = np.fmin(np.fmax.reduce([ends[1] for ends in given]), np.fmin(most, column.high))
            low, high = low.astype(np.float32), high.astype(np.float32)
        if (without := np.argwhere((low > 0) | (high < 0))).size:
            at = tuple(without[0])
            field_name = (column_names(fields) or [str(at[-1])])[at[-1]]
            raise DeclarationError(
                f"the bounds of '{field_name}' in '{key}' are {low[at]:g} to {high[at]:g}: 0 must be in them, as the "
                "rows of what is not there hold it"
            )
        found[key] = low, np.where(low == high, low + 1, high)
    return found


def _checked(module: str, key: str, ends: Any, fields: Mapping[str, Field], shape: tuple[int, ...]) -> Ends:
    """Return a module's bounds of a key as arrays of the column's shape, NaN for missing fields."""
    if not fields:
        return _range(f"{module}.bounds() of '{key}'", ends, shape)
    known = ", ".join(fields)
    if not isinstance(ends, Mapping):
        raise DeclarationError(
            f"{module}.bounds() of '{key}' are {ends!r:.60}: {{field: (low, high)}} is needed; its fields are {known}"
        )
    low, high = np.full(shape, np.nan), np.full(shape, np.nan)
    for name, pair in ends.items():
        if name not in fields:
            raise DeclarationError(f"{module}.bounds() of '{key}' have no field '{name}' to be of; there are: {known}")
        there = (..., fields[name].columns)
        low[there], high[there] = _range(f"{module}.bounds() of '{name}' in '{key}'", pair, low[there].shape)
    return low, high


def _range(what: str, ends: tuple[Any, Any], shape: tuple[int, ...]) -> Ends:
    try:
        low, high = (np.broadcast_to(np.asarray(end, np.float64), shape) for end in ends)
    except (ValueError, TypeError) as error:
        cure = "give numbers, or arrays that broadcast to it"
        raise DeclarationError(f"{what} do not fit its shape {shape} ({error}); {cure}") from None
    if np.isnan(low).any() or np.isnan(high).any():
        raise DeclarationError(f"{what} are {ends}: leave out what has none")
    if not (low <= high).all():
        raise DeclarationError(f"{what} have a low end above the high one: {ends}; swap them")
    return low, high


def statistics(worlds: Worlds, where: Array) -> dict[str, Array]:
    """Return copies of the episode statistics, (worlds,) or (worlds, n); rows of worlds other than `where` are zero.

    They include the numbers that vary, except words. A column with an entry per label of a kind, such as damage types,
    becomes one key for each: "deaths_zone".
    """
    columns = {key: values for key, (_, values) in _statistic_columns(worlds).items()}
    columns |= {key: values * 1 for key, values in worlds.numbers().items() if values.dtype.kind in "bif"}  # True: 1
    found, rows = dict[str, Array](), slice(None) if where.all() else where.nonzero()[0]
    for key, values in columns.items():
        found[key] = ended = np.zeros(values.shape, values.dtype)
        ended[rows] = values[rows]
    return found


def statistic_dims(worlds: Worlds) -> dict[str, Dims]:
    """Return the dimensions after `worlds` of each statistic, by its reported names."""
    return {key: dims for key, (dims, _) in _statistic_columns(worlds).items()}


def _statistic_columns(worlds: Worlds) -> dict[str, tuple[Dims, Array]]:
    """Return the dimensions and a view of each statistic, by its reported names."""
    if (found := STATISTICS.get(worlds)) is None:
        STATISTICS[worlds] = found = {}
        for key, component, name, column in published(worlds, Statistic):
            values, names = getattr(worlds[component], name), _reported(worlds, key, column.dims)
            if column.dims and names == [key]:
                found[key] = column.dims, values
            else:
                found |= {each: ((), values[:, k]) for k, each in enumerate(names)}
    return found


def _reported(worlds: Worlds, key: str, dims: Dims) -> list[str]:
    """Return the names under which a statistic is reported: its key, or one per label of a kind ("deaths_zone")."""
    labels = {(dim,): worlds.layout.labels[kind] for kind, dim in Label.kinds.items()}
    return [f"{key}_{label}" for label in labels[dims]] if dims in labels else [key]


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
    of_sides, absent = (np.arange(len(sides))[:, None], np.maximum(sides, 0)), sides < 0
    for key, values in statistics.items():
        match known.get(key, ()):
            case ("agents",):
                own[key] = values[:, agents].copy()
            case ("sides",):
                own[key] = values[of_sides]
            case _:
                own[key] = np.repeat(values[:, None], sides.shape[1], axis=1)
    for values in own.values() if absent.any() else ():
        values[absent] = 0
    return own
