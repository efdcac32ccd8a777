"""The engine: components, systems, schedule, runner. It knows no game.

Read in this order: component (nouns), access, system, numbers and module (verbs and their numbers), phase and schedule
(the order), layout (where it all lies), frame and view (how kernels come by it), tick (the order as code), cache and
stored (that code on disk), references and fingerprint (what it depends on), worlds (a batch of worlds, and the
threads), simd (sixteen rows at a time), workers (the threads).
"""

from .access import Add, Bitset, DamageType, Random, Read, RowIndex, Rows, Scratch, Write
from .component import (
    Action,
    Array,
    Clock,
    Column,
    Component,
    Entity,
    Observation,
    Real,
    Signal,
    Singleton,
    Statistic,
    column,
)
from .errors import DeclarationError, EngineError, NumberError, ScheduleError
from .jit import kernel
from .layout import Archetype, Layout
from .module import Module
from .numbers import number
from .phase import Phase, When
from .system import System
from .tick import RESET, SKIP, STEP
from .worlds import Worlds

__all__ = [
    "RESET",
    "SKIP",
    "STEP",
    "Action",
    "Add",
    "Archetype",
    "Array",
    "Bitset",
    "Clock",
    "Column",
    "Component",
    "DamageType",
    "DeclarationError",
    "EngineError",
    "Entity",
    "Layout",
    "Module",
    "NumberError",
    "Observation",
    "Phase",
    "Random",
    "Read",
    "Real",
    "RowIndex",
    "Rows",
    "ScheduleError",
    "Scratch",
    "Signal",
    "Singleton",
    "Statistic",
    "System",
    "When",
    "Worlds",
    "Write",
    "column",
    "kernel",
    "number",
]
