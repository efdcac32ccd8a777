"""One entity of one world, for debugging."""

from typing import Any

import numpy as np

from ..declarations.component import Component, Entity
from ..kernels.errors import DeclarationError, did_you_mean
from ..kernels.integers import is_whole
from .tables import Tables


class EntityView:
    """One entity with all its components, with the present values of the tables.

    `view.Health.points` and `view[Health].points` are values; a column with more dimensions is an array that shares
    the table's memory. `print(view)` shows everything.

    Args:
        worlds: A Worlds.
        row: The entity's row, the same in every table.
        world: The number of the world.

    Attributes:
        row: The entity's row.
        world: The number of its world.
        archetype: The name of its kind.
        index: Its number among the entities of its kind, from 0.

    Raises:
        DeclarationError: The row or the world does not exist.
    """

    def __init__(self, worlds: Tables, row: int, world: int = 0) -> None:
        asked: list[tuple[str, Any, int]] = [("row", row, worlds.dims["rows"]), ("world", world, worlds.count)]
        for name, value, count in asked:
            if not is_whole(value, 0, count - 1):
                raise DeclarationError(f"{name} {value!r} does not exist: there are {count}, from 0 to {count - 1}")
        self.row, self.world = int(row), int(world)
        spans = worlds.layout.spans
        self.archetype = next(name for name, span in spans.items() if row in span)
        self.index, self._called = self.row - int(spans[self.archetype].start), worlds.layout.entity_names[self.row]
        parts = worlds.layout.archetypes[self.archetype].parts
        components: list[type[Component]] = [Entity, *map(type, parts)]
        self._tables = {component: worlds[component] for component in components}

    def __getitem__(self, component: type[Component]) -> Any:
        """Return its values of a component, as a named tuple."""
        if component not in self._tables:
            raise DeclarationError(f"{self._name} has no {component.__name__}; it has: {', '.join(self._names)}")
        return component.Table(*(column[self.world, self.row] for column in self._tables[component]))

    def __getattr__(self, name: str) -> Any:
        if "_tables" not in vars(self):  # during a copy
            raise AttributeError(name)
        named = [component for component in self._tables if component.__name__ == name]
        if not named:
            hint = did_you_mean(name, self._names, before="; ")
            raise AttributeError(f"{self._name} has no {name}; it has: {', '.join(self._names)}{hint}")
        if len(named) > 1:
            raise AttributeError(f"{self._name} has {len(named)} components called {name}: take entity[its class]")
        return self[named[0]]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._names]

    def __repr__(self) -> str:
        alive = "alive" if self[Entity].alive else "not in the world"
        lines = [f"{self._name}, {alive}"]
        for component in self._tables:
            lines += [f"  {component.__name__}"] if not component.columns else []
            for k, (column, value) in enumerate(self[component]._asdict().items()):
                lines.append(f"  {'' if k else component.__name__:<12} {column:<18} {_text(value)}")
        return "\n".join(lines)

    @property
    def _name(self) -> str:
        return f"entity {self.row} of world {self.world} ({self._called})"

    @property
    def _names(self) -> list[str]:
        return [component.__name__ for component in self._tables]


def _text(value: Any) -> str:
    if np.ndim(value):
        return " ".join(np.array2string(value, precision=6, separator=", ").split())
    return f"{value:.7g}" if isinstance(value, np.floating) else str(value)
