"""A hash of the code of users' mechanics, which distinguishes games of the same name with equal numbers.

The hash is the same in every process, compiled or not, and does not depend on comments, docstrings and line numbers.
Functions of this package, of Python's library and of numpy count by name only: versions identify the rest.
"""

import hashlib
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from types import FunctionType
from typing import Any

import numpy as np

from ..declarations.access import Label, Parameter
from ..declarations.component import Component, index_of
from ..declarations.declared import declare
from ..declarations.fields import Field
from ..declarations.module import Module
from ..declarations.system import Neighbour, System
from ..kernels.frozen_values import described, is_library, is_outside, read_code, references

PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
"""The version of Python whose bytecode is hashed: hashes of two versions cannot be compared."""


def code_digest(module: Module) -> str:
    """Hash of the code of a mechanic's systems and of all that they refer to, and of its components and prefab values.

    Its numbers count only if archetypes, singletons or dimensions depend on them.
    """
    digest = hashlib.sha256()
    for line in _describe_module(module):
        digest.update(line.encode() + b"\n")
    return digest.hexdigest()[:32]


def full_name(target: Any) -> str:
    """Return the name of a class or function with its module."""
    return f"{target.__module__}.{target.__qualname__}"


def _describe_module(module: Module) -> Iterator[str]:
    declared, components = declare(module), set[type[Component]]()
    for archetype in declared.archetypes:
        yield f"archetype {archetype.name} {archetype.count} {archetype.alive} {archetype.order}"
        yield from (_describe_prefab(part, archetype.count) for part in archetype.parts)
        components.update(map(type, archetype.parts))
    for singleton in declared.singletons:
        yield _describe_prefab(singleton)
        components.add(type(singleton))
    dims = {dim: size if isinstance(size, str) else int(size) for dim, size in declared.dims.items()}
    yield f"{sorted(dims.items())} {' '.join(getattr(module, label, '') for label in sorted(Label.kinds))}"
    yield from (f"fields {key} {_describe_fields(added)}" for key, added in sorted(module.fields().items()))
    functions: list[Any] = [type(module).scratch] if is_outside(type(module).scratch) else []
    for system in sorted(module.systems(), key=lambda system: system.label):
        yield _describe_declaration(system)
        components.update(component for parameter in _described(system) for component in parameter.components)
        services = [each.service.function for each in system.parameters if each.service and each.service.function]
        functions += [each for each in (system.function, *services) if is_outside(each)]
    for component in sorted(components, key=full_name):
        yield _describe_component(component)
    for function in functions:  # grows in the loop
        yield read_code(function.__code__)[0]
        for name, value in references(function):
            yield from _describe_value(name, value, functions)


def _describe_prefab(part: Component, count: int = 1) -> str:
    values = {name: index_of(part.fills.get(name, column.fill), count) for name, column in part.columns.items()}
    arrays = {name: np.asarray(value, part.columns[name].dtype) for name, value in values.items()}
    return full_name(type(part)) + "".join(f" {name}{a.shape}{a.tobytes().hex()}" for name, a in arrays.items())


def _describe_component(component: type[Component]) -> str:
    bases = [full_name(base) for base in component.__mro__ if not is_outside(base)]
    columns = [
        (name, c.dtype.str, c.dims, float(c.fill), float(c.low), float(c.high), c.key, *_describe_fields(c.fields))
        for name, c in (component.columns if is_outside(component) else {}).items()
    ]
    capacity = getattr(component, "capacity", "") if is_outside(component) else ""  # an event's capacity
    capacity = full_name(capacity) if isinstance(capacity, type) else capacity
    return f"{full_name(component)} {bases} {component.order} {component.packed} {capacity} {columns}"


def _describe_fields(fields: tuple[Field, ...] | str) -> list[Any]:
    return [each if isinstance(each, str) else (each.name, each.size, each.order) for each in fields]


def _described(system: System) -> list[Parameter]:
    """Return its parameters without optional ones of outlast's own: games without these components keep their hash."""
    return [each for each in system.access if system.outside or not each.optional]


def _describe_declaration(system: System) -> str:
    def names(neighbours: tuple[Neighbour, ...]) -> list[str]:
        return [each if isinstance(each, str) else full_name(each) for each in neighbours]

    parameters = [
        (p.name, p.kind, [full_name(c) for c in p.components], p.type.__name__, *(["optional"] if p.optional else []))
        for p in _described(system)
    ]
    return (
        f"{system.label} {system.phase.name} {names(system.after)} {names(system.before)} {system.stream} {parameters}"
        + (f" {names(system.needs)}" if system.needs else "")
    )


def _describe_value(name: str, value: Any, known: list[FunctionType]) -> Iterator[str]:
    """Yield a value that code refers to.

    A user's function is added to `known`; other functions count by name.
    """

    def other(name: str, value: Any) -> Iterator[str]:
        function = getattr(value, "py_func", value)
        if isinstance(function, FunctionType) and is_outside(function) and not is_library(function):
            if function not in known:
                known.append(function)
            yield f"{name}=function {known.index(function)}"
        elif isinstance(value, dict):
            yield f"{name}=dict{len(value)}"
            for k, item in enumerate(value.items()):
                yield from described(f"{name}[{k}]", item, other)
        elif is_dataclass(value) and not isinstance(value, type):
            yield from other(name, {item.name: getattr(value, item.name) for item in fields(value)})
        else:
            yield name

    yield from described(name, value, other)
