"""The engine: components, systems, a schedule, and a runner for batches of worlds. It knows the rules of no game.

Read in this order: component and event (the tables), fields (of observations), access, system, numbers and module (the
functions that work on tables, and their numbers), phase and schedule (their order), kernel_check with
abstract_interpreter and abstract_values (check that systems do what they declare), layout with archetype (the memory
of a world), distributions, varied, given and draw (numbers that differ from world to world), made_once (what numbers
decide when worlds are made), roles and per_agent (numbers that differ from agent to agent), arguments (what kernels
get), tick (the code generator), machine_code (numba, and the loader), cache, cache_files with file_lock, cache_folder
and cache_key with references (the compile cache), available (cores for it), compile_errors, run_units (a tick in
machine code), team (threads that share worlds), execution and runner, worlds (a batch of worlds) with entity_view, and
identity (what tells games apart); then what kernels use: jit, simd, random. The errors are in errors.
"""

from .access import Add, Bitset, DamageType, Offset, Random, Read, RowIndex, Rows, Scratch, Write
from .archetype import Archetype
from .clock import RESET, SKIP, STEP
from .component import (
    Action,
    Array,
    Clock,
    Column,
    Component,
    Coupled,
    Entity,
    Observation,
    Real,
    Signal,
    Singleton,
    Statistic,
    column,
)
from .distributions import Distribution, choice, free, integers, log_uniform, uniform
from .draw import exists
from .entity_view import EntityView
from .errors import AbsentError, CapacityError, DeclarationError, EngineError, NumberError, RangeError, ScheduleError
from .event import Event, emit
from .fields import Field, Fields, columns_of
from .jit import kernel
from .layout import Layout
from .module import Module
from .numbers import number
from .per_agent import AgentRoles, differs, of
from .phase import Phase, When
from .roles import Role, Roles, role
from .system import System
from .worlds import Worlds

__all__ = [
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
    "Component",
    "Coupled",
    "DamageType",
    "DeclarationError",
    "Distribution",
    "EngineError",
    "Entity",
    "EntityView",
    "Event",
    "Field",
    "Fields",
    "Layout",
    "Module",
    "NumberError",
    "Observation",
    "Offset",
    "Phase",
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
    "Signal",
    "Singleton",
    "Statistic",
    "System",
    "When",
    "Worlds",
    "Write",
    "choice",
    "column",
    "columns_of",
    "differs",
    "emit",
    "exists",
    "free",
    "integers",
    "kernel",
    "log_uniform",
    "number",
    "of",
    "role",
    "uniform",
]
