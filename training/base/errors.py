"""The errors of training and evaluation."""

from collections.abc import Iterator
from contextlib import contextmanager

from outlast.envs.errors import UsageError, install


class TrainingError(UsageError):
    """A run cannot begin or continue: its folder is in use, or a checkpoint is damaged or belongs to another run.

    lost: Whether the only cause is that another process of the run has ended.
    """

    def __init__(self, text: str = "", *, lost: bool = False) -> None:
        super().__init__(text)
        self.lost = lost


class EmptyRunError(TrainingError):
    """A run has no curve because no episode of it has ended yet."""


@contextmanager
def needed(extra: str, what: str) -> Iterator[None]:
    """Raise a TrainingError if a library that is imported inside is missing: it names the feature and the extra.

    what: Beginning of the message, such as "figures need".
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise TrainingError(f"{what} {error.name}: {install(extra)}") from error
