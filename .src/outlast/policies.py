"""Policies that are written by hand: functions of an environment that return one of observations to actions.

>>> act = outlast.policies.scripted_policy(env, seed=0)
"""

from .envs.rollout.policies import (
    camper_policy,
    healer_policy,
    hoarder_policy,
    hunter_policy,
    noop_policy,
    random_policy,
    scripted_policy,
)

__all__ = [
    "camper_policy",
    "healer_policy",
    "hoarder_policy",
    "hunter_policy",
    "noop_policy",
    "random_policy",
    "scripted_policy",
]
