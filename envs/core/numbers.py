"""The numbers of a running game: reading and changing them."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from outlast.ecs import Clock, NumberError, Worlds
from outlast.ecs.memory.given import has_one_each
from outlast.ecs.memory.numbers import KEY, NO_LEVELS, ONCE, Given

from ..errors import NotResetError
from ..levels import Level, check_all
from ..scenarios.derivation import by_full_name, numbers
from ..scenarios.scenario import Scenario
from .validation import Array, world_mask


def current_numbers(worlds: Worlds) -> dict[str, Any]:
    """Return all numbers by name; arrays (worlds, ...) if they vary, (worlds, agents) if they differ by role."""
    differ = worlds.numbers() | worlds.agent_numbers()
    if differ and not worlds[Clock].episode.all():
        raise NotResetError("numbers() before reset(): those that differ are of the episodes that worlds are in")
    return numbers(worlds.modules) | differ


def change_numbers(
    scenario: Scenario, worlds: Worlds, asked: Sequence[tuple[str, Any]], mask: Any, refuse: Callable[[], None]
) -> None:
    """Set numbers; see SurvivalVectorEnv.set_numbers. refuse: Raises RecordingError during a recording."""
    where = world_mask("mask", mask, worlds.count)
    full = by_full_name(scenario.find_number, asked)
    varied = {name: _chosen(name, value, where) for name, value in full.items() if name in worlds.layout.varied}
    others = {name: value for name, value in full.items() if name not in varied}
    if others:
        if mask is not None:
            raise NumberError(
                f"{next(iter(others))} is the same in all worlds: leave out the mask, or make the environment of a "
                "scenario in which it varies: scenario.vary(...)"
            )
        refuse()
    with _restored(worlds):
        worlds.give_numbers(varied, where)
        if others:
            worlds.set_numbers(**others)


def copy_changed(source: Worlds, target: Worlds) -> None:
    """Give worlds of the same scenario the numbers that were changed in `source`; those that vary are in its state."""
    own = numbers(source.modules)
    if changed := {name: own[name] for name in source.changed}:
        target.set_numbers(**changed)


def current_levels(worlds: Worlds, mask: Any) -> list[Level]:
    """Return the levels of the worlds' current episodes; see SurvivalVectorEnv.levels."""
    clock, varied = worlds[Clock], worlds.numbers()
    rows = np.flatnonzero(world_mask("mask", mask, worlds.count))
    if not clock.episode[rows].all():
        raise NotResetError("levels() before reset(): they are those of the episodes that worlds are in")
    keys = zip(clock.seed[rows, 0], clock.world[rows, 0], clock.episode[rows, 0], strict=True)
    return [Level({name: values[w] for name, values in varied.items()}, key) for w, key in zip(rows, keys, strict=True)]


def change_levels(worlds: Worlds, levels: Sequence[Level], mask: Any) -> None:
    """Set the levels of the next episodes; see SurvivalVectorEnv.set_levels."""
    rows = np.flatnonzero(world_mask("mask", mask, worlds.count))
    if not worlds.layout.keyed:
        raise NumberError(NO_LEVELS)
    check_all(levels, {name: number.distribution for name, number in worlds.layout.varied.items()})
    if len(levels) not in (1, len(rows)):
        raise NumberError(f"{len(levels)} levels for {len(rows)} worlds: one, or as many, are needed")
    with _restored(worlds):
        waiting = worlds[Given].words[rows]  # drop levels that were set before and not played
        waiting[(waiting >> ONCE) & np.uint64(1) == 1] = 0
        waiting[:, KEY] = 0
        worlds[Given].words[rows] = waiting
        for row, level in zip(rows, levels if len(levels) > 1 else [*levels] * len(rows), strict=True):
            worlds.give_numbers(level.numbers, row, once=True)
            if level.key is not None:
                worlds.give_keys([level.key], row)


@contextlib.contextmanager
def _restored(worlds: Worlds) -> Iterator[None]:
    """Restore the previously given numbers if an exception is raised."""
    before = worlds[Given].words.copy() if Given in worlds else None
    try:
        yield
    except BaseException:
        if before is not None:
            worlds[Given].words[:] = before
        raise


def _chosen(name: str, value: Any, where: Array) -> Any:
    """Return the values of the worlds `where`, if there is one for each world; a single value, or None, unchanged."""
    if not has_one_each(value):
        return value
    if len(value) != len(where):
        raise NumberError(f"{name}: {len(value)} values; give one, or one for each of the {len(where)} worlds")
    return [each for each, chosen in zip(value, where, strict=True) if chosen]
