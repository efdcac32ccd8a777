"""Opponents of the learners, with ratings: their present and past selves, policies by name, and saved files."""

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.policies import POLICIES

from ..base.config import PAST, SELF
from ..base.errors import TrainingError
from ..base.presets import Form
from ..policies.checkpoint import REST, check_state, load_weights
from ..policies.player import Player
from ..policies.policy import Networks
from ..policies.rows import Packer
from .ratings import MEAN

Array = np.ndarray[Any, Any]
Plain = Callable[[dict[str, Array], Array], Array]  # of agents' observations and uniform numbers, to actions
PAST_SELVES = 5  # past selves that are drawn from: evenly spaced over the run
STEP = 4.0  # Elo's K-factor: half of it is gained by winning a game that should have been drawn
SCALE = 400.0  # Elo points for odds of ten to one
FORGET = 0.9  # weight of earlier games per update; they count less since learners change
WRONG = f"opponents in {REST} of the checkpoint do not fit the run"
HIGHEST, MOST, LONGEST = 1e6, 2.0**53, 20  # limits in a checkpoint: of ratings, games, digits of agent-steps
LEAST = 0.02  # added to every priority, so that an opponent that always loses is still drawn


@dataclass
class Opponent:
    """An opponent that can be drawn."""

    name: str  # one of OPPONENTS, a path, or past@STEPS for a past self, with its agent-steps of training
    weight: float  # relative frequency of draws, unless opponents are prioritised
    policies: Sequence[Networks] = ()  # those of a past self, one for each learner, or those of a file
    packers: Mapping[Form, Packer] | None = None  # of observations for these, by form; None: the learners' packers
    team: Array | None = None  # int (agents of a world,), the policy of each agent; None: as with the learners
    plain: Plain | None = None  # instead of policies
    rating: float = MEAN
    won: float = 0.0  # games that the learners won against it, in the shares of `record_all`; earlier ones count less
    games: float = 0.0  # games that they played against it; earlier ones count less
    total: int = 0  # all games against it, each counted as one

    @property
    def past(self) -> bool:
        """Return whether it is a past self."""
        steps = self.name.removeprefix(f"{PAST}@")
        return steps != self.name and steps.isdecimal() and len(steps) < LONGEST

    @property
    def weights(self) -> str:
        """A hash of the weights of its policies."""
        tensors = (each for policy in self.policies for each in policy.state_dict().values())
        return hashlib.sha256(b"".join(each.cpu().numpy().tobytes() for each in tensors)).hexdigest()

    @property
    def wins(self) -> float:
        """The share of games that the learners won, smoothed: 1/2 without games."""
        return (self.won + 0.5) / (self.games + 1)


class OpponentPool:
    """The pool that opponents are drawn from, by index, and the ratings of all in it.

    Index 0 is the present self: where it is drawn, learners play all sides. Past selves that are no longer drawn are
    kept while they play in any world.

    dropped: Games against past selves that are no longer in the pool. memory: Width of the widest memory of all.
    """

    def __init__(
        self,
        weights: Mapping[str, float],
        players: Mapping[str, Player],
        env: SurvivalVectorEnv,
        *,
        prioritised: bool,
        memory: int = 0,
    ) -> None:
        """Create a pool without past selves, for worlds like those of `env`.

        weights: By path or name of OPPONENTS. players: Players of the paths. prioritised: Whether opponents that win
        more are drawn more often: prioritised fictitious self-play (Vinyals et al., 2019); the present self keeps its
        weight. memory: Width of the memory of the learners' policies.
        """
        self.weights, self.prioritised = dict(weights), prioritised
        self.all = {0: Opponent(SELF, weights.get(SELF, 0.0))}
        for name in weights:  # the order decides the indices, which are in checkpoints and equal in all processes
            if name not in players and name not in (SELF, PAST):
                self._add(Opponent(name, weights[name], plain=plain(name, env)))
        for name, player in players.items():
            player.check(env)
            team = player.team if len(player.policies) > 1 else np.zeros(env.num_agents, int)
            self._add(Opponent(name, weights[name], player.policies, player.packers, team))
        self.past: list[int] = []
        self.dropped = 0
        self.memory = max([memory, *(player.memory for player in players.values())])

    def _add(self, one: Opponent) -> int:
        number = max(self.all) + 1
        self.all[number] = one
        return number

    @property
    def alone(self) -> bool:
        """Return whether the present self is the only opponent."""
        return self.weights.keys() <= {SELF}

    def chances(self) -> tuple[Array, Array]:
        """Return indices that can be drawn, int, and their weights, float64 of the same length."""
        shares = {k: one.weight for k, one in self.all.items() if not one.past}
        shares |= {k: self.weights[PAST] / len(self.past) for k in self.past}
        if not self.past:
            shares[0] += self.weights.get(PAST, 0.0)
        if self.prioritised:
            priority = {k: shares[k] * ((1 - self.all[k].wins) ** 2 + LEAST) for k in shares if k}
            factor = sum(shares[k] for k in priority) / (sum(priority.values()) or 1)
            shares |= {k: value * factor for k, value in priority.items()}
        return np.array(list(shares)), np.array(list(shares.values()))

    def remember(self, policies: Sequence[Networks], steps: int, playing: set[int]) -> None:
        """Add a copy of the learners to the past selves. playing: Indices of the opponents that play in some world."""
        if PAST not in self.weights:
            return
        past = Opponent(f"{PAST}@{steps}", 0.0, [frozen(policy) for policy in policies], rating=self.all[0].rating)
        self.past.append(self._add(past))
        if len(self.past) > PAST_SELVES:
            at = [int(self.all[k].name.partition("@")[2]) for k in self.past]
            gaps = [at[k + 1] - at[k - 1] for k in range(1, len(at) - 1)]
            del self.past[1 + int(np.argmin(gaps))]  # keeps the others evenly spaced
        for k in [k for k, one in self.all.items() if one.past and k not in self.past and k not in playing]:
            self.dropped += self.all.pop(k).total

    def record_all(self, games: Iterable[tuple[int, int, float]]) -> None:
        """Record the games of a rollout, in any order: the step in which each ended, the opponent, the share won.

        The share is that of the other sides that the learners' side beat, see lineup.shares_beaten. Between equals it
        is 1/2 on average for any number of sides, and ratings and priorities treat 1/2 as even.
        """
        ended: dict[tuple[int, int], list[float]] = {}
        for step, index, won in games:
            ended.setdefault((step, index), []).append(won)
        for step, index in sorted(ended):
            each = ended[step, index]
            self.record(index, math.fsum(each), len(each))  # an exact sum: it is the same in any order

    def record(self, index: int, won: float, games: int) -> None:
        """Record games against an opponent. won: Sum of the shares won."""
        one, own = self.all[index], self.all[0]
        expected = 1 / (1 + 10 ** ((one.rating - own.rating) / SCALE))
        change = float(np.clip(STEP * (won - games * expected), -SCALE / 4, SCALE / 4))
        own.rating += change
        if not one.past:  # a past self keeps its rating as the present self
            one.rating -= change
        one.won, one.games, one.total = one.won + won, one.games + games, one.total + games

    def report(self) -> dict[str, float]:
        """Return the values to log, by tag, and reduce the weight of the games so far."""
        tags = {}
        if not self.alone:
            tags["rating/self"] = self.all[0].rating
        by_kind = dict[str, list[Opponent]]()
        for one in self.all.values():
            by_kind.setdefault(PAST if one.past else one.name, []).append(one)
        for name, those in by_kind.items():
            if name != SELF and (games := sum(one.games for one in those)):
                tags[f"wins/{name}"] = sum(one.won for one in those) / games
                tags[f"rating/{name}"] = sum(one.rating * one.games for one in those) / games
                total = sum(one.total for one in those)
                tags[f"games/{name}"] = float(total + (self.dropped if name == PAST else 0))
                for one in those:
                    one.won, one.games = one.won * FORGET, one.games * FORGET
        return tags

    def state(self) -> dict[str, Any]:
        """Return the state for a checkpoint: ratings of all, the past selves, and hashes of the policies of files."""
        figures = {
            str(k): torch.tensor([one.rating, one.won, one.games, one.total], dtype=torch.float64, device="cpu")
            for k, one in self.all.items()
        }
        saved = {str(k): one.weights for k, one in self.all.items() if one.policies and not one.past}
        past = {str(k): {"name": one.name, "drawn": k in self.past} for k, one in self.all.items() if one.past}
        for k in past:
            past[k]["weights"] = [policy.state_dict() for policy in self.all[int(k)].policies]
        return {"figures": figures, "past": past, "dropped": self.dropped, "saved": saved}

    def restore(self, given: Any, policies: Sequence[Networks], begun: str) -> None:
        """Continue from the result of `state`, with policies like the learners'. Raises TrainingError otherwise.

        begun: The opponents with their weights at the beginning of the run.
        """
        _check(isinstance(given, dict) and given.keys() == {"figures", "past", "dropped", "saved"})
        figures, past, saved = (_by_index(given[name]) for name in ("figures", "past", "saved"))
        pool = {number: one for number, one in self.all.items() if not one.past}
        _check(saved.keys() <= pool.keys())
        for number, weights in saved.items():
            if pool[number].weights != weights:
                raise TrainingError(
                    f"{pool[number].name} is not the policy that the run has played against, as it was begun with "
                    f"{begun}: name that file, or put it there, to resume, or begin another run"
                )
        for number, kept in past.items():
            _check(number not in pool and isinstance(kept, dict) and kept.keys() == {"name", "drawn", "weights"})
            weights, name = kept["weights"], kept["name"]
            _check(isinstance(weights, list) and len(weights) == len(policies))
            pool[number] = Opponent(str(name), 0.0, [frozen(policy) for policy in policies])
            _check(isinstance(name, str) and pool[number].past)
            for policy, own in zip(pool[number].policies, weights, strict=True):
                load_weights(policy, own, f"{name} in {REST}")
        none = torch.zeros(4, dtype=torch.float64, device="cpu")
        check_state(figures, dict.fromkeys(pool, none), "opponents")
        for number, one in pool.items():
            one.rating, one.won, one.games, total = figures[number].tolist()
            _check(abs(one.rating) <= HIGHEST and 0 <= one.won <= one.games <= total <= MOST)
            one.total = int(total)
        self.dropped = given["dropped"]
        _check(type(self.dropped) is int and 0 <= self.dropped <= MOST)
        self.all, self.past = pool, sorted(number for number, kept in past.items() if kept["drawn"])


def _check(condition: bool) -> None:
    if not condition:
        raise TrainingError(WRONG)


def _by_index(given: Any) -> dict[int, Any]:
    """Return the values by their names, which must be indices. Raises TrainingError otherwise."""
    _check(isinstance(given, dict))
    _check(all(len(name) < LONGEST and name.isdecimal() and name == str(int(name)) for name in given))
    return {int(name): value for name, value in given.items()}


def frozen(policy: Networks) -> Networks:
    """Return a copy of a policy that is not trained."""
    return deepcopy(policy).requires_grad_(False)


def plain(name: str, env: SurvivalVectorEnv) -> Plain:
    """Return a policy by name, as a function of agents' observations and uniform numbers, see Opponent.plain."""
    if name == "random":
        return lambda observations, uniform: (uniform * env.action_sizes).astype(np.int64)
    if name == "noop":
        return lambda observations, uniform: np.broadcast_to(env.noop, uniform.shape)
    decide = POLICIES[name](env, 0)
    return lambda observations, uniform: np.asarray(decide(observations))
