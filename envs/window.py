"""A window on the screen that shows frames, through pygame."""

from typing import Any

import numpy as np

try:
    import pygame  # type: ignore[import-not-found,unused-ignore]
except ImportError as error:
    raise ImportError("render_mode='human' needs pygame: pip install pygame") from error


class Window:
    """Opens with the first frame, and holds the caller up to `fps` frames a second."""

    def __init__(self, title: str, fps: int) -> None:
        self.title, self.fps = title, fps
        self.clock = pygame.time.Clock()
        self.surface: Any = None

    def show(self, frame: np.ndarray[Any, Any]) -> None:
        """Show `frame`, uint8 (height, width, 3)."""
        if self.surface is None:
            pygame.display.init()
            self.surface = pygame.display.set_mode(frame.shape[1::-1])
            pygame.display.set_caption(self.title)
        pygame.surfarray.blit_array(self.surface, frame.swapaxes(0, 1))
        pygame.event.pump()  # or the system takes the window for dead
        pygame.display.flip()
        self.clock.tick(self.fps)

    def close(self) -> None:
        """Take it off the screen."""
        if self.surface is not None:
            pygame.display.quit()
        self.surface = None
