"""The errors of training and evaluation."""

from outlast.envs.errors import UsageError


class TrainingError(UsageError):
    """A run cannot begin or go on: its folder is in use, or a checkpoint is damaged or belongs to something else.

    lost: Whether the only problem is that another process of the run has ended.
    """

    def __init__(self, text: str = "", *, lost: bool = False) -> None:
        super().__init__(text)
        self.lost = lost


class EmptyRunError(TrainingError):
    """A run has no curve, since no episode has ended in it yet."""
