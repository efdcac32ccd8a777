"""Counter-based random numbers: every draw is a pure function of seed, world, episode, tick, stream and index.

Philox4x64-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC11; Random123). There is no
generator state to seed, share or advance, so worlds may run in any order and on any number of threads, and
a game from which one mechanic (one stream) is removed has the same draws in all others.

A `Key` is the tuple of uint64 (seed, world, episode, tick, stream); an `index`, 0 <= index < 2**63, numbers
the draws under one key. Philox gets (seed, world) as its key and (episode, tick, stream, index) as its
counter. Each function below uses the same four words of one (key, index): two draws need two indices.
Products and sums overflow on purpose: call uncompiled functions under np.errstate(over="ignore").
"""

import hashlib
import math

import numpy as np

from .jit import Real, kernel

Key = tuple[np.uint64, np.uint64, np.uint64, np.uint64, np.uint64]
Words = tuple[np.uint64, np.uint64, np.uint64, np.uint64]

MULTIPLIER_0 = np.uint64(0xD2E7470EE14C6C93)
MULTIPLIER_1 = np.uint64(0xCA5A826395121157)
WEYL_0 = np.uint64(0x9E3779B97F4A7C15)  # golden ratio
WEYL_1 = np.uint64(0xBB67AE8584CAA73B)  # sqrt(3) - 1
ROUNDS = 10  # the count of the published test vectors and of numpy

LOW = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)
TO_24_BITS = np.uint64(40)
TO_53_BITS = np.uint64(11)
ULP_24 = np.float32(2.0**-24)
ULP_53 = np.float64(2.0**-53)
NORMAL = 8.6  # no `normal` is farther from 0


def stream_number(name: str) -> int:
    """Return the stream of `name`: its 64-bit blake2b hash, the same in every process, version and platform."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")


@kernel
def high_product(a: np.uint64, b: np.uint64) -> np.uint64:
    """Return the upper 64 bits of the 128-bit product a * b."""
    a_low, a_high = a & LOW, a >> HALF
    b_low, b_high = b & LOW, b >> HALF
    cross = a_high * b_low + (a_low * b_low >> HALF)
    other = a_low * b_high + (cross & LOW)
    return a_high * b_high + (cross >> HALF) + (other >> HALF)


@kernel
def words(key: Key, index: int) -> Words:
    """Return four independent uniform uint64: Philox4x64-10 of (key, index)."""
    k0, k1, c0, c1, c2 = key
    c3 = np.uint64(index)
    for _ in range(ROUNDS):
        high_0, low_0 = high_product(MULTIPLIER_0, c0), MULTIPLIER_0 * c0
        high_1, low_1 = high_product(MULTIPLIER_1, c2), MULTIPLIER_1 * c2
        c0, c1, c2, c3 = high_1 ^ c1 ^ k0, low_1, high_0 ^ c3 ^ k1, low_0
        k0, k1 = k0 + WEYL_0, k1 + WEYL_1
    return c0, c1, c2, c3


@kernel
def _unit(word: np.uint64) -> Real:
    """Return a float32 in [0, 1) from the upper 24 bits: each multiple of 2**-24 is equally likely, and exact."""
    return np.float32(word >> TO_24_BITS) * ULP_24


@kernel
def uniform(key: Key, index: int) -> Real:
    """Draw a uniform float32 in [0, 1), a multiple of 2**-24; from word 0."""
    return _unit(words(key, index)[0])


@kernel
def uniform2(key: Key, index: int) -> tuple[Real, Real]:
    """Draw two independent uniform float32 in [0, 1) from one call of Philox: words 0 and 1."""
    first, second, _, _ = words(key, index)
    return _unit(first), _unit(second)


@kernel
def integer(key: Key, index: int, bound: int) -> np.int64:
    """Draw a uniform int64 in [0, bound), 1 <= bound < 2**63: the upper half of word 0 times bound.

    No rejection, so the cost is constant; a value's probability differs from 1 / bound by less than 2**-64, a relative
    error of bound * 2**-64.
    """
    return np.int64(high_product(words(key, index)[0], np.uint64(bound)))


@kernel
def normal(key: Key, index: int) -> Real:
    """Draw a standard normal float32 (Box-Muller on words 0 and 1); |value| < NORMAL: the logarithm gets 53 bits.

    It is computed in float64 and rounded once. Compiled and uncompiled code call the same libm; a difference in the
    last bit between the libms of two machines changes a result only about once in 2**28 draws.
    """
    first, second, _, _ = words(key, index)
    distance = np.float64((first >> TO_53_BITS) + np.uint64(1)) * ULP_53  # (0, 1]: its logarithm is finite
    turn = np.float64(second >> TO_53_BITS) * ULP_53
    return np.float32(math.sqrt(-2.0 * math.log(distance)) * math.cos(2.0 * math.pi * turn))
