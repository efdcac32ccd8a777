"""outlast: thousands of 2-D multi-agent survival worlds, advanced together.

>>> import outlast
>>> env = outlast.make_vec("ffa_3", 1024, seed=0)
>>> observations, info = env.reset()

The names in `__all__` are public, and docs/api.md describes them; everything else may change between versions.
"""

from importlib import import_module
from typing import TYPE_CHECKING, NoReturn

from . import components, ecs, errors, systems
from .ecs.declarations.distributions import choice, free, integers, log_uniform, uniform
from .ecs.declarations.roles import role
from .envs.adapters.registry import register as _register
from .envs.api.make import make_vec
from .envs.core.scaling import scaled
from .envs.core.vector_env import SurvivalVectorEnv
from .envs.errors import install as _install
from .envs.scenarios.ablations import ABLATIONS
from .envs.scenarios.scenario import Scenario
from .envs.scenarios.variants import ALIASES, VARIANTS, variant
from .envs.snapshots.state import State
from .errors import ScenarioError

if TYPE_CHECKING:
    from . import drawing
    from .envs import levels
    from .envs.adapters.gymnasium_agents import make_agents
    from .envs.adapters.pettingzoo import aec_env, parallel_env
    from .envs.adapters.puffer import make_puffer
    from .envs.adapters.rllib import SurvivalMultiAgentEnv
    from .envs.adapters.sb3 import make_sb3
    from .envs.adapters.torchrl import make_torchrl
    from .envs.api.check import check
    from .envs.api.film import film
    from .envs.api.play import play
    from .envs.api.rollout import rollout
    from .envs.levels import Level
    from .envs.recording import Recording, Replay, record
    from .envs.rendering.rgb import draw
    from .envs.rollout.policies import (
        camper_policy,
        healer_policy,
        hoarder_policy,
        hunter_policy,
        noop_policy,
        random_policy,
        scripted_policy,
    )
    from .envs.scenarios.floor_plan import FloorPlan
    from .envs.web.replay import replay_page
    from .training.arena.evaluation import evaluate
    from .training.plots.plot import plot
    from .training.policies.player import load_policy
    from .training.runs.train import train

__version__ = "0.2.0"
__all__ = [
    "ABLATIONS",
    "ALIASES",
    "VARIANTS",
    "FloorPlan",
    "Level",
    "Recording",
    "Replay",
    "Scenario",
    "ScenarioError",
    "State",
    "SurvivalMultiAgentEnv",
    "SurvivalVectorEnv",
    "aec_env",
    "camper_policy",
    "check",
    "choice",
    "components",
    "draw",
    "drawing",
    "ecs",
    "errors",
    "evaluate",
    "film",
    "free",
    "healer_policy",
    "hoarder_policy",
    "hunter_policy",
    "integers",
    "levels",
    "load_policy",
    "log_uniform",
    "make_agents",
    "make_puffer",
    "make_sb3",
    "make_torchrl",
    "make_vec",
    "noop_policy",
    "parallel_env",
    "play",
    "plot",
    "random_policy",
    "record",
    "replay_page",
    "role",
    "rollout",
    "scaled",
    "scripted_policy",
    "systems",
    "train",
    "uniform",
    "variant",
]

_LAZY = {  # names whose modules, or the libraries they need, are loaded when they are first asked for
    "FloorPlan": "envs.scenarios.floor_plan",
    "Recording": "envs.recording",
    "Replay": "envs.recording",
    "Level": "envs.levels",
    "SurvivalMultiAgentEnv": "envs.adapters.rllib",
    "aec_env": "envs.adapters.pettingzoo",
    "camper_policy": "envs.rollout.policies",
    "check": "envs.api.check",
    "draw": "envs.rendering.rgb",
    "evaluate": "training.arena.evaluation",
    "film": "envs.api.film",
    "healer_policy": "envs.rollout.policies",
    "hoarder_policy": "envs.rollout.policies",
    "hunter_policy": "envs.rollout.policies",
    "load_policy": "training.policies.player",
    "make_agents": "envs.adapters.gymnasium_agents",
    "make_puffer": "envs.adapters.puffer",
    "make_sb3": "envs.adapters.sb3",
    "make_torchrl": "envs.adapters.torchrl",
    "noop_policy": "envs.rollout.policies",
    "parallel_env": "envs.adapters.pettingzoo",
    "play": "envs.api.play",
    "plot": "training.plots.plot",
    "random_policy": "envs.rollout.policies",
    "record": "envs.recording",
    "replay_page": "envs.web.replay",
    "rollout": "envs.api.rollout",
    "scripted_policy": "envs.rollout.policies",
    "train": "training.runs.train",
}


if not TYPE_CHECKING:  # or checkers would take every misspelt name for one that exists

    def __getattr__(name: str) -> object:
        if name in ("drawing", "levels"):
            return import_module(f".{name}", __name__)
        if name in _LAZY:
            try:
                return getattr(import_module(f".{_LAZY[name]}", __name__), name)
            except ModuleNotFoundError as error:
                return _Missing(name, error)
        raise AttributeError(f"module 'outlast' has no attribute '{name}'")


class _Missing:
    """A public name whose library is not installed: an error when it is called, or a class is derived from it.

    As an attribute it is there, since `hasattr`, `from outlast import *` and tools that list members stop at errors.
    """

    def __init__(self, name: str, error: ModuleNotFoundError) -> None:
        self.__name__, self._error, self.__doc__ = name, error, str(error)
        if _LAZY[name].startswith("training.") and "pip install" not in str(error):
            self.__doc__ = f"outlast.{name} needs {error.name}: {_install('train')}"

    def __call__(self, *args: object, **kwargs: object) -> NoReturn:
        raise ModuleNotFoundError(self.__doc__, name=self._error.name) from self._error

    __mro_entries__ = __call__

    def __repr__(self) -> str:
        return f"<{self.__doc__}>"


def __dir__() -> list[str]:
    """Return the public names, whatever is installed."""
    return [*__all__, "__version__"]


_register()
