"""Mechanics of a line, for tests of what may be declared, and a duel to try them in."""

import linecache
from collections.abc import Mapping
from typing import Any

import numpy as np

import outlast
from outlast.ecs import Module

DUEL = outlast.variant("ffa_1")


def kind(name: str, /, *bases: type, **members: Any) -> Any:
    """Return a class of mechanics; members that are no functions become methods that return them."""
    made = {key: value if callable(value) else lambda self, value=value: value for key, value in members.items()}
    return type(name, bases or (Module,), made)


def mechanic(name: str, /, *bases: type, **members: Any) -> Any:
    """Return a mechanic of such a class."""
    return kind(name, *bases, **members)()


def taking(name: str = "act", /, **hints: Any) -> Any:
    """Return a function with these annotated parameters, which does nothing."""
    names: dict[str, Any] = {"__name__": __name__}
    exec(f"def {name}({', '.join(hints)}): ...", names)
    names[name].__annotations__ = {**hints, "return": None}
    return names[name]


def written(source: str, names: Mapping[str, Any], file: str = "mine.py") -> Any:
    """Return the function that a source defines, as if it were in a file, where checks find it."""
    linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
    exec(compile(source, file, "exec"), defined := {**names, "__name__": __name__})
    return defined[source.partition("def ")[2].partition("(")[0]]


def duel(*mechanics: Module, game: outlast.Scenario = DUEL, count: int = 1, **options: Any) -> Any:
    """Return an environment of a game with these mechanics, reset."""
    env = outlast.make_vec(game.with_(*mechanics), count, seed=0, **options)
    env.reset()
    return env


def idle(env: Any) -> Any:
    """Return actions that do nothing."""
    return np.tile(env.noop, (env.num_envs, env.num_agents, 1))
