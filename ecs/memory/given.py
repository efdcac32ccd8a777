"""Numbers and keys that users give instead of draws: their encoding, and checks that they could have been drawn."""

from collections.abc import Hashable
from typing import Any

import numpy as np

from ..declarations.distributions import CHOICE, FREE, in_python
from ..kernels.errors import NumberError
from ..kernels.jit import Array
from .layout import MemoryLayout
from .numbers import AWAY, GIVEN, HERE, KEY, WORD, Number, encode


def given_words(number: Number, layout: MemoryLayout, values: Any, count: int) -> Array:
    """Return the encoded values that a user gives to some worlds, for the column of Given.

    Args:
        number: The number.
        layout: A layout that varies it.
        values: One, or one for each of the worlds.
        count: Number of worlds.

    Returns:
        uint64 (count, width).

    Raises:
        NumberError: The number of values is wrong, a value could not be drawn, or the mechanic does not accept a value
            of a free number.
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
    """Return whether `values` has one value for each of several worlds; a tuple is a single value."""
    return isinstance(values, list) or (not isinstance(values, tuple) and np.ndim(values) > 0)


def check_taken(number: Number, layout: MemoryLayout, value: tuple[float, ...]) -> None:
    """Raise NumberError unless the mechanic accepts this value of a free number."""
    layout.modules[number.module].replace(**{number.field: value}).check(layout)


def misfits(number: Number, layout: MemoryLayout, words: Array) -> Array:
    """Return whether the words of each world could not have been drawn: bool (worlds,).

    Args:
        number: The number.
        layout: A layout that varies it.
        words: int32 (worlds, width), the words of this number.
    """
    rows, which = np.unique(words, axis=0, return_inverse=True)
    fits = np.array([_could_be(number, layout, row) for row in rows], bool)
    return ~fits[which.reshape(-1)]


def _could_be(number: Number, layout: MemoryLayout, row: Array) -> bool:
    """Return whether a number can have a value, given by its words."""
    if number.distribution.kind == CHOICE:
        encoded = (encode(layout.modules[number.module], number.field, each) for each in number.distribution.values)
        return any(np.array_equal(row, each) for each in encoded)
    value = row.view(number.dtype).tolist()
    if number.distribution.kind != FREE:
        return value[0] in number.distribution
    try:
        check_taken(number, layout, tuple(value))
    except NumberError:
        return False
    return True


def wrongly_given(layout: MemoryLayout, words: Array) -> str:
    """Return the fault in words of Given from a file, which kernels use as unchecked indices; "" if valid.

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
            return f"the key of random numbers in world {int(wrong.argmax())} is invalid"
    if (wrong := (words[:, KEY][:, 0] == 1) & (words[:, KEY][:, 3] == 0)).any():
        return f"the key of random numbers in world {int(wrong.argmax())} is of episode 0: the first one is 1"
    return ""
