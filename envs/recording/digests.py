"""Digests: sixteen bits for each component, which change if any of its bytes is different in any of the worlds.

A component consists of words of four bytes. Each word is multiplied by an odd number that belongs to the world, and
summed over the worlds. These sums are mixed, each is multiplied by an odd number that belongs to the word, and they are
summed up; finally the upper and lower half are combined. A word that differs in one world always changes the last sum;
combining the halves hides that in one of 2**16 cases.
"""

import hashlib

import numpy as np

from outlast.ecs import Component, Signal, Worlds

from ..core.validation import Array

WORLDS_PER_DIGEST = 64  # maximum; the worlds of larger batches take turns
SIGN_WORLDS = 8  # worlds whose upper halves of words a digest also sums, in turn
SHIFT = np.uint32(15)


class Digests:
    """Digests of the state of `worlds` and of its signals, without observations, which follow from the state.

    names: the components, in the order of a digest. turns: the digest of tick t covers the worlds `span(t)`, and all
    worlds have had a turn after this many ticks. period: ticks until a digest is made in the same way again.
    """

    def __init__(self, worlds: Worlds, worlds_per_digest: int = WORLDS_PER_DIGEST) -> None:
        self._count, self._size = worlds.count, worlds_per_digest
        self.turns = -(-worlds.count // worlds_per_digest)
        self._sign_turns = -(-min(worlds.count, worlds_per_digest) // SIGN_WORLDS)
        self.period = self.turns * self._sign_turns
        kinds = [c for c in worlds.components if c.packed or issubclass(c, Signal)]
        self._block = worlds.block.view(np.uint32)
        uniform, owners, self._shared, self._masks, sharers = _words(worlds, kinds)
        signals = [(k, _rows(a)) for k, c in enumerate(kinds) if not c.packed for a in worlds[c]]
        self._signals = [rows for _, rows in signals]
        owners = np.concatenate([owners, sharers, *(np.full(rows.shape[1], k) for k, rows in signals)])
        self._order = np.argsort(owners, kind="stable")
        found, self._starts = np.unique(owners[self._order], return_index=True)
        self.names = [kinds[k].__name__ for k in found]
        factors = _odd(len(owners), 1)
        factors[: len(uniform)][~uniform] = 0
        self._factors, self._weights = factors[self._order], _odd(worlds.count, 2)
        self._sign_weights = _odd(worlds.count, 3)
        self._sums = np.zeros(len(owners), np.uint32)

    def span(self, tick: int) -> slice:
        """Return the worlds that the digest of this tick covers."""
        start = tick % self.turns * self._size
        return slice(start, min(start + self._size, self._count))

    def compute(self, tick: int) -> Array:
        """Return the digest after the tick of this number: uint16 (components,)."""
        span = self.span(tick)
        self._add(span, tick // self.turns % self._sign_turns)
        words = self._sums[self._order]
        words ^= words >> SHIFT
        words *= self._factors
        totals: Array = np.add.reduceat(words, self._starts)
        return (totals ^ totals >> np.uint32(16)).astype(np.uint16)

    def _add(self, span: slice, turn: int) -> None:
        """Sum every word over these worlds.

        Of the topmost bits of words, which are the signs of numbers, a sum only shows whether their count is odd or
        even. So some worlds, in turn, also add their words' upper bits.
        """
        block, weights = self._block[span], self._weights[span]
        sums = self._sums[: block.shape[1]]
        np.einsum("wk,w->k", block, weights, out=sums)
        some = slice(turn * SIGN_WORLDS, turn * SIGN_WORLDS + SIGN_WORLDS)
        sums += np.einsum("wk,w->k", block[some] >> SHIFT, self._sign_weights[span][some])
        parts = [block[:, self._shared] & self._masks, *(rows[span] for rows in self._signals)]
        np.einsum("wk,w->k", np.concatenate(parts, 1), weights, out=self._sums[block.shape[1] :])


def _words(worlds: Worlds, kinds: list[type[Component]]) -> tuple[Array, Array, Array, Array, Array]:
    """Return the components to which the words of a world's block belong.

    For each word: whether it belongs to one component only, and to which. Then, for each component of each word that
    belongs to several: number of the word, mask of the component's bits, component.
    """
    owner = np.full(worlds.layout.world_bytes, -1)
    for place in worlds.layout.places:
        if place.offset >= 0:
            owner[place.offset : place.offset + place.nbytes] = kinds.index(place.component)
    fours = owner.reshape(-1, 4)
    owners = fours.max(1)
    uniform = ((fours == owners[:, None]) | (fours < 0)).all(1)
    parts = [(k, c) for k in np.flatnonzero(~uniform) for c in np.unique(fours[k]) if c >= 0]
    masks = [(np.where(fours[k] == c, 0xFF, 0) << np.arange(0, 32, 8)).sum() for k, c in parts]
    numbers, shares = (np.array([part[axis] for part in parts], np.intp) for axis in (0, 1))
    return uniform, np.maximum(owners, 0), numbers, np.array(masks, np.uint32), shares


def _rows(array: Array) -> Array:
    """Return a column's bytes as words, or as single bytes if four do not divide them: a row for each world."""
    rows = array.reshape(len(array), -1)
    return rows.view(np.uint32 if rows.shape[1] * rows.itemsize % 4 == 0 else np.uint8)


def _odd(count: int, stream: int) -> Array:
    """Return odd random numbers, uint32 (count,), which are the same in every call."""
    words = np.frombuffer(hashlib.shake_128(b"%d" % stream).digest(4 * count), "<u4")
    return words.astype(np.uint32) | np.uint32(1)
