"""Recordings as web pages that need no network."""

from .write import write_page

__all__ = ["write_page"]
