"""Numbers that differ from world to world: how they are drawn at resets, where they lie, and which ones can.

A varied number has four-byte words in the state of its world: the bits of a float32, an int32, or several of either for
a tuple. The systems of its mechanic read them there instead of from their argument blocks, so what varies nothing is
compiled to what it was. Prefab values that are the number itself, such as hit points at the start, are written into the
state at each reset.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product
from typing import Any

import numpy as np

from .component import Array, Singleton, column
from .distributions import CHOICE, INTEGERS, LOG_UNIFORM, NAMES, Distribution
from .errors import NumberError
from .jit import kernel
from .random import integer, stream_number, words

DIM = "varied words"
GIVEN = np.uint64(32)  # the bit of a word of Given that says that there is one
WORD = np.uint64(0xFFFFFFFF)
TO_53_BITS, ULP_53 = np.uint64(11), np.float64(2.0**-53)
CORNERS = 6  # numbers whose ends are combined, each with each; of more, all lowest and all highest ends are


class Given(Singleton):
    """The engine's own component of worlds with varied numbers: those that are not drawn, as somebody has set them."""

    words: Array = column("u8", DIM)  # 0: drawn; else the word, and bit 32


class Varied(Singleton):
    """The engine's own component of worlds with varied numbers: their values in this episode."""

    words: Array = column("i4", DIM)  # int32, or the bits of float32


@dataclass(frozen=True)
class VariedNumber:
    """A number of which each world has its own.

    Attributes:
        name: "module_number".
        module: Index of the mechanic among layout.modules.
        field: The number's name in the mechanic.
        distribution: What it is drawn from.
        kind: Its type in Python: int, float, bool, str or tuple.
        start: The first of its words.
        width: How many words it has.
    """

    name: str
    module: int
    field: str
    distribution: Distribution
    kind: type
    start: int
    width: int

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of its words."""
        return np.dtype("f4" if self.kind in (float, tuple) else "i4")


def place(modules: Sequence[Any], distributions: Mapping[str, Distribution]) -> dict[str, VariedNumber]:
    """Where the words of varied numbers lie, by name.

    Args:
        modules: The mechanics, in order.
        distributions: By name, "module_number".

    Raises:
        NumberError: There is no such number, or it cannot have the values.
    """
    owners = {
        f"{module.name}_{item.name}": (k, item.name) for k, module in enumerate(modules) for item in fields(module)
    }
    found: dict[str, VariedNumber] = {}
    start = 0
    for name in sorted(distributions):
        if name not in owners:
            raise NumberError(f"there is no number '{name}' to vary; known: {', '.join(owners)}")
        k, field = owners[name]
        kind, distribution = type(getattr(modules[k], field)), distributions[name]
        _check_kind(name, kind, distribution)
        widths = {encode(modules[k], field, value).size for value in distribution.probes()}
        if len(widths) > 1:
            raise NumberError(f"{name} = {distribution}: tuples of one length are needed, as they size memory")
        found[name] = VariedNumber(name, k, field, distribution, kind, start, width := widths.pop())
        start += width
    return found


def encode(module: Any, field: str, value: Any) -> np.ndarray[Any, Any]:
    """A number's value as int32 words. NumberError if the mechanic cannot have it."""
    kernels = module.replace(**{field: value}).value(field)
    real = isinstance(kernels, (float, tuple))
    return np.atleast_1d(np.array(kernels, np.float32).view(np.int32) if real else np.array(kernels, np.int32))


def _check_kind(name: str, kind: type, distribution: Distribution) -> None:
    allowed = {float: (0, 1, 2, 3), int: (INTEGERS, CHOICE)}.get(kind, (CHOICE,))
    if distribution.kind not in allowed:
        names = " or ".join(NAMES[k] for k in allowed)
        raise NumberError(f"{name} = {distribution}: it is of type {kind.__name__}, so take {names}")


def corners(numbers: Sequence[VariedNumber]) -> Iterator[dict[VariedNumber, Any]]:
    """Extreme values of varied numbers together: what holds for all of these is taken to hold for all between."""
    ends = [number.distribution.extremes() for number in numbers]
    if len(ends) <= CORNERS:
        combined: Iterable[Sequence[Any]] = product(*ends)
    else:
        lowest, highest = [values[0] for values in ends], [values[-1] for values in ends]
        singles = [[*lowest[:k], value, *lowest[k + 1 :]] for k, values in enumerate(ends) for value in values]
        combined = [lowest, highest, *singles]
    for values in combined:
        yield dict(zip(numbers, values, strict=True))


def with_values(layout: Any, values: Mapping[VariedNumber, Any]) -> Any:
    """The layout of worlds in which varied numbers have these values. Raises what mechanics say to them."""
    modules = list(layout.modules)
    for number, value in values.items():
        modules[number.module] = modules[number.module].replace(**{number.field: value})
    return type(layout)(modules, {name: number.distribution for name, number in layout.varied.items()})


@dataclass(frozen=True)
class Plan:
    """What draws the numbers of one world, as arrays; see `draw`.

    Attributes:
        kinds: int8 (numbers,), of their distributions.
        real: int8 (numbers,), 1 where words are float32.
        spans: int32 (numbers, 2), the first word and how many.
        streams: uint64 (numbers,), of random numbers: that of the number's name.
        ends: float64 (numbers, 2), lowest and highest; of choices 0.
        choices: int32 (words,), of all choices, one behind the other.
        options: int32 (numbers, 2), where a number's choices begin, and how many there are.
        patches: int32 (patches, 3), of prefab values: a word, where it goes in the state, and in bytes how wide it is
            there, 1 or 4.
    """

    kinds: Array
    real: Array
    spans: Array
    streams: Array
    ends: Array
    choices: Array
    options: Array
    patches: Array


def plan(layout: Any) -> Plan:
    """The arrays for `draw`, for an ecs.layout.Layout. Raises what `patches` raises."""
    numbers, choices, options = list(layout.varied.values()), list[int](), list[tuple[int, int]]()
    for number in numbers:
        values = number.distribution.values if number.distribution.kind == CHOICE else ()
        options.append((len(choices), len(values)))
        for value in values:
            choices += encode(layout.modules[number.module], number.field, value).tolist()
    ends = [(0, 0) if number.distribution.kind == CHOICE else number.distribution.values for number in numbers]
    return Plan(
        kinds=np.array([number.distribution.kind for number in numbers], np.int8),
        real=np.array([number.dtype.kind == "f" for number in numbers], np.int8),
        spans=np.array([(number.start, number.width) for number in numbers], np.int32),
        streams=np.array([stream_number(f"vary {number.name}") for number in numbers], np.uint64),
        ends=np.array(ends, np.float64),
        choices=np.array(choices or [0], np.int32),
        options=np.array(options, np.int32),
        patches=np.array(patches(layout), np.int32).reshape(-1, 3),
    )


@kernel
def between(kind: int, low: float, high: float, key: Any) -> float:
    """A draw between two ends, float64."""
    if kind == INTEGERS:
        return low + np.float64(integer(key, 0, int(high) - int(low) + 1))
    unit = np.float64(words(key, 0)[0] >> TO_53_BITS) * ULP_53
    if kind == LOG_UNIFORM:
        return min(max(math.exp(math.log(low) + unit * (math.log(high) - math.log(low))), low), high)
    return low + unit * (high - low)


@kernel
def draw(
    clock: Any,
    given: Any,
    values: Any,
    reals: Any,
    state: Any,
    state_bytes: Any,
    kinds: Any,
    real: Any,
    spans: Any,
    streams: Any,
    ends: Any,
    choices: Any,
    options: Any,
    patches: Any,
) -> None:
    """Set the numbers of a world whose episode begins, and the prefab values that they are.

    given: its column of Given. values, reals: its words of Varied, as int32 and as float32. state, state_bytes: all of
    its state, as int32 and as uint8. kinds and all that follow: see Plan.
    """
    for n in range(kinds.size):
        start, width = spans[n, 0], spans[n, 1]
        if given[start] >> GIVEN:
            for k in range(start, start + width):
                values[k] = np.int32(np.uint32(given[k] & WORD))
            continue
        key = (clock.seed[0], clock.world[0], clock.episode[0], np.uint64(0), streams[n])
        if kinds[n] == CHOICE:
            first = options[n, 0] + width * integer(key, 0, options[n, 1])
            for k in range(width):
                values[start + k] = choices[first + k]
        elif real[n]:
            reals[start] = np.float32(between(kinds[n], ends[n, 0], ends[n, 1], key))
        else:
            values[start] = np.int32(between(kinds[n], ends[n, 0], ends[n, 1], key))
    for p in range(patches.shape[0]):
        word, where = values[patches[p, 0]], patches[p, 1]
        if patches[p, 2] == 4:
            state[where >> 2] = word
        else:
            state_bytes[where] = np.uint8(word)


def patches(layout: Any) -> list[tuple[int, int, int]]:
    """Which prefab values are varied numbers: rows as in Plan.patches.

    Found by comparing what worlds with other values of the numbers would begin with.

    Args:
        layout: An ecs.layout.Layout.

    Raises:
        NumberError: The size of a table depends on a varied number, or a prefab value that is not the number itself.
    """
    numbers, found = list(layout.varied.values()), list[tuple[int, int, int]]()
    for number in numbers:
        found += _own_patches(layout, number)
    for values in corners(numbers):
        image, there = layout.initial_image.copy(), with_values(layout, values)
        for number, value in values.items():
            encoded = encode(layout.modules[number.module], number.field, value)
            for word, offset, width in found:
                if number.start <= word < number.start + number.width:
                    image[offset : offset + width] = encoded[word - number.start :].view(np.uint8)[:width]
        if not np.array_equal(image, there.initial_image):
            names = ", ".join(number.name for number in numbers)
            raise NumberError(f"{names} cannot vary together: what an episode begins with is computed from several")
    return found


def _own_patches(layout: Any, number: VariedNumber) -> list[tuple[int, int, int]]:
    """Those of one number."""
    probes = number.distribution.probes()
    layouts = [with_values(layout, {number: value}) for value in probes]
    for there in layouts:
        if sized := [dim for dim, size in layout.dims.items() if there.dims.get(dim) != size]:
            sizes = ", ".join(map(repr, sized))
            raise NumberError(f"{number.name} cannot vary: it decides how large tables are ({sizes})")
        if there.places != layout.places:
            raise NumberError(f"{number.name} cannot vary: it decides which components there are")
    images = np.stack([layout.initial_image, *(there.initial_image for there in layouts)])
    found = []
    for where in [each for each in layout.places if each.offset >= 0]:
        dtype = where.component.columns[where.name].dtype
        size = dtype.itemsize * math.prod(where.shape)
        values = images[:, where.offset : where.offset + size].copy().view(dtype)
        for k in np.flatnonzero((values != values[0]).any(0)):
            if number.kind is tuple or dtype.itemsize not in (1, 4) or not _is_number(values[1:, k], number, probes):
                column = f"{where.component.__name__}.{where.name}"
                raise NumberError(
                    f"{number.name} cannot vary: {column}, with which episodes begin, is computed from it"
                )
            found.append((number.start, where.offset + int(k) * dtype.itemsize, dtype.itemsize))
    return found


def _is_number(values: Array, number: VariedNumber, probes: Sequence[Any]) -> bool:
    """Whether a prefab value is the number, whatever it is, and has the same bits."""
    same = values.dtype == number.dtype if values.dtype.itemsize == 4 else number.dtype.kind == "i"
    return same and values.tolist() == np.array(probes).astype(values.dtype).tolist()
