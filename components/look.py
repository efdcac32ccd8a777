"""Looks of entities, as data: pictures, films and pages read it, so that mechanics need no code for them."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from outlast.ecs import Column, DeclarationError

NOTHING = -1


@dataclass(frozen=True)
class Look:
    """The look of a kind of entities, by columns: Look(tint=Crate.locked_by, line_to=Weld.other, ring=Aloft.ticks).

    A kind with a look is not drawn as a wall, even if it is solid and static.

    Attributes:
        color: Its colour, (red, green, blue), 0 to 255 each; None: one by kind.
        tint: A column of sides: where it is not -1, the entity has the colour of that side.
        ring: A column: where it is above 0, the entity has a ring.
        line_to: A column of rows: where it is not -1, a line is drawn to that entity.

    Raises:
        DeclarationError: A value is not a column, or has dimensions.
    """

    color: tuple[int, int, int] | None = None
    tint: Any = None
    ring: Any = None
    line_to: Any = None

    def __post_init__(self) -> None:
        for name in ("tint", "ring", "line_to"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, Column) and value.owner and not value.dims):
                raise DeclarationError(f"Look({name}={value!r:.60}): a column is needed, as in {name}=Crate.held")


@runtime_checkable
class HasLooks(Protocol):
    """A mechanic with looks of entities: any mechanic with this method."""

    def looks(self) -> dict[str, Look]:
        """Return looks by kind of entities, its own or others."""
