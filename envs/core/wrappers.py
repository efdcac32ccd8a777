"""Gymnasium's vector wrappers that cannot work: refused by name and with a remedy, before numpy raises some error."""

from collections.abc import Iterator
from types import FrameType

from gymnasium.spaces import Dict
from gymnasium.vector import VectorWrapper
from gymnasium.wrappers.vector import NormalizeObservation, NormalizeReward, RecordEpisodeStatistics

SUMMING = (NormalizeReward, RecordEpisodeStatistics)


def refuse_reward_sums(caller: FrameType | None) -> None:
    """TypeError if a call comes through a wrapper that sums up one reward for each sub-environment.

    An environment does not see its wrappers before it is called. Without this check, such a wrapper would raise numpy's
    error about shapes that do not broadcast.

    Args:
        caller: The frame that called the environment; those of wrappers lie above it.
    """
    for wrapper in _wrappers(caller):
        if isinstance(wrapper, SUMMING):
            raise TypeError(
                f"{type(wrapper).__name__} sums one reward for each sub-environment; here that is a world whose agents "
                "have a reward each, (worlds, agents). Wrap outlast.make_agents(...), in which every agent is a "
                'sub-environment; returns and lengths of episodes are also in info["statistics"]'
            )


def refuse_dicts(caller: FrameType | None) -> None:
    """TypeError if a call comes through a wrapper that needs observations in one array; see `refuse_reward_sums`."""
    for wrapper in _wrappers(caller):
        if isinstance(wrapper, NormalizeObservation) and isinstance(wrapper.env.single_observation_space, Dict):
            raise TypeError(
                "NormalizeObservation takes observations in one array, and here they are a dict; wrap "
                "gymnasium.wrappers.vector.FlattenObservation first: NormalizeObservation(FlattenObservation(env))"
            )


def _wrappers(caller: FrameType | None) -> Iterator[VectorWrapper]:
    """Yield the wrappers around an environment, the innermost one first."""
    while caller is not None and isinstance(wrapper := caller.f_locals.get("self"), VectorWrapper):
        yield wrapper
        caller = caller.f_back
