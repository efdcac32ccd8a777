"""A game that is won in a fixed tick, which may be the last one that its time limit allows."""

from dataclasses import dataclass

from outlast.components import End, Phase
from outlast.ecs import Clock, Module, Read, Write
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
