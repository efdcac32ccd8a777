"""Messages from a page: short JSON texts, validated before they reach the game."""

import json
from collections.abc import Mapping
from typing import Any

from ...errors import MessageError
from ...storage import strict_json

LONGEST = 512  # bytes of a message: more than the longest valid one
STEER = "steer"  # the command by which a page takes over
COMMANDS = ("begin", "pause", "resume", "restart", STEER)
SPEEDS = (0.25, 0.5, 1, 2, 4)


def parse(text: Any, ranges: Mapping[str, tuple[int, int]]) -> dict[str, Any]:
    """Return the message in `text`: {"held": {name: value}, "tapped": {...}}, {"command": name} or {"speed": times}.

    held: actions in every tick from now on. tapped: actions in the next tick only. Others are 0. command: one of
    COMMANDS. speed: one of SPEEDS, how many times as fast as usual.

    ranges: the lowest and highest value of each action by its name. Raises MessageError for everything else.
    """
    content = _loaded(text)
    if content.keys() == {"held", "tapped"}:
        for choices in content.values():
            _check_choices(choices, ranges)
        return content
    if content.keys() == {"command"} and content["command"] in COMMANDS:
        return content
    if content.keys() == {"speed"} and type(content["speed"]) in (int, float) and content["speed"] in SPEEDS:
        return content
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


def _check_choices(given: Any, ranges: Mapping[str, tuple[int, int]]) -> None:
    if not isinstance(given, dict) or given.keys() - ranges.keys():
        raise MessageError(f"held and tapped name actions: {', '.join(ranges)}"[:123])
    for name, value in given.items():
        low, high = ranges[name]
        if type(value) is not int or not low <= value <= high:
            raise MessageError(f"{name} is an integer from {low} to {high}"[:123])
