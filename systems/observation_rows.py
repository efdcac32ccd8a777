"""Masked rows of observations, such as `heals` with `heals_mask`: written here for all mechanics that have some."""

import linecache
import math
from collections.abc import Mapping
from inspect import signature
from typing import Annotated, Any, get_type_hints

from outlast.components import Body, ObservationMasks, Phase, Side
from outlast.components.body import SPEED, SPIN, half_room
from outlast.components.sight import is_set
from outlast.ecs import (
    Array,
    Column,
    Component,
    Field,
    Module,
    Observation,
    Offset,
    Read,
    Rows,
    Write,
    column,
    kernel,
)
from outlast.ecs.kernels.simd import trailing_zeros

from .geometry.blocks import block_span, first_row

FEW = 3  # if a kind has no more blocks than this, a branch for each is faster
WORD = 64  # how many blocks are looked at together


@kernel
def write_rows(
    rows: Array,
    row_masks: Array,
    masks: Array,
    members: Array,
    index: Array,
    fill: Any,
    tables: Any,
    skip_self: bool = False,
) -> None:
    """Write the dirty rows of the entities `members`, and their masks, for every observer.

    Args:
        rows: f4 (agents, entities, features), a column of the observation.
        row_masks: f4 (agents, entities), its mask.
        masks: The table of ObservationMasks.
        members: Bitset of the entities.
        index: RowIndex of the entities: their index in `rows`.
        fill: Kernel (row, e, filled, tables) that writes all features of entity `e` to `row`, zeros if not `filled`.
        tables: Tuple of what `fill` needs.
        skip_self: Whether the entities are the observers themselves, so that each only has rows of the others.
    """
    first, last = block_span(members)
    for i in range(rows.shape[0]):
        if last - first <= FEW:
            for b in range(first, last):
                write_block(rows, row_masks, masks, members, i, b, index, fill, tables, skip_self)
            continue
        for start in range(first, last, WORD):
            some = 0  # which blocks have dirty rows, found without a branch, which would often be mispredicted
            for b in range(start, min(start + WORD, last)):
                some |= int(masks.dirty[i, b] & members[b] != 0) << (b - start)
            while some:
                b = start + trailing_zeros(some)
                some &= some - 1
                write_block(rows, row_masks, masks, members, i, b, index, fill, tables, skip_self)


@kernel
def write_block(
    rows: Array,
    row_masks: Array,
    masks: Array,
    members: Array,
    i: int,
    b: int,
    index: Array,
    fill: Any,
    tables: Any,
    skip_self: bool,
) -> None:
    """Write the dirty rows in block `b` for observer `i`. For the other arguments see `write_rows`."""
    pending = masks.dirty[i, b] & members[b]
    while pending:
        e = first_row(b, pending)
        pending &= pending - 1
        k = index[e]
        if skip_self:
            if k == i:
                continue
            k -= k > i
        row_masks[i, k] = is_set(masks.mask, i, e)
        fill(rows[i, k], e, is_set(masks.filled, i, e) != 0, tables)


# ---- rows that are declared as a mapping of columns


BODY: dict[str, dict[str, Any]] = {  # fields of columns of Body
    **{key: {"unit": "m", "scale": half_room} for key in ("x", "y")},
    **{key: {"unit": "m/s", "scale": SPEED} for key in ("vx", "vy")},
    "angle": {"unit": "rad", "scale": math.pi},
    "omega": {"unit": "rad/s", "scale": SPIN},
}


def rows(mechanic: type[Module], key: str, kind: type[Component], /, **values: Any) -> type[Observation]:
    """Declare an observation with a row for each entity of a kind, and register the system that writes it.

        Crates = rows(Grabbing, "crates", Crate, x=Body.x, y=Body.y, held=Crate.held, mine=mine)

    Agents observe the crates that they see, with a mask, as they observe heals and boxes. The mechanic returns Crates()
    among its singletons, and the number of crates as the dimension "crates".

    Args:
        mechanic: The mechanic that has the system, called see_KEY.
        key: The key of the observation; KEY_mask is that of its mask.
        kind: A component that just these entities have.
        **values: What the fields of a row hold, by name: a column, or for what depends on the observer a function (i,
            e, ...) of its number and the entity's row, whose other parameters are annotated like those of systems.

    Returns:
        The class of the observation.
    """
    mask = column("f4", "agents", key, low=0, high=1)
    own = {key: column("f4", "agents", key, fields=_fields(values)), f"{key}_mask": mask}
    name = f"{''.join(part.title() for part in key.split('_'))}View"
    place = {"__module__": mechanic.__module__, "__qualname__": f"{mechanic.__qualname__}.{name}", "__doc__": "Rows."}
    view: type[Observation] = type(name, (Observation,), own | place)
    setattr(mechanic, name, view)  # where compiled code finds it again
    _register(mechanic, view, key, kind, values, f"see_{key}")
    return view


def more_fields(
    mechanic: type[Module], view: type[Observation], key: str, kind: type[Component], /, **values: Any
) -> tuple[Field, ...]:
    """Declare fields that a mechanic adds to the rows of another one, and register the system that writes them.

        HOLDS = more_fields(Grabbing, SelfView, "own", Side, holds=holds)

    The mechanic returns them in `fields`: {"own": HOLDS}.

    Args:
        mechanic: The mechanic that has the system, called see_more_KEY.
        view: The observation.
        key: Its key: "own", or one with a row for each entity of a kind.
        kind: A component that just these entities have; Side for "own".
        **values: As for `rows`.

    Returns:
        The fields.
    """
    _register(mechanic, view, key, kind, values, f"see_more_{key}")
    return _fields(values)


def _fields(values: Mapping[str, Any]) -> tuple[Field, ...]:
    """Return a field for each value: with the unit and the range of a column, if it is one."""
    return tuple(Field(name, **_described(value)) for name, value in values.items())


def _described(value: Any) -> dict[str, Any]:
    if not isinstance(value, Column):
        return {}
    if value.owner is Body:
        return BODY.get(value.name, {})
    ends = {"low": value.low, "high": value.high}
    return {"unit": value.unit, **ends, "scale": value.high if 1 < value.high < math.inf else 1.0}


def _register(
    mechanic: type[Module],
    view: type[Observation],
    key: str,
    kind: type[Component],
    values: Mapping[str, Any],
    name: str,
) -> None:
    """Write a system that writes the values, and register it."""
    known: dict[str, Any] = {"Write": Write, "Read": Read, "Rows": Rows, "Offset": Offset, "is_set": is_set}
    known |= {"View": view, "Kind": kind, "Side": Side, "Masks": ObservationMasks, "__name__": mechanic.__module__}
    given = {"view": "Write[View]", "masks": "Read[Masks]", "watchers": "Rows[Side]", "kinds": "Rows[Kind]"}
    tables, lines = dict[Any, str](), list[str]()
    cell, own = (f"view.{key}[i]", True) if key == "own" else (f"view.{key}[i, k]", False)
    for n, (field, value) in enumerate(values.items()):
        given[f"{key}_{field}"] = "Offset"
        if isinstance(value, Column):
            parameters, form = [Annotated[value.owner, "read"]], f"{{}}.{value.name}[e]"
        else:
            inner = getattr(value, "py_func", value)
            hints = get_type_hints(inner, include_extras=True)
            parameters = [hints[each] for each in [*signature(inner).parameters][2:]]
            known[f"f{n}"], form = kernel(inner), f"f{n}(i, e{', {}' * len(parameters)})"
        for hint in parameters:
            tables.setdefault(repr(hint), f"t{len(tables)}")
            known[f"h_{tables[repr(hint)]}"] = hint
        what = form.format(*(tables[repr(hint)] for hint in parameters))
        lines.append(f"{cell[:-1]}, {key}_{field}] = {what}{'' if own else ' if filled else 0'}")
    given |= {short: f"h_{short}" for short in tables.values()}
    body = ["    for i in range(watchers.size):"]
    if own:
        body += ["        e = watchers[i]", *(f"        {line}" for line in lines)]
    else:
        body += ["        for k in range(kinds.size):", "            e = kinds[k]"]
        body += ["            filled = is_set(masks.filled, i, e) != 0"]
        body += [f"            {line}" for line in lines]
        if name == f"see_{key}":
            body += [f"            view.{key}_mask[i, k] = is_set(masks.mask, i, e)"]
    head = ", ".join(f"{each}: {hint}" for each, hint in given.items())
    source = "\n".join([f"def {name}({head}) -> None:", *body, ""])
    file = f"<{mechanic.__module__}.{mechanic.__qualname__}.{name}>"
    linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
    exec(compile(source, file, "exec"), known)  # the source is ours, of names that are identifiers
    after = () if own or name == f"see_{key}" else (view,)
    mechanic.system(Phase.OBSERVE, after=after)(known[name])
