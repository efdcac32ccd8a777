"""The memory of a batch of worlds: their states, the buffers that environments return, and events, as tables."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..declarations import event
from ..declarations.component import Action, Clock, Component
from ..declarations.event import Event, EventMemory
from ..kernels.errors import DeclarationError
from .can_differ import patches
from .column_places import ALIGN
from .layout import MemoryLayout
from .numbers import AgentNumbers, Number, Varied


class Tables:
    """The tables of `count` worlds of one layout, in the initial state of episodes.

    tables[C] is the table of component C: columns of shape (count, capacity, ...) or, per world, (count, ...).

    Attributes:
        layout: The layout of each world.
        count: Number of worlds.
        block: uint8 (count, bytes), the state of each world.
        mode: int8 (count,), mode of the next tick for each world: SKIP, STEP or RESET.
        actions: All action columns in one array, (actions, count, ...), in the order of `layout.actions`.
        event_memory: The events of each world's last tick, in their memory format.
    """

    def __init__(self, layout: MemoryLayout, count: int) -> None:
        self.layout, self.count = layout, count
        self.block = aligned(count * layout.world_bytes).reshape(count, layout.world_bytes)
        self.block[:] = layout.initial_image
        self.mode = np.zeros(count, np.int8)
        counts = np.zeros((count, len(layout.events)), np.int32)
        self.event_memory = EventMemory(counts, np.zeros(count, layout.event_type))
        self.actions = self._allocate_actions()
        self._tables = {c: self._allocate(c) for c in layout.components}

    def __getitem__(self, component: type[Component]) -> Any:
        try:
            return self._tables[component]
        except KeyError:
            known = ", ".join(sorted(c.__name__ for c in self._tables))
            raise DeclarationError(f"this scenario has no component {component.__name__}; it has: {known}") from None

    def __contains__(self, component: type[Component]) -> bool:
        return component in self._tables

    @property
    def components(self) -> tuple[type[Component], ...]:
        """All components, in the order in which they are stored."""
        return self.layout.components

    @property
    def dims(self) -> dict[str, int]:
        """The sizes of this scenario's dimensions by name: "rows", and those that its modules define."""
        return self.layout.dims

    @property
    def changed(self) -> Mapping[str, int | float]:
        """The numbers that differ from those of the layout, by name, in the form for kernels."""
        return {}

    def agent_values(self, number: Number) -> np.ndarray[Any, Any]:
        """Return a number that differs by role, of each agent, (worlds, agents): a copy."""
        rows = self.layout.agents
        words = self[AgentNumbers].words[:, number.start + rows.start : number.start + rows.stop]
        found: np.ndarray[Any, Any] = words.copy().view(number.dtype)
        return found

    def initial_image(self, w: int) -> np.ndarray[Any, Any]:
        """Return the state of world `w` at the start of its episode, with the numbers that differ: uint8 (bytes,)."""
        image: np.ndarray[Any, Any] = self.layout.initial_image.copy()
        for by_role, component in enumerate((Varied, AgentNumbers)) if self[Clock].episode[w, 0] else ():
            for word, offset, size in patches(self.layout, bool(by_role)):
                image[offset : offset + size] = self[component].words[w].view(np.uint8)[4 * word : 4 * word + size]
        return image

    def _allocate(self, component: type[Component]) -> Any:
        if component.packed:
            return self.layout.columns(self.block, component)
        columns = component.columns.items()
        if issubclass(component, Event):
            return event.table(component, self.layout.events, self.event_memory)
        if issubclass(component, Action):
            first = self.layout.actions.index((component, next(iter(component.columns))))
            return component.Table(*self.actions[first : first + len(columns)])
        return component.Table(
            *(np.zeros((self.count, *component.row_shape(name, self.dims)), column.dtype) for name, column in columns)
        )

    def _allocate_actions(self) -> np.ndarray[Any, Any]:
        """Join all action columns in one array, (actions, worlds, ...), which an adapter sets by one assignment."""
        kinds = {
            (component.columns[name].dtype, component.row_shape(name, self.dims))
            for component, name in self.layout.actions
        }
        if len(kinds) > 1:
            found = ", ".join(
                f"{component.__name__}.{name} {component.columns[name].dtype} {component.row_shape(name, self.dims)}"
                for component, name in self.layout.actions
            )
            raise DeclarationError(f"all columns of actions must have the same type and shape; there are: {found}")
        dtype, shape = kinds.pop() if kinds else (np.dtype(np.int8), ())
        return np.zeros((len(self.layout.actions), self.count, *shape), dtype)


def aligned(size: int) -> np.ndarray[Any, Any]:
    """Return zeros, uint8 (size,), that begin at a cache line; kernels.simd may read one line past the end."""
    memory = np.zeros(size + 2 * ALIGN, np.uint8)
    start = -memory.ctypes.data % ALIGN
    return memory[start : start + size]
