"""Gymnasium's vector wrappers that cannot work: refused by name and with a remedy, before numpy raises some error."""

from collections.abc import Iterator
from types import FrameType

import gymnasium
from gymnasium.spaces import Dict
from gymnasium.vector import AutoresetMode, VectorWrapper
from gymnasium.wrappers.vector import NormalizeObservation, NormalizeReward, RecordEpisodeStatistics

SUMMING = (NormalizeReward, RecordEpisodeStatistics)
# RecordEpisodeStatistics leaves out the first step of every episode but the first under SAME_STEP. The floor in
# pyproject.toml is lower, as RLlib asks for gymnasium 1.2.2 exactly.
MISCOUNTS = tuple(int(part) for part in gymnasium.__version__.split(".")[:2]) < (1, 4)


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


def refuse_miscounts(caller: FrameType | None, mode: AutoresetMode) -> None:
    """TypeError if a call comes through a wrapper that would count episodes wrong; see `refuse_reward_sums`."""
    if not MISCOUNTS or mode is not AutoresetMode.SAME_STEP:
        return
    if any(isinstance(wrapper, RecordEpisodeStatistics) for wrapper in _wrappers(caller)):
        raise TypeError(
            f"RecordEpisodeStatistics of gymnasium {gymnasium.__version__} leaves out the first step of an episode "
            "under autoreset_mode='SameStep'; take gymnasium >= 1.4, 'NextStep', or info[\"statistics\"]"
        )


def _wrappers(caller: FrameType | None) -> Iterator[VectorWrapper]:
    """Yield the wrappers around an environment, the innermost one first."""
    while caller is not None and isinstance(wrapper := caller.f_locals.get("self"), VectorWrapper):
        yield wrapper
        caller = caller.f_back
