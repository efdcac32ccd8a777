"""Physics by pybox2d's public interface: in every tick all bodies of a world are created, pushed, stepped and read."""

from typing import Any

import Box2D

from tests.helpers import naive_mechanics
from tests.helpers.naive_world import NaiveEntity, World

SOLID = ("agent", "box", "wall", "inner_wall")


def move(world: World, actions: naive_mechanics.Actions) -> None:
    """The substeps of a new Box2D world that holds everything that can be touched."""
    numbers, box2d = world.numbers, Box2D.b2World(gravity=(0, 0), doSleep=True)
    box2d.continuousPhysics = numbers["physics_continuous"]
    bodies = [(entity, create_body(box2d, entity, world)) for entity in world.live(*SOLID)]
    agents = [(entity, body, actions[entity.index]) for entity, body in bodies if entity.kind == "agent"]
    evenly = numbers["motors_give"] == "evenly"
    given = [impulses(body, action, world.own(agent)) for agent, body, action in agents]
    for substep in range(numbers["physics_substeps"]):
        if evenly or substep == 0:
            for (_, body, _), (force, turn) in zip(agents, given, strict=True):
                share = 1 / numbers["physics_substeps"] if evenly else 1
                body.ApplyLinearImpulse((force.x * share, force.y * share), body.worldCenter, True)
                body.ApplyAngularImpulse(turn * share, True)
        iterations = numbers["physics_velocity_iterations"], numbers["physics_position_iterations"]
        box2d.Step(1 / numbers["physics_rate"], *iterations)
    for entity, body in bodies:
        if body.type == Box2D.b2_dynamicBody:
            (entity.x, entity.y), entity.angle = body.position, body.angle
            (entity.vx, entity.vy), entity.omega = body.linearVelocity, body.angularVelocity


def create_body(box2d: Any, entity: NaiveEntity, world: World) -> Any:
    """The entity as a body with one fixture."""
    numbers = world.own(entity) if entity.kind == "agent" else world.numbers
    moves = entity.kind == "agent" or (entity.kind == "box" and numbers["boxes_dynamic"])
    body = (box2d.CreateDynamicBody if moves else box2d.CreateStaticBody)(
        position=(entity.x, entity.y),
        angle=entity.angle,
        linearVelocity=(entity.vx, entity.vy),
        angularVelocity=entity.omega,
        linearDamping=numbers["physics_linear_damping"],
        angularDamping=numbers["physics_angular_damping"],
    )
    half = entity.half_width, entity.half_height
    shape = Box2D.b2CircleShape(radius=entity.radius) if entity.radius else Box2D.b2PolygonShape(box=half)
    density = numbers[{"agent": "agents_density", "box": "boxes_density"}[entity.kind]] if moves else 0
    friction, restitution = numbers["physics_friction"], numbers["physics_restitution"]
    body.CreateFixture(shape=shape, density=density, friction=friction, restitution=restitution)
    return body


def impulses(body: Any, action: dict[str, int], numbers: dict[str, Any]) -> tuple[Any, float]:
    """The impulses of the motors in a tick: a linear one in the world's frame, and an angular one."""
    ahead, left = numbers["motors_ahead"] * action["ahead"], numbers["motors_left"] * action["left"]
    return body.GetWorldVector((ahead, left)), numbers["motors_turn"] * action["turn"]
