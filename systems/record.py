"""The statistics that every episode reports at its end."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Death, Episode, Phase, Reward, Score, Side
from outlast.ecs import Clock, Module, Read, Rows, Singleton, Write


@dataclass(frozen=True)
class Record(Module):
    """Length, returns, kills by side, deaths by cause, and the tick of the first death."""

    def singletons(self) -> Iterable[Singleton]:
        return [Episode()]


@Record.system(Phase.RECORD)
def note(
    episode: Write[Episode],
    reward: Read[Reward],
    score: Read[Score],
    death: Read[Death],
    clock: Read[Clock],
    agents: Rows[Side],
) -> None:
    """Add this tick to the episode."""
    episode.length[0] = clock.tick[0]
    for s in range(score.kills.size):
        episode.kills[s] += score.kills[s]
    for i in range(agents.size):
        e = agents[i]
        episode.returns[i] += reward.reward[i]
        if death.now[e]:
            episode.deaths[death.damage_type[e]] += 1
            if episode.first_death[0] == 0:
                episode.first_death[0] = clock.tick[0]
