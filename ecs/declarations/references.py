"""References: what stands in a declaration for a number of the mechanic, or for the number of an entity."""

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Ref:
    """A number of the mechanic that declares something, in place of the number's value."""

    name: str


def ref(name: str) -> Any:
    """Name a number in a declaration, which then can differ between worlds or agents.

    It stands for a whole value: that of a prefab, as in Health(points=ref("points")); the count of an Archetype; or the
    size of a dimension that is a count of entities, as in {"boxes": ref("count")}.

    Args:
        name: The number's name in the mechanic.
    """
    return Ref(name)


class _Index:
    """The type of INDEX."""

    def __repr__(self) -> str:
        return "INDEX"


INDEX: Any = _Index()
"""A prefab value: the number of the entity among those of its kind, 0, 1, 2 and so on."""


def index_of(value: Any, count: int) -> Any:
    """Return a prefab value for `count` entities: what INDEX stands for, or the value itself."""
    return np.arange(count) if value is INDEX else value
