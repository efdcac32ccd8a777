"""The engine: components, systems, a schedule, and a runner for batches of worlds. It contains no rules of games.

It has six parts. Each imports only those above it in this list, so they can be read in this order:

============ ====================================================================================================
kernels      tools of compiled code: numba, types of arrays, vectors, random numbers, files of machine code
declarations parts of a mechanic: components, events, fields, systems and their access, phases, numbers, modules
memory       places and first values of columns; numbers that differ between worlds or agents
compilation  the order of systems, their arguments, the tick as machine code, and its cache
checks       checks of systems against their declarations, and the hash that identifies games
running      a batch of worlds: ticks, threads, tables for callers
============ ====================================================================================================

Other layers and users' mechanics import from here, or from the public modules: all of `kernels` (`random`, `simd`,
`jit`, `errors` ...), `declarations.{component, distributions, event, fields, roles}`, `memory.{given, numbers}` and
`checks.code_hash`. All other modules are private.

From modules to worlds: `running.compiled_game.plan` creates a `memory.layout.MemoryLayout` of them, a
`compilation.schedule.Schedule` of their systems, tries users' systems (`checks.trial`), generates the tick
(`compilation.tick`), and loads or compiles it (`compilation.cache`); `running.worlds.Worlds` is the batch that steps.
"""

from .compilation.cache import CompiledUnits
from .declarations.access import Add, Bitset, Label, Offset, Random, Read, RowIndex, Rows, Scratch, Service, Write
from .declarations.archetype import Archetype
from .declarations.component import (
    INDEX,
    Action,
    Clock,
    Column,
    Component,
    Coupled,
    Entity,
    Observation,
    Signal,
    Singleton,
    Statistic,
    column,
    index_unit,
    ref,
)
from .declarations.distributions import Distribution, choice, free, integers, log_uniform, uniform
from .declarations.event import Event, emit
from .declarations.fields import Field, Fields, columns_of
from .declarations.layout import Layout, WorldsView
from .declarations.module import Module
from .declarations.numbers import number
from .declarations.phase import PhaseBase, When
from .declarations.roles import Role, Roles, role
from .declarations.system import System
from .kernels.by_role import differs, of
from .kernels.errors import (
    AbsentError,
    CapacityError,
    DeclarationError,
    EngineError,
    NumberError,
    RangeError,
    ScheduleError,
)
from .kernels.jit import Array, Real, kernel
from .memory.column_places import Place
from .memory.entity_view import EntityView
from .memory.episode import RESET, SKIP, STEP, exists
from .memory.layout import MemoryLayout
from .memory.numbers import AgentRoles
from .running.step import Observer, Stepper
from .running.worlds import Worlds, checked_worlds

__all__ = [
    "INDEX",
    "RESET",
    "SKIP",
    "STEP",
    "AbsentError",
    "Action",
    "Add",
    "AgentRoles",
    "Archetype",
    "Array",
    "Bitset",
    "CapacityError",
    "Clock",
    "Column",
    "CompiledUnits",
    "Component",
    "Coupled",
    "DeclarationError",
    "Distribution",
    "EngineError",
    "Entity",
    "EntityView",
    "Event",
    "Field",
    "Fields",
    "Label",
    "Layout",
    "MemoryLayout",
    "Module",
    "NumberError",
    "Observation",
    "Observer",
    "Offset",
    "PhaseBase",
    "Place",
    "Random",
    "RangeError",
    "Read",
    "Real",
    "Role",
    "Roles",
    "RowIndex",
    "Rows",
    "ScheduleError",
    "Scratch",
    "Service",
    "Signal",
    "Singleton",
    "Statistic",
    "Stepper",
    "System",
    "When",
    "Worlds",
    "WorldsView",
    "Write",
    "checked_worlds",
    "choice",
    "column",
    "columns_of",
    "differs",
    "emit",
    "exists",
    "free",
    "index_unit",
    "integers",
    "kernel",
    "log_uniform",
    "number",
    "of",
    "ref",
    "role",
    "uniform",
]
