"""Protocols of the layout of a scenario, and of worlds that have it, for mechanics."""

from collections.abc import Mapping
from typing import Any, Protocol

from ..kernels.jit import Array
from .archetype import Archetype
from .component import Component, Singleton
from .fields import Field
from .roles import Roles


class Layout(Protocol):
    """The memory layout of a scenario's worlds, in the form for mechanics."""

    @property
    def archetypes(self) -> Mapping[str, Archetype]:
        """Archetypes by name, in the order of rows."""

    @property
    def spans(self) -> Mapping[str, range]:
        """Ranges of rows by name of the archetype."""

    @property
    def dims(self) -> dict[str, int]:
        """Sizes by name of the dimension."""

    @property
    def labels(self) -> Mapping[str, list[str]]:
        """Labels of mechanics by their kind, in alphabetical order, see declarations.access.Label."""

    @property
    def singletons(self) -> Mapping[type[Component], Singleton]:
        """The per-world components of all mechanics, with their initial values."""

    @property
    def fields(self) -> Mapping[str, Mapping[str, Field]]:
        """Fields by key of the observation and by name, in order of their columns."""

    @property
    def roles(self) -> Roles | None:
        """The roles of agents, or None."""

    @property
    def fewer(self) -> bool:
        """Return whether numbers have the values of one world, whose counts may be smaller than in other worlds."""

    def rows(self, *components: type[Component]) -> Array:
        """Return the rows, int32, of all entities whose archetype has every one of `components`."""

    def bitset(self, *components: type[Component]) -> Array:
        """Return int32 (blocks,): bit j of block b is set if row 16 b + j is one of `rows(*components)`."""

    def row_index(self, *components: type[Component]) -> Array:
        """Return int32 (rows,): each row's index in `rows(*components)`, or -1 if it is not one of them."""

    def numbers(self, module: str) -> dict[str, Any]:
        """Return the numbers of the mechanic of that name, or of a subclass of it, by name; {} if it is missing."""

    def prefab_values(self, component: type[Component], column: str) -> dict[str, Any]:
        """Return prefab values of a column (one, or one per entity) by name of the archetypes with the component."""

    def check_count(self, component: type[Component], dim: str) -> None:
        """Raise DeclarationError unless the dimension `dim` is the number of entities that have the component."""


class WorldsView(Protocol):
    """A batch of worlds between two ticks, in the form for mechanics."""

    @property
    def layout(self) -> Layout:
        """The layout of each world."""

    @property
    def count(self) -> int:
        """The number of worlds."""

    def __getitem__(self, component: type[Component]) -> Any:
        """Return the table of a component, with columns (worlds, ...)."""

    def __contains__(self, component: type[Component]) -> bool:
        """Return whether the worlds have a table of the component."""

    def number(self, name: str) -> Any:
        """Return the value of a number in this episode; (worlds, ...) if they differ, (worlds, agents) if agents do."""

    def span(self, archetype: str) -> slice:
        """Return the rows of an archetype, the same in every world."""
