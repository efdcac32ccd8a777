"""Scenarios in Python files and modules that the user names: "mygame.py:arena", "package.module:arena"."""

import difflib
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from outlast.ecs.identity import LIBRARIES

from ..errors import ScenarioError
from .scenario import Scenario

Result = TypeVar("Result")
NOT_THEIRS = {*LIBRARIES, "outlast"}  # packages whose lines are not where a user's mistake is


def scenario_in_file(text: str, name: str) -> Scenario:
    """A scenario in a Python file, which is imported as a module: its folder joins `sys.path`, as a script's does.

    So the file can import its neighbours, other processes can load pickles of its mechanics, and a file that is named
    twice is imported once. One within a package is imported as a module of that package.

    Args:
        text: Path of the file.
        name: Of a Scenario in it, or of a function without arguments that returns one. "": the only Scenario there.

    Raises:
        ScenarioError: There is no such file or scenario, the file raises an exception, or its name is that of another
            module.
    """
    path = Path(text)
    if not path.is_file():
        near = difflib.get_close_matches(path.name, [file.name for file in path.parent.glob("*.py")], 1)
        hint = f"; did you mean {path.with_name(near[0])}?" if near else ""
        raise ScenarioError(f"there is no file {text}{hint}")
    return _member(_import_file(path.resolve(), text), name, text)


def scenario_in_module(module: str, name: str) -> Scenario:
    """A scenario in a module that can be imported: see `scenario_in_file`. Raises ScenarioError."""
    try:
        found = importlib.util.find_spec(module) if all(module.split(".")) else None
    except ModuleNotFoundError:
        found = None
    except Exception as error:  # of a package around it, which is imported
        raise _failed(module, error) from error
    if found is None:
        file = Path(f"{module.replace('.', '/')}.py")
        hint = f"; for the file, write {file}:{name}" if file.is_file() else ""
        raise ScenarioError(f"there is no module {module}{hint}")
    return _member(_guarded(module, lambda: importlib.import_module(module)), name, module)


def _import_file(path: Path, shown: str) -> ModuleType:
    """The module of a file. Raises ScenarioError."""
    parts, folder = [path.stem], path.parent
    while (folder / "__init__.py").is_file():
        parts, folder = [folder.name, *parts], folder.parent
    name = ".".join(parts)
    if not all(part.isidentifier() for part in parts):
        raise ScenarioError(f"{shown} cannot be imported: '{name}' is no name of a module; rename the file")
    added = str(folder) not in sys.path
    if added:
        sys.path.insert(0, str(folder))
    try:
        module = _guarded(shown, lambda: importlib.import_module(name))
        origin = getattr(module, "__file__", None)
        if origin is None or not path.samefile(origin):
            raise ScenarioError(f"{shown} cannot be imported: '{name}' is {origin or 'built into Python'}; rename it")
    except BaseException:
        if added:
            sys.path.remove(str(folder))
        raise
    return module


def _member(module: ModuleType, name: str, shown: str) -> Scenario:
    """The scenario of that name in a module, or the only one. Raises ScenarioError."""
    own = {key: value for key, value in vars(module).items() if isinstance(value, Scenario)}
    if not name:
        if len(set(map(id, own.values()))) != 1:
            cure = f"name one, as in {shown}:{next(iter(own))}" if own else f"name what makes one, {shown}:FUNCTION"
            raise ScenarioError(f"{shown} holds {', '.join(own) if own else 'no Scenario'}: {cure}")
        name = next(iter(own))
    if not hasattr(module, name):
        makers = [key for key, value in vars(module).items() if _is_function_of(value, module)]
        near = difflib.get_close_matches(name, [*own, *makers], 2)
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        raise ScenarioError(f"{shown} has no '{name}'; {hint}Scenarios in it: {', '.join(own) or 'none'}")
    found: Any = getattr(module, name)
    if callable(found):
        found = _guarded(f"{shown}:{name}", found)
    if not isinstance(found, Scenario):
        raise ScenarioError(
            f"{shown}:{name} is {type(found).__name__} {found!r:.60}: a Scenario is needed, or a function without "
            "arguments that returns one"
        )
    return found


def _is_function_of(value: Any, module: ModuleType) -> bool:
    return callable(value) and getattr(value, "__module__", None) == module.__name__


def _guarded(shown: str, call: Callable[[], Result]) -> Result:
    """What a user's code returns. Raises ScenarioError, with the place and the message of what it raises."""
    try:
        return call()
    except (Exception, SystemExit) as error:
        raise _failed(shown, error) from error


def _failed(shown: str, error: BaseException) -> ScenarioError:
    """In one line, what the user's code raised, and where: in the last of its own lines that ran."""
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
