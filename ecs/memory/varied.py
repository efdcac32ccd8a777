"""Numbers that differ from world to world: how they are drawn at resets, where they lie in memory, and which ones can.

A varied number has four-byte words in the state of its world: the bits of a float32, an int32, or, for a tuple, several
float32. The systems of its mechanic read them there instead of from their argument blocks, so systems without varied
numbers compile to the same code as ever. Prefab values that are the number itself, such as hit points at the start, are
written into the state at each reset.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from ..declarations.component import Observation, Singleton, column
from ..declarations.distributions import CHOICE, FREE, INTEGERS, LOG_UNIFORM, NAMES, UNIFORM, Distribution
from ..declarations.fields import Field
from ..declarations.numbers import is_read, owners, rule_of
from ..kernels.errors import NumberError, meant
from ..kernels.jit import Array
from .made_once import differences, reasons

DIM = "varied words"
EXACT = 2**24  # float32 has all integers up to this one
CORNERS = 64  # the most combinations of extreme values; beyond, only all lowest, all highest, and each one by itself


class Varied(Singleton):
    """The engine's own component of worlds with varied numbers: their values in this episode."""

    words: Array = column("i4", DIM)  # int32, or the bits of float32


class NumbersView(Observation):
    """What agents observe of varied numbers: the same for every agent that exists in the episode, dead or alive."""

    numbers: Array = column("f4", "agents", "numbers fields")


@dataclass(frozen=True)
class VariedNumber:
    """A number of which each world has its own.

    Attributes:
        name: "module_number".
        module: Index of the mechanic among layout.modules.
        number: Its name in the mechanic.
        distribution: What it is drawn from.
        kind: Its type in Python: int, float, bool, str or tuple.
        start: The first of its words.
        width: How many words it has.
        archetypes: For a count, the kinds of entities that it counts. Tables have room for its highest value; in a
            world with fewer of them, the last ones are absent.
        dims: For a count, the dimensions whose size it is.
    """

    name: str
    module: int
    number: str
    distribution: Distribution
    kind: type
    start: int
    width: int
    archetypes: tuple[str, ...] = ()
    dims: tuple[str, ...] = ()

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of its words."""
        return np.dtype("f4" if self.kind in (float, tuple) else "i4")

    @property
    def words(self) -> slice:
        """The range of its words."""
        return slice(self.start, self.start + self.width)

    def field(self, start: int, module: Any) -> Field:
        """The field that shows it in NumbersView; for a number that is text, it shows the index among its choices.

        start: the field's first column. module: the mechanic.
        """
        ends = self.distribution.extremes()
        plain = [value for end in ends for value in (end if self.kind is tuple else (end,))]
        if self.kind is str:
            plain = [rule_of(module, self.number)["choices"].index(word) for word in plain]
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
            return np.array(rule_of(module, self.number)["choices"])[values]
        return values.astype(bool) if self.kind is bool else values.T


def place(modules: list[Any], distributions: Mapping[str, Distribution]) -> dict[str, VariedNumber]:
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
    found: dict[str, VariedNumber] = {}
    for name in sorted(distributions):
        if name not in known:
            raise NumberError(f"there is no number '{name}' to vary; {meant(name, known)}")
        k, field = known[name]
        kind, distribution = type(getattr(modules[k], field)), distributions[name]
        check_kind(name, kind, distribution, rule_of(modules[k], field).get("free", False))
        widths = {encode(modules[k], field, value).size for value in distribution.probes()}
        if len(widths) > 1:
            raise NumberError(f"{name} = {distribution}: tuples of one length are needed, as they size memory")
        counted = _counted(modules[k], field, distribution) if kind is int else ((), ())
        found[name] = VariedNumber(name, k, field, distribution, kind, start, width := widths.pop(), *counted)
        start += width
        hold(modules, [found[name]])
    return found


def hold(modules: list[Any], numbers: Iterable[VariedNumber]) -> None:
    """Give mechanics the highest value of varied counts, and of varied numbers whose own value no world can have.

    Args:
        modules: The mechanics, in order; they are replaced in this list.
        numbers: The varied numbers.
    """
    for number in numbers:
        module, highest = modules[number.module], number.distribution.extremes()[-1]
        value = getattr(module, number.number)
        if value != highest and (number.archetypes or value not in number.distribution):
            modules[number.module] = module.replace(**{number.number: highest})


def _counted(module: Any, field: str, distribution: Distribution) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of the archetypes and of the dimensions whose size is the number `field`."""
    values = distribution.probes()
    probes = [module.replace(**{field: value}) for value in values]
    counts: list[list[tuple[str, Any]]] = [[(each.name, each.count) for each in probe.archetypes()] for probe in probes]
    sizes: list[list[tuple[str, Any]]] = [list(probe.dims().items()) for probe in probes]
    found = []
    for rows in (counts, sizes):
        entries = zip(*rows, strict=True) if len({len(row) for row in rows}) == 1 else ()
        found.append(tuple(entry[0][0] for entry in entries if [size for _, size in entry] == list(values)))
    return found[0], found[1]


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


def corners(numbers: Sequence[VariedNumber]) -> Iterator[dict[VariedNumber, Any]]:
    """Combinations of extreme values of varied numbers: what holds for all of these is taken to hold between them."""
    ends = [number.distribution.extremes() for number in numbers]
    if math.prod(map(len, ends)) <= CORNERS:
        combined: Iterable[Sequence[Any]] = product(*ends)
    else:
        lowest, highest = [values[0] for values in ends], [values[-1] for values in ends]
        singles = [[*lowest[:k], value, *lowest[k + 1 :]] for k, values in enumerate(ends) for value in values]
        combined = [lowest, highest, *singles]
    for values in combined:
        yield dict(zip(numbers, values, strict=True))


def replaced(modules: Sequence[Any], values: Mapping[VariedNumber, Any]) -> list[Any]:
    """The mechanics with these values of varied numbers. Raises what the mechanics raise for them."""
    found = list(modules)
    for number, value in values.items():
        found[number.module] = found[number.module].replace(**{number.number: value})
    return found


def with_values(layout: Any, values: Mapping[VariedNumber, Any]) -> Any:
    """The layout of worlds in which varied numbers have these values, with room for the highest counts."""
    return layout.with_modules(replaced(layout.modules, values))


def extreme_layouts(layout: Any) -> list[Any]:
    """Layouts with the extreme values of numbers that vary or differ by role; without any, the layout itself."""
    numbers = [*layout.varied.values()]
    there = [with_values(layout, values) for values in corners(numbers)] if numbers else [layout]
    return [form for each in there for form in each.forms]


def differing_modules(layout: Any) -> list[Any]:
    """The mechanics whose numbers vary or differ by role, once with each of several values."""
    found = [module for form in (layout.forms if layout.per_agent else ()) for module in form.modules]
    for number in layout.varied.values():
        found += [replaced(layout.modules, {number: value})[number.module] for value in number.distribution.probes()]
    return found


def patches(layout: Any) -> list[tuple[int, int, int]]:
    """Find the prefab values that are varied numbers, by comparing initial states for different values of the numbers.

    Args:
        layout: A Layout.

    Returns:
        Rows as in draw.Plan.patches.

    Raises:
        NumberError: Something depends on a varied number other than systems that get it and prefab values that are the
            number itself; or nothing does.
    """
    numbers, found = list(layout.varied.values()), list[tuple[int, int, int]]()
    for number in numbers:
        found += _own_patches(layout, number)
    for values in corners(numbers):
        fewer = _without_room(layout, values)
        for module in fewer.modules:
            module.check(fewer)  # raises if a mechanic cannot do with fewer entities
        image = layout.initial_image.copy()
        for number, value in values.items():
            encoded = encode(layout.modules[number.module], number.number, value)
            for word, offset, width in found:
                if number.start <= word < number.start + number.width:
                    image[offset : offset + width] = encoded[word - number.start :].view(np.uint8)[:width]
        if not np.array_equal(image, _with_room(with_values(layout, values), fewer)):
            names = ", ".join(number.name for number in numbers)
            raise NumberError(f"{names} cannot vary together: what an episode begins with is computed from several")
    return found


def _without_room(layout: Any, values: Mapping[VariedNumber, Any]) -> Any:
    """The layout of worlds in which varied numbers have these values, with room for just so many entities."""
    fewer = type(layout)(replaced(layout.modules, values), checks=False)
    fewer.roles, fewer.fewer = layout.roles, True
    return fewer


def _with_room(layout: Any, fewer: Any) -> Array:
    """The initial state of worlds with fewer entities, with room for all of them: uint8 (layout.world_bytes,)."""
    image: Array = layout.initial_image.copy()
    for component in fewer.components:
        if not component.packed:
            continue
        tables = layout.columns(image[None], component), fewer.columns(fewer.initial_image[None], component)
        for room, values in zip(*tables, strict=True):
            if issubclass(component, Singleton):
                room[tuple(map(slice, values.shape))] = values
                continue
            for name, rows in fewer.spans.items():
                own = values[0, rows.start : rows.stop]
                room[0, layout.spans[name].start :][tuple(map(slice, own.shape))] = own
    return image


def _own_patches(layout: Any, number: VariedNumber) -> list[tuple[int, int, int]]:
    """The `patches` of one number."""
    probes, k = number.distribution.probes(), number.module
    by_agent = rule_of(layout.modules[k], number.number).get("per_agent", False)
    if shared := [name for name in number.archetypes if layout.archetypes[name].count > max(probes)]:
        raise NumberError(f"{number.name} cannot vary: it is not the only count of the entities {shared[0]!r}")
    images, found = [layout.initial_image], list[tuple[int, int, int]]()
    for value in probes:
        there = with_values(layout, {number: value})
        for other in layout.varied.values():
            for each in other.distribution.probes() if other.module == k and other is not number else ():
                there.modules[k].replace(**{other.number: each})  # raises if they exclude each other
        if reason := next(reasons(layout, there, k, systems=not by_agent), ""):  # see Layout.systems
            raise NumberError(f"{number.name} cannot vary: {reason}")
        images.append(_with_room(there, _without_room(layout, {number: value})))
    for where, i, values in differences(layout.places, images):
        width = values.dtype.itemsize
        if number.kind is tuple or width not in (1, 4) or not _is_number(values[1:], number, probes):
            column = f"{where.component.__name__}.{where.name}"
            if number.kind is not tuple and values[1:].tolist() == list(probes):  # only the type differs
                own = "f4" if number.kind is float else "i4"
                raise NumberError(
                    f"{number.name} cannot vary: {column}, with which episodes begin, is {values.dtype}, and the "
                    f"number {number.kind.__name__}: the column needs the type {own!r}"
                )
            raise NumberError(f"{number.name} cannot vary: {column}, with which episodes begin, is computed from it")
        found.append((number.start, where.offset + i * width, width))
    if not (found or number.archetypes or number.dims or is_read(layout.modules, layout.systems, number.name)):
        raise NumberError(f"{number.name} cannot vary: no system of {layout.modules[k].name} gets it")
    return found


def _is_number(values: Array, number: VariedNumber, probes: Sequence[Any]) -> bool:
    """Whether a prefab value is the number for each of its probes, and has the same bits."""
    same = values.dtype == number.dtype if values.dtype.itemsize == 4 else number.dtype.kind == "i"
    return same and values.tolist() == np.array(probes).astype(values.dtype).tolist()
