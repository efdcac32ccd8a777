"""Numbers of the game that change while agents train: --anneal rewards_kill=10:0@5e6."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

from outlast.envs.scenarios.scenario import Scenario

from .errors import TrainingError

NEEDED = "NUMBER=FROM:TO or NUMBER=FROM:TO@STEPS is needed, as in rewards_kill=10:0@5e6"


@dataclass(frozen=True)
class Anneal:
    """A number of the game that changes linearly over the first agent-steps of a run and then keeps its last value.

    Attributes:
        name: Name of the number in Scenario.replace.
        first: Value at the beginning.
        last: Value at the end.
        steps: Agent-steps that the change takes; 0: the length of the run.
    """

    name: str
    first: float
    last: float
    steps: int = 0

    def __str__(self) -> str:
        return f"{self.name}={self.first!r}:{self.last!r}@{self.steps}"

    def value(self, done: int, scenario: Scenario) -> float:
        """Return the value after `done` agent-steps, rounded if the scenario has an integer there."""
        share = min(1.0, done / max(1, self.steps))  # a run of 0 steps stays at its first value
        value = (1 - share) * self.first + share * self.last
        return round(value) if type(kept(scenario, self.name)) is int else value

    def check(self, scenario: Scenario) -> None:
        """Check that the number can change in the scenario. Raises NumberError or TrainingError."""
        if isinstance(now := kept(scenario, self.name), (bool, str, tuple)):
            raise TrainingError(f"{self.name} is {now!r}: only a single number can be annealed; change it by --set")
        if "_".join(scenario.find_number(self.name)) in dict(scenario.varied):
            raise TrainingError(
                f"{self.name} varies from world to world; annealing sets one value for all: use one of the two"
            )
        for end in (self.first, self.last):
            scenario.replace(**{self.name: int(end) if type(now) is int and end == int(end) else end})


def kept(scenario: Scenario, name: str) -> object:
    """Return the value of a number in the scenario. Raises NumberError if it has no such number."""
    return scenario.numbers()["_".join(scenario.find_number(name))]


def parse_anneal(texts: Iterable[str]) -> tuple[Anneal, ...]:
    """Parse texts like "rewards_kill=10:0@5e6". Raises TrainingError, also if a number occurs twice."""
    found: dict[str, Anneal] = {}
    for text in texts:
        if not (match := re.fullmatch(r"(\w+)=([^:@]+):([^:@]+)(?:@([^:@]+))?", text.strip())):
            raise TrainingError(f"--anneal {text}: {NEEDED}")
        name, *ends, steps = match.groups()
        if name in found:
            raise TrainingError(f"--anneal {text}: {name} is given twice")
        try:
            first, last, length = float(ends[0]), float(ends[1]), float(steps or 0)
        except ValueError:
            raise TrainingError(f"--anneal {text}: {NEEDED}") from None
        if not math.isfinite(first + last + length) or length != int(length) or (steps and length < 1):
            raise TrainingError(f"--anneal {text}: numbers must be finite, and STEPS an integer of at least 1")
        found[name] = Anneal(name, first, last, int(length))
    return tuple(found.values())
