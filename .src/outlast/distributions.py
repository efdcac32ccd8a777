"""What numbers of a game can be drawn from, for `Scenario.vary` and `outlast.role`.

>>> scenario = outlast.variant("ffa_3").vary(melee_damage=outlast.distributions.integers(5, 20))
"""

from .ecs.declarations.distributions import choice, free, integers, log_uniform, uniform

__all__ = ["choice", "free", "integers", "log_uniform", "uniform"]
