"""Events of all kinds in one table: agents, targets, amounts and causes."""

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from outlast.ecs import DeclarationError, Event, MemoryLayout
from outlast.ecs.declarations.event import COUNT, TIMES

from ..core.validation import Array

COLUMNS = {
    "world": "number of the world",
    "episode": "number of the world's episode, from 1",
    "tick": "of the episode, from 1; in tick 0 it starts",
    "event": "what happened, as in env.events()",
    "who": "the acting entity, as 'agent 1'; empty: none",
    "whom": "the entity acted upon, as 'box 3'",
    "amount": "how much; empty: it has none",
    "why": "the damage type",
    "more": "the event's other columns, as 'item=heal 3 side=1'",
}


def with_episodes(events: dict[str, Array], episodes: Array) -> dict[str, Array]:
    """Replace the column `episode` of events (by name) with each world's number in `episodes`, int (worlds,).

    The clock's own number of an episode starts again whenever a seed, or a level with a key, is given.
    """
    for rows in events.values():
        rows["episode"] = episodes[rows["world"]]
    return events


def event_table(
    layout: MemoryLayout, events: Mapping[str, Array], first_world: int = 0, where: Array | None = None
) -> dict[str, Array]:
    """Return one table of events, as env.events() returns them, of the worlds `where`, bool (worlds,), or of all.

    Returns:
        The columns by name, see COLUMNS: arrays of int64 or of objects (str; in `amount`, float or None), with an entry
        for each event. Events are ordered by world, then by kind, then as they happened.
    """
    kinds = {event.name: event for event in layout.events}
    parts = [_part(layout, kinds[name], rows) for name, rows in events.items()]
    table = {name: np.concatenate([part[name] for part in parts] or [np.empty(0, object)]) for name in COLUMNS}
    order = np.argsort(table["world"], kind="stable")
    if where is not None:
        order = order[where[table["world"][order].astype(np.intp)]]
    table = {name: column[order] for name, column in table.items()}
    table["world"] = table["world"] + first_world
    return table


def _part(layout: MemoryLayout, event: type[Event], rows: Array) -> dict[str, Array]:
    """Return the table of the events of one kind."""
    words = _words(layout)
    rest = [name for name in event.columns if name not in (COUNT, event.who, event.whom)]
    amount = next((name for name in rest if name == "amount" and rows[name].ndim == 1), None)
    why = next((name for name in rest if event.columns[name].unit == "damage type"), None)
    found: dict[str, Array] = {name: rows[name] for name in TIMES}
    found["event"] = _same(event.name, rows)
    for name, column in event.columns.items():
        unit = "entity" if name in (event.who, event.whom) else column.unit
        if unit in words:
            _check_words(event, name, rows, unit, len(words[unit]) - 1)
    found["who"], found["whom"] = (
        words["entity"][rows[name]] if name else _same("", rows) for name in (event.who, event.whom)
    )
    found["amount"] = rows[amount].astype(object) if amount else _same(None, rows)
    found["why"] = words["damage type"][rows[why]] if why else _same("", rows)
    found["more"] = _same("", rows)
    for name in rest:
        if name not in (amount, why):
            unit = event.columns[name].unit
            values = words[unit][rows[name]] if unit in words else rows[name]
            found["more"] += _said(name, values.tolist(), nothing=-1 if unit == "side" else "")
    found["more"] = np.array([words.strip() for words in found["more"]], object)
    return found


def _check_words(event: type[Event], name: str, rows: Array, unit: str, count: int) -> None:
    """Raise DeclarationError if the column `name`, whose values are numbers of `count` things, has any other number."""
    wrong = rows[name][(rows[name] < -1) | (rows[name] >= count)]
    if wrong.size:
        raise DeclarationError(
            f"the event {event.__name__} has {name} = {wrong.flat[0]}, and its unit is {unit!r}: "
            f"-1 to {count - 1} is possible; a system wrote something else"
        )


def _said(name: str, values: list[Any], nothing: object) -> Array:
    """Return " name=value" for each value, and "" for a value that is `nothing`."""
    texts = np.empty(len(values), object)
    texts[:] = ["" if value == nothing else f" {name}={value}" for value in values]
    return texts


def _same(value: object, rows: Array) -> Array:
    return np.full(len(rows), value, object)


@functools.lru_cache(maxsize=16)
def _words(layout: MemoryLayout) -> dict[str, Array]:
    """Return the names of what columns of these units refer to, by number, and at the end "" for -1, which is none."""
    names = {"entity": layout.entity_names, "damage type": layout.labels["damage_type"]}
    return {unit: np.array([*each, ""], object) for unit, each in names.items()}
