"""Messages from a page: short JSON texts, validated before they reach the game."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...errors import MessageError
from ...storage import strict_json

LONGEST = 512  # bytes of a message: more than the longest valid one
STEER = "steer"  # the command by which a page takes over
COMMANDS = ("begin", "pause", "resume", "restart", STEER)
SPEEDS = (0.25, 0.5, 1, 2, 4)

Choices = Mapping[str, int]


@dataclass(frozen=True)
class SteerMessage:
    """Keys. held: actions in every tick from now on. tapped: actions in the next tick only. Others are 0."""

    held: Choices
    tapped: Choices


@dataclass(frozen=True)
class Command:
    """One of COMMANDS."""

    name: str


@dataclass(frozen=True)
class Speed:
    """One of SPEEDS: how many times as fast as usual."""

    times: float


Message = SteerMessage | Command | Speed


def parse(text: Any, ranges: Mapping[str, tuple[int, int]]) -> Message:
    """Return the message in `text`: {"held": {name: value}, "tapped": {...}}, {"command": name} or {"speed": times}.

    ranges: the lowest and highest value of each action by its name. Raises MessageError for everything else.
    """
    content = _loaded(text)
    if content.keys() == {"held", "tapped"}:
        return SteerMessage(*(_choices(content[key], ranges) for key in ("held", "tapped")))
    if content.keys() == {"command"} and content["command"] in COMMANDS:
        return Command(content["command"])
    if content.keys() == {"speed"} and type(content["speed"]) in (int, float) and content["speed"] in SPEEDS:
        return Speed(content["speed"])
    raise MessageError('held and tapped, a known command, or a known speed is needed, as in {"command": "pause"}')


def _loaded(text: Any) -> dict[str, Any]:
    if not isinstance(text, str):
        raise MessageError("messages are text, not bytes")
    try:
        content = json.loads(text)
    except strict_json.BROKEN:
        raise MessageError("messages are JSON") from None
    if not isinstance(content, dict):
        raise MessageError("messages are JSON objects")
    return content


def _choices(given: Any, ranges: Mapping[str, tuple[int, int]]) -> Choices:
    if not isinstance(given, dict) or given.keys() - ranges.keys():
        raise MessageError(f"held and tapped name actions: {', '.join(ranges)}"[:123])
    for name, value in given.items():
        low, high = ranges[name]
        if type(value) is not int or not low <= value <= high:
            raise MessageError(f"{name} is an integer from {low} to {high}"[:123])
    return dict(given)
