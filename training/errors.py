"""What training and evaluation refuse."""

from outlast.envs.errors import UsageError


class TrainingError(UsageError):
    """A run that cannot begin or go on: a folder in use, or a checkpoint that is broken or of something else.

    Attributes:
        lost: Whether nothing is wrong but that another process of the run has ended.
    """

    def __init__(self, text: str = "", *, lost: bool = False) -> None:
        super().__init__(text)
        self.lost = lost


class EmptyRunError(TrainingError):
    """A run without a curve, as no episode has ended in it yet."""
