"""Checks of a game: does it keep to what its mechanics declare, and is it the same whenever it is played again?

A step trusts declarations, such as the bounds of a field, as checking them would take time. Here random agents play,
and everything that the environment returns is checked.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from outlast.ecs import EngineError
from outlast.ecs.kernels.integers import is_whole

from ..core.validation import Array
from ..core.vector_env import SurvivalVectorEnv
from ..rollout.policies import random_policy
from ..scenarios.parse import resolve
from ..scenarios.scenario import Scenario
from .make import make_vec
from .options import PLAY, option

Moment = dict[str, Array]  # the arrays that a step returns, by name: (worlds, ...)

AS_PYTHON = 20  # steps; Python and machine code may differ in the last bit, and collisions amplify it
CLOSE = 1e-3  # absolute and relative difference up to which numbers differ by rounding only


@dataclass(frozen=True)
class Finding:
    """A problem that `outlast.check` found.

    Attributes:
        check: The name of the check.
        text: What was found, and where.
    """

    check: str
    text: str

    def __str__(self) -> str:
        return f"{self.check}: {self.text}"


def check(
    scenario: Scenario | str,
    *,
    worlds: int = 8,
    steps: int = 300,
    seed: int = 0,
    passed: Callable[[str, str], None] = lambda name, text: None,
) -> list[Finding]:
    """Let random agents play a game of your own, and look for mistakes that raise no error.

    bounds: all observed numbers are within the bounds that fields declare. finite: observations, rewards and statistics
    are finite. again: an environment that has been played repeats itself from `reset(seed=)` on. alone: a world gives
    the same results without the others. state: worlds go on from a saved state as they did before. python: your own
    mechanics do what they declare, and give the same results when run as Python, apart from rounding, in the first 20
    steps.

    Args:
        scenario: A scenario or its name.
        worlds: Number of worlds.
        steps: Ticks to play in each world.
        seed: Seed of all random numbers: the same seed gives the same episodes.
        passed: Called after each check with its name and what was found ("" if nothing).

    Returns:
        The first problem that each check found; [] if all is well.

    Raises:
        ValueError: `steps` is not an integer of at least 1. Otherwise what make_vec raises.
    """
    if not is_whole(steps, 1):
        raise ValueError(f"steps = {steps!r}: an integer of at least 1 is needed")
    game, found = _Game(resolve(scenario), worlds, steps, seed), list[Finding]()
    for name, look in CHECKS.items():
        text = look(game)
        found += [Finding(name, text)] if text else []
        passed(name, text)
    return found


@dataclass(frozen=True)
class CheckOptions:
    """The options of `outlast.check` that are flags."""

    described = check
    worlds: int = option(8, PLAY, metavar="N", least=1)
    steps: int = option(300, PLAY, metavar="N", least=1)
    seed: int = option(0, PLAY, metavar="N", least=0, most=2**64 - 1)


class _Game:
    """A scenario, and what it returned when it was played for the first time."""

    def __init__(self, scenario: Scenario, worlds: int, steps: int, seed: int) -> None:
        self.scenario, self.worlds, self.steps, self.seed = scenario, worlds, steps, seed
        self.env = self.make()
        self.halfway: Any = None
        self.first = [*self.played(self.env)]

    def make(self, worlds: int = 0, first_world: int = 0, interpret: tuple[str, ...] = ()) -> SurvivalVectorEnv:
        count = worlds or self.worlds
        return make_vec(self.scenario, count, seed=self.seed, first_world=first_world, interpret=interpret)

    def played(self, env: SurvivalVectorEnv) -> Iterator[Moment]:
        """Yield what a reset and each step return, and keep the state in the middle."""
        act, (seen, info) = random_policy(env, self.seed), env.reset(seed=self.seed)
        yield _moment(seen, [info])
        for step in range(self.steps):
            if env is self.env and step == self.steps // 2 and self.halfway is None:
                self.halfway = env.get_state()
            seen, *results = env.step(act(seen))
            yield _moment(seen, results)


def _moment(observations: Mapping[str, Array], results: Sequence[Any]) -> Moment:
    """Return the arrays of a step or a reset by name. results: what it returns after the observations."""
    *signals, info = results
    named = dict(zip(("reward", "terminated", "truncated"), signals, strict=False))
    ended = {f"statistics {key}": values for key, values in info.get("statistics", {}).items()}
    return {**observations, **named, **ended}


def _bounds(game: _Game) -> str:
    spaces: Any = game.env.single_observation_space
    for step, moment in enumerate(game.first):
        for key, space in spaces.items():
            wrong = ~((moment[key] >= space.low) & (moment[key] <= space.high))
            if wrong.any():
                place = tuple(np.argwhere(wrong)[0].tolist())
                low, high = space.low[place[1:]], space.high[place[1:]]
                value = moment[key][place]
                return f"{_named(game, key, place, step)} is {value:g}, and {low:g} to {high:g} is declared"
    return ""


def _finite(game: _Game) -> str:
    for step, moment in enumerate(game.first):
        for key, values in moment.items():
            if values.dtype.kind == "f" and not np.isfinite(values).all():
                place = tuple(np.argwhere(~np.isfinite(values))[0].tolist())
                return f"{_named(game, key, place, step)} is {values[place]:g}"
    return ""


def _again(game: _Game) -> str:
    return _difference(game, game.played(game.env), "in the same environment, reset to the same seed,")


def _alone(game: _Game) -> str:
    last = game.worlds - 1
    return _difference(game, game.played(game.make(1, last)), "alone in its environment", worlds=slice(last, None))


def _state(game: _Game) -> str:
    half, act = game.steps // 2, random_policy(game.env, game.seed)
    seen, run = game.env.set_state(game.halfway), list[Moment]()
    for _ in range(half):
        act(seen)  # asked only to be counted: its actions depend on how often it was asked before
    for _ in range(game.steps - half):
        seen, *results = game.env.step(act(seen))
        run.append(_moment(seen, results))
    return _difference(game, iter(run), "played on from a saved state", start=half + 1)


def _python(game: _Game) -> str:
    own = tuple(system.label for system in game.env.worlds.schedule.systems if system.outside)
    if not own:
        return ""
    run = game.played(game.make(interpret=own))
    try:
        found = _difference(game, islice(run, AS_PYTHON + 1), f"with {', '.join(own)} as Python", close=CLOSE)
        return found or "".join("" for _ in run)
    except (EngineError, IndexError) as error:
        return str(error)


CHECKS: dict[str, Callable[[_Game], str]] = {
    each.__name__[1:]: each for each in (_bounds, _finite, _again, _alone, _state, _python)
}


def _difference(
    game: _Game, other: Iterator[Moment], how: str, *, start: int = 0, worlds: slice = slice(None), close: float = 0.0
) -> str:
    """Describe the first number that differs from the first play; "" if none does. start: the first step of `other`."""
    for step, (was, now) in enumerate(zip(game.first[start:], other, strict=False), start):
        for key, values in now.items():
            if key not in was:
                continue
            before = was[key][worlds]
            same = np.isclose(before, values, close, close, equal_nan=True)
            if not same.all():
                place = tuple(np.argwhere(~same)[0].tolist())
                where = _named(game, key, (place[0] + (worlds.start or 0), *place[1:]), step)
                return f"{how} {where} is {values[place]:g}, not {before[place]:g}"
    return ""


def _named(game: _Game, key: str, place: tuple[int, ...], step: int) -> str:
    """Describe a number of a step: "own.stamina of agent 1 in world 3, step 17"."""
    world, *rest = place
    name, fields = key, game.env.fields.get(key, {})
    for field, found in fields.items():
        if rest and found.columns.start <= rest[-1] < found.columns.stop:
            name = f"{key}.{field}"
    agent = f" of agent {rest[0]}" if rest and not key.startswith("statistics") else ""
    row = f", row {rest[1]}" if len(rest) > 2 else ""
    return f"{name}{agent}{row} in world {world}, step {step},"
