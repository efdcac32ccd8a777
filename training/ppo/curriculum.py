"""Levels that a function chooses while agents train: its arguments, and the assignment of levels to worlds."""

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
from outlast.envs.storage import inputs

from ..base.config import Choose
from ..base.errors import TrainingError
from ..policies.checkpoint import REST
from ..policies.player import Player

Array = np.ndarray[Any, Any]
Ended = tuple[int, int, Level, dict[str, Array]]  # step of the rollout, world, its level, statistics (...) by name
STREAM = np.uint64(0x6C6576656C)  # "level": keeps these draws apart from others of the same world and episode


@dataclass(frozen=True)
class TrainingProgress:
    """Progress of a run, for the function that chooses its levels.

    Attributes:
        scenario: The scenario of training, with the observations that the policy needs.
        steps: Agent-steps collected so far.
        seed: Seed of the run.
        rng: A generator for this call only, the same whenever the run is at this step.
        policy: The policy that has played so far, as from outlast.load_policy.
        levels: The last levels that the function returned; at first one level in which everything is drawn.
        played: The levels of the episodes that have ended since the last call, with their keys and all their numbers,
            rounded to float32. Identify your levels by their keys: the levels themselves are not equal.
        statistics: Their statistics, (episodes, ...) by name, as in info["statistics"] of SurvivalVectorEnv.
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
    """The levels that episodes are drawn from: those that the function returned last; at first, all is drawn."""

    def __init__(self, choose: Choose, env: SurvivalVectorEnv) -> None:
        """Take a function, called before each rollout. Raises TrainingError if worlds have no levels."""
        self.choose, self.varied, self.layout = choose, dict(env.scenario.varied), env.worlds.layout
        self.levels: Sequence[Level] = (Level(),)
        try:
            env.set_levels(self.levels)
        except NumberError:
            raise TrainingError(
                f"{env.scenario.name} has no levels to choose, since numbers, walls and roles are fixed: vary some, as "
                "by scenario.vary(melee_damage=outlast.distributions.integers(5, 20)), or leave out levels"
            ) from None

    def take(self, levels: Any) -> None:
        """Draw from these levels from now on. Raises TrainingError if they are not levels."""
        try:
            check_all(levels, self.varied)
            check_free(levels, self.layout)
        except NumberError as error:
            raise TrainingError(f"the function must return levels: {error}") from None
        if not levels:
            raise TrainingError("the function returned an empty list of levels; return [Level()] to draw everything")
        self.levels = tuple(levels)

    def deal(self, env: SurvivalVectorEnv, where: Array, keys: Array) -> None:
        """Give levels, drawn by keys uint64 (some worlds, 3), to the worlds `where`, before their episode."""
        words = hashed(STREAM, *keys.T)
        drawn = ((words >> np.uint64(11)) * 2.0**-53 * len(self.levels)).astype(int)
        dealt = zip((self.levels[k] for k in drawn), keys.tolist(), strict=True)
        env.set_levels([Level(level.numbers, level.key or tuple(own)) for level, own in dealt], where)

    def state(self) -> str:
        """Return the levels as text."""
        return json.dumps(encoded(self.levels))

    def restore(self, given: Any) -> None:
        """Restore the result of `state`. Raises TrainingError for other content."""
        try:
            self.take(decoded(json.loads(given)))
        except inputs.BROKEN_JSON as error:
            raise TrainingError(f"levels in {REST} of the checkpoint are invalid: {error}") from None


def joined(ended: Iterable[Ended], env: SurvivalVectorEnv) -> tuple[list[Level], dict[str, Array]]:
    """Return levels and statistics of episodes in the order of their ends; env defines the statistics."""
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
