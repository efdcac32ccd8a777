"""Scores by side, rewards, the end of an episode, and its statistics."""

from outlast.ecs import Array, Signal, Singleton, Statistic, column


class Score(Singleton):
    """Living members of each side, and the deaths and kills of this tick."""

    alive: Array = column("i4", "sides")
    deaths: Array = column("i4", "sides")
    kills: Array = column("i4", "sides")


class Outcome(Statistic):
    """The score of each side, in games that are not won by surviving longest: the highest score wins.

    A mechanic of the game declares and writes it. Without it, the side that survives longest wins.
    """

    outcome: Array = column("f8", "sides")


class Reward(Signal):
    """Reward of each agent for this tick."""

    reward: Array = column("f4", "agents")


class End(Signal):
    """The end of the episode in this tick: by its own rule, or by the time limit."""

    terminated: Array = column("b1")
    truncated: Array = column("b1")


class Episode(Statistic):
    """The statistics that every episode reports, with any mechanics."""

    length: Array = column("i4")  # ticks
    returns: Array = column("f8", "agents", key="return")  # sums of rewards


class Kills(Statistic):
    """The deaths of an episode, in games in which agents can die. Added and written by mortality."""

    kills: Array = column("i4", "sides")
    deaths: Array = column("i4", "damage_types")
    first_death: Array = column("i4")  # tick, 0: no deaths
