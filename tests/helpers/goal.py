"""Games that are won in a fixed tick, which may be the last one that the time limit allows, or by points."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import End, Outcome, Phase
from outlast.ecs import Clock, Module, Read, Singleton, Write
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.variants import variant

TICK = 10


@dataclass(frozen=True)
class Goal(Module):
    """The game is won at TICK."""


@Goal.system(Phase.END, after="ending.end")
def reach(clock: Read[Clock], end: Write[End]) -> None:
    if clock.tick[0] >= TICK:
        end.terminated[0] = True


def won_at_the_limit() -> Scenario:
    """A game whose episodes are won in the tick in which they would be truncated."""
    return variant("ffa_2").replace(ending_limit=TICK).with_(Goal())


@dataclass(frozen=True)
class Points(Module):
    """The side with the highest number wins, however long the others live."""

    def singletons(self) -> Iterable[Singleton]:
        return [Outcome()]


@Points.system(Phase.RECORD)
def count(outcome: Write[Outcome]) -> None:
    for s in range(outcome.outcome.size):
        outcome.outcome[s] = s - 5.0  # below 0, where absent sides must not win


def won_by_points() -> Scenario:
    """A game that ends at TICK, before anybody dies, and that the last side wins."""
    return variant("ffa_2").replace(ending_limit=TICK).with_(Points())
