"""Recordings: the inputs of episodes, in about one byte per agent-step, and bit-identical replays of them.

Read in this order: recorder (the stored part of a tick), container (the layout of the file), reader, replay (the ticks
repeated), digests (detection of differences).
"""

import os
import warnings
from collections.abc import Callable
from typing import Any

from ..core.vector_env import SurvivalVectorEnv
from .policy_record import PolicyRecorder
from .reader import Recording
from .recorder import Recorder
from .replay import Replay

__all__ = ["Recorder", "Recording", "Replay", "record"]


def record(
    env: SurvivalVectorEnv,
    path: str | os.PathLike[str],
    *,
    policy: Any = None,
    plays: Callable[[], Any] | None = None,
    episodes: int | None = None,
    played: dict[str, Any] | None = None,
) -> Recorder:
    """Record `env` from its next reset on, which must reset all worlds.

    Until the recording is closed, `set_state` is refused, as is changing numbers that do not vary, and actions are
    checked even if check_actions is False. Ends that an adapter adds (stop_when) are not recorded, and a UserWarning
    reports it: in the recording, those episodes break off.

    Args:
        env: The environment itself: `wrapper.unwrapped` of a gymnasium wrapper.
        path: A new file.
        policy: A policy from `outlast.load_policy`. What it thinks before every tick is recorded, too: the
            probabilities of its actions, the value that it expects, and what it attends to. For that it is called an
            additional time, for any policy that acts. None: record no policy.
        plays: A function that returns whether it plays each agent at present, bool (worlds, agents). None: all.
        episodes: Number of first episodes of each world that are counted; 0: all that end. A replay counts the
            same. None: it counts the first of each world, if each has one.
        played: Who plays, if a person does: "agent", the number of theirs, and "others", the name of its opponent.

    Returns:
        The recorder. Use it as a context manager, or close either it or the environment.

    Raises:
        RecordingError: The file exists or cannot be written, `env` is being recorded already or has numbers changed by
            set_numbers, or the policy cannot report its probabilities.
        TrainingError: The policy does not fit the environment.
        TypeError: `env` is not a SurvivalVectorEnv.
    """
    if not isinstance(env, SurvivalVectorEnv):
        raise TypeError(
            f"record() needs an environment of make_vec, not {type(env).__name__}: give env.unwrapped of a gymnasium "
            "wrapper, or env.base_env of an adapter"
        )
    if env._stops is not None:
        warnings.warn(
            "ends that an adapter adds (its learner's death, max_episode_steps) are in no recording: in replays and "
            "datasets these episodes just break off",
            stacklevel=2,
        )
    thoughts = None if policy is None else PolicyRecorder(env, policy, plays)
    return env.add_observer(
        lambda: Recorder(path, env.scenario, env.worlds, env.first_world, thoughts, env._guard.wait, episodes, played)
    )
