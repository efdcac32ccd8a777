"""Random numbers against numpy's Philox, the published vectors, and statistics of independent draws."""

import math
from collections.abc import Callable, Iterator

import numba
import numpy as np
import pytest

from outlast.ecs import kernel
from outlast.ecs.kernels import random as philox
from outlast.ecs.kernels.jit import entry_point

COUNT = 4_000 if numba.config.DISABLE_JIT else 400_000
KEY = tuple(np.uint64(number) for number in (7, 3, 1, 200, philox.stream_number("test")))
ONES = 2**64 - 1


@pytest.fixture(autouse=True, scope="module")
def _wrapping() -> Iterator[None]:
    """Uncompiled uint64 arithmetic wraps on purpose."""
    with np.errstate(over="ignore"):
        yield


@kernel
def _many_uniform(key: philox.Key, out: np.ndarray) -> None:
    for i in range(len(out)):
        out[i] = philox.uniform(key, i)


@kernel
def _many_integer(key: philox.Key, bound: int, out: np.ndarray) -> None:
    for i in range(len(out)):
        out[i] = philox.integer(key, i, bound)


@kernel
def _many_normal(key: philox.Key, out: np.ndarray) -> None:
    for i in range(len(out)):
        out[i] = philox.normal(key, i)


def _draw(fill: Callable[..., None], *arguments: object, dtype: type = np.float32) -> np.ndarray:
    out = np.empty(COUNT, dtype)
    fill(*arguments, out)
    return out


def _words(numbers: list[int]) -> list[int]:
    """Philox of (seed, world, episode, tick, stream, index) given as Python integers."""
    key = tuple(np.uint64(number) for number in numbers[:5])
    return [int(word) for word in philox.words(key, np.uint64(numbers[5]))]


def _hex(numbers: list[int]) -> str:
    return " ".join(f"{word:016x}" for word in _words(numbers))


def _numpy_words(seed: int, world: int, episode: int, tick: int, stream: int, index: int) -> list[int]:
    """The same from numpy, whose generator adds one to its counter before it uses it."""
    counter = episode + (tick << 64) + (stream << 128) + (index << 192)
    generator = np.random.Philox(counter=(counter - 1) % 2**256, key=seed + (world << 64))
    return [int(word) for word in generator.random_raw(4)]


def test_words_equal_numpy() -> None:
    numbers = np.random.default_rng(5).integers(0, 2**64, (COUNT // 80, 6), np.uint64)
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
    assert _hex([0] * 6) == "16554d9eca36314c db20fe9d672d0fdc d7e772cee186176b 7e68b68aec7ba23b"
    assert _hex([ONES] * 6) == "87b092c3013fe90b 438c3c67be8d0224 9cc7d7c69cd777b6 a09caebf594f0ba0"
    counter = [0x243F6A8885A308D3, 0x13198A2E03707344, 0xA4093822299F31D0, 0x082EFA98EC4E6C89]
    key = [0x452821E638D01377, 0xBE5466CF34E90C6C]
    assert _hex(key + counter) == "a528f45403e61d95 38c72dbd566e9788 a5a1610e72fd18b5 57bd43b5e52b7fe6"


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


def test_draws_are_float32() -> None:
    if numba.config.DISABLE_JIT:
        assert type(philox.uniform(KEY, 0)) is type(philox.normal(KEY, 0)) is np.float32
        assert type(philox.integer(KEY, 0, 5)) is np.int64
        return
    for draw, arguments, expected in (
        (philox.uniform, (KEY, 0), numba.float32),
        (philox.normal, (KEY, 0), numba.float32),
        (philox.integer, (KEY, 0, 5), numba.int64),
    ):
        draw(*arguments)
        assert {overload.signature.return_type for overload in entry_point(draw.py_func).overloads.values()} == {
            expected
        }


def test_uniform() -> None:
    draws = _draw(_many_uniform, KEY).astype(np.float64)
    assert draws.min() >= 0
    assert draws.max() < 1
    assert draws.mean() == pytest.approx(1 / 2, abs=5 * math.sqrt(1 / 12 / COUNT))
    assert draws.var() == pytest.approx(1 / 12, abs=5 * math.sqrt(1 / 180 / COUNT))
    assert _chi_square(np.floor(draws * 64).astype(int), 64) < _chi_square_limit(64)


def test_uniform_reaches_its_ends_and_never_one() -> None:
    assert float(philox._unit(np.uint64(0))) == 0
    assert float(philox._unit(np.uint64(ONES))) == 1 - 2**-24


@pytest.mark.parametrize("bound", [1, 3, 10, 1000])
def test_integer(bound: int) -> None:
    draws = _draw(_many_integer, KEY, bound, dtype=np.int64)
    assert draws.min() >= 0
    assert draws.max() < bound
    assert _chi_square(draws, bound) <= _chi_square_limit(bound)


def test_normal() -> None:
    draws = _draw(_many_normal, KEY).astype(np.float64)
    assert np.isfinite(draws).all()
    moments = [(draws**power).mean() for power in (1, 2, 3, 4)]
    for moment, expected, variance in zip(moments, (0, 1, 0, 3), (1, 2, 15, 96), strict=True):
        assert moment == pytest.approx(expected, abs=5 * math.sqrt(variance / COUNT))
    for limit in (0.5, 1, 2, 3):
        share = math.erfc(limit / math.sqrt(2))
        slack = 5 * math.sqrt(share * (1 - share) / COUNT)
        assert (abs(draws) > limit).mean() == pytest.approx(share, abs=slack)


def test_stream_numbers_never_change() -> None:
    assert philox.stream_number("placement") == 0x48352199E39040D5
    assert philox.stream_number("zone") == 0xC1602B38309904E8


def test_stream_numbers_differ_and_fit_a_word() -> None:
    numbers = {philox.stream_number(f"stream {n}") for n in range(1000)} | {philox.stream_number("")}
    assert len(numbers) == 1001
    assert all(0 <= number < 2**64 for number in numbers)


def _chi_square(draws: np.ndarray, bound: int) -> float:
    expected = len(draws) / bound
    return float(((np.bincount(draws, minlength=bound) - expected) ** 2 / expected).sum())


def _chi_square_limit(bound: int) -> float:
    """Mean and five standard deviations; keys are fixed, so this either always passes or never."""
    freedom = bound - 1
    return freedom + 5 * math.sqrt(2 * freedom)
