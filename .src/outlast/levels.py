"""Levels: what one episode of one world is made from, as data to keep, change and play again; and floor plans."""

from .envs.levels import Level, load, save
from .envs.scenarios.floor_plan import FloorPlan

__all__ = ["FloorPlan", "Level", "load", "save"]
