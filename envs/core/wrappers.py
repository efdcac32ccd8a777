"""Gymnasium's vector wrappers that sum one reward for each sub-environment, where each agent of a world has its own."""

from types import FrameType

from gymnasium.vector import VectorWrapper
from gymnasium.wrappers.vector import NormalizeReward, RecordEpisodeStatistics

SUMMING = (NormalizeReward, RecordEpisodeStatistics)


def refuse_reward_sums(caller: FrameType | None) -> None:
    """TypeError if a call of the environment comes through one of these wrappers.

    An environment does not see what wraps it before it is called; without this the wrapper would raise numpy's error
    about shapes that do not broadcast.

    Args:
        caller: The frame that called the environment; those of wrappers lie above it.
    """
    while caller is not None and isinstance(wrapper := caller.f_locals.get("self"), VectorWrapper):
        if isinstance(wrapper, SUMMING):
            raise TypeError(
                f"{type(wrapper).__name__} sums one reward for each sub-environment; here that is a world whose agents "
                "have a reward each, (worlds, agents). Wrap outlast.make_agents(...), in which every agent is a "
                'sub-environment; returns and lengths of episodes are also in info["statistics"]'
            )
        caller = caller.f_back
