"""Random numbers against numpy's Philox, the published vectors, and plain Python."""

import math
from collections.abc import Iterator

import numba
import numpy as np
import pytest

from outlast.ecs.kernels import random as philox

COUNT = 50 if numba.config.DISABLE_JIT else 5_000
KEY = tuple(np.uint64(number) for number in (7, 3, 1, 200, philox.stream_number("test")))
ONES = 2**64 - 1


@pytest.fixture(autouse=True, scope="module")
def _wrapping() -> Iterator[None]:
    """Uncompiled uint64 arithmetic wraps on purpose."""
    with np.errstate(over="ignore"):
        yield


def _words(numbers: list[int]) -> list[int]:
    """Philox of (seed, world, episode, tick, stream, index) given as Python integers."""
    key = tuple(np.uint64(number) for number in numbers[:5])
    return [int(word) for word in philox.words(key, np.uint64(numbers[5]))]


def _numpy_words(seed: int, world: int, episode: int, tick: int, stream: int, index: int) -> list[int]:
    """The same from numpy, whose generator adds one to its counter before it uses it."""
    counter = episode + (tick << 64) + (stream << 128) + (index << 192)
    generator = np.random.Philox(counter=(counter - 1) % 2**256, key=seed + (world << 64))
    return [int(word) for word in generator.random_raw(4)]


def test_words_equal_numpy() -> None:
    numbers = np.random.default_rng(5).integers(0, 2**64, (COUNT, 6), np.uint64)
    for row in numbers.tolist():
        assert _words(row) == _numpy_words(*row)


@pytest.mark.parametrize("field", range(6))
@pytest.mark.parametrize("value", [0, 1, 2**32 - 1, 2**32, 2**63, ONES])
def test_words_equal_numpy_at_the_edges(field: int, value: int) -> None:
    for rest in (0, ONES):
        row = [rest] * 6
        row[field] = value
        assert _words(row) == _numpy_words(*row)


def test_words_equal_published_vectors() -> None:
    """philox4x64-10 of Random123's kat_vectors; there the order is counter, then key."""
    counter = [0x243F6A8885A308D3, 0x13198A2E03707344, 0xA4093822299F31D0, 0x082EFA98EC4E6C89]
    key = [0x452821E638D01377, 0xBE5466CF34E90C6C]
    for numbers, expected in (
        ([0] * 6, "16554d9eca36314c db20fe9d672d0fdc d7e772cee186176b 7e68b68aec7ba23b"),
        ([ONES] * 6, "87b092c3013fe90b 438c3c67be8d0224 9cc7d7c69cd777b6 a09caebf594f0ba0"),
        (key + counter, "a528f45403e61d95 38c72dbd566e9788 a5a1610e72fd18b5 57bd43b5e52b7fe6"),
    ):
        assert " ".join(f"{word:016x}" for word in _words(numbers)) == expected


def test_draws_follow_their_words() -> None:
    """Every draw from plain Python integers: also what makes compiled and uncompiled agree."""
    for index in range(200):
        first, second, _, _ = (int(word) for word in philox.words(KEY, index))
        assert float(philox.uniform(KEY, index)) == (first >> 40) / 2**24
        assert philox.uniform2(KEY, index) == ((first >> 40) / 2**24, (second >> 40) / 2**24)
        for bound in (1, 2, 3, 1000, 2**32 + 1, 2**63 - 1):
            assert int(philox.integer(KEY, index, bound)) == first * bound >> 64
        distance, turn = ((first >> 11) + 1) / 2**53, (second >> 11) / 2**53
        expected = math.sqrt(-2 * math.log(distance)) * math.cos(2 * math.pi * turn)
        assert float(philox.normal(KEY, index)) == pytest.approx(expected, rel=1e-6)
    assert (float(philox._unit(np.uint64(0))), float(philox._unit(np.uint64(ONES)))) == (0, 1 - 2**-24)


def test_stream_numbers_never_change() -> None:
    assert philox.stream_number("placement") == 0x48352199E39040D5
    assert philox.stream_number("zone") == 0xC1602B38309904E8
