"""Pages: recordings as web pages that need no network, and the parts that they are made of."""

from .assets import DRAWING, assemble
from .write import write

__all__ = ["DRAWING", "assemble", "write"]
