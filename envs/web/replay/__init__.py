"""Recordings as web pages that need no network."""

from .from_recordings import replay_page
from .write import write_page

__all__ = ["replay_page", "write_page"]
