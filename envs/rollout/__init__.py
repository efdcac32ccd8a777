"""Rollouts: policies play whole episodes in many worlds, here or on a Ray cluster, and summaries are made of them."""

from .local import rollout
from .policies import (
    Policy,
    camper_policy,
    healer_policy,
    hoarder_policy,
    hunter_policy,
    noop_policy,
    random_policy,
    scripted_policy,
)
from .summary import Summary

__all__ = [
    "Policy",
    "Summary",
    "camper_policy",
    "healer_policy",
    "hoarder_policy",
    "hunter_policy",
    "noop_policy",
    "random_policy",
    "rollout",
    "scripted_policy",
]
