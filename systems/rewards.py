"""Rewards: for being alive, for kills, for deaths."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Phase, Reward, Score, Side
from outlast.ecs import Clock, Module, Read, Rows, Singleton, Write, number


@dataclass(frozen=True)
class Rewards(Module):
    """R = alive or dead, + kills * kill, + deaths * death, of an agent's side (paper, section 3.5).

    A side is alive while one of its members is. posthumous: whether a side that is dead after the tick is still paid
    for its kills in it; in the paper's free-for-all runs it was not (reference rules, section 5).
    """

    alive: float = number(1.0)
    dead: float = number(0.0)
    kill: float = number(0.0)
    death: float = number(0.0)
    posthumous: bool = number(True)

    def singletons(self) -> Iterable[Singleton]:
        return [Reward()]


@Rewards.system(Phase.REWARD, after="ending.count")
def pay(
    reward: Write[Reward],
    score: Read[Score],
    side: Read[Side],
    clock: Read[Clock],
    agents: Rows[Side],
    alive: float,
    dead: float,
    kill: float,
    death: float,
    posthumous: bool,
) -> None:
    """Every member gets what its side gets; nothing in the tick that starts an episode."""
    for i in range(agents.size):
        s = side.side[agents[i]]
        pay = alive if score.alive[s] > 0 else dead
        if posthumous or score.alive[s] > 0:
            pay += score.kills[s] * kill
        pay += score.deaths[s] * death
        reward.reward[i] = pay if clock.tick[0] > 0 else 0
