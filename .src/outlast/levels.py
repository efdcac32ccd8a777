"""Levels: what one episode of one world is made from, as data to keep, change and play again."""

from .envs.levels import Level, load, save

__all__ = ["Level", "load", "save"]
