"""The numbers of mechanics: their declarations with types and ranges, and their validation."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..kernels.errors import DeclarationError, NumberError
from .distributions import Distribution


def number(
    default: Any,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    above: float = -math.inf,
    choices: tuple[str, ...] = (),
    scales_with: str = "",
    per_agent: bool = False,
    free: bool = False,
    unit: str = "",
    about: str = "",
) -> Any:
    """Declare a number of a module, with its default and its range.

    Args:
        default: The value if a scenario does not set it.
        low: Inclusive lower bound.
        high: Inclusive upper bound.
        above: Exclusive lower bound.
        choices: The values of a number that is a str; kernels get the index.
        scales_with: The full name of another number ("room_size"): when a scenario changes that one, this one changes
            in proportion, unless it was set explicitly.
        per_agent: Whether roles may differ in it; only for an int or a float. Systems then read it by `of(reach, e)`,
            where e is the row of the agent.
        free: Whether worlds of a batch may have any value of the same length; only for a tuple (see
            distributions.free). Then only systems, and `check`, may depend on the value.
        unit: The unit in words, in the plural: "metres".
        about: Description, as in "radius of an agent", or of the case that it is True. `outlast numbers` prints it.

    Raises:
        DeclarationError: `scales_with`, `unit` or `about` is not a text.
    """
    for key, text in (("scales_with", scales_with), ("unit", unit), ("about", about)):
        if not isinstance(text, str):
            raise DeclarationError(f"number({default!r:.40}, ...) has {key}={text!r:.40}: a text is needed")
    rule = {"low": low, "high": high, "above": above, "choices": choices, "scales_with": scales_with}
    rule |= {"per_agent": per_agent, "free": free, "unit": unit, "about": about}
    return dataclasses.field(default=default, metadata=rule)


KINDS: dict[str, type] = {"int": int, "float": float, "bool": bool, "str": str, "tuple": tuple}


def kind_of(name: str, item: "dataclasses.Field[Any]") -> type:
    """Return the annotated type of a number. DeclarationError without a default of that type."""
    text = item.type if isinstance(item.type, str) else getattr(item.type, "__name__", str(item.type))
    kind = KINDS.get(text.partition("[")[0].strip())
    if kind is None or (kind is str and not item.metadata.get("choices")):
        raise DeclarationError(
            f"{name} is annotated {text}: a number is int, float, bool, tuple[float, ...], or str with choices, as in "
            'mode: str = number("slow", choices=("slow", "fast"))'
        )
    if item.default is dataclasses.MISSING or not item.init:
        raise DeclarationError(f"{name} needs a default, and init: declare {name.split('.')[1]}: {text} = number(3)")
    if not (type(item.default) is kind or (kind is float and type(item.default) is int)):
        raise DeclarationError(f"{name} is annotated {text}, but its default is {item.default!r}; let the two agree")
    if item.metadata.get("per_agent") and kind not in (int, float):
        raise DeclarationError(f"{name} is {text} and per_agent: roles can differ in an int or a float only")
    if item.metadata.get("scales_with") and kind not in (float, tuple):
        raise DeclarationError(f"{name} is {text} and scales with another number: only a float or a tuple can")
    if item.metadata.get("free") and kind is not tuple:
        raise DeclarationError(f"{name} is {text} and free: only a tuple can be; others have distributions")
    return kind


def checked(name: str, value: Any, kind: type, rule: Any) -> Any:
    """Return `value` as a `kind`, on which the compiled tick depends. NumberError if it violates `rule`."""
    if isinstance(value, Distribution):
        raise NumberError(f"{name} = {value!r}: a value is needed; Scenario.vary lets it differ from world to world")
    if kind is str:
        if not isinstance(value, str) or value not in rule["choices"]:
            raise NumberError(f"{name} = {value!r}: allowed are {', '.join(map(repr, rule['choices']))}")
        return value
    if kind is tuple:
        if not isinstance(value, (tuple, list)):
            raise NumberError(f"{name} = {value!r}: a tuple of numbers is needed")
        return tuple(checked(f"{name}[{k}]", element, float, rule) for k, element in enumerate(value))
    if kind is bool:
        if not isinstance(value, (bool, np.bool_)):
            raise NumberError(f"{name} = {value!r}: True or False is needed")
        return bool(value)
    integral = kind is int
    limit = 2**31 - 1 if integral else 3e38  # the maximum that a column can hold
    real = isinstance(value, (int, np.integer) if integral else (int, float, np.integer, np.floating))
    if not real or isinstance(value, bool) or not abs(value) <= limit:
        needed = "an integer below 2**31" if integral else "a finite number (below 3e38)"
        raise NumberError(f"{name} = {value!r}: {needed} is needed")
    low, high, above = (
        rule.get(key, end) for key, end in (("low", -math.inf), ("high", math.inf), ("above", -math.inf))
    )
    if not low <= value <= high or not value > above:
        least = f"> {above:g}" if math.isfinite(above) else f">= {low:g}"
        raise NumberError(f"{name} = {value!r}: must be {least}" + (f" and <= {high:g}" if math.isfinite(high) else ""))
    return int(value) if integral else float(value)


def owners(modules: Iterable[Any]) -> dict[str, tuple[int, str]]:
    """Return for every number, by full name, the index of its mechanic and its name in the mechanic."""
    found: dict[str, tuple[int, str]] = {}
    for k, module in enumerate(modules):
        for item in dataclasses.fields(module):
            if (name := f"{module.name}_{item.name}") in found:
                raise NumberError(f"two mechanics have the number '{name}': give one of them another name")
            found[name] = k, item.name
    return found


def full_name(modules: Iterable[Any], mechanic: str, name: str) -> str:
    """Return the full name of the number of a system's parameter: of its own mechanic, or any mechanic's in full."""
    own, known = f"{mechanic}_{name}", owners(modules)
    return own if own in known or name not in known else name


def is_read(
    modules: Sequence[Any], systems: Iterable[Any], full: str, kinds: Sequence[str] = ("number", "numbers")
) -> bool:
    """Return whether a parameter of one of these kinds, of one of the systems, is the number of that full name."""
    named = [(s.module, p.name) for s in systems for p in s.access if p.kind in kinds and full.endswith(p.name)]
    return any(full_name(modules, mechanic, name) == full for mechanic, name in named)


def kernel_value(modules: Sequence[Any], module: Any, system: Any, parameter: Any) -> tuple[str, Any]:
    """Return the full name and the value of the number named by a parameter of a mechanic's system.

    Raises:
        DeclarationError: The number does not exist, or its type is not the annotated one.
    """
    full = full_name(modules, module.name, parameter.name)
    owner = modules[owners(modules)[full][0]] if full == parameter.name else module
    value = owner.value(full.removeprefix(f"{owner.name}_"))
    if type(value) is not parameter.type:
        raise DeclarationError(
            f"{system.label}: parameter '{parameter.name}' is annotated {parameter.type.__name__}, but kernels get "
            f"this number as {type(value).__name__}; annotate it so"
        )
    return full, value


def rule_of(module: Any, field: str) -> Any:
    """Return the declaration of a mechanic's number by `number`."""
    return next(item.metadata for item in dataclasses.fields(module) if item.name == field)
