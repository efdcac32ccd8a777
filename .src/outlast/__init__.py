"""outlast: thousands of 2-D multi-agent survival worlds, advanced together.

>>> import outlast
>>> env = outlast.make_vec("ffa_3", 1024, seed=0)
>>> observations, info = env.reset()
"""

from importlib import import_module
from typing import Any

from .envs.faces.register import register as register_gymnasium
from .envs.faces.zoo import register as register_pettingzoo
from .envs.fixes import FIXES
from .envs.make import make_vec
from .envs.scenario import Scenario, ScenarioError
from .envs.variants import ALIASES, VARIANTS, variant

__version__ = "0.1.0"
__all__ = ["ALIASES", "FIXES", "VARIANTS", "Scenario", "ScenarioError", "make_vec", "variant"]

_LAZY: dict[str, str] = {  # names whose modules need a library that is loaded when they are first asked for
    "Recording": "envs.recording",
    "Replay": "envs.recording",
    "aec_env": "envs.faces.parallel",
    "load_policy": "training.player",
    "make_agents": "envs.faces.agents",
    "make_puffer": "envs.faces.puffer",
    "make_sb3": "envs.faces.sb3",
    "parallel_env": "envs.faces.parallel",
    "SurvivalMultiAgentEnv": "envs.faces.rllib",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f".{_LAZY[name]}", __name__), name)
    raise AttributeError(f"module 'outlast' has no attribute '{name}'")


register_gymnasium()
register_pettingzoo()
