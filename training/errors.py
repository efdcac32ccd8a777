"""What training and evaluation refuse."""

from outlast.envs.errors import UsageError


class TrainingError(UsageError):
    """A run that cannot begin or go on: a folder in use, or a checkpoint that is broken or of something else."""
