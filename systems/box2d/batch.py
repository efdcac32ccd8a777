"""A contact batch: the few bodies of one world that may touch something, passed to Box2D for one tick.

Both backends (`native`, `portable`) take the same batch and give the same bits. A batch is a float32
array (capacity, 16), with a row for each body in Box2D's order; the columns are named here.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from outlast.components.polygon import MOST
from outlast.ecs.kernels.errors import OutlastError

ContactBatch = NDArray[np.float32]
Traits = NDArray[np.float32] | None
Joints = NDArray[np.float32] | None
Touches = NDArray[np.float32] | None
Outlines = NDArray[np.float32] | None

X, Y = 0, 1  # metres, centre of the body; read and written
ANGLE = 2  # radians; read and written
VX, VY = 3, 4  # metres per second; read and written
OMEGA = 5  # radians per second; read and written
RADIUS = 6  # metres; above 0 for a circle, 0 for a rectangle or a polygon
HALF_WIDTH, HALF_HEIGHT = 7, 8  # metres; of a rectangle, or of the rectangle around a polygon
DYNAMIC = 9  # MOVED: can be pushed; DRIVEN: keeps its velocity in contacts; 0: does not move
MASS, INERTIA = 10, 11  # kilograms, kilogram square metres about the centre; above 0 if dynamic, otherwise 0
MAX_TRAVEL = 12  # maximum metres of a dynamic body from its start after any substep; beyond, the call is abandoned
JX, JY = 13, 14  # newton seconds, at the centre, at the start of EVERY substep; both 0 for none
JTURN = 15  # newton metre seconds, at the start of EVERY substep
COLUMNS = 16
MOVED, DRIVEN = 1, 2

# Traits, for games in which bodies differ: a second float32 array (capacity, 7), with a row for each body
FRICTION, RESTITUTION = 0, 1
LINEAR_DAMPING, ANGULAR_DAMPING = 2, 3  # per second
LAYER, HITS = 4, 5  # bit masks below 65,536: two bodies touch if each hits the layer of the other
SENSOR = 6  # 1: touches, but neither pushes nor stops anything
TRAITS = 7

# Joints: a float32 array (joints, 11), with a row for each joint between two bodies of the batch
KIND = 0  # WELD, ROD or ROPE
FIRST, SECOND = 1, 2  # the two bodies, by their row in the batch
OWN_X, OWN_Y, OTHER_X, OTHER_Y = 3, 4, 5, 6  # metres, the two ends, each in the frame of its body
REST = 7  # of a weld, radians: angle of the second body minus that of the first; otherwise metres between the ends
HERTZ, RATIO = 8, 9  # frequency and damping ratio of a spring: a weld's for the angle, a rod's for the length; 0: rigid
FORCE = 10  # newtons, the largest of all substeps; written
JOINTS = 11
ROD, WELD, ROPE = 3, 8, 10  # b2JointType. Bodies that are welded do not touch each other

# Outlines, for games with polygons: a float32 array (capacity, 17), with a row for each body
CORNERS = 0  # number of corners, 3 to 8, in Box2D's order (components.polygon); 0: a circle or a rectangle
CORNER = 1  # metres: x and y of each corner, around the body's centre
OUTLINE = CORNER + 2 * MOST

# Touches: a float32 array (1 + touches, 5); the first row has their number, which may exceed the capacity
LOW, HIGH = 0, 1  # the two bodies, by their row in the batch; touches are in order of both
IMPULSE = 2  # newton seconds of the push that separates them, summed over substeps; 0 for sensors
AT_X, AT_Y = 3, 4  # metres, the point of the strongest push; for sensors, the middle of the other body
TOUCHES = 5

SOLVED = 0  # the batch holds the state after the tick
ABANDONED = 1  # a body went further than its MAX_TRAVEL; the batch is untouched
INVALID = 2  # too many bodies, or a number out of bounds or NaN: an error of the caller; the batch is untouched
CAPACITY = 512  # maximum bodies in a batch
MOST_JOINTS = 1024
LIMITS = np.full(COLUMNS, 1e6, np.float32)  # the largest numbers; Box2D's squares of larger ones overflow
LIMITS[[VX, VY, OMEGA]] = 1e15, 1e15, 1e19
LIMITS[[MASS, INERTIA]] = 1e17, 1e26
LIMITS[MAX_TRAVEL] = np.inf
TRAIT_LIMITS = np.array([1e5, 1e5, 1e5, 1e5, 0xFFFF, 0xFFFF, 1], np.float32)  # upper limits; the lower ones are 0
JOINT_LIMITS = np.array([ROPE, CAPACITY, CAPACITY, 1e6, 1e6, 1e6, 1e6, 1e6, 1e5, 1e5, np.inf], np.float32)  # upper
LONGEST = np.float32(2)  # metres: maximum distance of a body in a substep (b2_maxTranslation)
SMALLEST = np.float32(1e-3)  # metres; minimum of radii and half sides


class Settings(NamedTuple):
    """Box2D's numbers for a tick, with zero gravity. The defaults are the paper's (reference rules, section 1)."""

    dt: np.float32 = np.float32(1 / 60)  # seconds a substep
    substeps: int = 2
    velocity_iterations: int = 10
    position_iterations: int = 10
    friction: np.float32 = np.float32(0.2)
    restitution: np.float32 = np.float32(0)
    linear_damping: np.float32 = np.float32(0.8)  # per second
    angular_damping: np.float32 = np.float32(0.8)  # per second
    continuous: int = 1  # 1: fast bodies do not tunnel through static ones


class IncompatibleBox2D(OutlastError, RuntimeError):
    """The memory layout of the installed Box2D does not fit the native backend; the portable one works with any."""
