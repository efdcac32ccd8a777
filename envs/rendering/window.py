"""A window on the screen that shows frames, through pygame."""

from importlib import import_module
from typing import Any

import numpy as np

from ..errors import needed


class Window:
    """A window that opens with the first frame and shows at most `fps` frames per second. Needs pygame: ImportError."""

    def __init__(self, fps: int) -> None:
        with needed("window", "a window needs pygame"):
            self.pygame: Any = import_module("pygame")  # imported here, as pygame is optional
        self.fps = fps
        self.clock = self.pygame.time.Clock()
        self.surface: Any = None

    def show(self, frame: np.ndarray[Any, Any]) -> None:
        """Show `frame`, uint8 (height, width, 3)."""
        if self.surface is None:
            self.pygame.display.init()
            self.surface = self.pygame.display.set_mode(frame.shape[1::-1])
            self.pygame.display.set_caption("outlast")
        self.pygame.surfarray.blit_array(self.surface, frame.swapaxes(0, 1))
        self.pygame.event.pump()  # otherwise the system takes the window for dead
        self.pygame.display.flip()
        self.clock.tick(self.fps)

    def close(self) -> None:
        """Close the window. Closing it again does no harm."""
        if self.surface is not None:
            self.pygame.display.quit()
        self.surface = None
