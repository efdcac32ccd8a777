"""Policies as users give them: by name, by the path of a saved one, or as a function."""

import contextlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..core.make import make_vec
from ..core.vector_env import SurvivalVectorEnv
from ..scenarios.scenario import Scenario
from .policies import POLICIES, Policy
from .saved import common_scenario, load_saved


def load_policies(names: Sequence[str | Policy], asked: Scenario, seed: int) -> tuple[Scenario, list[str | Policy]]:
    """Load saved policies, and find the scenario with observations that all policies can play with.

    Args:
        names: Names of policies, paths of saved ones, or functions.
        asked: The scenario.
        seed: Seed of all policies; each draws its own random numbers.

    Returns:
        The scenario, and the names, in which the loaded policies replace paths.

    Raises:
        UsageError: A policy cannot play there, or PyTorch is not installed.
    """
    chosen = loaded(names, seed)
    players: list[Any] = [each for each in chosen if hasattr(each, "scenario")]
    fitting = common_scenario(asked, players)
    if players:
        with contextlib.closing(make_vec(fitting, 1, seed=seed)) as env:
            for player in players:
                player.check(env)
    return fitting, chosen


def loaded(names: Sequence[str | Policy], seed: int) -> list[str | Policy]:
    """Return the names and functions, with loaded policies in place of their files' paths. Raises UsageError."""
    seeds = [seed, *(int(np.random.SeedSequence([seed, k]).generate_state(1)[0]) for k in range(1, len(names)))]
    return [
        load_saved(name, own) if isinstance(name, str) and name not in POLICIES else name
        for name, own in zip(names, seeds, strict=True)
    ]


def maker(chosen: str | Policy) -> Callable[[SurvivalVectorEnv, int], Policy]:
    """Return a function that makes the policy for an environment and a seed, as in POLICIES, or returns `chosen`."""
    return POLICIES[chosen] if isinstance(chosen, str) else lambda env, seed: chosen
