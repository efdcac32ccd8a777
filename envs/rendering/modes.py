"""Render modes of environments, and what they return."""

from typing import Any

from gymnasium.logger import warn

from outlast.ecs import Worlds

from .rgb import draw, text

RENDER_MODES = ("rgb_array", "ansi")
FPS = 30


def render_world(worlds: Worlds, w: int, render_mode: str) -> Any:
    """Draw world `w` as a picture ("rgb_array", uint8 (512, 512, 3)) or as a map of characters ("ansi", str)."""
    return draw(worlds, w) if render_mode == "rgb_array" else text(worlds, w)


def render_worlds(worlds: Worlds, render_mode: str | None) -> tuple[Any, ...] | None:
    """Draw a frame of each world; None without a mode."""
    if render_mode is None:
        warn(f"render() draws nothing without a render_mode; make the environment with one of {RENDER_MODES}")
        return None
    return tuple(render_world(worlds, w, render_mode) for w in range(worlds.count))
