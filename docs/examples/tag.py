"""Tag: one agent is it, and a touch passes that on; a base is safe, running tires, and shields protect for a while."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from outlast import Scenario, systems
from outlast.components import Bag, Body, Item, Phase, Reward, SelfView, Shape, Side, Spawned, Weapon
from outlast.components.agent import present
from outlast.components.body import PLACE
from outlast.components.inventory import held
from outlast.ecs import (
    Archetype,
    Array,
    Component,
    Entity,
    Event,
    Field,
    Module,
    Observation,
    Random,
    Read,
    RowIndex,
    Rows,
    Singleton,
    Statistic,
    Write,
    column,
    emit,
    kernel,
    number,
    ref,
)
from outlast.ecs.kernels.random import integer
from outlast.systems.observation_rows import observe

# --- stamina: who runs gets tired


class Breath(Component):
    """How long an agent can still run. Written by stamina."""

    left: Array = column("i4")  # ticks for which it can still run


@dataclass(frozen=True)
class Stamina(Module):
    """An agent that moves loses a tick of breath, one that stands gains some; without any, it has to stand."""

    most: int = number(90, low=1, unit="ticks", about="breath of a rested agent")
    rest: int = number(2, low=1, unit="ticks", about="breath that a tick of rest gives back")

    def archetypes(self) -> Iterable[Archetype]:
        """One more component for every agent."""
        return [Archetype("agent", (Breath(left=ref("most")),))]

    def fields(self):
        """A number in the agents' own row, and in its copies that the others see."""
        return {"own": (Field("stamina", "ticks", scale=100.0),)}

    def bounds(self, layout):
        """The range of that number."""
        return {"own": {"stamina": (0, self.most)}}


@Stamina.system(Phase.DRIVE, after=Body)
def tire(body: Write[Body], breath: Write[Breath], agents: Rows[Breath], most: int, rest: int) -> None:
    """Steering has set the speed of each agent; what is out of breath is stopped."""
    for e in agents:
        if breath.left[e] == 0:
            body.vx[e], body.vy[e] = 0, 0
        if body.vx[e] == 0 and body.vy[e] == 0:
            breath.left[e] = min(breath.left[e] + rest, most)
        else:
            breath.left[e] -= 1


observe(Stamina, SelfView, "own", Side, stamina=Breath.left)

# --- tag: a melee that takes no hit points, but passes on who is it


class Player(Component):
    """What an agent is in the game. Written by tag, and `safe` also by shields."""

    it: Array = column("u1")  # 1: this agent is it
    safe: Array = column("i4")  # ticks for which it cannot be tagged


class Tagged(Event, capacity=1, who="by", whom="agent"):
    """A touch that made another agent it."""

    agent: Array = column("i4", unit="entity")
    by: Array = column("i4", unit="entity")


class Tags(Statistic):
    """Touches in this episode, and for how many ticks each agent was it."""

    tags: Array = column("i4")
    ticks_it: Array = column("i4", "agents")


@dataclass(frozen=True)
class Tag(systems.Melee):
    """One agent is it. Whom it strikes is it from then on, unless that one is in the base, or safe."""

    damage_type: ClassVar[str] = ""  # tagging does no damage

    reach = 1.0
    cooldown = 15  # ticks without a strike, after a hit and for an agent that has become it
    damage = 0
    base: float = number(1.5, low=0, unit="metres", about="radius of the safe circle in the middle of the room")
    it_reward: float = number(-1.0, unit="reward per tick", about="for being it")
    free_reward: float = number(0.1, unit="reward per tick", about="for being neither it nor in the base")

    def archetypes(self) -> Iterable[Archetype]:
        """What a melee adds, and the players."""
        return [*super().archetypes(), Archetype("agent", (Player(),))]

    def singletons(self) -> Iterable[Singleton]:
        """What a melee adds, and what happens, is counted and is paid here."""
        return [*super().singletons(), Tagged(), Tags(), Reward()]

    def fields(self):
        """Two more numbers in the agents' own row."""
        return {"own": (Field("it"), Field("safe", "ticks", scale=100.0))}

    def bounds(self, layout):
        """Whoever makes agents safe says for how long, as shields do."""
        return {"own": {"it": (0, 1), "safe": (0, 0)}}


@kernel
def in_base(body, e, base) -> bool:
    """Whether the centre of `e` is in the safe circle."""
    return body.x[e] * body.x[e] + body.y[e] * body.y[e] <= base * base


@Tag.system(Phase.DRAW)
def choose(player: Write[Player], entities: Read[Entity], agents: Rows[Player], key: Random) -> None:
    """A random agent of those that there are is it at the start of the episode."""
    player.it[agents[integer(key, 0, present(entities, agents))]] = 1


@Tag.system(Phase.MELEE, after="tag.aim")
def strike(
    player: Write[Player],
    weapon: Write[Weapon],
    tagged: Write[Tagged],
    body: Read[Body],
    agents: Rows[Player],
    index: RowIndex[Player],
    base: float,
    cooldown: int,
) -> None:
    """In place of the melee's strike. `aim`, which is the melee's own, has found what everybody's strike hits."""
    for me in agents:
        e = weapon.target[me]
        hit = e >= 0 and index[e] >= 0  # an agent, and not something else with hit points
        if player.it[me] and hit and player.safe[e] == 0 and not in_base(body, e, base):
            player.it[me], player.it[e] = 0, 1
            weapon.cooldown[e] = cooldown
            k = emit(tagged)
            tagged.agent[k], tagged.by[k] = e, me
            break
    for e in agents:
        player.safe[e] = max(player.safe[e] - 1, 0)


observe(Tag, SelfView, "own", Side, it=Player.it, safe=Player.safe)


@Tag.system(Phase.REWARD)
def pay(
    reward: Write[Reward],
    player: Read[Player],
    body: Read[Body],
    agents: Rows[Player],
    base: float,
    it_reward: float,
    free_reward: float,
) -> None:
    """Whoever is it loses, and others gain outside of the base."""
    for i in range(agents.size):
        e = agents[i]
        free = 0 if in_base(body, e, base) else free_reward
        reward.reward[i] = it_reward if player.it[e] else free


@Tag.system(Phase.RECORD)
def count(tags: Write[Tags], tagged: Read[Tagged], player: Read[Player], agents: Rows[Player]) -> None:
    """Events of the tick can be read until the next one begins."""
    tags.tags[0] += tagged.count[0]
    for i in range(agents.size):
        tags.ticks_it[i] += player.it[agents[i]]


# --- shields: items


class Shield(Component):
    """An item that makes its user safe."""

    ticks: Array = column("i4")  # for which the user is safe


class ShieldView(Observation):
    """Shields on the ground. Mask: 1 = visible."""

    shields: Array = column("f4", "agents", "shields", fields=PLACE)
    shields_mask: Array = column("f4", "agents", "shields", low=0, high=1)


@dataclass(frozen=True)
class Shields(Module):
    """Shields lie around. An agent that uses one cannot be tagged for a while."""

    count: int = number(4, low=1, about="number of shields")
    radius: float = number(0.3, low=0.002, unit="metres", about="radius of a shield on the ground")
    ticks: int = number(60, low=1, unit="ticks", about="how long a shield protects")

    def archetypes(self) -> Iterable[Archetype]:
        """A new kind of item."""
        body = (Body(), Shape(radius=ref("radius")), Spawned())
        return [Archetype("shield", (*body, Item(), Shield(ticks=ref("ticks"))), ref("count"))]

    def singletons(self) -> Iterable[Singleton]:
        """What agents see of them on the ground."""
        return [ShieldView()]

    def dims(self) -> dict[str, int | str]:
        """The dimension "shields" of the columns above."""
        return {"shields": ref("count")}

    def fields(self):
        """Whether the last slot of the bag, which is what an agent can use, holds one."""
        return {"own": (Field("has_shield"),)}

    def bounds(self, layout):
        """Nobody is safe for longer than a shield makes it."""
        return {"own": {"has_shield": (0, 1), "safe": (0, self.ticks)}}


@Shields.system(Phase.EFFECT)
def protect(player: Write[Player], item: Read[Item], shield: Read[Shield], shields: Rows[Shield]) -> None:
    """A used shield makes its user safe."""
    for e in shields:
        if item.user[e] >= 0:
            player.safe[item.user[e]] = shield.ticks[e]


@kernel
def has_shield(i, e, bag: Read[Bag], index: RowIndex[Shield]) -> int:
    """What is in the last slot may be another kind of item."""
    return 1 if held(bag, e, index) >= 0 else 0


observe(Shields, ShieldView, "shields", Shield, x=Body.x, y=Body.y)
observe(Shields, SelfView, "own", Side, has_shield=has_shield)

# --- the game

TAG = Scenario(
    "tag",
    (
        systems.Agents(count=4),
        systems.FreeForAll(),
        systems.Room(size=12.0),
        systems.SpawnGrid(cells=6),
        systems.Steering(speed=4.0),
        systems.Physics(),
        systems.Inventory(slots=2),
        systems.Pickup(),
        systems.Ending(limit=600),
        systems.Record(),
        Stamina(),
        Tag(),
        Shields(),
    ),
)
