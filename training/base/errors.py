"""The errors of training and evaluation."""

from outlast.envs.errors import UsageError


class TrainingError(UsageError):
    """A run cannot begin or continue: its folder is in use, or a checkpoint is damaged or belongs to another run.

    lost: Whether the only cause is that another process of the run has ended.
    """

    def __init__(self, text: str = "", *, lost: bool = False) -> None:
        super().__init__(text)
        self.lost = lost


class EmptyRunError(TrainingError):
    """A run has no curve because no episode of it has ended yet."""
