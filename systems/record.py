"""The statistics that every episode reports at its end."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Episode, Phase, Reward, Side
from outlast.ecs import Clock, Module, Read, Rows, Singleton, Write


@dataclass(frozen=True)
class Record(Module):
    """Statistics of length and returns."""

    def singletons(self) -> Iterable[Singleton]:
        return [Episode()]


@Record.system(Phase.RECORD)
def note(episode: Write[Episode], reward: Read[Reward], clock: Read[Clock], agents: Rows[Side]) -> None:
    """Add this tick to the statistics of the episode."""
    episode.length[0] = clock.tick[0]
    for i in range(agents.size):
        episode.returns[i] += reward.reward[i]
