"""Pictures of environments in notebooks. The first picture loads OpenCV."""

from typing import Any

import numpy as np


class Pictured:
    """An environment that a notebook's cell shows as a picture of its first world, if the cell ends with it.

    A base class of SurvivalVectorEnv and of the adapters, which have that as `base_env`, TorchRL's as `vector_env`.
    """

    def _repr_png_(self) -> bytes | None:
        """Return world 0 as a PNG of 512 x 512 pixels; None, so that text is shown, if closed or not yet reset."""
        from .rgb import draw

        env: Any = getattr(self, "base_env", None) or getattr(self, "vector_env", None) or self
        return None if env.closed or not env._tracker.running[0] else png(draw(env.worlds, 0))


def png(image: np.ndarray[Any, Any]) -> bytes:
    """Return an RGB picture, uint8 (height, width, 3), as the bytes of a PNG file."""
    import cv2

    done, encoded = cv2.imencode(".png", image[..., ::-1])
    if not done:
        raise ValueError(f"a picture of {image.shape} cannot be a PNG")
    return bytes(encoded)
