"""Memory layout of the objects of Box2D 2.3 (LP64), and its functions by symbol.

The numbers were read out of pybox2d 2.3.10's library; `verify` checks every one before it is used.
"""

import contextlib
from typing import Any, Final

import Box2D

from outlast.ecs.kernels.jit import external, has_symbol, load_library, loader, storer

FILE: Final[str] = Box2D._Box2D.__file__
with contextlib.suppress(OSError):  # then its symbols are missing, which `verify` reports
    load_library(FILE)  # at import, so that kernels from the disk cache find the symbols, too

load_f4, load_i4, load_i8 = loader("float32"), loader("int32"), loader("intp")
load_u1, load_u2 = loader("uint8"), loader("uint16")
store_f4, store_i4, store_i8 = storer("float32"), storer("int32"), storer("intp")
store_u1, store_u2 = storer("uint8"), storer("uint16")

# b2World: the block allocator comes first, then the stack allocator
WORLD_SIZE: Final = 0x19380
WORLD_STACK: Final = 0x80
WORLD_MANAGER: Final = 0x192A0
WORLD_BODIES, WORLD_BODY_COUNT = 0x19320, 0x19330
# b2ContactManager, from WORLD_MANAGER: the broad phase comes first, in it the dynamic tree
TREE_ROOT, TREE_NODES, TREE_COUNT, TREE_CAPACITY = 0x00, 0x08, 0x10, 0x14
TREE_FREE, TREE_INSERTIONS = 0x18, 0x20
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
BODY_VELOCITY, BODY_OMEGA, BODY_WORLD, BODY_NEXT = 0x40, 0x48, 0x58, 0x68
BODY_FIXTURES, BODY_FIXTURE_COUNT, BODY_JOINTS, BODY_EDGES = 0x70, 0x78, 0x80, 0x88
BODY_INVERSE_MASS, BODY_INVERSE_INERTIA = 0x94, 0x9C
BODY_LINEAR_DAMPING, BODY_ANGULAR_DAMPING, BODY_SIZE = 0xA0, 0xA4, 0xB8
STATIC, KINEMATIC, MOVING = 0, 1, 2  # b2BodyType
IN_ISLAND = 1  # bit of the flags of bodies and contacts
# b2Fixture
FIXTURE_BODY, FIXTURE_SHAPE = 0x10, 0x18
FIXTURE_FRICTION, FIXTURE_RESTITUTION = 0x20, 0x24
FIXTURE_PROXIES, FIXTURE_PROXY_COUNT, FIXTURE_SIZE = 0x28, 0x30, 0x48
FIXTURE_LAYER, FIXTURE_HITS, FIXTURE_SENSOR = 0x34, 0x36, 0x3A  # 16 bits each, and a byte
PROXY_SIZE: Final = 0x20  # b2FixtureProxy
# b2CircleShape, b2PolygonShape
SHAPE_TYPE, CIRCLE_RADIUS, CIRCLE_SIZE = 0x08, 0x0C, 0x18
CIRCLE, POLYGON = 0, 2  # b2Shape::Type
POLYGON_CENTROID, POLYGON_VERTICES, POLYGON_NORMALS = 0x10, 0x18, 0x98
POLYGON_COUNT, POLYGON_SIZE = 0x118, 0x120
# b2Contact, and the b2ContactEdge in a body's list
CONTACT_FLAGS, CONTACT_NEXT, CONTACT_FIXTURE_A, CONTACT_FIXTURE_B = 0x08, 0x18, 0x60, 0x68
CONTACT_MANIFOLD, MANIFOLD_COUNT = 0x78, 0x3C  # b2Manifold; its number of points
TOUCHING, SOLID = 2, 6  # bits of a contact that is touching, and of one that is enabled as well
IMPULSE_COUNT: Final = 0x10  # b2ContactImpulse: the normal impulses come first
POST_SOLVE: Final = 5  # which function of a b2ContactListener it is
EDGE_OTHER, EDGE_CONTACT, EDGE_NEXT = 0x00, 0x08, 0x18
# b2Joint, with a b2JointEdge for either body's list
JOINT_TYPE, JOINT_EDGE_A, JOINT_EDGE_B, JOINT_BODY_A, JOINT_BODY_B = 0x08, 0x20, 0x40, 0x60, 0x68
JOINT_FLAG, JOINT_COLLIDES = 0x74, 0x75  # whether it is in an island; whether its two bodies touch each other
LINK_OTHER, LINK_JOINT, LINK_NEXT = 0x00, 0x08, 0x18
# b2WeldJoint, b2DistanceJoint, b2RopeJoint: a spring has a frequency and a damping ratio, anchors have four numbers
WELD_SPRING, WELD_ANCHORS, WELD_ANGLE, WELD_IMPULSE = 0x80, 0x8C, 0x9C, 0xA4
ROD_SPRING, ROD_ANCHORS, ROD_IMPULSE, ROD_LENGTH, ROD_AXIS = 0x80, 0x8C, 0xA0, 0xA4, 0xB0
ROPE_ANCHORS, ROPE_LENGTH, ROPE_IMPULSE, ROPE_AXIS = 0x80, 0x90, 0x98, 0xA4
# b2SolverData: a b2TimeStep comes first
DATA_POSITIONS, DATA_VELOCITIES = 0x18, 0x20
# b2TimeStep
STEP_DT, STEP_INVERSE_DT, STEP_RATIO = 0x00, 0x04, 0x08
STEP_VELOCITY, STEP_POSITION, STEP_WARM = 0x0C, 0x10, 0x14
# b2ContactSolverDef and b2ContactSolver
SOLVER_CONTACTS, SOLVER_COUNT = 0x18, 0x20
SOLVER_POSITIONS, SOLVER_VELOCITIES, SOLVER_STACK = 0x28, 0x30, 0x38
SOLVER_CONSTRAINTS = 0x38
# b2ContactVelocityConstraint: two points, each with a normal and a tangent impulse
CONSTRAINT_SIZE, IMPULSES_0, IMPULSES_1, CONSTRAINT_POINTS = 0x9C, 0x10, 0x34, 0x94

SIGNATURES: dict[str, tuple[str, ...]] = {
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
    "_ZN11b2WeldJoint23InitVelocityConstraintsERK12b2SolverData": ("void", "intp", "intp"),
    "_ZN11b2WeldJoint24SolveVelocityConstraintsERK12b2SolverData": ("void", "intp", "intp"),
    "_ZN11b2WeldJoint24SolvePositionConstraintsERK12b2SolverData": ("uint8", "intp", "intp"),
    "_ZN15b2DistanceJoint23InitVelocityConstraintsERK12b2SolverData": ("void", "intp", "intp"),
    "_ZN15b2DistanceJoint24SolveVelocityConstraintsERK12b2SolverData": ("void", "intp", "intp"),
    "_ZN15b2DistanceJoint24SolvePositionConstraintsERK12b2SolverData": ("uint8", "intp", "intp"),
    "_ZN11b2RopeJoint23InitVelocityConstraintsERK12b2SolverData": ("void", "intp", "intp"),
    "_ZN11b2RopeJoint24SolveVelocityConstraintsERK12b2SolverData": ("void", "intp", "intp"),
    "_ZN11b2RopeJoint24SolvePositionConstraintsERK12b2SolverData": ("uint8", "intp", "intp"),
    "_ZN15b2WorldManifold10InitializeEPK10b2ManifoldRK11b2TransformfS5_f": (
        "void",
        "intp",
        "intp",
        "intp",
        "float32",
        "intp",
        "float32",
    ),
    "sincosf": ("void", "float32", "intp", "intp"),  # which Box2D calls, too: other sines may differ in the last bit
}


def _function(name: str) -> Any:
    return external(name, *SIGNATURES[name], cure='take physics_backend="portable"')


solve_impacts = _function("_ZN7b2World8SolveTOIERK10b2TimeStep")
construct_body = _function("_ZN6b2BodyC1EPK9b2BodyDefP7b2World")
reset_mass = _function("_ZN6b2Body13ResetMassDataEv")
synchronize_fixtures = _function("_ZN6b2Body19SynchronizeFixturesEv")
create_proxies = _function("_ZN9b2Fixture13CreateProxiesEP12b2BroadPhaseRK11b2Transform")
find_new_contacts = _function("_ZN16b2ContactManager15FindNewContactsEv")
collide = _function("_ZN16b2ContactManager7CollideEv")
destroy_contact = _function("_ZN9b2Contact7DestroyEPS_P16b2BlockAllocator")
construct_solver = _function("_ZN15b2ContactSolverC1EP18b2ContactSolverDef")
destroy_solver = _function("_ZN15b2ContactSolverD1Ev")
initialize_velocities = _function("_ZN15b2ContactSolver29InitializeVelocityConstraintsEv")
warm_start = _function("_ZN15b2ContactSolver9WarmStartEv")
solve_velocities = _function("_ZN15b2ContactSolver24SolveVelocityConstraintsEv")
store_impulses = _function("_ZN15b2ContactSolver13StoreImpulsesEv")
solve_positions = _function("_ZN15b2ContactSolver24SolvePositionConstraintsEv")
begin_weld = _function("_ZN11b2WeldJoint23InitVelocityConstraintsERK12b2SolverData")
weld_velocities = _function("_ZN11b2WeldJoint24SolveVelocityConstraintsERK12b2SolverData")
weld_positions = _function("_ZN11b2WeldJoint24SolvePositionConstraintsERK12b2SolverData")
begin_rod = _function("_ZN15b2DistanceJoint23InitVelocityConstraintsERK12b2SolverData")
rod_velocities = _function("_ZN15b2DistanceJoint24SolveVelocityConstraintsERK12b2SolverData")
rod_positions = _function("_ZN15b2DistanceJoint24SolvePositionConstraintsERK12b2SolverData")
begin_rope = _function("_ZN11b2RopeJoint23InitVelocityConstraintsERK12b2SolverData")
rope_velocities = _function("_ZN11b2RopeJoint24SolveVelocityConstraintsERK12b2SolverData")
rope_positions = _function("_ZN11b2RopeJoint24SolvePositionConstraintsERK12b2SolverData")
find_points = _function("_ZN15b2WorldManifold10InitializeEPK10b2ManifoldRK11b2TransformfS5_f")
sincos = _function("sincosf")


def missing_symbols() -> list[str]:
    """Return the functions that the installed Box2D does not export; none on Linux, all of them on Windows."""
    return [name for name in SIGNATURES if not has_symbol(name)]
