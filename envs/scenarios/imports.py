"""Scenarios and mechanics in files and modules that the user names: "mygame.py:arena", "package.module:Swamp".

Also scenarios of installed packages: entry points of the group `outlast.scenarios`, NAME = "package.module:scenario".
"""

import functools
import importlib
import importlib.util
import logging
import re
import sys
import traceback
from collections.abc import Callable, Collection
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from outlast.ecs import Module
from outlast.ecs.kernels.errors import did_you_mean
from outlast.ecs.kernels.frozen_values import LIBRARIES

from ..errors import ScenarioError
from .scenario import Scenario
from .variants import ALIASES, VARIANTS

Result = TypeVar("Result")
GROUP = "outlast.scenarios"
LOGGER = logging.getLogger("outlast")
NOT_THEIRS = {*LIBRARIES, "outlast"}  # packages in whose code a user's mistake cannot be


def module_of(place: str) -> ModuleType:
    """Import what a user names: a module, or a file as a module.

    As for a script, the file's folder is added to `sys.path`. So the file can import its neighbours, other processes
    can load pickles of its mechanics, and a file that is named twice is imported only once. A file within a package is
    imported as a module of that package.

    Args:
        place: "FILE.py", or "package.module".

    Raises:
        ScenarioError: The file or module does not exist, it raises an exception, or its name is that of another module.
    """
    return _import_file(place) if place.endswith(".py") else _import_module(place)


def scenario_in(place: str, name: str, offered: str = "") -> Scenario:
    """Return a scenario in a file or module, which is imported.

    Args:
        place: The file or module, as for `module_of`.
        name: Name of a Scenario there, or of a function without arguments that returns one. "": the only Scenario.
        offered: How a scenario without a name of its own is called; "": by its name there.

    Raises:
        ScenarioError: The scenario is unknown, or the file or module cannot be imported (see `module_of`).
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

    Raises:
        ScenarioError: The member does not exist; the message lists the names in `wanted`.
    """
    if not hasattr(module, name):
        own = [key for key, value in vars(module).items() if getattr(value, "__module__", None) == module.__name__]
        hint = did_you_mean(name, [*wanted, *own], after=" ")
        raise ScenarioError(f"{place} has no '{name}'; {hint}known: {', '.join(wanted) or 'none'}")
    return getattr(module, name)


def _import_module(name: str) -> ModuleType:
    """Import a module by its name. Raises ScenarioError if that is not possible."""
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
    """Import a file as a module. Raises ScenarioError if that is not possible."""
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
