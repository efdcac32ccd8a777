"""Draws of numbers that differ from world to world, and the entities that are absent if a count is not the highest."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..declarations.component import Observation, Signal
from ..declarations.distributions import CHOICE, FREE, INTEGERS, LOG_UNIFORM
from ..kernels.errors import AbsentError
from ..kernels.jit import Array, kernel
from ..kernels.random import integer, stream_number, words
from .given import GIVEN, ONCE, WORD
from .varied import VariedNumber, encode

ABSENT = np.int64(-1)  # the identity of an entity that is not in this episode
TO_53_BITS, ULP_53 = np.uint64(11), np.float64(2.0**-53)


@dataclass(frozen=True)
class Plan:
    """The arrays by which `draw` draws the numbers of one world.

    Attributes:
        kinds: int8 (numbers,), kinds of distributions; a free number is a choice with one option.
        real: int8 (numbers,), 1 if words are float32.
        spans: int32 (numbers, 2), the first word, and how many there are.
        streams: uint64 (numbers,), streams of random numbers: those of the numbers' names.
        ends: float64 (numbers, 2), lowest and highest value; 0 for choices.
        choices: int32 (words,), the words of all choices in a row.
        options: int32 (numbers, 2), where a number's choices begin, and how many there are.
        patches: int32 (patches, 3), for prefab values: the word, its place in the state, and its size there in bytes,
            1 or 4.
        absences: int32 (archetypes, 3), for counts: the word, the first row of the entities and one after the last.
    """

    kinds: Array
    real: Array
    spans: Array
    streams: Array
    ends: Array
    choices: Array
    options: Array
    patches: Array
    absences: Array


def plan(layout: Any) -> Plan:
    """Return the arrays for `draw`, for a Layout. Raises the errors of `varied.patches`."""
    numbers, choices, options = list(layout.varied.values()), list[int](), list[tuple[int, int]]()
    for number in numbers:
        values = number.distribution.values if number.distribution.kind in (CHOICE, FREE) else ()
        options.append((len(choices), len(values)))
        for value in values:
            choices += encode(layout.modules[number.module], number.number, value).tolist()
    absences = [
        (number.start, layout.spans[name].start, layout.spans[name].stop)
        for number in numbers
        for name in number.archetypes
    ]
    kinds = [CHOICE if number.distribution.kind == FREE else number.distribution.kind for number in numbers]
    ends = [
        (0, 0) if kind == CHOICE else number.distribution.values for kind, number in zip(kinds, numbers, strict=True)
    ]
    return Plan(
        kinds=np.array(kinds, np.int8),
        real=np.array([number.dtype.kind == "f" for number in numbers], np.int8),
        spans=np.array([(number.start, number.width) for number in numbers], np.int32).reshape(-1, 2),
        streams=np.array([stream_number(f"vary {number.name}") for number in numbers], np.uint64),
        ends=np.array(ends, np.float64).reshape(-1, 2),
        choices=np.array(choices or [0], np.int32),
        options=np.array(options, np.int32).reshape(-1, 2),
        patches=np.array(layout.varied_patches, np.int32).reshape(-1, 3),
        absences=np.array(absences, np.int32).reshape(-1, 3),
    )


@kernel
def between(kind: int, low: float, high: float, key: Any) -> float:
    """Draw a float64 between two ends."""
    if kind == INTEGERS:
        return low + np.float64(integer(key, 0, int(high) - int(low) + 1))
    unit = np.float64(words(key, 0)[0] >> TO_53_BITS) * ULP_53
    if kind == LOG_UNIFORM:
        return min(max(math.exp(math.log(low) + unit * (math.log(high) - math.log(low))), low), high)
    return low + unit * (high - low)


@kernel
def draw_between(values: Any, reals: Any, word: int, real: bool, kind: int, low: float, high: float, key: Any) -> None:
    """Draw a word between two ends: in `values`, as int32, or, if it is `real`, in `reals`, as float32."""
    if real:
        reals[word] = np.float32(between(kind, low, high, key))
    else:
        values[word] = np.int32(between(kind, low, high, key))


@kernel
def take_key(clock: Any, given: Any, start: int) -> None:
    """Key the random numbers of an episode by a given key, or by the world's own, which goes on counting meanwhile.

    given: the world's column of Given. start: where the keys are in it.
    """
    own = start + 4
    if given[own] != 0:
        clock.seed[0], clock.world[0], clock.episode[0] = given[own + 1], given[own + 2], given[own + 3] + np.uint64(1)
        given[own] = given[own + 1] = given[own + 2] = given[own + 3] = 0
    if given[start] != 0:
        given[own], given[own + 1], given[own + 2], given[own + 3] = 1, clock.seed[0], clock.world[0], clock.episode[0]
        clock.seed[0], clock.world[0], clock.episode[0] = given[start + 1], given[start + 2], given[start + 3]
        given[start] = given[start + 1] = given[start + 2] = given[start + 3] = 0


@kernel
def draw(
    clock: Any,
    entities: Any,
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
    absences: Any,
) -> None:
    """Set the numbers of a world whose episode begins, and the prefab values set by these numbers.

    given: its column of Given. values, reals: its words of Varied, as int32 and as float32. state, state_bytes: its
    whole state, as int32 and as uint8. kinds and all that follow: see Plan.
    """
    take_key(clock, given, values.size)
    for n in range(kinds.size):
        start, width = spans[n, 0], spans[n, 1]
        if given[start] >> GIVEN:
            for k in range(start, start + width):
                values[k] = np.int32(np.uint32(given[k] & WORD))
                if given[k] >> ONCE:
                    given[k] = 0
            continue
        key = (clock.seed[0], clock.world[0], clock.episode[0], np.uint64(0), streams[n])
        if kinds[n] == CHOICE:
            first = options[n, 0] + width * integer(key, 0, options[n, 1])
            for k in range(width):
                values[start + k] = choices[first + k]
        else:
            draw_between(values, reals, start, real[n], kinds[n], ends[n, 0], ends[n, 1], key)
    for p in range(patches.shape[0]):
        word, where = values[patches[p, 0]], patches[p, 1]
        if patches[p, 2] == 4:
            state[where >> 2] = word
        else:
            state_bytes[where] = np.uint8(word)
    for a in range(absences.shape[0]):
        for e in range(absences[a, 1] + values[absences[a, 0]], absences[a, 2]):
            entities.alive[e], entities.identity[e] = 0, ABSENT


@kernel
def exists(entities: Any, e: int) -> bool:
    """Whether row `e` is an entity of this episode, alive or not. False if a varied count leaves it out."""
    return bool(entities.identity[e] != ABSENT)


@kernel
def check_absent(entities: Any) -> None:
    """AbsentError if an entity is alive that is not in this episode."""
    for e in range(entities.alive.size):
        if entities.alive[e] and not exists(entities, e):
            raise AbsentError(
                "an entity is alive that this episode leaves out, as its number varies and is smaller here; "
                "pass over rows for which exists(entities, e) is False"
            )


def published_rows(layout: Any) -> list[tuple[VariedNumber, Any, str]]:
    """Return what has a row for learners per entity of a varied count: the number, the component and the column."""
    return [
        (number, component, name)
        for number in layout.varied.values()
        for component in layout.components
        if issubclass(component, (Observation, Signal))
        for name, column in component.columns.items()
        if column.dims[:1] and column.dims[0] in number.dims
    ]


@kernel
def show(rows: Any, words: Any, reals: Any, shown: Any) -> None:
    """Fill the rows of NumbersView.

    rows: float32 (agents, n). words, reals: those of Varied, as int32 and as float32. shown: int32 (n, 2), for each
    column its word, and whether it is a float32.
    """
    for i in range(rows.shape[0]):
        for k in range(shown.shape[0]):
            rows[i, k] = reals[shown[k, 0]] if shown[k, 1] else np.float32(words[shown[k, 0]])


def shown(layout: Any) -> Array:
    """Return the argument `shown` of `show`, int32 (n, 2)."""
    numbers = [layout.varied[name] for name in layout.fields["numbers"]]
    words = [(number.start + k, number.dtype.kind == "f") for number in numbers for k in range(number.width)]
    return np.array(words, np.int32)


@kernel
def clear_rows(rows: Any, count: Any) -> None:
    """Clear the rows of absent agents, who observe nothing and get no rewards.

    rows: float32 (most, n), contiguous. count: int32 (1,), how many agents are there.
    """
    for i in range(count[0], rows.shape[0]):
        for k in range(rows.shape[1]):
            rows[i, k] = 0
