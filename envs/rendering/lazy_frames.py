"""Pictures of many worlds, each drawn only if somebody looks at it."""

from collections.abc import Callable, Sequence
from typing import Any

from gymnasium.logger import warn

from outlast.ecs import Worlds

RENDER_MODES = ("rgb_array", "ansi")
FPS = 30


class Frames(Sequence[Any]):
    """What an environment of `count` sub-environments, `each` of them in a world, renders.

    draw(w) is called when a frame of world w is first read. fresh() says whether the worlds are still as they were; if
    not, reading a frame that has not been drawn is a RuntimeError, as it would show a later tick.
    """

    def __init__(self, draw: Callable[[int], Any], count: int, each: int, fresh: Callable[[], bool]) -> None:
        self._draw, self._count, self._each, self._fresh = draw, count, each, fresh
        self._drawn: dict[int, Any] = {}

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Any:
        which = range(self._count)[index]
        if isinstance(which, range):
            return [self._frame(k // self._each) for k in which]
        return self._frame(which // self._each)

    def _frame(self, w: int) -> Any:
        if w not in self._drawn:
            if not self._fresh():
                raise RuntimeError(
                    "frames are drawn when they are read, and the environment has moved on since render(); "
                    "list(env.render()) draws all of them at once"
                )
            self._drawn[w] = self._draw(w)
        return self._drawn[w]


class Painter:
    """Draws worlds as a render_mode says: "rgb_array", "ansi", or None for nothing.

    moved() is to be called whenever the worlds have changed: frames that were not read by then are gone.
    """

    def __init__(self, worlds: Worlds, render_mode: str | None) -> None:
        self._worlds, self._mode, self._moves = worlds, render_mode, 0

    def moved(self) -> None:
        """The worlds have changed."""
        self._moves += 1

    def frames(self, count: int, each: int = 1) -> Frames | None:
        """A frame for each of `count` sub-environments, `each` of them in a world; None without a mode."""
        if self._mode is None:
            warn(f"render() draws nothing without a render_mode; make the environment with one of {RENDER_MODES}")
            return None
        paint, moves = painter(self._mode), self._moves
        return Frames(lambda w: paint(self._worlds, w), count, each, lambda: self._moves == moves)


def painter(render_mode: str) -> Callable[[Worlds, int], Any]:
    """The function that draws a world in that mode."""
    from .rgb import draw, text  # here, as OpenCV takes longer to load than everything else

    return draw if render_mode == "rgb_array" else text
