"""Levels: all that one episode of one world is made from, as data that can be kept, changed and played again.

A level has values of the numbers that vary in its scenario (see Scenario.vary), which may include the floor plan, and
the key of its random numbers, from which drawn walls and roles, start places and everything else follow. Environments
return the levels that they are playing, and accept others for their next episodes.
"""

import contextlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from outlast.ecs import NumberError
from outlast.ecs.declarations.distributions import FREE, Distribution, in_python
from outlast.ecs.memory.given import check_taken

from .errors import ScenarioError
from .scenarios.derivation import in_full
from .scenarios.parse import resolve
from .scenarios.scenario import Scenario
from .storage import inputs
from .storage.inputs import read_text
from .storage.outputs import atomic_write

VERSION = 1
KEYS, LEVEL_KEYS = ("version", "varied", "levels"), ("numbers", "key")
MOST = 2**64  # seeds and numbers of worlds and episodes are below it


@dataclass(frozen=True)
class Level:
    """The level of one episode.

    >>> level = env.levels()[0]
    >>> env.set_levels([level.mutated(scenario, rng) for _ in range(env.num_worlds)])

    Attributes:
        numbers: Values of varied numbers, by full name ("melee_damage"): a number, a bool, a text or a tuple; numbers
            and arrays of NumPy are converted. Numbers that are left out are drawn.
        key: (seed, world, episode), the key of the random numbers; episodes count from 1. None: the key of the world
            that plays the level.

    Raises:
        NumberError: `numbers` is not a dict, or `key` is not a valid key.
    """

    numbers: Mapping[str, Any] = field(default_factory=dict)
    key: tuple[int, int, int] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.numbers, Mapping):
            raise NumberError(f"numbers = {self.numbers!r:.60}: values by name are needed, as a dict")
        object.__setattr__(self, "numbers", {str(name): in_python(value) for name, value in self.numbers.items()})
        key: Any = in_python(self.key)
        if key is None:
            return
        valid = type(key) is tuple and len(key) == 3 and all(type(each) is int and 0 <= each < MOST for each in key)
        if not (valid and key[2]):  # episode 0 means that a world has not begun
            raise NumberError(f"key = {self.key!r}: seed, world and episode are needed, from 0, 0 and 1 to 2**64 - 1")
        object.__setattr__(self, "key", key)

    def __hash__(self) -> int:
        return hash((frozenset(self.numbers.items()), self.key))

    def mutated(
        self, scenario: Scenario | str, rng: np.random.Generator, count: int = 1, rekey: bool = False
    ) -> "Level":
        """Return a level like this one, with some numbers drawn anew.

        Args:
            scenario: The scenario that varies the numbers, or its name.
            rng: Generator that chooses the numbers, and draws their values.
            count: How many numbers to draw; if fewer vary, all. Free ones (distributions.free) stay as they are.
            rekey: Whether to draw another key, too, for other start places and other luck.

        Raises:
            NumberError: `count` is not an integer from 0, `rng` is not a Generator, the scenario does not vary one of
                the level's numbers, or one has a value that could not be drawn.
        """
        if not isinstance(rng, np.random.Generator):
            raise NumberError(f"rng = {rng!r:.60}: a generator is needed, as np.random.default_rng(0)")
        if type(count) is bool or not hasattr(count, "__index__") or count < 0:
            raise NumberError(f"count = {count!r}: an integer >= 0 is needed")
        varied = dict(resolve(scenario).varied)
        check(self, varied)
        able = sorted(name for name, distribution in varied.items() if distribution.kind != FREE)
        chosen: list[str] = rng.permutation(able).tolist()[:count]
        drawn = {name: varied[name].sample(rng) for name in chosen}
        key = (int(rng.integers(MOST - 1, dtype=np.uint64)), 0, 1) if rekey else self.key
        return Level({**self.numbers, **drawn}, key)


def save(path: str | os.PathLike[str], scenario: Scenario | str, levels: Iterable[Level]) -> None:
    """Write levels to a JSON file, completely or not at all.

    Args:
        path: The file; an existing one is replaced.
        scenario: The scenario of the levels, or its name; the file has its varied numbers.
        levels: The levels.

    Raises:
        NumberError: A level has a number that the scenario does not vary, or a value that could not be drawn; nothing
            is written.
        OSError: The file cannot be written.
    """
    scenario, listed = resolve(scenario), levels if isinstance(levels, Level) else list(levels)
    _check_playable(listed, scenario)
    content = {
        "version": VERSION,
        "varied": {name: repr(distribution) for name, distribution in scenario.varied},
        "levels": encoded(listed),
    }
    with atomic_write(Path(path)) as place:
        place.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def load(path: str | os.PathLike[str], scenario: Scenario | str) -> list[Level]:
    """Read levels that `save` wrote.

    Args:
        path: The file.
        scenario: The scenario to play them in, or its name; it must be able to draw each of their numbers.

    Raises:
        ScenarioError: The file holds no levels, or is of another version.
        NumberError: A level has a number that the scenario does not vary, or a value that could not be drawn.
        OSError: The file cannot be read.
    """
    scenario = resolve(scenario)
    try:
        content = inputs.parse_json(read_text(path))
        inputs.check_version(content, VERSION)
        inputs.check_keys(content, KEYS)
        varied = content["varied"]
        if not isinstance(content["levels"], list):
            raise ScenarioError("its levels are not a list")
        if not isinstance(varied, dict) or not all(isinstance(text, str) for text in varied.values()):
            raise ScenarioError("what varied is not given as texts by name")
        for each in content["levels"]:
            inputs.check_keys(each, LEVEL_KEYS)
        found = decoded(content["levels"])
    except inputs.BROKEN_JSON as error:
        raise ScenarioError(f"{path} is not a file of levels: {error}") from None
    try:
        _check_playable(found, scenario)
    except NumberError as error:
        now = {name: repr(distribution) for name, distribution in scenario.varied}
        then = ", ".join(f"{name}={text}" for name, text in varied.items() if now.get(name) != text)
        more = f"; in the scenario that it was saved for, {then:.200} varied" if then else ""
        raise NumberError(f"{path}: {error}{more}") from None
    return found


def encoded(levels: Iterable[Level]) -> list[dict[str, Any]]:
    """Return levels as JSON has them."""
    return [{"numbers": dict(each.numbers), "key": each.key} for each in levels]


def decoded(entries: Iterable[Any]) -> list[Level]:
    """Return levels out of what `encoded` returned. KeyError, TypeError, ValueError or AttributeError for all else."""
    return [Level(each["numbers"], each["key"]) for each in entries]


def check_all(levels: Any, varied: Mapping[str, Distribution]) -> None:
    """NumberError, which names the first that is wrong, unless all are levels that fit these distributions."""
    if isinstance(levels, (Level, str)) or not isinstance(levels, Sequence):
        raise NumberError(f"levels = {levels!r:.200}: a list of outlast.levels.Level is needed")
    for k, level in enumerate(levels):
        if not isinstance(level, Level):
            raise NumberError(f"level {k} is {level!r:.200}: an outlast.levels.Level is needed")
        with _named(k):
            check(level, varied)


def check_free(levels: Sequence[Level], layout: Any) -> None:
    """NumberError, which names the first that is wrong, unless the mechanics take the free numbers of these levels.

    layout: an ecs.memory.layout.MemoryLayout that varies them. `check_all` has found nothing else.
    """
    for k, level in enumerate(levels):
        for name, value in level.numbers.items():
            if (number := layout.varied[name]).distribution.kind == FREE:
                with _named(k):
                    check_taken(number, layout, value)


@contextlib.contextmanager
def _named(k: int) -> Iterator[None]:
    """Put the number of a level before errors."""
    try:
        yield
    except NumberError as error:
        raise NumberError(f"level {k}: {error}") from None


def _check_playable(levels: Any, scenario: Scenario) -> None:
    """Do `check_all` and, if any number is free, `check_free`."""
    check_all(levels, dict(scenario.varied))
    if any(distribution.kind == FREE for _, distribution in scenario.varied):
        check_free(levels, scenario.worlds(1).layout)


def check(level: Level, varied: Mapping[str, Distribution]) -> None:
    """Raise NumberError unless the level's numbers are some that could be drawn from these distributions."""
    names = ", ".join(varied) or "none"
    for name, value in level.numbers.items():
        if name not in varied:
            known = f"take its full name, {full}" if (full := in_full(name)) in varied else f"these do: {names}"
            raise NumberError(f"{name} does not vary here; {known}")
        varied[name].check(name, value)
