"""Archetypes: the kinds of entities that modules declare, each a range of rows with the same components."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from ..kernels.errors import DeclarationError, NumberError
from ..kernels.integers import is_whole
from .component import Component, Ref, Singleton

MOST = 2**16  # maximum entities of a kind and size of a dimension: more takes gigabytes, or minutes to lay out


@dataclass(frozen=True)
class Archetype:
    """`count` entities of one kind and the prefab values of their components.

    Several modules may declare the same archetype: counts add up, components join. A count of 0 extends
    an archetype that another module declares.

    Attributes:
        name: Unique among kinds.
        parts: The components of the kind, with their prefab values.
        count: Number of entities that this module adds, or ref("count"), a number of the module.
        alive: Whether they are in the world right after a reset. All modules that add entities of the kind must agree.
        order: Position of its rows: kinds are sorted by this number, those without one come last, and ties go by name.
            All modules that set it for a kind must give the same number.
        roles: Whether its entities are the agents that can have roles, see declarations.roles; for one kind only.
    """

    name: str
    parts: tuple[Component, ...]
    count: int = 0
    alive: bool = True
    order: int | None = None
    roles: bool = False

    def __post_init__(self) -> None:
        count: Any = self.count
        if isinstance(count, Ref):
            return
        if not is_whole(count, 0):
            raise NumberError(f"Archetype({self.name!r}, ...) with the count {count!r:.60}: an integer >= 0 is needed")
        if self.count > MOST:
            raise NumberError(f"{self.count} entities of the kind {self.name!r}: at most {MOST} are possible")
        order: Any = self.order
        if order is not None and not is_whole(order):
            raise DeclarationError(f"Archetype({self.name!r}, ...) with the order {order!r:.60}: an integer is needed")
        parts: Any = self.parts
        if not isinstance(parts, tuple) or not all(isinstance(part, Component) for part in parts):
            raise DeclarationError(
                f"Archetype({self.name!r}, {parts!r:.60}): a tuple of instances of components is needed, as in "
                f"Archetype({self.name!r}, (Health(points=20),)); with one, mind the comma"
            )


def merge(parts: Iterable[Archetype]) -> dict[str, Archetype]:
    """Join the declarations that several modules make of each archetype; by name, in the order of rows."""
    merged, alive = dict[str, Archetype](), dict[str, set[bool]]()
    for part in parts:
        before = merged.get(part.name, Archetype(part.name, ()))
        have, own = {type(component) for component in before.parts}, set[type[Component]]()
        for component in part.parts:
            if isinstance(component, Singleton):
                raise DeclarationError(f"{type(component).__name__} is per world and cannot be part of '{part.name}'")
            if type(component) in have:
                raise DeclarationError(
                    f"two archetypes called '{part.name}' have {type(component).__name__}, of two mechanics "
                    "or of one: leave it out of one of them, or rename one"
                )
            if type(component) in own:
                raise DeclarationError(f"Archetype({part.name!r}, ...) has {type(component).__name__} twice")
            own.add(type(component))
        orders = {before.order, part.order} - {None}
        if len(orders) > 1:
            raise DeclarationError(
                f"modules give '{part.name}' the orders {before.order} and {part.order}; let one of them leave it out"
            )
        begins = alive.setdefault(part.name, set())
        if part.count or not part.alive:
            begins.add(part.alive)
        if len(begins) > 1:
            raise DeclarationError(
                f"one module has '{part.name}' in the world right after reset, but another one alive=False: all "
                "of a kind begin alike; leave it out, or give them a name of their own"
            )
        merged[part.name] = Archetype(
            part.name,
            before.parts + part.parts,
            before.count + part.count,
            False not in begins,
            next(iter(orders), None),
            before.roles or part.roles,
        )
    for name, kind in merged.items():
        merged[name] = replace(kind, parts=_with_required(_with_brought(name, kind.parts)))
    if len(agents := [name for name, kind in merged.items() if kind.roles]) > 1:
        raise DeclarationError(f"{' and '.join(agents)} both set roles: only one kind can be the agents with roles")
    places = {name: math.inf if kind.order is None else kind.order for name, kind in merged.items()}
    return {name: merged[name] for name in sorted(merged, key=lambda name: (places[name], name))}


def _with_brought(name: str, parts: tuple[Component, ...]) -> tuple[Component, ...]:
    """Return the components of a kind, and those that they bring."""
    found = list(parts)
    for part in parts:
        for brought in part.brings():
            if type(brought) in {type(each) for each in found}:
                what = type(brought).__name__
                raise DeclarationError(f"'{name}' has {what}, which {type(part).__name__} brings: leave {what} out")
            found.append(brought)
    return tuple(found)


def _with_required(parts: tuple[Component, ...]) -> tuple[Component, ...]:
    """Return the components of a kind, and those that they require, with default values."""
    found, have = list(parts), {type(part) for part in parts}
    for part in found:  # `found` grows in the loop
        for required in part.requires:
            if required not in have:
                have.add(required)
                found.append(required())
    return tuple(found)
