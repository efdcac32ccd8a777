"""Making environments from a variant's name or a scenario."""

from typing import Any

from ..errors import ScenarioError
from ..scenarios.scenario import Scenario
from ..scenarios.variants import variant
from .vector_env import SurvivalVectorEnv


def make_vec(scenario: str | Scenario, num_worlds: int, **options: Any) -> SurvivalVectorEnv:
    """A batch of `num_worlds` worlds of a variant or scenario.

    >>> env = outlast.make_vec("teams_3", 4096, seed=0, threads=2)

    options: seed, threads, autoreset, copy, check_actions, first_world, render_mode; see SurvivalVectorEnv. Raises
    ScenarioError for an unknown variant, and NumberError or ScheduleError for a scenario that cannot be.
    """
    if isinstance(scenario, str):
        scenario = variant(scenario)
    if not isinstance(scenario, Scenario):
        raise ScenarioError(f"{scenario!r}: the name of a variant or a Scenario is needed")
    return SurvivalVectorEnv(scenario, num_worlds, **options)
