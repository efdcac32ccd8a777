"""Public names that are loaded when they are first asked for, from the stub that type checkers read."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import NoReturn

from .envs.errors import install as _install


def attach(module: str, file: str) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a module that has a stub.

    Args:
        module: Its name.
        file: Its path.
    """
    places = _places(Path(file).with_suffix(".pyi"))
    package = module if Path(file).name == "__init__.py" else module.rpartition(".")[0]

    def get(name: str) -> object:
        if name not in places:
            others = (stub for stub in Path(file).parent.glob("*.pyi") if name in _places(stub))
            hint = next((f"; did you mean {package}.{stub.stem}.{name}?" for stub in others), "")
            raise AttributeError(
                f"module '{module}' has no attribute '{name}'{hint}", name=name, obj=sys.modules[module]
            )
        place, member = places[name]
        try:
            found = import_module(place, package)
        except ModuleNotFoundError as error:
            return Missing(f"{module}.{name}", place, error)
        return getattr(found, member) if member else found

    return get, lambda: [*places, *(["__version__"] if module == package else [])], [*places]


def _places(stub: Path) -> dict[str, tuple[str, str]]:
    """Return the public names in a stub: the module that has each, and its name there, "" for the module itself."""
    found = dict[str, tuple[str, str]]()
    for each in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(each, ast.ImportFrom):
            for one in each.names:
                found[one.name] = "." * each.level + (each.module or one.name), one.name if each.module else ""
    return found


class Missing:
    """A public name whose library is not installed: an error when it is called, or a class is derived from it.

    As an attribute it is there, since `hasattr`, `from outlast import *` and tools that list members stop at errors.
    """

    def __init__(self, name: str, place: str, error: ModuleNotFoundError) -> None:
        self.__name__, self._error, self.__doc__ = name, error, str(error)
        if place.startswith(".training.") and "pip install" not in str(error):
            self.__doc__ = f"{name} needs {error.name}: {_install('train')}"

    def __call__(self, *args: object, **kwargs: object) -> NoReturn:
        """Raise ModuleNotFoundError."""
        raise ModuleNotFoundError(self.__doc__, name=self._error.name) from self._error

    __mro_entries__ = __call__

    def __repr__(self) -> str:
        return f"<{self.__doc__}>"
