"""Errors of environments, files and tools. A refused call leaves the environment as it was.

Each one is also the error of Gymnasium, or of Python, that callers expect in such a case.
"""

import contextlib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires

from gymnasium import error

from outlast.ecs.kernels.errors import NumberError, OutlastError


def install(extra: str) -> str:
    """Return the command that installs an extra, with versions: "pip install 'outlast[window]' (pygame-ce>=2.5.3)".

    Wherever outlast was installed from, pip finds it installed, and needs an index only for what is missing.
    """
    try:
        lines = requires("outlast") or []
    except PackageNotFoundError:  # outlast was imported from a folder without being installed
        lines = []
    given = [line.partition(";") for line in lines]
    named = [name.strip() for name, _, marker in given if f"'{extra}'" in marker.replace('"', "'")]
    versions = ", ".join(name for name in named if not name.startswith("outlast["))
    return f"pip install 'outlast[{extra}]'" + (f" ({versions})" if versions else "")


@contextlib.contextmanager
def needed(extra: str, what: str, kind: type[Exception] | None = None) -> Iterator[None]:
    """Raise an error with the cure if a library that is imported inside is missing, or is too old.

    extra: What installs it. what: What needs it, as in "training needs {}", where {} stands for the library's name.
    """
    try:
        yield
    except ImportError as error:
        library = (error.name or "").partition(".")[0]
        if library == "outlast":
            raise
        found = "" if isinstance(error, ModuleNotFoundError) else f"; {error}"
        text = f"{what.replace('{}', library or 'a library')}: {install(extra)}{found}"
        raise (ModuleNotFoundError(text, name=library) if kind is None else kind(text)) from error


class ActionError(OutlastError, error.InvalidAction, ValueError):
    """Actions of the wrong shape or type, or out of range."""


class NotResetError(OutlastError, error.ResetNeeded, RuntimeError):
    """A call that needs a running episode."""


class ClosedError(OutlastError, error.ClosedEnvironmentError, RuntimeError):
    """A call after close()."""


class PendingError(OutlastError, error.AlreadyPendingCallError, error.NoAsyncCallError, RuntimeError):
    """A call between send() and recv() or while another thread is in a call, or recv() without send()."""

    name = "step"  # the pending call, which Gymnasium's errors name in this attribute

    def __init__(self, message: str) -> None:
        Exception.__init__(self, message)  # the constructors of Gymnasium's two errors cannot both be called


class FaultError(OutlastError, RuntimeError):
    """A world is in a state from which it cannot go on; only a reset of that world helps."""


class EndlessError(OutlastError, RuntimeError):
    """A request for complete episodes, one of which does not end."""


class ScenarioError(OutlastError, ValueError):
    """An unknown variant or mechanic (the message lists the known ones), or mechanics that do not go together."""


class KeywordError(NumberError, TypeError):
    """A keyword that is neither a parameter of the function nor a number of the scenario.

    Also a TypeError, worded like Python's own: TorchRL's GymEnv tries a keyword, and goes on without it after that.
    """


class StateError(OutlastError, ValueError):
    """A saved state that is damaged, or of another scenario."""


class FilmError(OutlastError, ValueError):
    """Pictures or a film that cannot be drawn or written as requested; nothing is left half-written."""


class PageError(OutlastError, ValueError):
    """A page that cannot be written, or whose worlds do not exist."""


class RecordingError(OutlastError, ValueError):
    """A recording that is damaged, or cannot be written or replayed."""


class ReplayError(RecordingError):
    """A replay that differs from its recording; the message names the first differing tick and its components."""


class ClusterError(OutlastError, RuntimeError):
    """A Ray cluster that does not exist, or does not complete its work."""


class PlayError(OutlastError, RuntimeError):
    """A game or another live page that cannot begin: no such agent, no port, or no library to serve it with."""


class MessageError(OutlastError, ValueError):
    """A message of a page that the game does not understand; the text, at most 123 bytes, closes the connection."""


class UsageError(OutlastError, ValueError):
    """A mistake in usage, which the command line reports in one line. Other packages derive their errors from it."""
