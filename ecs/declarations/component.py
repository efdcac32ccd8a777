"""Components: the nouns of a world, declared as columns and stored as structure-of-arrays numpy tables.

A component is a class whose attributes are columns. Its base class determines what rows it has and how it is used:

========== =========== ==========================================================================
base       rows        meaning
========== =========== ==========================================================================
Component  one/entity  state of an entity; a table column has shape (worlds, capacity, ...)
Singleton  one/world   state of a world;   a table column has shape (worlds, ...)
Action     one/world   input of the learner, without floats, shape (worlds, agents, ...)
Observation one/world  output for the learner, shape (worlds, agents, ...)
Signal     one/world   results for the learner beside the observation: rewards, ends
Statistic  one/world   counts over an episode, reported at its end
Event      one/world   a list of the events of a tick (see declarations.event)
========== =========== ==========================================================================

An instance, `Health(points=20)`, is a prefab, not a live object: it holds the values of a new row. Every table has a
row for every entity (zero if its archetype lacks the component), so a row number means the same entity in all tables.
"""

import re
from collections import namedtuple
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..kernels.errors import DeclarationError
from ..kernels.frozen_values import annotated_arrays, is_outside
from ..kernels.integers import is_whole
from ..kernels.jit import Array
from .fields import Field

OTHER_FLOATS = ("f2", "f12", "f16")  # float types that kernels cannot compute with
INDICES = {"entity": "rows"}  # units of indices: the dimension of each; see index_unit
# attributes of Component
RESERVED = ("Table", "brings", "columns", "fills", "keys", "order", "packed", "requires", "row_shape")


@dataclass(frozen=True)
class Column:
    """One column: element type, trailing shape (names are dimensions of the scenario), prefab value and bounds.

    `key` is the name under which environments publish it (default: the attribute's name). `fields` name the numbers
    along its last dimension, which is added to `dims` for them ("own fields" for the key "own"). `unit` is its unit.
    `below` is the dimension of the indices that it holds.
    """

    dtype: np.dtype[Any]
    dims: tuple[int | str, ...]
    fill: float
    low: float
    high: float
    key: str = ""
    fields: tuple[Field, ...] | str = ()
    unit: str = ""
    below: str = ""
    owner: Any = field(default=None, compare=False, repr=False)  # the component, and the column's name there
    name: str = field(default="", compare=False, repr=False)

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "owner", owner)
        object.__setattr__(self, "name", name)

    def shape(self, dims: dict[str, int]) -> tuple[int, ...]:
        """Return the trailing shape as numbers."""
        return tuple(dims[dim] if isinstance(dim, str) else dim for dim in self.dims)

    def range(self, dims: Mapping[str, int]) -> tuple[int, int] | None:
        """Return the lowest and highest integer (or bool) allowed; None for floats, or if its type allows no others."""
        if self.dtype.kind not in "biu":
            return None
        limits = np.iinfo(np.uint8 if self.dtype == bool else self.dtype)
        index = self.below or INDICES.get(self.unit, "")
        low = self.low if self.low > -np.inf or not index else 0 if self.below else -1  # -1: none
        high = min(self.high, _size(index, dims) - 1, 1 if self.dtype == bool else np.inf)
        if low <= limits.min and high >= limits.max:
            return None
        return int(max(low, limits.min)), int(min(high, limits.max))


def _size(index: str, dims: Mapping[str, int]) -> float:
    """Return the number that an index stays below: a dimension, or a sum such as "slots + 1".

    It is infinite if the scenario lacks the dimension, or if `index` is "", for a column without indices.
    """
    names = [name.strip() for name in index.split("+")]
    return sum(int(name) if name.isdigit() else dims.get(name, np.inf) for name in names)


def column(
    dtype: str,
    *dims: int | str,
    fill: float = 0,
    low: float = -np.inf,
    high: float = np.inf,
    key: str = "",
    fields: tuple[Field, ...] | str = (),
    unit: str = "",
    below: str = "",
) -> Any:
    """Declare a column of a component.

    Args:
        dtype: Type of its elements, as numpy writes it: "f4", "i4", "u1".
        *dims: Trailing dimensions, as sizes or as names of dimensions of the scenario.
        fill: Value of a new row.
        low: Inclusive lower bound, published in the spaces of environments. Lower integers are refused in states that
            are set and in columns that a system from outside outlast has written.
        high: Inclusive upper bound, with the same checks.
        key: Name under which environments publish it (default: the attribute's name).
        fields: For an Observation: the fields of its last dimension; its length is theirs and that of fields that other
            mechanics add. If the rows are copies of another observation's, the key of that one.
        unit: Unit, such as "m". With "entity" (a row), or another unit that `index_unit` declares, such as
            "side", -1 means none, and indices that do not exist are errors like integers below `low`.
        below: The dimension whose indices it holds, from 0 or `low`, such as "boxes"; or a sum, such as "slots + 1".
    """
    return Column(np.dtype(dtype), dims, fill, low, high, key, fields, unit, below)


def index_unit(unit: str, dimension: str) -> None:
    """Make columns of a unit, such as "side", hold indices of a dimension, or -1 for none.

    Raises:
        DeclarationError: The unit belongs to another dimension.
    """
    if (known := INDICES.setdefault(unit, dimension)) != dimension:
        raise DeclarationError(f"integers of unit {unit!r} are indices of '{known}', not of '{dimension}': rename one")


def as_stored(label: str, column: Column, value: Any) -> Any:
    """Return a prefab value as an array of the column's type. DeclarationError if the column cannot hold it."""
    given = np.asarray(value)
    if column.dtype.kind == "f" and given.dtype.kind in "biuf":
        return given.astype(column.dtype)
    with np.errstate(invalid="ignore"):
        stored = given.astype(column.dtype) if given.dtype.kind in "biuf" else None
    if stored is None or not np.array_equal(stored, given):
        raise DeclarationError(f"{label} is {column.dtype}, which cannot hold {value!r:.60}")
    return stored


def _check_column(label: str, column: Column) -> None:
    """Raise DeclarationError for a type that kernels cannot handle, impossible sizes or bounds, or an unfit fill."""
    if column.dtype.kind not in "biuf" or not column.dtype.isnative or column.dtype.str[1:] in OTHER_FLOATS:
        raise DeclarationError(
            f'{label} has the type {column.dtype.str}: columns hold integers, floats or truths, such as "i4", "f4", "?"'
        )
    dims: tuple[Any, ...] = column.dims
    for dim in dims:
        if not isinstance(dim, str) and not is_whole(dim, 1):
            raise DeclarationError(
                f"{label} has the dimension {dim!r:.60}: a size of at least 1 or the name of a dimension is needed"
            )
    if not column.low <= column.high:
        raise DeclarationError(
            f"{label} goes from {column.low:g} to {column.high:g}: the low end must not be above the high one"
        )
    index: Any = column.below
    if not isinstance(index, str):
        raise DeclarationError(
            f"{label} is below {index!r:.60}: the name of a dimension is needed; for a number take high"
        )
    if column.dtype.kind == "f" and (index or column.unit in INDICES):
        raise DeclarationError(f'{label} is {column.dtype}, and an index of {index or INDICES[column.unit]}: take "i4"')
    as_stored(label, column, column.fill)


def snake_case(name: str) -> str:
    """Return SafeZone as safe_zone, HTTPServer as http_server."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


def table_type(cls: type["Component"]) -> Any:
    """Return a namedtuple of the columns that can be imported by name, so that numba can cache functions using it."""
    table = namedtuple("Table", list(cls.columns), module=cls.__module__)  # type: ignore[misc]
    table.__name__ = cls.__name__
    table.__qualname__ = f"{cls.__qualname__}.Table"
    return table


class Coupled(NamedTuple):
    """Columns of a component that must fit each other. A system that writes one must write all it needs.

    Attributes:
        columns: A system that writes one of these ...
        needs: ... must write all of these.
        cure: How a system does that, in words.
        computed_by: The system of resets, if any, that computes the needed columns: systems before it need not.
    """

    columns: tuple[str, ...]
    needs: tuple[str, ...]
    cure: str
    computed_by: str = ""


class Component:
    """State of an entity: in every world, one row for each entity of the archetypes that have the component.

    A component without columns is a marker: Rows[Burning] are the entities of the archetypes that have it.
    """

    columns: ClassVar[dict[str, Column]] = {}
    requires: ClassVar[tuple[type["Component"], ...]] = ()  # an entity with this component also gets these
    coupled: ClassVar[tuple[Coupled, ...]] = ()
    Table: ClassVar[Any] = None
    order: ClassVar[int] = 0
    packed: ClassVar[bool] = True  # whether its columns lie in the state of the world, or in buffers of their own

    def __init_subclass__(cls, order: int = 0, packed: bool | None = None) -> None:
        columns = {name: value for name, value in vars(cls).items() if isinstance(value, Column)}
        for name in columns:
            if name.startswith("_") or name in RESERVED:
                raise DeclarationError(f"{cls.__name__}.{name}: no column can be called so; take another name")
        needed: Any = cls.requires
        if not isinstance(needed, tuple) or not all(isinstance(c, type) and issubclass(c, Component) for c in needed):
            raise DeclarationError(f"{cls.__name__}.requires = {needed!r:.80}: a tuple is needed, as in (Health,)")
        if packed is not None:
            if is_outside(cls):
                raise DeclarationError(f"{cls.__name__}: packed is for outlast's own components; leave it out")
            cls.packed = packed
        if is_outside(cls) and (bare := [name for name in annotated_arrays(cls) if name not in columns]):
            raise DeclarationError(
                f'{cls.__name__}.{bare[0]} is not a column: declare it as in {bare[0]}: Array = column("f4"), or as a '
                "ClassVar, if it should not be one"
            )
        if cls.columns:
            base = next(base.__name__ for base in cls.__mro__[1:] if vars(base).get("columns"))
            raise DeclarationError(
                f"{cls.__name__} extends {base}, which has columns: a component has its own columns only; "
                "let entities have both"
            )
        if not columns:  # a base such as Singleton, or a marker
            cls.Table = table_type(cls)
            return
        published = issubclass(cls, (Action, Observation, Signal, Statistic))
        for name, value in columns.items():
            _check_column(f"{cls.__name__}.{name}", value)
            if value.dtype.kind == "f" and not published and (value.low > -np.inf or value.high < np.inf):
                raise DeclarationError(
                    f"{cls.__name__}.{name} is {value.dtype} with low or high, which are of integers and of what "
                    "environments publish; leave them out"
                )
            if value.key and not published:
                raise DeclarationError(
                    f"{cls.__name__}.{name} has a key, which only columns of an Action, an Observation, a Signal or a "
                    "Statistic have; leave it out"
                )
        if not cls.packed and (filled := [name for name, value in columns.items() if value.fill]):
            raise DeclarationError(
                f"{cls.__name__}.{filled[0]}: columns with buffers of their own begin as 0; "
                "leave out fill, and write the value in a system that runs at reset"
            )
        if named := [name for name, value in columns.items() if value.fields and not issubclass(cls, Observation)]:
            raise DeclarationError(
                f"{cls.__name__}.{named[0]} has fields, which only columns of an Observation have; make each a column"
            )
        for name in {name for coupled in cls.coupled for name in (*coupled.columns, *coupled.needs)} - columns.keys():
            raise DeclarationError(f"{cls.__name__}.coupled: unknown column '{name}'; known: {', '.join(columns)}")
        cls.columns, cls.order = columns, order
        cls.Table = table_type(cls)

    def __init__(self, **fills: Any) -> None:
        for name in fills:
            if name not in self.columns:
                known = ", ".join(self.columns)
                raise DeclarationError(f"{type(self).__name__} has no column '{name}'; it has: {known}")
        if fills and not self.packed:
            raise DeclarationError(
                f"{type(self).__name__}({next(iter(fills))}=...): it has buffers of its own, which begin as 0; "
                "write the value in a system that runs at reset"
            )
        self.fills = fills

    def brings(self) -> tuple["Component", ...]:
        """Return components that are added to kinds with this one, with values derived from its own."""
        return ()

    @classmethod
    def row_shape(cls, name: str, dims: dict[str, int]) -> tuple[int, ...]:
        """Return the shape of a column in one world: (capacity, ...)."""
        return (dims["rows"], *cls.columns[name].shape(dims))


class Singleton(Component):
    """State of a world. A column without dimensions has shape (worlds, 1)."""

    def __init__(self, **fills: Any) -> None:
        if not self.columns:
            raise DeclarationError(f'{type(self).__name__} has no columns: declare one, as in x: Array = column("f4")')
        super().__init__(**fills)

    @classmethod
    def row_shape(cls, name: str, dims: dict[str, int]) -> tuple[int, ...]:
        """Return the shape of a column in one world: its own dimensions, at least one."""
        return cls.columns[name].shape(dims) or (1,)

    @classmethod
    def keys(cls) -> set[str]:
        """Return the keys of this component's columns, and of all imported components that are derived from it."""
        own = {column.key or name for name, column in cls.columns.items()}
        return own.union(*(subclass.keys() for subclass in cls.__subclasses__()))


class Action(Singleton, packed=False):
    """An input that the learner sets: integer columns, with `low` and `high` as the range of each."""

    def __init_subclass__(cls, order: int = 0, packed: bool | None = None) -> None:
        super().__init_subclass__(order, packed)
        for name, value in cls.columns.items():
            if value.dtype.kind != "i" or not (np.isfinite([value.low, value.high]).all() and value.low < value.high):
                raise DeclarationError(
                    f"{cls.__name__}.{name} is {value.dtype} from {value.low} to {value.high}: an action is a signed "
                    "integer with a finite low below a finite high"
                )
            if not value.low <= 0 <= value.high:
                raise DeclarationError(
                    f"{cls.__name__}.{name} goes from {value.low} to {value.high}: 0 must be in it, which does nothing"
                )
            kind = np.iinfo(value.dtype)
            if value.low < kind.min or value.high > kind.max:
                raise DeclarationError(
                    f"{cls.__name__}.{name} goes from {value.low} to {value.high}, and {value.dtype} from {kind.min} "
                    f"to {kind.max}: make it two actions, as all columns of actions have one type, outlast's int8"
                )


class Observation(Singleton, packed=False):
    """An output that the learner sees, in buffers that environments return; the column's key is the observation's key.

    Columns are float32, like the spaces of observations. `fields` declares the numbers of a row.
    """

    def __init_subclass__(cls, order: int = 0, packed: bool | None = None) -> None:
        super().__init_subclass__(order, packed)
        for name, value in cls.columns.items():
            if value.dtype != np.float32:
                raise DeclarationError(f"{cls.__name__}.{name} is {value.dtype}: observations are float32, 'f4'")
            if value.fields:
                key = value.fields if isinstance(value.fields, str) else value.key or name
                cls.columns[name] = replace(value, dims=(*value.dims, f"{key} fields"))


class Signal(Singleton, packed=False):
    """A result that the learner gets besides the observation: reward, terminated, truncated.

    A signal that only a user's systems write is set to 0 in every tick before the first of them runs, so that they can
    add to it.
    """


class Statistic(Singleton):
    """A count over one episode: zero at reset, reported when the episode ends."""

    def __init_subclass__(cls, order: int = 0, packed: bool | None = None) -> None:
        super().__init_subclass__(order, packed)
        for name, value in cls.columns.items():
            if len(value.dims) > 1:
                raise DeclarationError(
                    f"{cls.__name__}.{name} has the dimensions {value.dims}: a statistic is one number, or has one for "
                    "each agent, side or the like; make it several"
                )


class Entity(Component):
    """A component of the engine that every row has. Systems that spawn or despawn entities write it."""

    alive: Array = column("u1", high=1)  # 1 while the entity is in the world
    identity: Array = column("i8", low=-1)  # stable number of (archetype, index), to index draws by; -1: absent


class Clock(Singleton):
    """A component of the engine that every world has: the key of its random numbers."""

    seed: Array = column("u8")
    world: Array = column("u8")
    episode: Array = column("u8")
    tick: Array = column("u8", high=2**62)  # ticks since reset: 0 in the tick that resets


# ---- placeholders in declarations for a number of the mechanic, or for the number of an entity


@dataclass(frozen=True)
class Ref:
    """A number of the declaring mechanic, instead of the number's value."""

    name: str


def ref(name: str) -> Any:
    """Name a number in a declaration; the number can then differ between worlds or agents.

    It stands for a complete value: that of a prefab, as in Health(points=ref("points")); the count of an Archetype; or
    the size of a dimension that is a count of entities, as in {"boxes": ref("count")}.

    Args:
        name: The number's name in the mechanic.
    """
    return Ref(name)


class _Index:
    """The type of INDEX."""

    def __repr__(self) -> str:
        return "INDEX"


INDEX: Any = _Index()
"""A prefab value: the number of the entity among those of its kind, 0, 1, 2 and so on."""


def index_of(value: Any, count: int) -> Any:
    """Return a prefab value for `count` entities: the indices for INDEX, or the value itself."""
    return np.arange(count) if value is INDEX else value
