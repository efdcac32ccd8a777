"""outlast: thousands of 2-D multi-agent survival worlds, advanced together.

>>> import outlast
>>> env = outlast.make_vec("ffa_3", 1024, seed=0)
>>> observations, info = env.reset()
"""

from .envs.make import make_vec
from .envs.scenario import Scenario, ScenarioError
from .envs.variants import ALIASES, VARIANTS, variant

__version__ = "0.1.0"
__all__ = ["ALIASES", "VARIANTS", "Scenario", "ScenarioError", "make_vec", "variant"]
