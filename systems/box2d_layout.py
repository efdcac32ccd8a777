"""Where things lie inside Box2D 2.3.10's objects (LP64), and its functions by symbol; `box2d_verify` checks them."""

from typing import Final

import Box2D

from outlast.ecs.jit import external, has_symbol, load_library, loader, storer

FILE: Final[str] = Box2D._Box2D.__file__
load_library(FILE)  # here, so that a kernel from the disk cache finds its symbols too

load_f4, load_i4, load_i8, load_u2 = loader("float32"), loader("int32"), loader("intp"), loader("uint16")
store_f4, store_i4, store_i8 = storer("float32"), storer("int32"), storer("intp")
store_u1, store_u2 = storer("uint8"), storer("uint16")

# b2World: the block allocator comes first, then the stack allocator
WORLD_SIZE: Final = 0x19380
WORLD_STACK: Final = 0x80
WORLD_MANAGER: Final = 0x192A0
WORLD_BODIES, WORLD_BODY_COUNT = 0x19320, 0x19330
# b2ContactManager, from WORLD_MANAGER: the broad phase comes first, in it the dynamic tree
TREE_ROOT, TREE_NODES, TREE_COUNT, TREE_CAPACITY, TREE_FREE, TREE_INSERTIONS = 0x00, 0x08, 0x10, 0x14, 0x18, 0x20
PROXY_COUNT, MOVE_COUNT = 0x28, 0x3C
MANAGER_CONTACTS, MANAGER_CONTACT_COUNT, MANAGER_FILTER, MANAGER_LISTENER = 0x58, 0x60, 0x68, 0x70
# b2TreeNode
NODE_NEXT, NODE_HEIGHT, NODE_SIZE = 0x18, 0x24, 0x28
# b2BodyDef
DEF_TYPE, DEF_POSITION, DEF_ANGLE, DEF_VELOCITY, DEF_OMEGA = 0x00, 0x04, 0x0C, 0x10, 0x18
DEF_LINEAR_DAMPING, DEF_ANGULAR_DAMPING, DEF_SIZE = 0x1C, 0x20, 0x40
# b2Body
BODY_TYPE, BODY_FLAGS, BODY_INDEX, BODY_POSITION, BODY_SIN, BODY_COS = 0x00, 0x04, 0x08, 0x0C, 0x14, 0x18
BODY_LOCAL, BODY_CENTER0, BODY_CENTER, BODY_ANGLE0, BODY_ANGLE = 0x1C, 0x24, 0x2C, 0x34, 0x38
BODY_VELOCITY, BODY_OMEGA, BODY_WORLD, BODY_PREVIOUS, BODY_NEXT = 0x40, 0x48, 0x58, 0x60, 0x68
BODY_FIXTURES, BODY_FIXTURE_COUNT, BODY_EDGES = 0x70, 0x78, 0x88
BODY_INVERSE_MASS, BODY_INVERSE_INERTIA, BODY_SIZE = 0x94, 0x9C, 0xB8
STATIC, MOVING = 0, 2  # b2BodyType
IN_ISLAND = 1  # bit of the flags of bodies and contacts
# b2Fixture
FIXTURE_DENSITY, FIXTURE_BODY, FIXTURE_SHAPE, FIXTURE_FRICTION, FIXTURE_RESTITUTION = 0x00, 0x10, 0x18, 0x20, 0x24
FIXTURE_PROXIES, FIXTURE_PROXY_COUNT, FIXTURE_SIZE = 0x28, 0x30, 0x48
PROXY_SIZE: Final = 0x20  # b2FixtureProxy
# b2CircleShape, b2PolygonShape
SHAPE_TYPE, CIRCLE_RADIUS, CIRCLE_SIZE = 0x08, 0x0C, 0x18
CIRCLE, POLYGON = 0, 2  # b2Shape::Type
POLYGON_VERTICES, POLYGON_SIZE = 0x18, 0x120
# b2Contact, and the b2ContactEdge in a body's list
CONTACT_FLAGS, CONTACT_NEXT, CONTACT_FIXTURE_A, CONTACT_FIXTURE_B = 0x08, 0x18, 0x60, 0x68
SOLID = 6  # bits of a contact that is enabled and touching
EDGE_OTHER, EDGE_CONTACT, EDGE_NEXT = 0x00, 0x08, 0x18
# b2TimeStep
STEP_DT, STEP_INVERSE_DT, STEP_RATIO, STEP_VELOCITY, STEP_POSITION, STEP_WARM, STEP_SIZE = 0, 4, 8, 12, 16, 20, 24
# b2ContactSolverDef and b2ContactSolver
SOLVER_CONTACTS, SOLVER_COUNT, SOLVER_POSITIONS, SOLVER_VELOCITIES, SOLVER_STACK = 0x18, 0x20, 0x28, 0x30, 0x38
SOLVER_CONSTRAINTS, SOLVER_SIZE = 0x38, 0x80  # the size is generous: the object is 0x50
# b2ContactVelocityConstraint: two points, each with a normal and a tangent impulse
CONSTRAINT_SIZE, IMPULSES_0, IMPULSES_1 = 0x9C, 0x10, 0x34

_NAMES: dict[str, tuple[str, ...]] = {
    "_ZN7b2WorldC1ERK6b2Vec2": ("void", "intp", "intp"),
    "_ZN7b2WorldD1Ev": ("void", "intp"),
    "_ZN7b2World8SolveTOIERK10b2TimeStep": ("void", "intp", "intp"),
    "_ZN6b2BodyC1EPK9b2BodyDefP7b2World": ("void", "intp", "intp", "intp"),
    "_ZN6b2Body13ResetMassDataEv": ("void", "intp"),
    "_ZN6b2Body19SynchronizeFixturesEv": ("void", "intp"),
    "_ZN9b2Fixture13CreateProxiesEP12b2BroadPhaseRK11b2Transform": ("void", "intp", "intp", "intp"),
    "_ZN16b2ContactManager15FindNewContactsEv": ("void", "intp"),
    "_ZN16b2ContactManager7CollideEv": ("void", "intp"),
    "_ZN9b2Contact7DestroyEPS_P16b2BlockAllocator": ("void", "intp", "intp"),
    "_ZN15b2ContactSolverC1EP18b2ContactSolverDef": ("void", "intp", "intp"),
    "_ZN15b2ContactSolverD1Ev": ("void", "intp"),
    "_ZN15b2ContactSolver29InitializeVelocityConstraintsEv": ("void", "intp"),
    "_ZN15b2ContactSolver9WarmStartEv": ("void", "intp"),
    "_ZN15b2ContactSolver24SolveVelocityConstraintsEv": ("void", "intp"),
    "_ZN15b2ContactSolver13StoreImpulsesEv": ("void", "intp"),
    "_ZN15b2ContactSolver24SolvePositionConstraintsEv": ("uint8", "intp"),
    "sincosf": ("void", "float32", "intp", "intp"),
}
(construct_world, destroy_world, solve_impacts, construct_body, reset_mass, synchronize_fixtures, create_proxies,
 find_new_contacts, collide, destroy_contact, construct_solver, destroy_solver, initialize_velocities, warm_start,
 solve_velocities, store_impulses, solve_positions, sincos) = (
    external(name, *kinds) for name, kinds in _NAMES.items()
)


def missing_symbols() -> list[str]:
    """The C++ functions that the installed Box2D does not export; empty on Linux, all of them on Windows."""
    return [name for name in _NAMES if not has_symbol(name)]
