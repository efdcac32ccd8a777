"""What the faces refuse. The environment is as it was before the refused call."""


class ActionError(ValueError):
    """Actions of the wrong shape or type, or out of range."""


class NotResetError(RuntimeError):
    """A step where there is no running episode."""


class ClosedError(RuntimeError):
    """A call after close()."""


class PendingError(RuntimeError):
    """A call between send() and recv() or while another thread is in one, or recv() without send()."""


class FaultError(RuntimeError):
    """A world is in a state that cannot go on; only a reset of that world helps."""


class EndlessError(RuntimeError):
    """Whole episodes are asked for, and one does not end."""


class StateError(ValueError):
    """A saved state that is broken, or of another scenario."""


class FilmError(ValueError):
    """Pictures or a film that cannot be drawn or written as asked; nothing is left half-written."""


class PageError(ValueError):
    """A page of worlds that are not there, or of nothing."""


class RecordingError(ValueError):
    """A recording that is broken, or cannot be written or replayed."""


class ReplayError(RecordingError):
    """A replay that is not what was recorded: names the first run of the tick and the components that differ."""


class ClusterError(RuntimeError):
    """A Ray cluster that is not there, or does not do its work."""


class PlayError(RuntimeError):
    """A game that cannot begin: no such agent, no port, or no library to serve it with."""


class TrainingError(ValueError):
    """A run that cannot begin or go on: a folder in use, or a checkpoint that is broken or of something else."""
