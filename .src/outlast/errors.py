"""Every error of outlast, by name. `OutlastError` is the base of all of them.

Each one is also an error of Gymnasium or Python that callers may already catch:

>>> try:
...     env.step(actions)
... except gymnasium.error.ResetNeeded:  # outlast.errors.NotResetError is one
...     env.reset()
"""

from .ecs.kernels.errors import (
    AbsentError,
    CapacityError,
    DeclarationError,
    EngineError,
    NumberError,
    OutlastError,
    RangeError,
    ScheduleError,
)
from .envs.errors import (
    ActionError,
    ClosedError,
    ClusterError,
    EndlessError,
    FaultError,
    FilmError,
    KeywordError,
    MessageError,
    NotResetError,
    PageError,
    PendingError,
    PlayError,
    RecordingError,
    ReplayError,
    ScenarioError,
    StateError,
    UsageError,
)
from .systems.box2d.batch import IncompatibleBox2D
from .training.base.errors import EmptyRunError, TrainingError

__all__ = [
    "AbsentError",
    "ActionError",
    "CapacityError",
    "ClosedError",
    "ClusterError",
    "DeclarationError",
    "EmptyRunError",
    "EndlessError",
    "EngineError",
    "FaultError",
    "FilmError",
    "IncompatibleBox2D",
    "KeywordError",
    "MessageError",
    "NotResetError",
    "NumberError",
    "OutlastError",
    "PageError",
    "PendingError",
    "PlayError",
    "RangeError",
    "RecordingError",
    "ReplayError",
    "ScenarioError",
    "ScheduleError",
    "StateError",
    "TrainingError",
    "UsageError",
]
