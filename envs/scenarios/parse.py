"""Scenarios, mechanics, distributions and roles from what users type. This may import code: never use it for files.

Scenarios and mechanics may be in files and modules, "mygame.py:arena", "package.module:Swamp"; scenarios also in
installed packages, as entry points of the group `outlast.scenarios`, NAME = "package.module:scenario".
"""

import ast
import dataclasses
import difflib
import functools
import importlib
import importlib.util
import inspect
import logging
import os
import re
import sys
import traceback
from collections.abc import Callable, Collection, Iterable, Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

from outlast.ecs import Distribution, Module, NumberError
from outlast.ecs.kernels.errors import did_you_mean
from outlast.ecs.kernels.frozen_values import LIBRARIES

from ..errors import KeywordError, ScenarioError
from ..storage import inputs
from ..storage.inputs import read_text
from .scenario import Scenario
from .scenario_json import distribution_of, imported, roles_of
from .variants import ALIASES, VARIANTS, ablated, variant

LOGGER = logging.getLogger("outlast")
GROUP = "outlast.scenarios"
NOT_THEIRS = {*LIBRARIES, "outlast"}  # packages in whose code a user's mistake cannot be
Params = ParamSpec("Params")
Result = TypeVar("Result")
NAME = re.compile(r"(?P<place>.+\.(py|json)|[^:+]*)(:(?P<name>[^:+]*))?(?P<ablations>(\+[^:+]*)*)")
MECHANIC = re.compile(r"((?P<place>.+\.py|[\w.]+):)?(?P<name>\w+)(?P<numbers>\(.*\))?", re.DOTALL)
FOREIGN = {"num_worlds": ("num_envs", "n_envs")}  # other libraries' words for arguments
OWN = "one of your own is FILE.py:NAME, package.module:NAME or FILE.json"
ROLES = '{"drawn": "never", "roles": [{"name": "hunter", "count": 1, "numbers": {"melee_damage": 20}}, ...]}'


def named(text: str) -> Scenario:
    """Return the scenario that a user names; if it has no name of its own, it is called as it is named here.

    text: "teams_2", a variant. "FILE.py:NAME" or "package.module:NAME", a Scenario, or a function without arguments
    that returns one, in a file or module, which is imported. "FILE.py", the only Scenario in it. "FILE.json", what
    `Scenario.save` wrote. "NAME", an installed package's scenario. Each may be followed by ablations, as in
    "teams_2+health_cap". Raises ScenarioError.
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

    Raises ScenarioError for what is neither a Scenario nor the name of one, KeywordError for a number that it does not
    have, and NumberError for a value out of its range.
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

    text: "DropLast" or "DropLast(offset=2.0)": one of outlast's mechanics, or of those imported already;
    "FILE.py:Swamp(drag=0.3)" or "package.module:Swamp": one from a file or module, which is imported. Numbers are
    literals: nothing is evaluated. Raises ScenarioError; NumberError for a number out of its range.
    """
    match = MECHANIC.fullmatch(text.strip())
    if match is None:
        raise ScenarioError(f"{text}: a mechanic is needed, as in 'DropLast(offset=2.0)' or FILE.py:NAME")
    kind = mechanic_in(match["place"], match["name"]) if match["place"] else _known(match["name"])
    given = _literals(text, match["numbers"] or "()", [item.name for item in dataclasses.fields(kind)])
    made = kind(**given)
    return made, [f"{made.name}_{number}" for number in given]


def distribution(text: str) -> Distribution:
    """Return the distribution that a user names: "uniform(5, 20)", "integers(2, 8)", "choice(1, 2, 3)" ...

    Values are literals or words without quotes (true and false are booleans); nothing is evaluated. Raises
    ScenarioError for another text; NumberError if nothing can be drawn from the values.
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

    Raises ScenarioError for a file that cannot be read or is something else; NumberError for roles that do not fit.
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


def module_of(place: str) -> ModuleType:
    """Import what a user names: a module, or a file as a module; ScenarioError if that is not possible.

    As for a script, the file's folder is added to `sys.path`. So the file can import its neighbours, other processes
    can load pickles of its mechanics, and a file that is named twice is imported only once. A file within a package is
    imported as a module of that package.
    """
    return _import_file(place) if place.endswith(".py") else _import_module(place)


def scenario_in(place: str, name: str, offered: str = "") -> Scenario:
    """Return a scenario in a file or module, which is imported. Raises ScenarioError as `module_of`, or if unknown.

    name: That of a Scenario there, or of a function without arguments that returns one. "": the only Scenario.
    offered: How a scenario without a name of its own is called; "": by its name there.
    """
    module = module_of(place)
    own = {key: value for key, value in vars(module).items() if isinstance(value, Scenario)}
    if not name:
        if len(set(map(id, own.values()))) != 1:
            cure = f"name one, as in {place}:{next(iter(own))}" if own else _how_to_hold_one(module, place)
            raise ScenarioError(f"{place} holds {', '.join(own) if own else 'no Scenario'}: {cure}")
        name = next(iter(own))
    found = member_of(module, name, place, own)
    if callable(found):
        found = _guarded(f"{place}:{name}", found)
    if not isinstance(found, Scenario):
        raise ScenarioError(
            f"{place}:{name} is {type(found).__name__} {found!r:.60}: a Scenario is needed, or a function without "
            "arguments that returns one"
        )
    return found.known_as(offered or name)


def _how_to_hold_one(module: ModuleType, place: str) -> str:
    """Return the cure for a module without a scenario, with the first of its own mechanics."""
    kinds = [each for each in vars(module).values() if isinstance(each, type) and each.__module__ == module.__name__]
    added = next((f".with_({each.__name__}())" for each in kinds if issubclass(each, Module)), "")
    return f'add one, as in GAME = outlast.variant("ffa_1"){added}, or name what makes one, {place}:FUNCTION'


def mechanic_in(place: str, name: str) -> type[Module]:
    """Return the class of a mechanic in a file or module, which is imported. Raises ScenarioError as `scenario_in`."""
    module = module_of(place)
    own = {key: value for key, value in vars(module).items() if isinstance(value, type) and issubclass(value, Module)}
    found = member_of(module, name, place, own)
    if name not in own:
        raise ScenarioError(f"{place}:{name} is {type(found).__name__} {found!r:.60}: a class of mechanics is needed")
    return own[name]


def member_of(module: ModuleType, name: str, place: str, wanted: Collection[str]) -> Any:
    """Return the member of that name of a module, which the user called `place`.

    Raises a ScenarioError that lists the names in `wanted` if it does not exist.
    """
    if not hasattr(module, name):
        own = [key for key, value in vars(module).items() if getattr(value, "__module__", None) == module.__name__]
        hint = did_you_mean(name, [*wanted, *own], after=" ")
        raise ScenarioError(f"{place} has no '{name}'; {hint}known: {', '.join(wanted) or 'none'}")
    return getattr(module, name)


def _import_module(name: str) -> ModuleType:
    try:
        found = importlib.util.find_spec(name) if all(name.split(".")) else None
    except ModuleNotFoundError:
        found = None
    except Exception as error:  # raised by a package around it, which find_spec imports
        raise _failed(name, error) from error
    if found is None:
        file = Path(f"{name.replace('.', '/')}.py")
        hint = f"; the file is named {file}" if file.is_file() else ""
        raise ScenarioError(f"there is no module {name}{hint}")
    return _guarded(name, lambda: importlib.import_module(name))


def _import_file(text: str) -> ModuleType:
    path = Path(text)
    if not path.is_file():
        hint = did_you_mean(path.name, (file.name for file in path.parent.glob("*.py")), before="; ", count=1)
        raise ScenarioError(f"there is no file {text}{hint}")
    path = path.resolve()
    parts, folder = [path.stem], path.parent
    while (folder / "__init__.py").is_file():
        parts, folder = [folder.name, *parts], folder.parent
    name = ".".join(parts)
    if not all(part.isidentifier() for part in parts):
        raise ScenarioError(f"{text} cannot be imported: '{name}' is not a name of a module; rename the file")
    added = str(folder) not in sys.path
    if added:
        sys.path.insert(0, str(folder))
    try:
        importlib.invalidate_caches()  # the file may have been written just now
        module = _guarded(text, lambda: importlib.import_module(name))
        origin = getattr(module, "__file__", None)
        if origin is None or not path.samefile(origin):
            raise ScenarioError(f"{text} cannot be imported: '{name}' is {origin or 'built into Python'}; rename it")
    except BaseException:
        if added:
            sys.path.remove(str(folder))
        raise
    return module


def _guarded(shown: str, call: Callable[[], Result]) -> Result:
    """Call a user's code. If it raises an error, raise ScenarioError with the place and message of that."""
    try:
        return call()
    except (Exception, SystemExit) as error:
        raise _failed(shown, error) from error


def _failed(shown: str, error: BaseException) -> ScenarioError:
    """Return an error of one line: what the user's code raised, and the last of the user's lines that ran."""
    if isinstance(error, SyntaxError) and error.filename:
        return ScenarioError(f"{error.filename}, line {error.lineno}: {type(error).__name__}: {error.msg}")
    places = [
        f"{frame.f_code.co_filename}, line {line}"
        for frame, line in traceback.walk_tb(error.__traceback__)
        if str(frame.f_globals.get("__name__")).partition(".")[0] not in NOT_THEIRS
    ]
    place = places[-1] if places else shown
    text = " ".join(str(error).split())
    return ScenarioError(f"{place}: {type(error).__name__}{text and f': {text}'}")


@functools.cache  # cached, so that each warning is given once
def installed() -> dict[str, EntryPoint]:
    """Return the scenarios of installed packages by name, without importing anything of them.

    A scenario that cannot be used by its name is left out, with a warning that names the package.
    """
    found = dict[str, EntryPoint]()
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, package(entry))):
        if entry.name in VARIANTS or entry.name in ALIASES:
            problem = "that is the name of a variant"
        elif not re.fullmatch(r"[A-Za-z][\w-]*", entry.name):
            problem = "a name has letters, digits, - and _ only"
        elif entry.name in found and found[entry.name].value != entry.value:
            problem = f"{package(found[entry.name])} has one of that name, too"
        else:
            found[entry.name] = entry
            continue
        LOGGER.warning("the scenario '%s' of the package %s is left out: %s", entry.name, package(entry), problem)
    return found


def package(entry: EntryPoint) -> str:
    """Return the name of the package that an entry point belongs to."""
    return entry.dist.name if entry.dist else entry.module


def scenario_of_package(entry: EntryPoint) -> Scenario:
    """Import the scenario of an entry point. Raises a ScenarioError that names the package."""
    try:
        return scenario_in(entry.module, entry.attr, entry.name)
    except ScenarioError as error:
        raise ScenarioError(f"the scenario '{entry.name}' of the package {package(entry)}: {error}") from error
