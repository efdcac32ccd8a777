"""Recordings as web pages that need no network."""

from .write import replay_page, write_page

__all__ = ["replay_page", "write_page"]
