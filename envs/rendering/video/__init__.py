"""Films and folders of pictures: `footage` draws the frames, `write_film` writes them, completely or not at all."""

from .footage import footage
from .writer import write_film

__all__ = ["footage", "write_film"]
