"""Ctrl-C wherever Python looks for signals."""

import sys
from types import FrameType
from typing import Any


def interrupt_after(events: int) -> None:
    """Raise KeyboardInterrupt in this thread after `events` returns from calls; sys.setprofile(None) prevents it."""
    left = events

    def profile(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal left
        if event in ("return", "c_return"):
            left -= 1
            if left < 0:
                sys.setprofile(None)
                raise KeyboardInterrupt

    sys.setprofile(profile)
