"""Recordings: what decides an episode, in about one byte an agent-step, and replays of it that are the same bits.

Read in this order: recorder (what is kept of a tick), container (the layout of the file), reader, replay (the ticks
repeated), digests (how a difference is found).
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
) -> Recorder:
    """Record all that `env` does from its next reset on, which must be one of all worlds.

    Meanwhile `set_state` is refused, and actions are checked whatever check_actions says. Ends that an adapter adds
    (stop_when) are not recorded, of which a UserWarning warns: those episodes just break off.

    Args:
        env: The environment itself: `wrapper.unwrapped` of a gymnasium wrapper.
        path: A new file.
        policy: Record what this policy, which `outlast.load_policy` returned, thinks ahead of every tick: the
            probabilities of its actions, the value that it expects, what it attends to. It is asked once more for
            that, whoever acts. None: of no policy.
        plays: Which agents it plays at the moment, a function that returns bool (worlds, agents). None: all.

    Returns:
        The recorder. Use it as a context manager, or close it or the environment.

    Raises:
        RecordingError: The file exists or cannot be written, `env` is recorded already, or the policy is none that
            says what it thinks.
        TrainingError: The policy does not fit the environment.
        TypeError: `env` is no SurvivalVectorEnv.
    """
    if not isinstance(env, SurvivalVectorEnv):
        raise TypeError(
            f"record() needs what make_vec returns, not {type(env).__name__}: give env.unwrapped of a gymnasium "
            "wrapper, or env.base_env of an adapter"
        )
    if env._stops is not None:
        warnings.warn(
            "ends that an adapter adds (its learner's death, max_episode_steps) are in no recording: in replays and "
            "datasets these episodes just break off",
            stacklevel=2,
        )
    thoughts = None if policy is None else PolicyRecorder(env, policy, plays)
    return env.run_with(lambda: Recorder(path, env.scenario, env.worlds, env.first_world, thoughts, env._guard.wait))
