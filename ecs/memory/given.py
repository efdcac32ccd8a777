"""Varied numbers that are given instead of drawn, and given keys of random numbers: their memory and validation."""

from collections.abc import Hashable
from typing import Any

import numpy as np

from ..declarations.component import Singleton, column
from ..declarations.distributions import CHOICE, FREE, in_python
from ..kernels.errors import NumberError
from ..kernels.jit import Array
from .varied import VariedNumber, encode

GIVEN_DIM = "given words"
GIVEN = np.uint64(32)  # this bit of a word of Given says that a value is given
ONCE = np.uint64(33)  # this bit says that it is for one episode only
HERE, WORD = np.uint64(1) << GIVEN, np.uint64(0xFFFFFFFF)
KEY, AWAY = slice(-8, -4), slice(-4, None)  # words at the end of Given, see there
KEYS = 8  # the number of these words
NO_LEVELS = "no numbers, walls or roles are drawn here, so seeds decide: reset(seed=[...])"  # see Layout.keyed


class Given(Singleton):
    """The engine's own component of worlds whose episodes are levels: what users have given, and is not drawn.

    It outlasts episodes. The words of varied numbers are followed by a key of random numbers for the next episode (1 if
    there is one, seed, world and episode), and by the world's own key while it plays an episode with a given one.
    """

    words: Array = column("u8", GIVEN_DIM)  # 0: drawn; else the word, bit 32, and maybe bit 33


def given_words(number: VariedNumber, layout: Any, values: Any, count: int) -> Array:
    """Encode the values that a user gives to some worlds, for the column of Given.

    Args:
        number: The number.
        layout: A Layout that varies it.
        values: One, or one for each of the worlds.
        count: How many worlds.

    Returns:
        uint64 (count, width).

    Raises:
        NumberError: The number of values is wrong, a value could not be drawn, or it is one of a free number that its
            mechanic does not take.
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
        found[value] = encode(module, number.number, int(value) if number.kind is int else value).view(np.uint32)
    given: Array = np.array([found[value] for value in keys], np.uint64) | HERE
    return given


def misfits(number: VariedNumber, layout: Any, words: Array) -> Array:
    """Which worlds have words that could not have been drawn: bool (worlds,).

    Args:
        number: The number.
        layout: A Layout that varies it.
        words: int32 (worlds, width), the words of this number.
    """
    module = layout.modules[number.module]
    if number.distribution.kind == FREE:
        values, which = np.unique(np.ascontiguousarray(words).view(number.dtype), axis=0, return_inverse=True)
        fits = np.array([_is_taken(number, layout, tuple(value.tolist())) for value in values], bool)[which.reshape(-1)]
    elif number.distribution.kind == CHOICE:
        known = np.array([encode(module, number.number, value) for value in number.distribution.values])
        fits = (words[:, None] == known).all(2).any(1)
    else:
        values = np.ascontiguousarray(words).view(number.dtype)[:, 0]
        low, high = (number.dtype.type(end) for end in number.distribution.values)
        fits = (low <= values) & (values <= high)
    return ~np.asarray(fits)


def check_taken(number: VariedNumber, layout: Any, value: tuple[float, ...]) -> None:
    """Raise NumberError unless the mechanic takes this value of a free number."""
    layout.modules[number.module].replace(**{number.number: value}).check(layout)


def _is_taken(number: VariedNumber, layout: Any, value: tuple[float, ...]) -> bool:
    """Whether the mechanic takes this value of a free number."""
    try:
        check_taken(number, layout, value)
    except NumberError:
        return False
    return True


def wrongly_given(layout: Any, words: Array) -> str:
    """What is wrong with words of Given from a file, which kernels would use as indices unchecked; "" if nothing is.

    Args:
        layout: A Layout with varied numbers.
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
            return f"the key of random numbers in world {int(wrong.argmax())} is none"
    if (wrong := (words[:, KEY][:, 0] == 1) & (words[:, KEY][:, 3] == 0)).any():
        return f"the key of random numbers in world {int(wrong.argmax())} is of episode 0: the first one is 1"
    return ""


def has_one_each(values: Any) -> bool:
    """Whether these are values for several worlds, one each; a tuple is a single value."""
    return isinstance(values, list) or (not isinstance(values, tuple) and np.ndim(values) > 0)
