"""What the faces refuse. The environment is as it was before the refused call."""


class ActionError(ValueError):
    """Actions of the wrong shape or type, or out of range."""


class NotResetError(RuntimeError):
    """A step where there is no running episode."""


class ClosedError(RuntimeError):
    """A call after close()."""


class PendingError(RuntimeError):
    """A call between send() and recv(), or recv() without send()."""


class FaultError(RuntimeError):
    """A world is in a state that cannot go on; only a reset of that world helps."""


class StateError(ValueError):
    """A saved state that is broken, or of another scenario."""


class ClusterError(RuntimeError):
    """A Ray cluster that is not there, or does not do its work."""
