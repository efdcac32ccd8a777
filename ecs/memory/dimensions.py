"""The sizes of the named dimensions of columns, which modules declare and which may name each other."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ..declarations.archetype import MOST
from ..declarations.component import Component
from ..declarations.declared import Declared
from ..declarations.module import Module
from ..kernels.errors import DeclarationError, NumberError, did_you_mean
from ..kernels.frozen_values import is_outside
from ..kernels.integers import is_whole

NEEDED = 'an integer >= 0, or names of dimensions and numbers, as in "agents + boxes" or "agents - 1"'


def dimension_sizes(declared: Sequence[Declared], given: Mapping[str, int]) -> dict[str, int]:
    """Return the sums of the sizes that mechanics declare.

    Args:
        declared: The declarations of the mechanics.
        given: Sizes that the engine knows, which modules may name, and add to.

    Returns:
        The size of every dimension that a module declares, by name.

    Raises:
        DeclarationError: A size is not a number or names of dimensions; dimensions form a circle; or no imported
            mechanic has a named dimension. If its mechanic is only left out, it counts as 0.
        NumberError: A dimension is larger than MOST.
    """
    terms: dict[str, list[int | str]] = {}
    for each in declared:
        for dim, size in each.dims.items():
            _check_size(each.module, dim, size)
            terms.setdefault(dim, []).extend(_terms(size) if isinstance(size, str) else [size])
    found: dict[str, int] = {}

    def size_of(dim: str, trail: tuple[str, ...]) -> int:
        if dim in trail:
            circle = " -> ".join((*trail[trail.index(dim) :], dim))
            raise DeclarationError(f"dimensions name each other in a circle: {circle}")
        if dim not in found:
            if dim not in terms and dim not in given:
                _check_known(declared[0].module, dim, trail, {*terms, *given})
            more = (size_of(term, (*trail, dim)) if isinstance(term, str) else term for term in terms.get(dim, ()))
            total = given.get(dim, 0) + sum(more)
            if not 0 <= total <= MOST and dim in terms:
                raise NumberError(f"the dimension '{dim}' would be {total}: at least 0 and at most {MOST} is possible")
            found[dim] = total
        return found[dim]

    return {dim: size_of(dim, ()) for dim in terms}


def _terms(size: str) -> list[int | str]:
    """Return the names and numbers whose sum a size is: "agents - 1" is that of "agents" and -1."""
    parts = [part.strip() for part in size.replace(" - ", " + -").split("+")]
    return [int(part) if part.lstrip("-").isdecimal() else part for part in parts]


def check_indices(module: Module, components: Sequence[type[Component]], dims: Mapping[str, int]) -> None:
    """Raise DeclarationError if a column is declared as an index of a dimension that no imported mechanic has.

    Args:
        module: Any module; gives access to the imported ones.
        components: The components of the scenario.
        dims: The sizes of its dimensions. Those of mechanics that it lacks may be missing.
    """
    for component in components:
        for name, column in component.columns.items():
            for dim in (term.strip() for term in column.below.split("+") if column.below):
                if not (dim.isdigit() or dim in dims or _has_a_mechanic(module, dim)):
                    hint = did_you_mean(dim, dims) or "take names and numbers, with + between them"
                    raise DeclarationError(
                        f"{component.__name__}.{name} is below {column.below!r}: unknown dimension {dim!r}; {hint}"
                    )


def check_owners(modules: Sequence[Module], engine: Collection[str], shared: Collection[Any]) -> None:
    """Check that mechanics from outside of outlast do not add to dimensions of the engine or of outlast's mechanics.

    Args:
        modules: Instances of Module.
        engine: The names of the engine's dimensions.
        shared: The dimensions of outlast's mechanics that others may add to: counts of entities, capacities of events.

    Raises:
        DeclarationError: A mechanic does, for example because its own dimension has a name that is taken.
    """
    declared = {dim: module.name for module in modules if not is_outside(type(module)) for dim in module.dims()}
    owners = declared | dict.fromkeys(engine, "the engine")
    for module in modules:
        for dim in module.dims() if is_outside(type(module)) else ():
            if dim in owners and dim not in shared:
                raise DeclarationError(
                    f"{module.name}.dims() has '{dim}', a dimension of {owners[dim]}, to which its size would be "
                    f"added: give yours another name, as '{module.name} {dim}'"
                )


def _check_size(module: Module, dim: str, size: Any) -> None:
    """Raise DeclarationError if a size is neither a number nor names of dimensions."""
    if not isinstance(size, str) and not is_whole(size, 0):
        raise DeclarationError(f"{module.name}.dims() has {{{dim!r}: {size!r:.60}}}: {NEEDED}")


def _has_a_mechanic(module: Module, dim: str) -> bool:
    """Return whether an imported mechanic has the dimension. module: any module; gives access to the imported ones."""
    return bool(module.providing(lambda other: dim in other.dims()))


def _check_known(module: Module, dim: str, trail: tuple[str, ...], known: set[str]) -> None:
    """Raise DeclarationError if no imported mechanic has the dimension. trail: the dimensions that lead to it."""
    if not _has_a_mechanic(module, dim):
        hint = did_you_mean(dim, known) or f"known: {', '.join(sorted(known))}"
        raise DeclarationError(f"the dimension '{trail[-1]}' has the size of '{dim}', which no module has; {hint}")
