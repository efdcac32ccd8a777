"""Time plain Box2D with the same bodies and forces: the floor of a step.

    python -m perf.floor [--worlds 64 256 1024] [--save MACHINE]

A simulator can hardly be faster than its physics engine. Here the engine is a
compiled loop that calls b2World::Step on worlds made with Box2D's public
interface: agents, boxes and walls with the scenario's numbers, and motors, but
no cameras, items, melee, zone, observations, rewards or resets. Beside it is
our whole step, with all of these. The two are timed in turn, on one thread.
Times are microseconds per world-step at the best batch size of each; the last
column is the median of the ratios of the rounds.
"""

from typing import Any

import Box2D
import numpy as np
from tqdm import tqdm

from outlast import Scenario
from outlast.components import Body, Shape, Solid
from outlast.ecs import RESET, Worlds
from outlast.ecs.kernels.jit import entry_point, external
from outlast.envs.scenarios.variants import VARIANTS
from outlast.systems.box2d import layout as at
from perf.measure import DRAWS, LIMIT, Call, alternate, stepper
from perf.rows import scenario
from perf.table import Table, options, positive

world_step = external("_ZN7b2World4StepEfii", "void", "intp", "float32", "int32", "int32", cure="compile it")


def main() -> None:
    """Measure the paper's variants, and the largest row of its tables with boxes that can be pushed."""
    parser = options(__doc__)
    text = "numbers of worlds in a batch, each measured (default 64 256 1024)"
    parser.add_argument("--worlds", type=positive, nargs="+", default=[64, 256, 1024], help=text)
    given = parser.parse_args()
    crowd = scenario("10 agents, 10 heals, 20 boxes").replace(boxes_dynamic=True)
    cases = {**VARIANTS, "10 agents, 10 heals, 20 dynamic boxes": crowd}
    table = Table("floor", "scenario", "box2d", "outlast", "outlast / box2d")
    for name, case in tqdm(cases.items(), unit="scenario"):
        times = [compare(case, worlds) for worlds in given.worlds]
        floor, ours = (min((t[:, k] for t in times), key=np.median) for k in range(2))
        table.add(name, float(np.median(floor)), float(np.median(ours)), float(np.median(ours / floor)))
    table.finish(given.save)


def compare(case: Scenario, worlds: int) -> np.ndarray:
    """Microseconds a world-step of the floor and of ours, (rounds, 2)."""
    return alternate([plain_box2d(case, worlds), stepper(case, worlds)], rounds=7) / worlds * 1e6


def plain_box2d(case: Scenario, count: int) -> Call:
    """Calls that step `count` Box2D worlds by a tick with random actions of the motors."""
    start = Worlds(case.modules, count)
    start.seed(0, np.arange(count))
    start.run(np.full(count, RESET, np.int8))
    built = [build(start, case, w) for w in range(count)]
    worlds = np.array([int(world.this) for world, _ in built], np.int64)
    agents = np.array([[int(body.this) for body in bodies] for _, bodies in built], np.int64)
    generator = np.random.default_rng(0)
    pushes = generator.integers(-1, 2, (DRAWS, count, agents.shape[1], 3)).astype(np.float32)
    motors, physics = case["motors"], case["physics"]
    pushes *= np.array([motors.ahead, motors.left, motors.turn], np.float32)  # type: ignore[attr-defined]
    rate, substeps = np.float32(physics.rate), physics.substeps  # type: ignore[attr-defined]
    iterations = physics.velocity_iterations, physics.position_iterations  # type: ignore[attr-defined]
    loop, kept = entry_point(step_all), built  # the worlds live as long as this call does

    def call(k: int) -> int:
        loop(worlds, agents, pushes[k % DRAWS], np.float32(1) / rate, substeps, *iterations)
        return len(kept)

    for k in range(LIMIT):
        call(k)
    return call


def build(start: Worlds, case: Scenario, w: int) -> tuple[Any, list[Any]]:
    """World `w` as a b2World, and its agents; boxes and walls as they lie after a reset."""
    physics: Any = case["physics"]
    world = Box2D.b2World(gravity=(0, 0))
    world.continuousPhysics = physics.continuous
    body, shape, agents = start[Body], start[Shape], []
    for e in start.layout.rows(Solid):
        create = world.CreateDynamicBody if start[Solid].dynamic[w, e] else world.CreateStaticBody
        made = create(
            position=(float(body.x[w, e]), float(body.y[w, e])),
            linearDamping=physics.linear_damping,
            angularDamping=physics.angular_damping,
        )
        radius, half = float(shape.radius[w, e]), (float(shape.half_width[w, e]), float(shape.half_height[w, e]))
        outline = Box2D.b2CircleShape(radius=radius) if radius > 0 else Box2D.b2PolygonShape(box=half)
        numbers = {"friction": physics.friction, "restitution": physics.restitution}
        made.CreateFixture(shape=outline, density=float(start[Solid].density[w, e]), **numbers)
        if e in range(*start.span("agent").indices(start.dims["rows"])):
            made.sleepingAllowed = False  # it is pushed all the time
            agents.append(made)
    return world, agents


def step_all(
    worlds: Any, agents: Any, pushes: Any, dt: Any, substeps: Any, velocity_iterations: Any, position_iterations: Any
) -> None:
    """Compiled: push every agent in its own frame, then step every world. pushes: float32 (worlds, agents, 3)."""
    for w in range(worlds.size):
        for i in range(agents.shape[1]):
            body, inverse = agents[w, i], at.load_f4(agents[w, i] + at.BODY_INVERSE_MASS)
            sine, cosine = at.load_f4(body + at.BODY_SIN), at.load_f4(body + at.BODY_COS)
            x = cosine * pushes[w, i, 0] - sine * pushes[w, i, 1]
            y = sine * pushes[w, i, 0] + cosine * pushes[w, i, 1]
            velocity, omega = body + at.BODY_VELOCITY, body + at.BODY_OMEGA
            at.store_f4(velocity, at.load_f4(velocity) + inverse * x)
            at.store_f4(velocity + 4, at.load_f4(velocity + 4) + inverse * y)
            turn = at.load_f4(body + at.BODY_INVERSE_INERTIA) * pushes[w, i, 2]
            at.store_f4(omega, at.load_f4(omega) + turn)
        for _ in range(substeps):
            world_step(worlds[w], dt, velocity_iterations, position_iterations)


if __name__ == "__main__":
    main()
