"""A workspace: the memory in which one thread's batches are built, with a b2World that is empty between calls."""

import ctypes
import weakref
from typing import Any

import Box2D
import numpy as np
from numpy.typing import NDArray

from . import layout as at
from .batch import CAPACITY, MOST_JOINTS

_PAIRS = CAPACITY * (CAPACITY - 1) // 2

# Byte offsets in a workspace; the b2World comes first
STEP = 103_424  # b2TimeStep
SOLVER_DEF = STEP + 64  # b2ContactSolverDef
SOLVER = SOLVER_DEF + 64  # b2ContactSolver
FILTER = SOLVER + 120  # the address of Box2D's own b2ContactFilter
BODY_DEF = SOLVER + 128  # b2BodyDef
GROUP = BODY_DEF + 64  # the bodies of the island being solved
STACK = GROUP + 8 * CAPACITY  # bodies whose contacts remain to be followed
POSITIONS = STACK + 8 * CAPACITY  # b2Position of each body in the island
VELOCITIES = POSITIONS + 12 * CAPACITY  # b2Velocity of each body in the island
BEFORE = VELOCITIES + 12 * CAPACITY  # VELOCITIES of the previous iteration
CONTACTS = BEFORE + 12 * CAPACITY  # the contacts of the island
IMPULSES = CONTACTS + 8 * _PAIRS  # their impulses in the previous iteration
SOLVER_DATA = IMPULSES + 16 * _PAIRS  # b2SolverData, for joints
LINKS = SOLVER_DATA + 64  # the joints of the island
JOINT, JOINT_SLOT = LINKS + 8 * MOST_JOINTS, 320  # joint k of a batch lives in slot k: see joints
LISTENER = JOINT + JOINT_SLOT * MOST_JOINTS  # b2ContactListener, and the address of the workspace
FUNCTIONS = LISTENER + 16  # its virtual functions
POINTS = FUNCTIONS + 64  # b2WorldManifold
TOUCH_COUNT = POINTS + 64  # number of pairs that have touched in this tick
TOUCH_KEYS = TOUCH_COUNT + 8  # their keys: the lower position in the batch times CAPACITY, plus the higher one
TOUCH = TOUCH_KEYS + 8 * _PAIRS  # of each pair: whether it has touched; impulse; strongest push, and its point
SLOTS = (TOUCH + 24 * _PAIRS + 63) // 64 * 64

# Body k of a batch lives in slot k: b2Body, b2Fixture, b2FixtureProxy and the two shapes it may have
SLOT = 640
FIXTURE = 192
PROXY = FIXTURE + at.FIXTURE_SIZE
DISC = PROXY + at.PROXY_SIZE
BOX = DISC + at.CIRCLE_SIZE
SIZE = SLOTS + CAPACITY * SLOT


def make_workspace() -> NDArray[np.uint8]:
    """Return memory for one thread's scenes (uint8); its b2World is destroyed with its last view.

    It holds pointers: use it in the process and at the address where it was created. Call `verify` once before. It has
    about 8 MiB, most of which is never touched.
    """
    memory = np.zeros(SIZE + 64, np.uint8)
    owner = _Owner(memory)
    start = -memory.ctypes.data % 64
    workspace = np.asarray(owner)[start : start + SIZE]
    base = workspace.ctypes.data
    construct = ctypes.CDLL(at.FILE)["_ZN7b2WorldC1ERK6b2Vec2"]
    construct(ctypes.c_void_p(base), ctypes.c_void_p(base + GROUP))  # gravity: zeros
    weakref.finalize(owner, _destroy, base, memory).atexit = False
    _write_templates(workspace)
    _write_pointers(workspace, base)
    return workspace


class _Owner:
    """The owner of memory that views refer to. Not an array: numpy 2.5 frees it before its finalizers run."""

    def __init__(self, memory: NDArray[np.uint8]) -> None:
        self.__array_interface__ = memory.__array_interface__


def _destroy(base: int, memory: NDArray[np.uint8]) -> None:
    """End the b2World at `base`, in memory that is kept alive during the call."""
    ctypes.CDLL(at.FILE)["_ZN7b2WorldD1Ev"](ctypes.c_void_p(base))


def _write_templates(workspace: NDArray[np.uint8]) -> None:
    """Copy objects made by the public API; these have vtable pointers and the defaults of unused fields."""
    disc, box = Box2D.b2CircleShape(), Box2D.b2PolygonShape(box=(1, 1))
    world = Box2D.b2World()
    fixture = world.CreateStaticBody().CreateFixture(shape=disc)
    _copy(workspace, BODY_DEF, Box2D.b2BodyDef(), at.DEF_SIZE)
    slots = workspace[SLOTS:].reshape(CAPACITY, SLOT)
    _copy(slots, FIXTURE, fixture, at.FIXTURE_SIZE)
    _copy(slots, DISC, disc, at.CIRCLE_SIZE)
    _copy(slots, BOX, box, at.POLYGON_SIZE)


def _copy(memory: NDArray[np.uint8], offset: int, item: Any, size: int) -> None:
    """Copy an object of Box2D's to this offset in memory, or in each row of it."""
    memory[..., offset : offset + size] = np.frombuffer(ctypes.string_at(int(item.this), size), np.uint8)


def _write_pointers(workspace: NDArray[np.uint8], base: int) -> None:
    words = workspace.view(np.int64)
    functions = (ctypes.c_int64 * 6).from_address(
        ctypes.c_int64.from_address(int(words[(at.WORLD_MANAGER + at.MANAGER_LISTENER) // 8])).value
    )
    words[FUNCTIONS // 8 : FUNCTIONS // 8 + 6] = functions  # Box2D's own empty ones
    words[LISTENER // 8 : LISTENER // 8 + 2] = base + FUNCTIONS, base
    words[FILTER // 8] = words[(at.WORLD_MANAGER + at.MANAGER_FILTER) // 8]  # used for bodies with traits
    words[(at.WORLD_MANAGER + at.MANAGER_FILTER) // 8] = 0  # none: every pair may touch
    words[(at.WORLD_MANAGER + at.MANAGER_LISTENER) // 8] = 0
    words[(SOLVER_DEF + at.SOLVER_CONTACTS) // 8] = base + CONTACTS
    words[(SOLVER_DEF + at.SOLVER_POSITIONS) // 8] = base + POSITIONS
    words[(SOLVER_DEF + at.SOLVER_VELOCITIES) // 8] = base + VELOCITIES
    words[(SOLVER_DATA + at.DATA_POSITIONS) // 8] = base + POSITIONS
    words[(SOLVER_DATA + at.DATA_VELOCITIES) // 8] = base + VELOCITIES
    words[(SOLVER_DEF + at.SOLVER_STACK) // 8] = base + at.WORLD_STACK
    slots, starts = words[SLOTS // 8 :].reshape(CAPACITY, SLOT // 8), base + np.arange(SLOTS, SIZE, SLOT)
    slots[:, (FIXTURE + at.FIXTURE_BODY) // 8] = starts
    slots[:, (FIXTURE + at.FIXTURE_PROXIES) // 8] = starts + PROXY
