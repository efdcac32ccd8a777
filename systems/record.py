"""The statistics that every episode reports at its end."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Death, Episode, Phase, Reward, Score, Side
from outlast.ecs import Clock, Module, Read, RowIndex, Rows, Singleton, Write


@dataclass(frozen=True)
class Record(Module):
    """Records length, returns, kills by side, deaths by cause, and the tick of the first death."""

    def singletons(self) -> Iterable[Singleton]:
        return [Episode(), Death()]


@Record.system(Phase.RECORD)
def note(
    episode: Write[Episode],
    reward: Read[Reward],
    score: Read[Score],
    deaths: Read[Death],
    clock: Read[Clock],
    agents: Rows[Side],
    index: RowIndex[Side],
) -> None:
    """Add this tick to the statistics of the episode."""
    episode.length[0] = clock.tick[0]
    for s in range(score.kills.size):
        episode.kills[s] += score.kills[s]
    for i in range(agents.size):
        episode.returns[i] += reward.reward[i]
    for k in range(deaths.count[0]):
        if index[deaths.agent[k]] < 0:
            continue
        if deaths.damage_type[k] >= 0:
            episode.deaths[deaths.damage_type[k]] += 1
        if episode.first_death[0] == 0:
            episode.first_death[0] = clock.tick[0]
