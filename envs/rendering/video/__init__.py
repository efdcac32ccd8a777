"""Films and folders of pictures: `footage` draws the frames, `writer` writes them, whole or not at all."""

from .writer import write

__all__ = ["write"]
