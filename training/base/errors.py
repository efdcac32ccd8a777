"""The errors of training and evaluation."""

from collections.abc import Iterator
from contextlib import contextmanager

from outlast.envs.errors import UsageError, install


class TrainingError(UsageError):
    """A run cannot begin or go on: its folder is in use, or a checkpoint is damaged or belongs to something else.

    lost: Whether the only problem is that another process of the run has ended.
    """

    def __init__(self, text: str = "", *, lost: bool = False) -> None:
        super().__init__(text)
        self.lost = lost


class EmptyRunError(TrainingError):
    """A run has no curve, since no episode has ended in it yet."""


@contextmanager
def needed(extra: str, what: str) -> Iterator[None]:
    """Turn the lack of a library that is imported inside into a TrainingError: what needs it, and the extra to install.

    what: The beginning of the message, as "figures need".
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise TrainingError(f"{what} {error.name}: {install(extra)}") from error
