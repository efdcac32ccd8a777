"""The start of a tick and of an episode: clocks, first values, keys, draws, roles, absent entities."""

import math
from typing import Any, NamedTuple

import numpy as np

from ..declarations.component import Component, Observation, Signal
from ..declarations.distributions import CHOICE, FREE, INTEGERS, LOG_UNIFORM
from ..declarations.event import clear
from ..declarations.roles import ANYONE, NEVER
from ..kernels.errors import AbsentError, NumberError
from ..kernels.jit import Array, kernel
from ..kernels.random import integer, stream_number, words
from .can_differ import patches
from .layout import MemoryLayout
from .numbers import GIVEN, ONCE, WORD, Number, encode

SKIP, STEP, RESET = 0, 1, 2  # modes of a world in a tick
EPISODE, TICK, CLOCK_SIZE = 2, 3, 4  # two words of the Clock, and its size in words; a world's state begins with it
ABSENT = np.int64(-1)  # the identity of an entity that is not in this episode
TO_53_BITS, ULP_53 = np.uint64(11), np.float64(2.0**-53)
STREAM = stream_number("roles")


class Plan(NamedTuple):
    """The arrays for drawing the numbers of worlds, or of agents. A set has the distributions of a role.

    Attributes:
        rows: int32 (entities,), the rows of the agents; 0 for worlds.
        real: int8 (numbers,), 1 if words are float32.
        spans: int32 (numbers, 2), the first word, and the number of words.
        streams: uint64 (numbers,), streams of random numbers.
        kinds: int8 (numbers, sets), kinds of distributions; a single value is a choice with one option.
        ends: float64 (numbers, sets, 2), lowest and highest value; 0 for choices.
        choices: int32 (words,), the words of all choices in a row.
        options: int32 (numbers, sets, 2), first word of the choices, and their number.
        patches: int32 (patches, 3), for prefab values: the word, its place in the state, and its size in bytes, 1 or 4.
    """

    rows: Array
    real: Array
    spans: Array
    streams: Array
    kinds: Array
    ends: Array
    choices: Array
    options: Array
    patches: Array


def plan(layout: MemoryLayout, by_role: bool) -> Plan:
    """Return the arrays for the numbers of worlds, or for those that differ by role.

    Raises:
        NumberError: See `can_differ.patches`.
    """
    numbers = [*(layout.per_agent if by_role else layout.varied).values()]
    shape = len(numbers), len(layout.roles.roles) if by_role and layout.roles else 1
    kinds, ends, options = np.zeros(shape, np.int8), np.zeros((*shape, 2)), np.zeros((*shape, 2), np.int32)
    choices = list[int]()
    for n, number in enumerate(numbers):
        for r, drawn in enumerate(number.distributions):
            kinds[n, r] = CHOICE if drawn.kind == FREE else drawn.kind
            if kinds[n, r] == CHOICE:
                options[n, r] = len(choices), len(drawn.values)
                for value in drawn.values:
                    choices += encode(layout.modules[number.module], number.field, value).tolist()
            else:
                ends[n, r] = drawn.values
    prefix = "role" if by_role else "vary"
    return Plan(
        rows=np.array(layout.agents if by_role else [0], np.int32),
        real=np.array([number.dtype.kind == "f" for number in numbers], np.int8),
        spans=np.array([(number.start, number.width) for number in numbers], np.int32).reshape(-1, 2),
        streams=np.array([stream_number(f"{prefix} {number.name}") for number in numbers], np.uint64),
        kinds=kinds,
        ends=ends,
        choices=np.array(choices or [0], np.int32),
        options=options,
        patches=np.array(patches(layout, by_role), np.int32).reshape(-1, 3),
    )


def absences(layout: MemoryLayout) -> Array:
    """Return int32 (kinds, 3), for varied counts: the word, the first row of the entities and one after the last."""
    spans = [(n.start, layout.spans[kind]) for n in layout.varied.values() for kind in n.kinds]
    return np.array([(word, span.start, span.stop) for word, span in spans], np.int32).reshape(-1, 3)


class RolePlan(NamedTuple):
    """The arrays for the roles of agents.

    Attributes:
        fixed: int32 (counts, agents), the role of each agent before drawing, in worlds with the fewest agents, with one
            more and so on.
        groups: int32 (counts, groups + 1), starts of the groups of agents within which roles are drawn; 1 entry without
            groups.
    """

    fixed: Array
    groups: Array


def role_plan(layout: MemoryLayout) -> RolePlan:
    """Return the arrays for `assign`, for a layout with roles.

    Raises:
        NumberError: Roles are drawn by side without sides, or the sizes of sides differ between worlds.
    """
    assert layout.roles is not None
    counts = layout.agent_counts
    fixed = np.array(layout.roles.of_counts(counts[0], counts[-1]), np.int32)
    return RolePlan(fixed, np.array([_groups(layout, layout.roles.drawn, count) for count in counts], np.int32))


def _groups(layout: MemoryLayout, drawn: str, count: int) -> list[int]:
    """Return a row of RolePlan.groups, for worlds with `count` agents."""
    if drawn == NEVER:
        return [0]
    sizes = {(count,)} if drawn == ANYONE else layout.groupings(count)
    if sizes == {()}:
        raise NumberError('roles: drawn = "side", but agents are not in teams; add Teams, or take "anyone"')
    if len(sizes) > 1:
        raise NumberError('roles: drawn = "side", but the sizes of teams vary; let one of them be, or take "anyone"')
    starts: list[int] = np.minimum(np.cumsum([0, *sizes.pop()]), count).tolist()
    return starts


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
def take_key(clock: Any, given: Any, start: int) -> None:
    """Set the key of an episode's random numbers: a given one, or the world's own, whose count continues.

    given: the world's column of Given. start: index of the keys.
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
def draw(clock: Any, roles: Any, values: Any, reals: Any, plan: Any) -> None:
    """Draw numbers, keyed by the index of the agent (0 for worlds) in place of the tick.

    roles: int32 (agents,), the set of each. values, reals: the words, as int32 and as float32.
    """
    for n in range(plan.streams.size):
        width = plan.spans[n, 1]
        for i in range(plan.rows.size):
            r, word = roles[i], plan.spans[n, 0] + plan.rows[i]
            key = (clock.seed[0], clock.world[0], clock.episode[0], np.uint64(i), plan.streams[n])
            if plan.kinds[n, r] == CHOICE:
                first = plan.options[n, r, 0] + width * integer(key, 0, plan.options[n, r, 1])
                for k in range(width):
                    values[word + k] = plan.choices[first + k]
            elif plan.real[n]:
                reals[word] = np.float32(between(plan.kinds[n, r], plan.ends[n, r, 0], plan.ends[n, r, 1], key))
            else:
                values[word] = np.int32(between(plan.kinds[n, r], plan.ends[n, r, 0], plan.ends[n, r, 1], key))


@kernel
def patch(state: Any, state_bytes: Any, values: Any, patches: Any) -> None:
    """Write numbers into their prefab values. state, state_bytes: a world, as int32 and as uint8."""
    for p in range(patches.shape[0]):
        word, where = values[patches[p, 0]], patches[p, 1]
        if patches[p, 2] == 4:
            state[where >> 2] = word
        else:
            state_bytes[where] = np.uint8(word)


@kernel
def draw_of_world(
    clock: Any, entities: Any, given: Any, values: Any, reals: Any, state: Any, state_bytes: Any, plan: Any, absent: Any
) -> None:
    """Set the numbers of a world whose episode begins, and the values that depend on them.

    given: its column of Given. values, reals: its words of Varied, as int32 and as float32. state, state_bytes: its
    state, as int32 and as uint8. absent: see `absences`.
    """
    take_key(clock, given, values.size)
    draw(clock, plan.rows, values, reals, plan)  # the only row, 0, is also the index of the only set
    for k in range(values.size):
        if given[k] >> GIVEN:
            values[k] = np.int32(np.uint32(given[k] & WORD))
            if given[k] >> ONCE:
                given[k] = 0
    patch(state, state_bytes, values, plan.patches)
    for a in range(absent.shape[0]):
        for e in range(absent[a, 1] + values[absent[a, 0]], absent[a, 2]):
            entities.alive[e], entities.identity[e] = 0, ABSENT


@kernel
def assign(clock: Any, entities: Any, roles: Any, rows: Any, plan: Any) -> None:
    """Set the roles of the agents of a world whose episode begins. rows: their rows; the last agents may be absent."""
    key = (clock.seed[0], clock.world[0], clock.episode[0], np.uint64(0), np.uint64(STREAM))
    present = 0
    for e in rows:
        present += exists(entities, e)
    c = present - (rows.size - plan.fixed.shape[0] + 1)
    for i in range(rows.size):
        roles[i] = plan.fixed[c, i]
    for g in range(plan.groups.shape[1] - 1):
        for i in range(plan.groups[c, g + 1] - 1, plan.groups[c, g], -1):  # Fisher-Yates shuffle
            o = plan.groups[c, g] + integer(key, i, i - plan.groups[c, g] + 1)
            roles[i], roles[o] = roles[o], roles[i]


@kernel
def draw_of_agents(
    clock: Any,
    entities: Any,
    roles: Any,
    values: Any,
    reals: Any,
    state: Any,
    state_bytes: Any,
    plan: Any,
    role_plan: Any,
) -> None:
    """Set roles and numbers of the agents of a world whose episode begins, and their prefab values.

    roles: the column of AgentRoles. values, reals: the words of AgentNumbers, as int32 and as float32.
    """
    assign(clock, entities, roles, plan.rows, role_plan)
    draw(clock, roles, values, reals, plan)
    patch(state, state_bytes, values, plan.patches)


@kernel
def exists(entities: Any, e: int) -> bool:
    """Return whether row `e` is an entity of this episode, alive or not. False if a varied count leaves it out."""
    return bool(entities.identity[e] != ABSENT)


@kernel
def check_absent(entities: Any) -> None:
    """Raise AbsentError if an entity is alive that is not in this episode."""
    for e in range(entities.alive.size):
        if entities.alive[e] and not exists(entities, e):
            raise AbsentError(
                "an entity is alive that this episode leaves out, since its number varies and is smaller here; "
                "skip rows for which exists(entities, e) is False"
            )


def published_rows(layout: MemoryLayout) -> list[tuple[Number, type[Component], str]]:
    """Return the columns for learners with rows per entity of a varied count: the number, component and column."""
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


def shown(layout: MemoryLayout) -> Array:
    """Return the argument `shown` of `show`, int32 (n, 2)."""
    numbers = [layout.varied[name] for name in layout.fields["numbers"]]
    words = [(number.start + k, number.dtype.kind == "f") for number in numbers for k in range(number.width)]
    return np.array(words, np.int32)


@kernel
def clear_rows(rows: Any, count: Any) -> None:
    """Clear the rows of absent agents, which get no observations and rewards.

    rows: float32 (most, n), contiguous. count: int32 (1,), the number of agents.
    """
    for i in range(count[0], rows.shape[0]):
        for k in range(rows.shape[1]):
            rows[i, k] = 0


@kernel
def advance_clock(world: Any, initial_image: Any, event_counts: Any, mode: int, kept: int) -> None:
    """Count a tick, or start an episode, and clear the events of the previous tick.

    world: the world's state as uint64, like initial_image. event_counts: see ecs.event.clear. kept: number of words
    at the beginning of the state that outlast an episode.
    """
    clear(event_counts)
    if mode == RESET:
        world[EPISODE] += np.uint64(1)
        world[TICK] = np.uint64(0)
        load_initial_state(world, initial_image, kept)
    else:
        world[TICK] += np.uint64(1)


@kernel
def load_initial_state(world: Any, initial_image: Any, kept: int) -> None:
    """Set the state, except the words that are kept, to the start of an episode."""
    for k in range(kept, initial_image.size):
        world[k] = initial_image[k]


@kernel
def zero(rows: Any) -> None:
    """Set all entries of some arrays to 0."""
    for row in rows:
        for k in range(row.size):
            row[k] = 0
