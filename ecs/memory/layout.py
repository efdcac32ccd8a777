"""The memory layout of a world: archetypes are ranges of rows, components are columns at offsets in its state.

All packed columns of one world are contiguous, so a tick reads one block of memory, and a world is saved, copied
or reset by copying bytes. Columns that environments return (actions, observations, signals) have their own buffers.
"""

import functools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import fields
from itertools import groupby
from typing import Any

import numpy as np

from ..declarations.access import SELECTIONS, Label, Parameter
from ..declarations.archetype import merge
from ..declarations.component import Action, Clock, Column, Component, Entity, Observation, Signal, Singleton, Statistic
from ..declarations.declared import declare, one_of_each
from ..declarations.distributions import Distribution
from ..declarations.event import Event, memory_type
from ..declarations.fields import Field, width
from ..declarations.module import Module
from ..declarations.placed_fields import placed
from ..declarations.roles import Roles
from ..declarations.system import System
from ..kernels.errors import DeclarationError, NumberError, did_you_mean
from ..kernels.random import stream_number
from ..kernels.simd import SIMD_WIDTH
from .column_places import ALIGN, Place, fill, place_columns
from .dimensions import check_indices, check_owners, dimension_sizes
from .numbers import (
    AGENT_WORDS,
    GIVEN_WORDS,
    KEYS,
    ROLES,
    WORDS,
    AgentNumbers,
    AgentRoles,
    Given,
    Number,
    NumbersView,
    Varied,
    encode,
    extremes,
    hold,
    place,
    place_by_role,
    replaced,
    selecting,
)

ENGINE = (Clock, Entity, Given, Varied, AgentRoles, AgentNumbers)  # components that modules do not bring


class MemoryLayout:
    """The memory layout of a scenario's worlds, for any number of worlds.

    Attributes:
        modules: Instances of Module, in order of their names.
        archetypes: Archetypes by name, in the order of rows.
        spans: Ranges of rows by name of the archetype.
        dims: Sizes by name of the dimension.
        labels: The labels of the modules by their kind, in alphabetical order, see declarations.access.Label.
        fields: Fields by key of the observation and by name, in order of their columns; only keys that declare fields.
        events: The events, in the order of `event_type`, their memory in a world.
        varied: The numbers that differ from world to world, by name.
        roles: The roles of agents, or None.
        per_agent: The numbers that differ from agent to agent, by name.

    Args:
        modules: The mechanics, in any order.
        distributions: Distributions of numbers drawn for each episode of each world, by name, "module_number".
        observed: The drawn numbers that agents observe, in numbers.NumbersView.
        roles: Roles of agents with numbers of their own.
        varied: Instead of `distributions`, the `varied` of a layout of the same mechanics.
        fewer: Whether it is the layout of a world with exactly its number of entities, see `at_extremes`.
    """

    def __init__(
        self,
        modules: Sequence[Module],
        distributions: Mapping[str, Distribution] | None = None,
        observed: Sequence[str] = (),
        roles: Roles | None = None,
        varied: Mapping[str, Number] | None = None,
        fewer: bool = False,
    ) -> None:
        self.fewer = fewer
        self.modules = sorted(modules, key=lambda module: (module.name, type(module).__name__))
        self.varied = place(self.modules, distributions or {}) if varied is None else varied
        hold(self.modules, self.varied.values())
        self.declared = [declare(module) for module in self.modules]
        self.archetypes = merge(archetype for each in self.declared for archetype in each.archetypes)
        self._check_counts()
        self.spans: dict[str, range] = {}
        start = 0
        for name, archetype in self.archetypes.items():
            self.spans[name] = range(start, start + archetype.count)
            start += archetype.count
        self.dims = {"rows": start, "blocks": -(-start // SIMD_WIDTH)}
        named = {kind: {getattr(module, kind, "") for module in self.modules} - {""} for kind in Label.kinds}
        self.labels = {kind: sorted(labels) for kind, labels in named.items()}
        self.dims |= {dim: len(self.labels[kind]) for kind, dim in Label.kinds.items()}
        given, sizes = {*self.dims}, dimension_sizes(self.declared, self.dims)
        self.dims |= sizes
        self.roles = roles
        self.per_agent: dict[str, Number] = self._place_roles(roles) if roles else {}
        self.singletons = one_of_each(self.declared)
        _check_keys(Observation, self.singletons)  # before their fields are placed; again below, with `numbers`
        self.fields: dict[str, dict[str, Field]] = placed(self, self.modules, self._observations(), Observation.keys())
        if observed:
            self._observe(observed)
        self.dims |= {f"{key} fields": width(fields) for key, fields in self.fields.items()}
        self._counted: set[str] = set()
        for module in self.modules:
            module.check(self)
        attached = {type(part) for a in self.archetypes.values() for part in a.parts}
        others = sorted(attached | self.singletons.keys(), key=lambda c: (c.__module__, c.__qualname__))
        if self.keyed:
            self.dims[WORDS] = sum(number.width for number in self.varied.values())
            self.dims[GIVEN_WORDS] = self.dims[WORDS] + KEYS
        own = (Clock, *([Given, Varied] if self.keyed else []), Entity)
        own += (*([AgentRoles] if roles else []), *([AgentNumbers] if self.per_agent else []))
        self.components: tuple[type[Component], ...] = (*own, *others)
        self._check_dims()
        for base in (Action, Observation, Signal, Statistic):
            _check_keys(base, self.components)
        self.events = self._events()
        check_indices(self.modules[0], self.components, self.dims)
        shared = {*self._counted, *(event.capacity for event in self.events)}
        engine = given | {dim for dim, size in self.dims.items() if sizes.get(dim) != size}
        check_owners(self.modules, engine, shared)

    def __repr__(self) -> str:
        """Return a line for each archetype: its rows, their state after a reset, and its components."""
        lines = [
            f"Layout({self.dims['rows']} rows, {len(self.components)} components, {self.world_bytes} bytes a world)"
        ]
        for name, archetype in self.archetypes.items():
            span, parts = self.spans[name], ", ".join(type(part).__name__ for part in archetype.parts)
            here = f"row {span.start}" if len(span) == 1 else f"rows {span.start} to {span.stop - 1}"
            lines.append(f"  {name}: {here}{'' if archetype.alive else ', not alive at first'}: {parts}")
        return "\n".join(lines)

    def rows(self, *components: type[Component]) -> np.ndarray[Any, Any]:
        """Return the rows, int32, of all entities whose archetype has every one of `components`."""
        rows = [
            row
            for name, archetype in self.archetypes.items()
            if {Entity, *(type(part) for part in archetype.parts)}.issuperset(components)
            for row in self.spans[name]
        ]
        return np.array(rows, np.int32)

    def bitset(self, *components: type[Component]) -> np.ndarray[Any, Any]:
        """Return int32 (blocks,): bit j of block b is set if row 16 b + j is one of `rows(*components)`."""
        bits = np.zeros(self.dims["blocks"], np.int32)
        rows = self.rows(*components)
        np.bitwise_or.at(bits, rows // SIMD_WIDTH, 1 << rows % SIMD_WIDTH)
        return bits

    def row_index(self, *components: type[Component]) -> np.ndarray[Any, Any]:
        """Return int32 (rows,): each row's index in `rows(*components)`, or -1 if it is not one of them."""
        index = np.full(self.dims["rows"], -1, np.int32)
        rows = self.rows(*components)
        index[rows] = np.arange(len(rows))
        return index

    def at_extremes(self, fewer: bool = False) -> "list[MemoryLayout]":
        """Return the layouts with the extreme values of numbers that vary or differ by role; without any, this one.

        Args:
            fewer: Whether they have exactly the counted entities, not the capacity for the highest counts.

        Raises:
            NumberError: Values are impossible, by themselves or together; "role NAME: ..." for those of a role.
        """
        found, differing = list[MemoryLayout](), self.varied or self.per_agent
        for role, modules in extremes(self.modules, self.varied.values(), self.roles) if differing else ():
            try:
                found.append(self.with_modules(modules, self.roles and self.roles.bare(), fewer))
            except NumberError as error:
                raise NumberError(f"role {role}: {error}" if role else str(error)) from None
        return found or [self]

    @property
    def keyed(self) -> bool:
        """Return whether episodes are levels with keys, since numbers, walls or roles are drawn; see Given."""
        drawn = any(module.draws_level for module in self.modules) or (self.roles is not None and self.roles.random)
        return bool(self.varied) or drawn

    @property
    def agents(self) -> range:
        """The rows of the agents that can have roles."""
        return next((self.spans[name] for name, kind in self.archetypes.items() if kind.roles), range(0))

    def groups(self, agents: int | None = None) -> tuple[int, ...]:
        """Return the sizes of the groups, such as teams, of agents (None: all), by a module; () without groups."""
        return _groups(self.modules, self.dims.get("agents", 0) if agents is None else agents)

    def groupings(self, agents: int) -> set[tuple[int, ...]]:
        """Return all possible values of `groups` in worlds with `agents` agents."""
        others = [replaced(self.modules, {n.name: v}) for n in self.varied.values() for v in n.distribution.values]
        return {_groups(modules, agents) for modules in (self.modules, *others)}

    @functools.cached_property
    def agent_counts(self) -> range:
        """The numbers of agents that a world can have."""
        most = self.dims.get("agents", 0)
        fewest = [n.distribution.extremes()[0] for n in self.varied.values() if "agents" in n.dims]
        return range(min([most, *fewest]), most + 1)

    @functools.cached_property
    def entity_names(self) -> tuple[str, ...]:
        """The names of the entities, by row, such as "agent 1"."""
        return tuple(f"{name} {k}" for name, span in self.spans.items() for k in range(len(span)))

    @functools.cached_property
    def systems(self) -> tuple[System, ...]:
        """The systems of the modules, including those that exist only for some of the differing values."""
        found = [system for module in self.modules for system in module.systems()]
        known = {system.label for system in found}
        for module in selecting(self.declared, (*self.per_agent.values(), *self.varied.values())):
            more = [system for system in module.systems() if system.label not in known]
            known |= {system.label for system in more}
            found += more
        return tuple(system.among(self.brings) for system in found)

    def brings(self, parameter: Parameter) -> bool:
        """Return whether these worlds have a parameter's components, and rows if it selects rows."""
        if parameter.kind in SELECTIONS.values():
            return len(self.rows(*parameter.components)) > 0
        return {*parameter.components} <= {*self.components}

    def with_modules(
        self, modules: Sequence[Module], roles: Roles | None = None, fewer: bool = False
    ) -> "MemoryLayout":
        """Return the layout of the same worlds with other numbers.

        Args:
            modules: The same mechanics, in the same order.
            roles: Roles that replace the present ones.
            fewer: Whether worlds have exactly the counted entities, and no varied numbers.
        """
        if fewer:
            return type(self)(modules, roles=roles or self.roles, fewer=True)
        observed = [*self.fields.get("numbers", ())]
        return type(self)(modules, None, observed, roles or self.roles, self.varied)

    def numbers(self, module: str) -> dict[str, Any]:
        """Return the numbers of the module of that name, or of a subclass of it, by name; {} if it is missing."""
        found = [each for each in self.modules if module in (getattr(base, "name", "") for base in type(each).__mro__)]
        return {item.name: getattr(each, item.name) for each in found for item in fields(each)}

    def prefab_values(self, component: type[Component], column: str) -> dict[str, Any]:
        """Return prefab values of a column (one, or one per entity) by name of the archetypes with the component."""
        fill = component.columns[column].fill
        parts = ((name, part) for name, archetype in self.archetypes.items() for part in archetype.parts)
        return {name: part.fills.get(column, fill) for name, part in parts if type(part) is component}

    def check_count(self, component: type[Component], dim: str) -> None:
        """Raise DeclarationError unless the dimension `dim` is the number of entities that have the component."""
        self._counted.add(dim)
        count, size = len(self.rows(component)), self.dims.get(dim, 0)
        if count != size:
            raise DeclarationError(
                f"{count} entities have {component.__name__}, but the dimension '{dim}' is {size}: a module that "
                f"brings more of them adds to it, as in def dims(self): return {{'{dim}': self.count}}"
            )

    def _place_roles(self, roles: Roles) -> dict[str, Number]:
        """Return the numbers that differ by role, and add their dimensions. NumberError if roles do not fit."""
        if not self.agents:
            makers = self.modules[0].providers(lambda module: any(kind.roles for kind in module.archetypes()))
            raise NumberError(f"roles: this scenario has no agents to have them; add {makers}")
        if not self.fewer:  # otherwise roles that do not fit have no agents
            roles.of_agents(len(self.agents))
        found = place_by_role(self.modules, roles, self.dims["rows"])
        roles.check_apart(self.varied)
        self.dims[ROLES] = len(roles.roles)
        self.dims |= {AGENT_WORDS: len(found) * self.dims["rows"]} if found else {}
        return found

    def _observe(self, names: Sequence[str]) -> None:
        """Add the observation "numbers", which shows these varied numbers to agents."""
        self.singletons[NumbersView], start, shown = NumbersView(), 0, dict[str, Field]()
        for name in names:
            shown[name] = self.varied[name].as_field(start, self.modules[self.varied[name].module])
            start += self.varied[name].width
        self.fields["numbers"] = shown

    def _events(self) -> tuple[type[Event], ...]:
        """Return the events, and add their capacities to `dims`: 0 for a dimension without a definition."""
        found: dict[str, type[Event]] = {}
        for event in self.components:
            if not issubclass(event, Event):
                continue
            if (other := found.setdefault(event.name, event)) is not event:
                one, two = (f"{each.__module__}.{each.__qualname__}" for each in (other, event))
                raise DeclarationError(f"{one} and {two} are both the event '{event.name}'; rename one of the classes")
            capacity = event.capacity
            if isinstance(capacity, type):
                capacity = len(self.rows(capacity))
            unknown = isinstance(capacity, str) and capacity not in self.dims and not self._makers(capacity)
            if unknown and (hint := did_you_mean(capacity, self.dims)):  # other names may come with other mechanics
                raise DeclarationError(
                    f"{event.__name__} has the capacity '{capacity}', a dimension that no mechanic defines; {hint}"
                )
            self.dims[event.capacity_dim()] = self.dims.get(capacity, 0) if isinstance(capacity, str) else capacity
        return tuple(found.values())

    @property
    def actions(self) -> list[tuple[type[Component], str]]:
        """The columns of actions as (component, name), in the `order` of their components."""
        kinds = [component for component in self.components if issubclass(component, Action)]
        kinds.sort(key=lambda component: (component.order, component.__qualname__))
        return [(component, name) for component in kinds for name in component.columns]

    def _observations(self) -> dict[str, tuple[str, Column]]:
        """Return, by key of every observation, the name of the mechanic that brings it, and its column."""
        brought = [(each.module.name, singleton) for each in self.declared for singleton in each.singletons]
        return {
            column.key or name: (module, column)
            for module, singleton in brought
            for name, column in (singleton.columns.items() if isinstance(singleton, Observation) else ())
        }

    def _check_counts(self) -> None:
        """Raise DeclarationError if an archetype is only extended, or has a fixed count of 0."""
        for name, archetype in self.archetypes.items():
            if archetype.count == 0 and not any(name in kinds for d in self.declared for kinds in d.kinds.values()):
                kinds = self.modules[0].providing(
                    lambda module: any(kind.name == name and kind.count for kind in module.archetypes())  # noqa: B023
                )
                if here := [module.name for module in self.modules if type(module) in kinds]:
                    raise DeclarationError(
                        f"{here[0]} declares 0 of the kind '{name}': leave {here[0]} out, or count them by a number "
                        'that may be 0: Archetype(..., ref("count")), and count: int = number(2, low=0)'
                    )
                declared = [name for name, kind in self.archetypes.items() if kind.count]
                cure = did_you_mean(name, declared) or "add a module that does"
                raise DeclarationError(
                    f"modules extend the archetype '{name}', but none declares how many there are; "
                    f"{f'add {self.modules[0].named(kinds)}' if kinds else cure}"
                )

    def _check_dims(self) -> None:
        """Raise DeclarationError if a column has a dimension that no module defines."""
        for component in self.components:
            for name, column in component.columns.items():
                for dim in column.dims:
                    if isinstance(dim, str) and dim not in self.dims:
                        makers = self._makers(dim) or "a module whose dims() has it"
                        raise DeclarationError(
                            f"no module defines the dimension '{dim}'; known: {', '.join(sorted(self.dims))}. "
                            f"{component.__name__}.{name} needs it: add {makers}"
                        )

    def _makers(self, dim: str) -> str:
        """Return the names of the imported modules that define a dimension, in words; "" for none."""
        return str(self.modules[0].providers(lambda module: dim in module.dims()))

    @functools.cached_property
    def event_type(self) -> np.dtype[Any]:
        """The type of one world's events in memory."""
        return memory_type(self.events, self.dims)

    @property
    def places(self) -> list[Place]:
        """The places of all columns."""
        return self._placing[0]

    @property
    def world_bytes(self) -> int:
        """The size of a world's state in bytes."""
        return self._placing[1]

    @functools.cached_property
    def _placing(self) -> tuple[list[Place], int]:
        return place_columns(self.components, self.dims)

    def columns(self, block: np.ndarray[Any, Any], component: type[Component]) -> Any:
        """Return the table of a packed component in `block`, uint8 (worlds, world_bytes): columns (worlds, ...)."""
        return component.Table(*(place.view(block) for place in self._places_of.get(component, ())))

    def touched_lines(self, components: Collection[type[Component]]) -> np.ndarray[Any, Any]:
        """Return the cache lines that hold these components, for entities that have them, and the engine's own.

        Args:
            components: See Schedule.touched.

        Returns:
            int64 (lines,), offsets in a world's state, in order.
        """
        found = set[int]()
        for where in self.places:
            if where.offset >= 0 and where.component in {*components, *ENGINE}:
                alone = issubclass(where.component, Singleton)
                rows = [0] if alone else self.rows(where.component).tolist()
                size = where.nbytes if alone else where.nbytes // where.shape[0]
                for row in rows:
                    start = where.offset + row * size
                    found.update(range(start // ALIGN, (start + size - 1) // ALIGN + 1))
        return ALIGN * np.array(sorted(found), np.int64)

    @functools.cached_property
    def _places_of(self) -> dict[type[Component], list[Place]]:
        return {component: list(own) for component, own in groupby(self.places, lambda place: place.component)}

    @functools.cached_property
    def initial_image(self) -> np.ndarray[Any, Any]:
        """The state of a world at the start of an episode, before any system runs and numbers are drawn.

        Returns:
            uint8 (world_bytes,).
        """
        block = np.zeros((1, self.world_bytes), np.uint8)
        for singleton, values in self.singletons.items():
            if singleton.packed:
                fill(self.columns(block, singleton), slice(None), values, singleton.__name__, self.dims)
        for name, archetype in self.archetypes.items():
            span = slice(self.spans[name].start, self.spans[name].stop)
            entity = self.columns(block, Entity)
            entity.alive[0, span] = archetype.alive
            kind = stream_number(name) >> 33 << 32  # positive, with room for 2**32 entities of a kind
            entity.identity[0, span] = kind + np.arange(archetype.count)
            for part in archetype.parts:
                fill(self.columns(block, type(part)), (0, span), part, f"{name}: {type(part).__name__}", self.dims)
        for number in self.per_agent.values():
            words, module = self.columns(block, AgentNumbers).words, self.modules[number.module]
            own = encode(module, number.field, getattr(module, number.field))
            words[:, number.start : number.start + self.dims["rows"]] = own
        return np.ascontiguousarray(block[0])


def _groups(modules: Sequence[Module], agents: int) -> tuple[int, ...]:
    return next((found for module in modules if (found := module.groups(agents))), ())


def _check_keys(base: type[Component], components: Iterable[type[Component]]) -> None:
    """Raise DeclarationError if two columns of a kind share a key, as environments would publish only one of them."""
    owners: dict[str, str] = {}
    for component in components:
        for name, column in component.columns.items() if issubclass(component, base) else ():
            key, owner = column.key or name, f"{component.__module__}.{component.__qualname__}.{name}"
            if key in owners:
                raise DeclarationError(
                    f"{owners[key]} and {owner} are both the {base.__name__.lower()} '{key}'; rename one of the "
                    'columns, or give it another key: column(..., key="mine")'
                )
            owners[key] = owner
