"""outlast: thousands of 2-D multi-agent survival worlds, advanced together.

>>> import outlast
>>> env = outlast.make_vec("ffa_3", 1024, seed=0)
>>> observations, info = env.reset()
"""

from importlib import import_module
from typing import Any

from .envs.adapters.gymnasium_registry import register as register_gymnasium
from .envs.adapters.pettingzoo_registry import register as register_pettingzoo
from .envs.core.make import make_vec
from .envs.scenarios.ablations import FIXES
from .envs.scenarios.scenario import Scenario, ScenarioError
from .envs.scenarios.variants import ALIASES, VARIANTS, variant

__version__ = "0.1.0"
__all__ = ["ALIASES", "FIXES", "VARIANTS", "Scenario", "ScenarioError", "make_vec", "variant"]

_LAZY: dict[str, str] = {  # names whose modules need a library that is loaded when they are first asked for
    "Recording": "envs.recording",
    "Replay": "envs.recording",
    "aec_env": "envs.adapters.pettingzoo",
    "load_policy": "training.player",
    "make_agents": "envs.adapters.gymnasium_agents",
    "make_puffer": "envs.adapters.puffer",
    "make_sb3": "envs.adapters.sb3",
    "parallel_env": "envs.adapters.pettingzoo",
    "record": "envs.recording",
    "SurvivalMultiAgentEnv": "envs.adapters.rllib",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f".{_LAZY[name]}", __name__), name)
    raise AttributeError(f"module 'outlast' has no attribute '{name}'")


register_gymnasium()
register_pettingzoo()
