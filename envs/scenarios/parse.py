"""Scenarios, mechanics, distributions and roles from what users type. This may import code: never use it for files."""

import ast
import dataclasses
import difflib
import functools
import inspect
import os
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from outlast.ecs import Distribution, Module, NumberError
from outlast.ecs.kernels.errors import did_you_mean

from ..errors import KeywordError, ScenarioError
from ..storage import inputs
from ..storage.inputs import read_text
from .imports import installed, mechanic_in, scenario_in, scenario_of_package
from .mechanics import imported
from .scenario import Scenario
from .scenario_json import distribution_of, roles_of
from .variants import ALIASES, VARIANTS, ablated, variant

Params = ParamSpec("Params")
Result = TypeVar("Result")
NAME = re.compile(r"(?P<place>.+\.(py|json)|[^:+]*)(:(?P<name>[^:+]*))?(?P<ablations>(\+[^:+]*)*)")
MECHANIC = re.compile(r"((?P<place>.+\.py|[\w.]+):)?(?P<name>\w+)(?P<numbers>\(.*\))?", re.DOTALL)
FOREIGN = {"num_worlds": ("num_envs", "n_envs")}  # other libraries' words for arguments
OWN = "one of your own is FILE.py:NAME, package.module:NAME or FILE.json"
ROLES = '{"drawn": "never", "roles": [{"name": "hunter", "count": 1, "numbers": {"melee_damage": 20}}, ...]}'


def named(text: str) -> Scenario:
    """Return the scenario that a user names; if it has no name of its own, it is called as it is named here.

    Args:
        text: "teams_2", a variant. "FILE.py:NAME" or "package.module:NAME", a Scenario, or a function without
            arguments that returns one, in a file or module, which is imported. "FILE.py", the only Scenario in it.
            "FILE.json", what `Scenario.save` wrote. "NAME", an installed package's scenario. Each may be followed by
            ablations, as in "teams_2+health_cap".

    Raises:
        ScenarioError: The scenario is unknown, an ablation does not fit it, or what is imported raises an exception.
    """
    match = NAME.fullmatch(text)
    if match is None:
        raise ScenarioError(f"{text!r} is not a name of a scenario; {OWN}")
    place, name = match["place"], match["name"]
    ablations = match["ablations"].split("+")[1:]
    if place.endswith(".json") and name is None:
        found = Scenario.load(place).known_as(Path(place).stem)
    elif place.endswith(".py") or name is not None:
        found = scenario_in(place, name or "")
    elif place in installed():
        found = scenario_of_package(installed()[place])
    elif place in VARIANTS or place in ALIASES:
        return variant(text)
    else:
        known = [*VARIANTS, *ALIASES, *installed()]
        hint = did_you_mean(place, known, after=" ")
        raise ScenarioError(f"there is no variant '{place}'; {hint}known: {', '.join(known)}; {OWN}")
    return ablated(found, ablations) if ablations else found


def checks_keywords(make: Callable[Params, Result]) -> Callable[Params, Result]:
    """Decorate a function that takes numbers of a scenario as keywords.

    A keyword that misspells a required argument would be read as a number, and Python would only report that the
    argument is missing: instead, KeywordError names both.
    """
    needed = [
        name
        for name, each in inspect.signature(make).parameters.items()
        if each.kind is each.POSITIONAL_OR_KEYWORD and each.default is each.empty
    ]

    @functools.wraps(make)
    def checked(*given: Params.args, **keywords: Params.kwargs) -> Result:
        for name in needed[len(given) :]:
            words = {*difflib.get_close_matches(name, keywords, 1), *FOREIGN.get(name, ())}
            if name not in keywords and (close := [word for word in keywords if word in words]):
                raise KeywordError(f"unexpected keyword argument {close[0]!r}: did you mean {name}?")
        return make(*given, **keywords)

    return checked


def options_of(make: Callable[..., Any]) -> tuple[str, ...]:
    """Return the names of a function's own arguments, which are not numbers of a scenario."""
    return tuple(name for name, each in inspect.signature(make).parameters.items() if each.kind is not each.VAR_KEYWORD)


def resolve(
    scenario: Scenario | str, numbers: Mapping[str, Any] | None = None, options: Iterable[str] = ()
) -> Scenario:
    """Return the scenario that a function was called with, by its name (see `named`), with these numbers changed.

    options: Names of the function's own keywords, so that the error for "thread" asks "did you mean threads?".

    Raises:
        ScenarioError: `scenario` is unknown, or neither a name nor a Scenario.
        KeywordError: The scenario does not have one of the numbers.
        NumberError: A value is out of its range.
    """
    if isinstance(scenario, str):
        scenario = named(scenario)
    if not isinstance(scenario, Scenario):
        raise ScenarioError(f"{scenario!r}: a Scenario or the name of one is needed; {OWN}")
    if not numbers:
        return scenario
    for name in numbers:
        try:
            scenario.find_number(name, options)
        except NumberError as error:
            raise KeywordError(f"unexpected keyword argument {name!r}: {error}") from None
    return scenario.replace(**numbers)


def mechanic(text: str) -> tuple[Module, list[str]]:
    """Return a mechanic that a user names, and the full names of the numbers that the text gives it.

    Args:
        text: "DropLast" or "DropLast(offset=2.0)": one of outlast's mechanics, or of those imported already;
            "FILE.py:Swamp(drag=0.3)" or "package.module:Swamp": one from a file or module, which is imported. Numbers
            are literals: nothing is evaluated.

    Raises:
        ScenarioError: The mechanic or its number is unknown.
        NumberError: A number is out of its range.
    """
    match = MECHANIC.fullmatch(text.strip())
    if match is None:
        raise ScenarioError(f"{text}: a mechanic is needed, as in 'DropLast(offset=2.0)' or FILE.py:NAME")
    kind = mechanic_in(match["place"], match["name"]) if match["place"] else _known(match["name"])
    given = _literals(text, match["numbers"] or "()", [item.name for item in dataclasses.fields(kind)])
    made = kind(**given)
    return made, [f"{made.name}_{number}" for number in given]


def distribution(text: str) -> Distribution:
    """Return the distribution that a user names.

    Args:
        text: "uniform(5, 20)", "log_uniform(0.1, 10)", "integers(2, 8)" or "choice(1, 2, 3)". Values are literals or
            words without quotes (true and false are booleans); nothing is evaluated.

    Raises:
        ScenarioError: The text is something else.
        NumberError: Nothing can be drawn from the values.
    """
    try:
        call = ast.parse(text.strip(), mode="eval").body
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name)) or call.keywords:
            raise ValueError(text)
        name, values = call.func.id, [_literal(value) for value in call.args]
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        raise ScenarioError(
            f"{text:.80}: a distribution of literals is needed, as in 'uniform(5, 20)', 'integers(2, 8)' or "
            "'choice(1, 2, 3)'"
        ) from None
    return distribution_of(name, *values)


def with_roles(scenario: Scenario, path: str | os.PathLike[str]) -> Scenario:
    """Return the scenario with the roles in a file, which has the form ROLES; see scenario_json.plain_roles.

    Raises:
        ScenarioError: The file cannot be read, or is something else.
        NumberError: The roles are not possible in this scenario.
    """
    name = os.fspath(path)
    try:
        given = inputs.parse_json(read_text(path))
        found = roles_of(given)
    except OSError as error:
        raise ScenarioError(f"{name} cannot be read: {error.strerror}") from error
    except inputs.BROKEN_JSON as error:
        reason = f"{error}; " if isinstance(error, ValueError) else ""
        raise ScenarioError(f"{name} does not hold roles: {reason}as in {ROLES}") from error
    try:
        named: Any = {each.name: each for each in found.roles}
        return scenario.roles(drawn=found.drawn, **named)
    except NumberError as error:
        raise NumberError(f"{name}: {error}") from None


def _literal(value: ast.expr) -> Any:
    if isinstance(value, ast.Name):
        return {"true": True, "false": False}.get(value.id, value.id)
    return ast.literal_eval(value)


def _known(name: str) -> type[Module]:
    """Return the imported mechanic with that name of its class. Raises ScenarioError if it is unknown."""
    # outlast's own come last, so they replace others of the same name
    known = {kind.__name__: kind for kind in imported().values()}
    if name not in known:
        hint = did_you_mean(name, known, after=" ")
        raise ScenarioError(
            f"there is no mechanic {name}; {hint}known: {', '.join(sorted(known))}; one of your own is FILE.py:NAME"
        )
    return known[name]


def _literals(text: str, call: str, known: Collection[str]) -> dict[str, Any]:
    """Return the keywords of a call, such as "(offset=2.0)". Raises ScenarioError unless all are known and literals."""
    try:
        tree = ast.parse(f"f{call}", mode="eval").body
        if not isinstance(tree, ast.Call) or tree.args:
            raise ValueError(call)
        found = {str(keyword.arg): ast.literal_eval(keyword.value) for keyword in tree.keywords}
        if len(found) < len(tree.keywords):
            raise ValueError(call)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        raise ScenarioError(f"{text}: numbers are given as in '(offset=2.0, mode=\"name\")', each once") from None
    if unknown := found.keys() - set(known):
        raise ScenarioError(f"{text}: there is no number {min(unknown)}; it has: {', '.join(known) or 'none'}")
    return found


def typed(text: str, now: Any) -> Any:
    """Convert a text to the type of another value; return the text, which is refused later, if it has no such value."""
    if isinstance(now, tuple):  # 8,4 or (8, 4)
        return tuple(typed(part, 1.0) for part in text.strip("()[]").rstrip(",").split(","))
    if isinstance(now, bool):
        return {"true": True, "false": False}.get(text.lower(), text)
    if isinstance(now, str):
        return text.strip("'\"")
    try:
        value = float(text)
    except ValueError:
        return text
    return int(value) if isinstance(now, int) and value.is_integer() else value  # 1e3 is an integer, too
