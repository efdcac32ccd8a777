"""Masked rows of observations, such as `heals` with `heals_mask`: written here for all mechanics with such rows."""

import linecache
import math
from collections.abc import Mapping
from inspect import signature
from typing import Annotated, Any, get_origin, get_type_hints

from outlast.components import Bag, Body, ObservationMasks, Phase, Side
from outlast.components.body import SPEED, SPIN, half_room
from outlast.components.inventory import held
from outlast.components.sight import is_set
from outlast.ecs import (
    Array,
    Bitset,
    Column,
    Component,
    Entity,
    Field,
    Module,
    Observation,
    Offset,
    Read,
    RowIndex,
    Rows,
    Singleton,
    Write,
    column,
    kernel,
)
from outlast.ecs.kernels.simd import trailing_zeros

from .geometry.blocks import block_span, first_row

FEW = 3  # up to this many blocks of a kind, a branch for each is faster
WORD = 64  # blocks that are tested together


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
        fill: Kernel (row, i, e, filled, tables) that writes all features of entity `e` to `row`, zeros if not `filled`.
        tables: Tuple of the arguments of `fill`.
        skip_self: Whether the entities are the observers themselves, so that each has rows of the others only.
    """
    first, last = block_span(members)
    for i in range(rows.shape[0]):
        if last - first <= FEW:
            for b in range(first, last):
                write_block(rows, row_masks, masks, members, i, b, index, fill, tables, skip_self)
            continue
        for start in range(first, last, WORD):
            some = 0  # blocks with dirty rows, computed without a branch, which would often be mispredicted
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
        fill(rows[i, k], i, e, is_set(masks.filled, i, e) != 0, tables)


# ---- rows that are declared as a mapping of columns


NUMBERS = (int, float, bool)  # annotations of numbers of mechanics, which are found by their names
BODY: dict[str, dict[str, Any]] = {  # fields of columns of Body
    **{key: {"unit": "m", "scale": half_room} for key in ("x", "y")},
    "angle": {"unit": "rad", "scale": math.pi},
    **{key: {"unit": "m/s", "scale": SPEED} for key in ("vx", "vy")},
    "omega": {"unit": "rad/s", "scale": SPIN},
}
MOTION = {key: getattr(Body, key) for key in BODY}  # place and motion, as values of `rows` and `observe`


def rows(mechanic: type[Module], key: str, kind: type[Component], /, **values: Any) -> type[Observation]:
    """Declare an observation with a row for each entity of a kind, and register the system that writes it.

        Crates = rows(Grabbing, "crates", Crate, x=Body.x, y=Body.y, held=Crate.held, mine=mine)

    Agents observe visible crates, with a mask, like heals and boxes. The mechanic returns Crates()
    among its singletons, and the number of crates as the dimension "crates".

    Args:
        mechanic: The mechanic that has the system.
        key: The key of the observation; KEY_mask is that of its mask.
        kind: A component that only these entities have.
        **values: Values of the fields of a row, by name, as for `observe`.

    Returns:
        The class of the observation.
    """
    mask = column("f4", "agents", key, low=0, high=1)
    own = {key: column("f4", "agents", key, fields=_fields(values)), f"{key}_mask": mask}
    name = f"{''.join(part.title() for part in key.split('_'))}View"
    place = {"__module__": mechanic.__module__, "__qualname__": f"{mechanic.__qualname__}.{name}", "__doc__": "Rows."}
    view: type[Observation] = type(name, (Observation,), own | place)
    setattr(mechanic, name, view)  # where compiled code finds it
    observe(mechanic, view, key, kind, **values)
    return view


def more_fields(
    mechanic: type[Module], view: type[Observation], key: str, kind: type[Component], /, **values: Any
) -> tuple[Field, ...]:
    """Declare fields that a mechanic adds to the rows of another one, and register the system that writes them.

        HOLDS = more_fields(Grabbing, SelfView, "own", Side, holds=holds)

    The mechanic returns them in `fields`: {"own": HOLDS}. The arguments are those of `observe`.

    Returns:
        The fields.
    """
    _register(mechanic, view, key, kind, values, f"see_more_{key}")
    return _fields(values)


def observe(mechanic: type[Module], view: type[Observation], key: str, kind: type[Component], /, **values: Any) -> None:
    """Register the system see_KEY of a mechanic, which writes fields of an observation that are declared elsewhere.

        observe(Heals, HealView, "heals", Heal, x=Body.x, y=Body.y)

    Shape (agents, n): row k is that of entity k of the kind, zeros if it is hidden. Shape (agents, 1): the row
    is that of the last item of the agent's bag, zeros if it is not of the kind. Shape (agents,): the row is that of the
    agent itself. A KEY_mask, if any, is written, too.

    Args:
        mechanic: The mechanic that has the system.
        view: The observation.
        key: Its key.
        kind: A component that only the entities of its rows have; Side for rows of the agents themselves.
        **values: Values of the fields, by name: a column, which reads 0 in the own row of a dead agent, or a column of
            a singleton; or otherwise a function (i, e, ...) of the agent's number and the row of the entity, whose
            other parameters are annotated like those of systems. One whose third parameter is `into` returns nothing,
            but writes a field of several columns there: zeros where `e` is -1.
    """
    _register(mechanic, view, key, kind, values, f"see_{key}")


def _fields(values: Mapping[str, Any]) -> tuple[Field, ...]:
    """Return a field for each value: with the unit and the range of a column."""
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
    """Generate a system that writes the values, and register it."""
    known: dict[str, Any] = {"Write": Write, "Read": Read, "Rows": Rows, "Bitset": Bitset, "RowIndex": RowIndex}
    known |= {"Offset": Offset, "View": view, "Kind": kind, "Side": Side, "Bag": Bag, "Entity": Entity, "held": held}
    known |= {"Masks": ObservationMasks, "write_rows": write_rows, "kernel": kernel, "__name__": mechanic.__module__}
    dims = getattr(view, key).dims
    own, slot = len(dims) == 1, dims[1:] == (1,)
    row = f"view.{key}[i, " if own else f"view.{key}[i, 0, " if slot else "row["
    needed, lines = dict[str, str](), list[str]()
    for n, (field, value) in enumerate(values.items()):
        needed[f"{key}_{field}"] = "Offset"
        form, hints = _statement(value, f"f{n}", f"{row}{key}_{field}", own)
        if not isinstance(value, Column):
            known[f"f{n}"] = kernel(getattr(value, "py_func", value))
        taken = list[str]()
        for parameter, hint in hints.items():
            same = [each for each, there in needed.items() if known.get(there) == hint]
            number = hint in NUMBERS or get_origin(hint) is tuple
            taken += [parameter] if number else same or [f"t{len(needed)}"]
            needed[taken[-1]] = f"h_{taken[-1]}"
            known[f"h_{taken[-1]}"] = hint
        lines.append(form.format(", ".join(taken)))
    if own or slot:
        given = {"view": "Write[View]", "entities": "Read[Entity]", "watchers": "Rows[Kind]"}
        body = ["for i in range(watchers.size):", "    e = watchers[i]", "    filled = entities.alive[e] != 0"]
        if slot:
            given |= {"watchers": "Rows[Side, Bag]", "bag": "Read[Bag]", "index": "RowIndex[Kind]"}
            body += ["    e = held(bag, e, index) if filled else -1", "    filled = e >= 0"]
            body += [f"    view.{key}_mask[i, 0] = filled"]
        source, body = "", body + [f"    {line}" for line in lines]
    else:
        given = {"view": "Write[View]", "masks": "Read[Masks]", "kinds": "Bitset[Kind]", "index": "RowIndex[Kind]"}
        fill = [f"({', '.join(needed)},) = tables", *lines]
        source = _function(f"fill_{name}", "row, i, e, filled, tables", fill, "@kernel")
        call = f"view.{key}, view.{key}_mask, masks, kinds, index, fill_{name}, ({', '.join(needed)},)"
        body = [f"write_rows({call})"]
    source += _function(name, ", ".join(f"{each}: {hint}" for each, hint in {**given, **needed}.items()), body)
    file = f"<{mechanic.__module__}.{mechanic.__qualname__}.{name}>"
    linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
    exec(compile(source, file, "exec"), known)  # the source is generated here, from names that are identifiers
    mechanic.system(Phase.OBSERVE)(known[name])


def _statement(value: Any, name: str, place: str, own: bool) -> tuple[str, dict[str, Any]]:
    """Return the statement that writes a value to its place, and the annotations of the parameters in its {}."""
    if isinstance(value, Column):
        single = issubclass(value.owner, Singleton)
        rest = "" if own and single else " if filled else 0"
        return f"{place}] = {{}}.{value.name}[{0 if single else 'e'}]{rest}", {"": Annotated[value.owner, "read"]}
    function = getattr(value, "py_func", value)
    hints = get_type_hints(function, include_extras=True)
    names = [*signature(function).parameters][2:]
    if names[:1] == ["into"]:
        return f"{name}(i, e if filled else -1, {place}:], {{}})", {each: hints[each] for each in names[1:]}
    return f"{place}] = {name}(i, e, {{}})" + ("" if own else " if filled else 0"), {
        each: hints[each] for each in names
    }


def _function(name: str, parameters: str, body: list[str], decorator: str = "") -> str:
    """Return the source of a function."""
    return "\n".join([decorator, f"def {name}({parameters}):", *(f"    {line}" for line in body), ""])
