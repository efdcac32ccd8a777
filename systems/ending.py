"""The end: when an episode is over."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Death, End, Phase, Score, Side
from outlast.components.limits import TICKS
from outlast.ecs import (
    Array,
    Clock,
    Entity,
    Layout,
    Module,
    NumberError,
    Read,
    RowIndex,
    Rows,
    Singleton,
    Write,
    kernel,
    number,
)

LAST_ALIVE, NEVER = 1, 2  # indices into the choices of Ending.rule


@dataclass(frozen=True)
class Ending(Module):
    """Scores of sides, and the end of the episode (paper, section 3.5).

    rule = "all dead": it ends when all sides are dead. "last alive": when at most one side is. "never": only at its
    limit. limit: ticks until it is truncated if it has not ended by its rule; 0: never, as in the paper.
    """

    rule: str = number(
        "all dead",
        choices=("all dead", "last alive", "never"),
        about="episodes end when no side lives (all dead), at most one does (last alive), or only at the limit (never)",
    )
    limit: int = number(0, low=0, high=TICKS, unit="ticks", about="length after which an episode is cut off; 0: never")

    def check(self, layout: Layout) -> None:
        if self.rule == "never" and not self.limit:
            raise NumberError('ending.rule = "never" without a limit: episodes would not end; set ending_limit')

    def singletons(self) -> Iterable[Singleton]:
        return [Score(), End(), Death()]


def outliving_wins(layout: Layout) -> bool:
    """Return whether the side that lives longest has won: not if episodes only end at their limit."""
    return layout.numbers("ending").get("rule") != "never"


@kernel
def _known(side: int, score: Array) -> int:
    """Return the side, used as an index here, if it exists: users' systems may set it. Otherwise raise IndexError."""
    if not 0 <= side < score.alive.size:
        raise IndexError(
            "a system has set the side of an agent, or of its damage, to one that does not exist; -1: absent"
        )
    return side


@Ending.system(Phase.REWARD)
def count(
    score: Write[Score],
    deaths: Read[Death],
    side: Read[Side],
    entities: Read[Entity],
    agents: Rows[Side],
    index: RowIndex[Side],
) -> None:
    """Count living members, deaths and kills of this tick for each side. Killing the own side does not count."""
    score.alive[:] = 0
    score.deaths[:] = 0
    score.kills[:] = 0
    for e in agents:
        if entities.alive[e]:
            score.alive[_known(side.side[e], score)] += 1
    for k in range(deaths.count[0]):
        e, killer = deaths.agent[k], deaths.side[k]
        if index[e] < 0:
            continue
        score.deaths[_known(side.side[e], score)] += 1
        if killer >= 0 and killer != side.side[e]:
            score.kills[_known(killer, score)] += 1


@Ending.system(Phase.END)
def end(end: Write[End], score: Read[Score], clock: Read[Clock], rule: int, limit: int) -> None:
    """Terminate by the rule, or truncate at the limit."""
    sides_alive = 0
    for s in range(score.alive.size):
        sides_alive += score.alive[s] > 0
    end.terminated[0] = rule != NEVER and sides_alive <= (1 if rule == LAST_ALIVE else 0)
    end.truncated[0] = not end.terminated[0] and limit > 0 and clock.tick[0] >= limit
