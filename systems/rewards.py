"""Rewards: for being alive, for kills, for deaths."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Phase, Reward, Score, Side
from outlast.components.limits import MUCH
from outlast.ecs import Module, Read, Rows, Singleton, Write, kernel, number, of

MEMBERS = 1  # index into the choices of Rewards.basis


@dataclass(frozen=True)
class Rewards(Module):
    """R = alive or dead, + kills * kill, + deaths * death, of an agent's side (paper, section 3.5).

    posthumous: whether a side that is dead after the tick is still paid for its kills in it; in the paper's
    free-for-all runs it was not (reference rules, section 5).

    Two numbers address the flaws 2 and 3 of the paper (section 5). basis: the basis of `alive` and `dead`. "side": a
    side is alive while one of its members is, as in the paper. "members": the mean over its members, so that a dead
    member has a cost. outlive: paid to a living side for each other side that dies out, for any cause.
    """

    alive: float = number(
        1.0,
        low=-MUCH,
        high=MUCH,
        per_agent=True,
        unit="reward per tick",
        about="for each agent of a side that is alive",
    )
    dead: float = number(
        0.0, low=-MUCH, high=MUCH, per_agent=True, unit="reward per tick", about="for each agent of a side that is dead"
    )
    kill: float = number(0.0, low=-MUCH, high=MUCH, per_agent=True, unit="reward", about="for each kill of the side")
    death: float = number(
        0.0, low=-MUCH, high=MUCH, per_agent=True, unit="reward", about="for each death of a member of the side"
    )
    posthumous: bool = number(True, about="a side that is dead after the tick is paid for its kills in that tick")
    basis: str = number(
        "side",
        choices=("side", "members"),
        about="alive and dead are paid by whether any member lives (side), or by the share that does (members)",
    )
    outlive: float = number(
        0.0,
        low=-MUCH,
        high=MUCH,
        per_agent=True,
        unit="reward",
        about="for a living side, for each other side that dies out",
    )

    def singletons(self) -> Iterable[Singleton]:
        return [Reward()]


@kernel
def members(side: Any, agents: Any, s: int) -> int:
    """Return the number of agents of side `s`, dead or alive."""
    count = 0
    for e in agents:
        count += side.side[e] == s
    return count


@Rewards.system(Phase.REWARD, after=Score)
def pay(
    reward: Write[Reward],
    score: Read[Score],
    side: Read[Side],
    agents: Rows[Side],
    alive: float,
    dead: float,
    kill: float,
    death: float,
    posthumous: bool,
    basis: int,
    outlive: float,
) -> None:
    """Pay every member the reward of its side."""
    gone = 0
    for s in range(score.alive.size):
        gone += score.deaths[s] > 0 and score.alive[s] == 0
    for i in range(agents.size):
        e = agents[i]
        s = side.side[e]
        if s < 0:  # absent
            reward.reward[i] = 0
            continue
        pay = of(alive, e) if score.alive[s] > 0 else of(dead, e)
        if basis == MEMBERS:
            share: Any = np.float32(score.alive[s]) / np.float32(members(side, agents, s))
            pay = share * of(alive, e) + (np.float32(1) - share) * of(dead, e)
        if posthumous or score.alive[s] > 0:
            pay += score.kills[s] * of(kill, e)
        if score.alive[s] > 0:
            pay += gone * of(outlive, e)
        pay += score.deaths[s] * of(death, e)
        reward.reward[i] = pay
