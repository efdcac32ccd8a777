"""The transfer tests of hide and seek (arXiv 1909.07528, section 6 and appendix): tasks for one agent without an enemy.

Agents observe what hiders do, so that networks of the game can begin with them. There are no rows for sites, for the
place where an agent has begun, and for what must be sheltered: these are where they always are.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from outlast.components import Body, Phase, Push, Reward, Shape, Solid
from outlast.components.hide_and_seek import NOBODY, Aloft, Crate, Movable
from outlast.components.limits import FAR, MANY, MUCH
from outlast.components.transfer import Errand, Parade, Passed, Solved, Target
from outlast.ecs import (
    Archetype,
    Clock,
    Layout,
    Module,
    NumberError,
    Random,
    Read,
    Real,
    Rows,
    Singleton,
    Write,
    kernel,
    number,
    ref,
)
from outlast.ecs.kernels.random import uniform
from outlast.systems.geometry.bodies import Bodies
from outlast.systems.geometry.queries import first_on_ray

HALF = np.float32(0.5)
NEAREST, FARTHEST = np.float32(0.2), np.float32(0.45)  # of the room: how far ahead crates wait
LATEST = 10_000  # ticks: for the largest number of crates, the last one still leaves within an int32
SPREAD = np.float32(0.6)  # the slope of the lines to the outermost ones
EDGE = np.float32(14 / 15)  # rays begin one of 30 cells from the edge, as there; of half the floor


@dataclass(frozen=True)
class Task(Module):
    """Base of the tasks: the rewards of one agent, and for how many ticks of an episode the task was done."""

    @classmethod
    def slot(cls) -> type:
        return Solved

    def singletons(self) -> Iterable[Singleton]:
        return [Reward(), Solved()]

    def check(self, layout: Layout) -> None:
        if layout.dims["agents"] != 1:
            raise NumberError(f"{self.name} is a task for one agent, and there are {layout.dims['agents']}")


@kernel
def metres(body: Read[Body], e: int, x: Real, y: Real) -> Real:
    """Return how far the centre of body `e` is from a point."""
    dx, dy = body.x[e] - x, body.y[e] - y
    return np.float32(np.sqrt(dx * dx + dy * dy))


@dataclass(frozen=True)
class Locking(Task):
    """The agent locks all crates, in the order of their rows, and then comes back (LockObjectsTask).

    A crate can be locked if all before it are locked. Coming nearer to the next one is paid, and getting away costs as
    much; so it is with the way back.
    """

    lock: float = number(5.0, low=0, high=MUCH, unit="reward", about="reward for locking a crate")
    unlock: float = number(5.0, low=0, high=MUCH, unit="reward", about="penalty for unlocking a crate")
    nearer: float = number(0.5, low=0, high=MUCH, unit="reward per metre", about="reward for coming nearer")
    success: float = number(1.0, low=0, high=MUCH, unit="reward per tick", about="reward while the task is done")
    back: float = number(
        0.0, low=0, high=FAR, unit="metres", about="how near to its start it comes back; 0: it need not"
    )
    start: tuple[float, ...] = number(
        (), low=-FAR, high=FAR, unit="metres", about="x and y of where the agent begins; (): anywhere"
    )

    def singletons(self) -> Iterable[Singleton]:
        return [*super().singletons(), Errand()]

    def check(self, layout: Layout) -> None:
        super().check(layout)
        if len(self.start) not in (0, 2):
            raise NumberError(f"{self.name}.start = {self.start}: two numbers are needed, x and y, or none")


@Locking.system(Phase.SPAWN, after="spawn_grid")
def begin(body: Write[Body], agents: Rows[Aloft], start: tuple[float, ...]) -> None:
    """Put the agent where it begins."""
    if len(start) > 0:
        body.x[agents[0]], body.y[agents[0]] = start[0], start[1]


@Locking.system(Phase.REWARD)
def pay_locks(
    reward: Write[Reward],
    errand: Write[Errand],
    solved: Write[Solved],
    movable: Write[Movable],
    body: Read[Body],
    clock: Read[Clock],
    agents: Rows[Aloft],
    crates: Rows[Crate],
    lock: float,
    unlock: float,
    nearer: float,
    success: float,
    back: float,
) -> None:
    """Find the next crate, and pay for what has changed since the last tick."""
    e, crate, locked = agents[0], NOBODY, 0
    for thing in crates:
        movable.lockable[thing] = crate == NOBODY
        locked += movable.locked_by[thing] != NOBODY
        if crate == NOBODY and movable.locked_by[thing] == NOBODY:
            crate = thing
    way: Real = np.float32(0)
    if clock.tick[0] == 0:
        errand.x[0], errand.y[0] = body.x[e], body.y[e]
    if crate != NOBODY:
        way = metres(body, e, body.x[crate], body.y[crate])
    elif back > 0:
        way = metres(body, e, errand.x[0], errand.y[0])
    reward.reward[0] = 0
    if clock.tick[0] > 0:
        more, gone, left = locked - errand.locked[0], errand.way[0], way
        if crate != errand.crate[0]:  # a way ends with a lock, and the next one begins without pay
            gone, left = (gone, np.float32(0)) if more > 0 else (np.float32(0), left)
        done = crate == NOBODY and way <= back
        reward.reward[0] = nearer * (gone - left) + lock * max(more, 0) - unlock * max(-more, 0) + success * done
        solved.solved[0] += done
    errand.crate[0], errand.locked[0], errand.way[0] = crate, locked, way


@dataclass(frozen=True)
class Blueprint(Task):
    """The agent brings a crate to each site (ConstructionDenseRewardWrapper, ConstructionCompletedRewardWrapper)."""

    sites: tuple[float, ...] = number(
        (-1.0, 0.0, 1.0, 0.0), low=-FAR, high=FAR, unit="metres", about="x and y of each site, one after the other"
    )
    near: float = number(0.2, low=0, high=FAR, unit="metres", about="how near to a site the middle of a crate must be")
    away: float = number(
        0.05, low=0, high=MUCH, unit="reward per metre", about="penalty per tick for the way from a site to a crate"
    )
    success: float = number(1.0, low=0, high=MUCH, unit="reward per tick", about="reward while all sites have crates")

    def check(self, layout: Layout) -> None:
        super().check(layout)
        if len(self.sites) % 2 or not self.sites:
            raise NumberError(f"{self.name}.sites = {self.sites}: pairs of x and y are needed, at least one")


@Blueprint.system(Phase.REWARD)
def pay_sites(
    reward: Write[Reward],
    solved: Write[Solved],
    body: Read[Body],
    clock: Read[Clock],
    crates: Rows[Crate],
    sites: tuple[float, ...],
    near: float,
    away: float,
    success: float,
) -> None:
    """Pay for crates at sites; each site counts the crate that is nearest."""
    count, total, done = len(sites) // 2, np.float32(0), clock.tick[0] > 0
    for k in range(count):
        least = np.float32(FAR)
        for crate in crates:
            least = min(least, metres(body, crate, sites[2 * k], sites[2 * k + 1]))
        total += least
        done &= least <= near
    reward.reward[0] = success * done - away * total / count if clock.tick[0] > 0 else 0
    solved.solved[0] += done


@dataclass(frozen=True)
class Shelter(Task):
    """The agent shelters a pillar from rays that come from the edge of the floor to its middle (ShelterRewardWrapper).

    Whatever stands in the way stops a ray, also the agent. The task is done while no ray arrives.
    """

    radius: float = number(0.5, above=0, high=FAR, unit="metres", about="radius of the pillar in the middle")
    rays: int = number(10, low=1, high=MANY, about="rays from each side of the floor")
    hit: float = number(0.1, low=0, high=MUCH, unit="reward per tick", about="penalty if all rays arrive")

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("pillar", (Body(), Shape(radius=ref("radius")), Solid(), Target()), 1, order=70)]


@Shelter.system(Phase.REWARD)
def pay_rays(
    reward: Write[Reward],
    solved: Write[Solved],
    clock: Read[Clock],
    targets: Rows[Target],
    bodies: Bodies,
    room_size: float,
    rays: int,
    hit: float,
) -> None:
    """Cast the rays, from each side in turn, and pay for those that do not arrive."""
    far, arrive = HALF * EDGE * np.float32(room_size), 0
    for k in range(4 * rays):
        along = far * (np.float32(2) * np.float32(k // 4) / np.float32(rays) - np.float32(1))
        x, y = along, -far
        for _ in range(k % 4):  # quarter turns
            x, y = -y, x
        found, _ = first_on_ray(bodies, bodies.members, x, y, -x, -y, NOBODY)
        arrive += found == targets[0]
    reward.reward[0] = -hit * np.float32(arrive) / np.float32(4 * rays) if clock.tick[0] > 0 else 0
    solved.solved[0] += clock.tick[0] > 0 and arrive == 0


@dataclass(frozen=True)
class Counting(Task):
    """Crates leave the sight of an agent that stands still, one after the other, to its left or to its right.

    Nothing is paid. How many have gone to the left is what a classifier reads from the memory of a policy. Crates wait
    side by side ahead of the agent, and each leaves on a line of its own.
    """

    first: int = number(10, low=0, high=LATEST, unit="ticks", about="earliest tick in which a crate leaves")
    apart: int = number(10, low=0, high=LATEST, unit="ticks", about="mean time from one crate to the next")
    speed: float = number(2.5, above=0, high=FAR, unit="metres per second", about="speed of crates that leave")

    def singletons(self) -> Iterable[Singleton]:
        return [Reward(), Parade(), Passed()]  # without Solved, as there is nothing to do


@Counting.system(Phase.SPAWN, after="spawn_grid")
def line_up(
    body: Write[Body],
    parade: Write[Parade],
    agents: Rows[Aloft],
    crates: Rows[Crate],
    room_size: float,
    first: int,
    apart: int,
    key: Random,
) -> None:
    """Put the agent at the wall behind it and the crates ahead; draw their places, ticks and sides."""
    back = -HALF * EDGE * np.float32(room_size)
    body.x[agents[0]], body.y[agents[0]] = back, 0
    for k in range(crates.size):
        ahead = np.float32(room_size) * (NEAREST + (FARTHEST - NEAREST) * np.float32(k) / np.float32(crates.size))
        across = SPREAD * (np.float32(2 * k + HALF + uniform(key, 3 * k)) / np.float32(crates.size) - np.float32(1))
        body.x[crates[k]], body.y[crates[k]] = back + ahead, ahead * across
        parade.tick[k] = first + int(apart * (k + uniform(key, 3 * k + 1)))
        parade.side[k] = 1 if uniform(key, 3 * k + 2) < HALF else -1


@Counting.system(Phase.DRIVE, after=(Body, Push, "handling", "preparation"))
def leave(
    body: Write[Body],
    push: Write[Push],
    parade: Read[Parade],
    passed: Write[Passed],
    clock: Read[Clock],
    agents: Rows[Aloft],
    crates: Rows[Crate],
    speed: float,
) -> None:
    """Keep the agent still; move the crates whose time has come, and count those that go to the left."""
    for e in agents:
        body.vx[e], body.vy[e], body.omega[e] = 0, 0, 0
        push.x[e], push.y[e], push.turn[e] = 0, 0, 0
    passed.went_left[0] = 0
    for k in range(crates.size):
        if clock.tick[0] >= parade.tick[k]:
            body.vy[crates[k]] = speed * np.float32(parade.side[k])
            passed.went_left[0] += parade.side[k] > 0
