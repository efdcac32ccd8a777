"""Levels that a user's function chooses during training: what the function knows, and which world plays which level."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.ecs import NumberError
from outlast.envs.core.spaces import statistics
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.levels import Level, check_all, check_free, decoded, encoded
from outlast.envs.rollout.policies import hashed
from outlast.envs.scenarios.scenario import Scenario

from .config import Choose
from .errors import TrainingError
from .player import Player

Array = np.ndarray[Any, Any]
Ended = tuple[int, int, Level, dict[str, Array]]  # step of the rollout, world, what it played, statistics (...) by name
STREAM = np.uint64(0x6C6576656C)  # "level": sets these draws apart from others of the same world and episode


@dataclass(frozen=True)
class TrainingProgress:
    """How far a run is, for the function that chooses its levels.

    Attributes:
        scenario: The scenario that is trained in, with the observations that the policy needs.
        steps: Agent-steps collected so far.
        seed: Seed of the run.
        rng: A new generator for each call of the function, the same whenever the run is at this step.
        policy: The policy that has played up to now, as from outlast.load_policy.
        levels: What the function returned last; at first a single level of which everything is drawn.
        played: The levels of the episodes that have ended since the last call, with all numbers and keys. To find a
            given level among them, compare keys: numbers are rounded to float32.
        statistics: Statistics of these episodes, (episodes, ...) by name, like SurvivalVectorEnv's info["statistics"].
    """

    scenario: Scenario
    steps: int
    seed: int
    rng: np.random.Generator
    policy: Player
    levels: Sequence[Level]
    played: Sequence[Level]
    statistics: Mapping[str, Array]


class Curriculum:
    """The levels that episodes of a run are drawn from.

    Attributes:
        levels: What the function returned last; at first a single level of which everything is drawn.
    """

    def __init__(self, choose: Choose, env: SurvivalVectorEnv) -> None:
        """Make one.

        Args:
            choose: The function, called before the first rollout and after each one.
            env: Worlds like those that are trained in. Raises NumberError if they can have no levels.
        """
        self.choose, self.varied, self.layout = choose, dict(env.scenario.varied), env.worlds.layout
        self.levels: Sequence[Level] = (Level(),)
        env.set_levels(self.levels)

    def ask(self, progress: TrainingProgress) -> None:
        """Let the function choose the levels of the next rollout. Raises TrainingError for anything but levels."""
        self.take(self.choose(progress))

    def take(self, levels: Any) -> None:
        """Draw from these levels from now on. Raises TrainingError for anything but levels."""
        try:
            check_all(levels, self.varied)
            check_free(levels, self.layout)
        except NumberError as error:
            raise TrainingError(f"what was chosen are no levels: {error}") from None
        if not levels:
            raise TrainingError("what was chosen are no levels: there is none; return [Level()] to have all drawn")
        self.levels = tuple(levels)

    def deal(self, env: SurvivalVectorEnv, where: Array, keys: Array) -> None:
        """Give levels to worlds whose next episode is about to begin.

        Args:
            env: The worlds.
            where: The worlds that get levels, bool (worlds,).
            keys: Their own keys, uint64 (some worlds, 3), by which levels are drawn. A level without a key is played
                with the world's own, even if the run is resumed in new worlds.
        """
        words = hashed(STREAM, *keys.T)
        drawn = ((words >> np.uint64(11)) * 2.0**-53 * len(self.levels)).astype(int)
        dealt = zip((self.levels[k] for k in drawn), keys.tolist(), strict=True)
        env.set_levels([Level(level.numbers, level.key or tuple(own)) for level, own in dealt], where)

    def state(self) -> str:
        """Return what a resumed run needs to go on."""
        return json.dumps(encoded(self.levels))

    def restore(self, given: Any) -> None:
        """Go on from what `state` returned. Raises TrainingError for anything else."""
        try:
            self.take(decoded(json.loads(given)))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise TrainingError(f"levels in rest.pt of the checkpoint are none: {error}") from None


def joined(ended: Iterable[Ended], env: SurvivalVectorEnv) -> tuple[list[Level], dict[str, Array]]:
    """Return levels and statistics of episodes, in the order in which they ended, whatever their lane.

    Args:
        ended: The episodes, in any order.
        env: Worlds like theirs, which determine what statistics there are if no episode has ended.
    """
    ordered = sorted(ended, key=lambda each: each[:2])
    none = statistics(env.worlds, np.zeros(env.num_worlds, bool))
    rows = {name: [own[name] for *_, own in ordered] for name in none}
    found = {name: np.stack(rows[name]) if ordered else values[:0] for name, values in none.items()}
    return [level for _, _, level, _ in ordered], found


def just_ended(env: SurvivalVectorEnv, t: int, done: Array, measured: Mapping[str, Array]) -> list[Ended]:
    """Return the episodes that ended in step t of a rollout, before their worlds are reset."""
    rows = np.flatnonzero(done).tolist()
    levels = env.levels(done)
    return [
        (t, env.first_world + w, level, {name: values[w].copy() for name, values in measured.items()})
        for w, level in zip(rows, levels, strict=True)
    ]
