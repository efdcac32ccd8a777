"""Errors of environments, files and tools. The environment is as it was before the refused call.

Each one is also the error of Gymnasium, or of Python, that callers expect there.
"""

from importlib.metadata import PackageNotFoundError, requires

from gymnasium import error

from outlast.ecs.errors import NumberError, OutlastError


def install(extra: str) -> str:
    """What installs an extra of outlast, with the versions it takes: "pip install 'outlast[play]' (websockets>=14)".

    Wherever outlast was installed from, pip finds it there and needs no index for it, only for what is missing.
    """
    try:
        lines = requires("outlast") or []
    except PackageNotFoundError:  # imported from a folder, without having been installed
        lines = []
    given = [line.partition(";") for line in lines]
    named = [name.strip() for name, _, marker in given if f"'{extra}'" in marker.replace('"', "'")]
    versions = ", ".join(name for name in named if not name.startswith("outlast["))
    return f"pip install 'outlast[{extra}]'" + (f" ({versions})" if versions else "")


class ActionError(OutlastError, error.InvalidAction, ValueError):
    """Actions of the wrong shape or type, or out of range."""


class NotResetError(OutlastError, error.ResetNeeded, RuntimeError):
    """A step where there is no running episode."""


class ClosedError(OutlastError, error.ClosedEnvironmentError, RuntimeError):
    """A call after close()."""


class PendingError(OutlastError, error.AlreadyPendingCallError, error.NoAsyncCallError, RuntimeError):
    """A call between send() and recv() or while another thread is in one, or recv() without send()."""

    name = "step"  # the call, as in Gymnasium

    def __init__(self, message: str) -> None:
        Exception.__init__(self, message)  # Gymnasium's two constructors cannot be called one after the other


class FaultError(OutlastError, RuntimeError):
    """A world is in a state that cannot go on; only a reset of that world helps."""


class EndlessError(OutlastError, RuntimeError):
    """Whole episodes are asked for, and one does not end."""


class ScenarioError(OutlastError, ValueError):
    """An unknown variant or mechanic, or mechanics that do not go together; the message lists the known ones."""


class KeywordError(NumberError, TypeError):
    """A keyword that is neither a function's own nor a number of the scenario.

    Also a TypeError, in Python's words for one: TorchRL's GymEnv tries a keyword, and goes on without it after that.
    """


class StateError(OutlastError, ValueError):
    """A saved state that is broken, or of another scenario."""


class FilmError(OutlastError, ValueError):
    """Pictures or a film that cannot be drawn or written as asked; nothing is left half-written."""


class PageError(OutlastError, ValueError):
    """A page of worlds that do not exist, or of nothing."""


class RecordingError(OutlastError, ValueError):
    """A recording that is broken, or cannot be written or replayed."""


class ReplayError(RecordingError):
    """A replay that differs from its recording: names the first tick record and the components that differ."""


class ClusterError(OutlastError, RuntimeError):
    """A Ray cluster that does not exist, or does not do its work."""


class PlayError(OutlastError, RuntimeError):
    """A game or another live page that cannot begin: no such agent, no port, or no library to serve it with."""


class MessageError(OutlastError, ValueError):
    """A message of a page that the game does not understand; the text, at most 123 bytes, closes the connection."""


class UsageError(OutlastError, ValueError):
    """A mistake of use: the command line reports it in one line. Other packages derive their errors from it."""
