"""Entities put into worlds by hand, for tests and scripts."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from outlast.components import Body, Item, Polygon, Shape, Wall
from outlast.components.body import HEADING, face
from outlast.ecs import Component, Entity, Worlds
from outlast.ecs.declarations.component import as_stored
from outlast.ecs.kernels.errors import did_you_mean
from outlast.ecs.kernels.integers import is_whole
from outlast.ecs.kernels.jit import interpreted
from outlast.systems.geometry.aabb import make_half_extents
from outlast.systems.geometry.places import measure

REST = ("vx", "vy", "omega")


def place(worlds: Worlds, kind: str, number: int, where: Any, values: Mapping[str, Any]) -> int:
    """Put an entity into the worlds `where`; see SurvivalVectorEnv.place, which does not check these arguments."""
    span = worlds.span(kind)
    if not is_whole(number, 0, span.stop - span.start - 1):
        raise ValueError(f"number = {number!r:.60}: there are {span.stop - span.start} of the kind '{kind}', from 0 on")
    row, chosen = int(span.start + number), np.atleast_1d(np.arange(worlds.count)[where])
    parts = [type(part) for part in worlds.layout.archetypes[kind].parts]
    columns = [_column(kind, parts, name) for name in values]
    _check_coupled(columns)
    if outline := [name for own, name in columns if Polygon in parts and own in (Polygon, Shape)]:
        raise ValueError(
            f"{outline[0]}: the outline of the kind '{kind}' is its Polygon; declare another kind for another"
        )
    given = [
        as_stored(f"{own.__name__}.{column}", own.columns[column], value)
        for (own, column), value in zip(columns, values.values(), strict=True)
    ]
    entities = worlds[Entity]
    if absent := chosen[entities.identity[chosen, row] < 0].tolist():
        raise ValueError(f"{kind} {number} is absent in world {absent[0]}, whose episode has fewer of that kind")
    if Item in parts and (carried := chosen[worlds[Item].holder[chosen, row] >= 0].tolist()):
        raise ValueError(
            f"{kind} {number} is in a bag in world {carried[0]}: take it out by a tick in which it is used"
        )
    entities.alive[chosen, row] = 1
    if Body in parts:
        for name in REST:
            getattr(worlds[Body], name)[chosen, row] = 0
    for (own, column), value in zip(columns, given, strict=True):
        getattr(worlds[own], column)[chosen, row] = value
    with interpreted():
        for w in chosen.tolist():
            _couple(worlds, parts, w, row)
    return row


def _column(kind: str, parts: list[type[Component]], name: str) -> tuple[type[Component], str]:
    """Return the component and the column that a name stands for: "points", or "Health.points"; "x" is Body's."""
    owner, _, column = name.rpartition(".")
    found = [part for part in parts if column in part.columns and owner in ("", part.__name__)]
    if len(found) == 1 or Body in found:
        return Body if Body in found else found[0], column
    if found:
        names = " and ".join(f"'{part.__name__}.{column}'" for part in found)
        raise ValueError(
            f"'{column}' of the kind '{kind}' could be {names}: choose one, as in **{{{names.split()[0]}: 1}}"
        )
    known = [each for part in parts for each in part.columns]
    hint = did_you_mean(column, known) or f"it has: {', '.join(dict.fromkeys(known)) or 'none'}"
    raise ValueError(f"the kind '{kind}' has no column '{name}'; {hint}")


def _check_coupled(columns: list[tuple[type[Component], str]]) -> None:
    """Raise ValueError for a column that must fit others which are neither given nor computed here."""
    for own, column in columns:
        for coupled in own.coupled:
            missing = [need for need in coupled.needs if (own, need) not in columns]
            if column in coupled.columns and missing and not coupled.computed_by and coupled.columns != HEADING:
                raise ValueError(f"{own.__name__}.{column} needs {', '.join(missing)}: {coupled.cure}")


def _couple(worlds: Worlds, parts: list[type[Component]], w: int, row: int) -> None:
    """Compute the dependent columns of an entity, by the systems that do so at resets."""
    rows = np.array([row], np.int32)
    if Body in parts:
        body = _of_world(worlds, Body, w)
        face(body, row, body.angle[row])
    computed = {(part, each.computed_by.partition(".")[2]) for part in parts for each in part.coupled}
    for system in worlds.schedule.systems:
        if any(
            (part, system.name) in computed for p in system.parameters if p.kind == "write" for part in p.components
        ):
            system.kernel(*(rows if p.kind == "rows" else _given(worlds, p, w) for p in system.parameters))
    if Wall in parts:
        tables = (_of_world(worlds, part, w) for part in (Body, Shape))
        measure(_of_world(worlds, Wall, w), worlds.layout.rows(Wall), make_half_extents(worlds.dims), *tables)


def _given(worlds: Worlds, parameter: Any, w: int) -> Any:
    """Return the table for a system; None for one that the game lacks."""
    return None if parameter.kind == "none" else _of_world(worlds, parameter.components[0], w)


def _of_world(worlds: Worlds, component: type[Component], w: int) -> Any:
    """Return the table of a component in one world."""
    table = worlds[component]
    return type(table)(*(column[w] for column in table))
