"""Line-ups, policies with weights of which one is drawn for each world and episode; sides, and which of them wins."""

import contextlib
import copy
import math
import os
import re
import weakref
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from outlast.components import End, Outcome, Score
from outlast.ecs import Clock, Worlds

from ..core.spaces import side
from ..core.validation import Array, checked_actions
from ..core.vector_env import Actions, Arrays, SurvivalVectorEnv
from ..errors import UsageError
from ..scenarios.parse import member_of, module_of
from ..scenarios.scenario import Scenario
from .memory import Begins, has_memory, tell
from .policies import POLICIES, Maker, Policy, hashed, maker_of, others_policy
from .saved import SAVED_AS, common_scenario, is_saved, load_saved, models, policy_file, similar, text_of
from .summary import RESULTS

Other = str | os.PathLike[str] | Policy
Others = Other | Mapping[Any, float]  # one policy, or the weight of each of several
Entries = list[tuple[str | Policy, float]]  # a name, a path or a function, with its weight
ROLES = 2
OWN = re.compile(r".+\.py:[^\W\d]\w*|[^\W\d]\w*(\.[^\W\d]\w*)+:[^\W\d]\w*")  # policies in users' files and modules
OWN_AS = "FILE.py:FUNCTION"  # what such a policy is named by
PLAYED = ("against", "own_side", "result")  # columns that tables of episodes get: text, int, text

OWNERS = weakref.WeakValueDictionary[int, "Lineup"]()  # who plays a policy with a memory, by the policy's id
STREAM = np.uint64(0x6D697874757265)  # "mixture"; makes draws differ from others in the same world and episode


def parse_lineup(text: str, names: Collection[str] = tuple(POLICIES)) -> dict[str, float]:
    """Return the weights in a text such as "scripted:0.5,runs/a.zip:0.3,random", by name or path, in order.

    text: Policies as for `checked_entries`, or FILE.py:FUNCTION, see `own_policy`; each followed by a colon and its
    weight, or else the weight is 1. names: Those that are allowed. Raises UsageError.
    """
    pairs = []
    for part in text.split(","):
        name, weight = part.strip(), "1"
        # C:/runs may be a folder, whose colon is not that of a weight
        if ":" in name and not (is_saved(name) or is_own(name) or Path(name).is_dir()):
            name, _, weight = (piece.strip() for piece in name.rpartition(":"))
        pairs.append((name, weight))
    return {str(name): weight for name, weight in checked_entries(pairs, names)}


def checked_entries(pairs: Iterable[tuple[Any, Any]], names: Collection[str] = tuple(POLICIES)) -> Entries:
    """Check policies with their weights, and return them. Raises UsageError, as for a policy that is given twice.

    pairs: Pairs of a policy and its weight, a finite number above 0. A policy is one of `names`, a model's name, the
    path of a saved policy, the folder of a run, whose newest one is taken, or a function (observations) -> actions.
    """
    entries: Entries = []
    for given, weight in pairs:
        policy = text_of(given) if isinstance(given, os.PathLike) else given
        if isinstance(policy, str):
            policy = policy_file(policy, names)
            if not (policy in names or is_saved(policy) or (is_own(policy) and tuple(names) == tuple(POLICIES))):
                raise UsageError(f"{policy or 'nothing'}: {similar(policy, names)}{_needed(names)}")
        elif not callable(policy):
            raise UsageError(f"{policy!r} is not a policy: {_needed(names)}, or a function (observations) -> actions")
        if _same(policy) in [_same(other) for other, _ in entries]:
            raise UsageError(f"{policy} is there twice: give it once, with the sum of its weights")
        entries.append((policy, _checked_weight(policy, weight)))
    if not entries:
        raise UsageError(f"a mixture of nothing: {_needed(names)}")
    return entries


def entries_of(others: Any) -> Entries:
    """Return the entries of a line-up as users give it: a policy, a text ("scripted:2,random") or weights by policy."""
    try:
        if isinstance(others, str):
            return list(parse_lineup(others).items())
        return checked_entries(others.items() if isinstance(others, Mapping) else [(others, 1)])
    except UsageError as error:
        raise UsageError(f"others = {others!r}: {error}") from None


def copied_others(others: Others, memo: Any) -> Others:
    """Return a copy, made by copy.deepcopy, so that no policy plays in two environments. Raises UsageError."""
    try:
        return copy.deepcopy(others, memo)
    except TypeError as error:
        raise UsageError(f"others = {others!r:.80} cannot be copied: {error}; give it __deepcopy__()") from error


def load_policies(names: Sequence[str | Policy], asked: Scenario, seed: int) -> tuple[Scenario, list[str | Policy]]:
    """Return the scenario with observations that all policies can play with, and what `loaded` returns."""
    chosen = loaded(names, seed)
    players: list[Any] = [each for each in chosen if hasattr(each, "scenario")]
    fitting = common_scenario(asked, players)
    if players:
        with contextlib.closing(SurvivalVectorEnv(fitting, 1, seed=seed)) as env:
            for player in players:
                player.check(env)
    return fitting, chosen


def is_own(name: str) -> bool:
    """Return whether it names a policy in a file or module of the user: "mygame.py:clever", "package.module:clever"."""
    return OWN.fullmatch(name) is not None and not is_saved(name)


def is_foreign(policy: str | Policy) -> bool:
    """Return whether it is a user's function, which may keep observations, and return anything."""
    return callable(policy) or is_own(policy)


def own_policy(name: str) -> Maker:
    """Return a function (env, seed) that makes the policy which `is_own` is about; its file or module is imported."""
    place, _, member = name.rpartition(":")
    return maker_of(member_of(module_of(place), member, place, ()), name)


def loaded(names: Sequence[str | Policy], seed: int) -> list[str | Policy]:
    """Return the names and functions, with loaded policies in place of their files' paths. Raises UsageError."""
    seeds = [seed, *(int(np.random.SeedSequence([seed, k]).generate_state(1)[0]) for k in range(1, len(names)))]
    return [
        load_saved(name, own) if isinstance(name, str) and not (name in POLICIES or is_own(name)) else name
        for name, own in zip(names, seeds, strict=True)
    ]


def maker(chosen: str | Policy) -> Maker:
    """Return a function that makes the policy for an environment and a seed, as in POLICIES, or returns `chosen`."""
    if isinstance(chosen, str):
        return POLICIES[chosen] if chosen in POLICIES else own_policy(chosen)
    return lambda env, seed: chosen


def draw(weights: Sequence[float] | Array, seeds: Any, worlds: Any, episodes: Any) -> Array:
    """Draw an entry for each world: a function of the weights and (seed, world, episode), the same in any batch.

    weights: Finite numbers >= 0, at least one above 0: (entries,), or a row for each world, (worlds, entries). An entry
    with twice the weight is drawn twice as often. The others: See `key_of`. Returns indices, int64 (worlds,).
    """
    weights = np.asarray(weights, np.float64)
    if not (np.isfinite(weights).all() and (weights >= 0).all() and (weights > 0).any(-1).all()):
        raise ValueError(f"weights = {weights.tolist()}: finite numbers >= 0 are needed, in each row one above 0")
    # scaled, so that the sum neither vanishes nor overflows
    sums = np.cumsum(weights / weights.max(-1, keepdims=True), -1)
    words = hashed(STREAM, *(np.asarray(part).astype(np.uint64) for part in (seeds, worlds, episodes)))
    uniform = (words >> np.uint64(11)) * 2.0**-53
    return np.asarray((sums <= uniform[:, None] * sums[..., -1:]).sum(-1))


def key_of(worlds: Worlds, where: Any = slice(None)) -> tuple[Array, Array, Array]:
    """Return the present seeds, world numbers and episode numbers of the worlds `where`, uint64 (worlds,) each."""
    clock = worlds[Clock]
    return clock.seed[where, 0], clock.world[where, 0], clock.episode[where, 0]


def role_of(side: Any, world: Any, episode: Any) -> Any:
    """Return which role plays a side: roles alternate, and swap from world to world and from episode to episode."""
    return (side + world + episode) % ROLES


def own_side(world: Any, episode: Any, sides: Any) -> Any:
    """Return which of `sides` a policy plays against all others: another in the next world, and in the next episode."""
    return (world + episode) % sides


class Lineup:
    """Several policies as one policy with a memory: at the beginning of each episode, it draws which of them plays.

    The draw is a function of (seed, world, episode). Each policy is called for all worlds at once, but not while it
    plays in none of them. It gets the observations of the line-up's agents only, in order of id: a dict of float32
    (worlds, agents, ...); functions of users get copies in `actions`. It returns integers (worlds, agents, actions). A
    policy with a memory also has a method `reset`: see memory.told. "random" is a function of (seed, world, episode,
    tick, agent): it plays a world in the same way in any batch.

    Attributes:
        names: What the policies are called in errors and results; by default their names or paths.
        drawn: Index of the policy that plays in each world, int (worlds,).
        agents: Which agents of a world it plays, a list or a slice.

    Args:
        entries: The policies with their weights; see `checked_entries` and `draw`. If a policy has a method `check`,
            that is called with `env`, and raises if the policy cannot play there.
        learner: An agent that it does not play; None: it plays all.
    """

    def __init__(
        self, entries: Entries, env: SurvivalVectorEnv, learner: int | None = None, names: Sequence[str] = ()
    ) -> None:
        given, self._weights = zip(*entries, strict=True)
        self._env, last = env, env.num_agents - 1
        ids = [i for i in range(env.num_agents) if i != learner]
        self.agents: Any = ids  # replaced by a slice where that is possible, as that copies nothing
        if learner in (None, 0, last):
            self.agents = slice(int(learner == 0), last if learner == last and last else None)
        self.names = tuple(names) or tuple(getattr(policy, "__name__", str(policy)) for policy in given)
        self._policies = [self._playing(policy, env, ids) for policy in given]
        prefix, but = ("", "") if learner is None else ("others: ", " but the learner")
        self._whats = [f"{prefix}the actions that {name} returned" for name in self.names]
        self._axes = f"(worlds, agents{but}, actions)"
        self._shape = (env.num_worlds, len(ids), len(env.action_sizes))
        self._foreign = any(map(is_foreign, given))  # users' functions, which may keep the arrays that they get
        self._begins = None if len(given) == 1 and not has_memory(self._policies[0]) else Begins(env)
        self.drawn = np.zeros(env.num_worlds, int)

    @staticmethod
    def _playing(playing: Any, env: SurvivalVectorEnv, agents: Sequence[int]) -> Policy:
        """Return the function that plays for an entry."""
        if isinstance(playing, str):
            if playing in POLICIES:
                return others_policy(playing, env, agents)
            if is_own(playing):
                return own_policy(playing)(env, 0)
            playing = load_saved(playing)
            playing.key_by(env, agents)
        if callable(check := getattr(playing, "check", None)):
            check(env)
        return cast(Policy, playing)

    def reset(self, where: Array) -> None:
        """Draw who plays in the worlds `where`, bool (worlds,), as episodes begin there."""
        self.drawn[where] = draw(self._weights, *key_of(self._env.worlds, where))
        for policy in self._policies:
            if has_memory(policy) and where.all():
                OWNERS[id(policy)] = self
            tell(policy, where)

    def actions(self) -> Actions:
        """Return its actions in the worlds as they are now, after `reset` where episodes begin; once for each step."""
        if not self._shape[1]:
            return np.zeros(self._shape, np.int8)
        if self._begins is not None and (where := self._begins.look()).any():
            self.reset(where)
        seen = {key: values[:, self.agents] for key, values in self._env._reader.views.items()}
        return self({key: values.copy() for key, values in seen.items()} if self._foreign else seen)

    def __call__(self, observations: Arrays) -> Actions:
        """Return the actions, integers (worlds, agents, actions). Raises ActionError."""
        if len(self.names) == 1:
            return self._actions(0, observations)
        joint = np.empty(self._shape, np.int64)
        for k in range(len(self.names)):
            if (here := self.drawn == k).any():
                joint[here] = self._actions(k, observations)[here]
        return joint

    def _actions(self, k: int, observations: Arrays) -> Actions:
        if has_memory(self._policies[k]) and OWNERS.get(id(self._policies[k])) is not self:
            raise UsageError(
                f"{self.names[k]} has a memory (a method reset), and has played in other worlds since it began to play "
                "here: give each environment a policy of its own"
            )
        actions, sizes = self._policies[k](observations), self._env.action_sizes
        return checked_actions(actions, self._shape, sizes, False, what=self._whats[k], axes=self._axes)


def _needed(names: Collection[str]) -> str:
    own = f", or {OWN_AS} of your own" * (tuple(names) == tuple(POLICIES))
    return f"{', '.join(names)} or a saved policy ({SAVED_AS}) is needed{own}"


def _checked_weight(policy: object, weight: Any) -> float:
    with contextlib.suppress(TypeError, ValueError):
        if not isinstance(weight, bool) and 0 < (number := float(weight)) < math.inf:
            return number
    raise UsageError(f"the weight of {policy} is {weight!r}: a finite number above 0 is needed; leave out who has 0")


def _same(policy: str | Policy) -> object:
    """Return a value that is equal for two spellings of the same path."""
    if isinstance(policy, str) and is_saved(policy) and policy not in models():
        return os.path.realpath(policy)
    return policy


class Standings:
    """Progress of each side of each world in its episode."""

    def __init__(self, worlds: Worlds) -> None:
        self._worlds = worlds
        self.life = np.zeros((worlds.count, worlds.dims["sides"]), int)  # ticks that ended with a living member

    def begin(self, where: Array) -> None:
        """Begin anew in the worlds `where`, bool (worlds,)."""
        self.life[where] = 0

    def watch(self) -> None:
        """Count the ticks that sides live; to be called after each step."""
        self.life += self._worlds[Score].alive > 0

    def of(self, rows: Array) -> Array:
        """Return scores in components.Outcome, or else ticks lived, float64 (rows, sides); -inf for absent sides."""
        come = self._worlds[Outcome].outcome[rows] if Outcome in self._worlds else self.life[rows]
        there = (side(self._worlds, rows)[:, :, None] == np.arange(come.shape[1])).any(1)
        return np.where(there, come, -np.inf)


def own_wins(come: Array, own: Array) -> Array:
    """Return whether the side `own` of each world wins against all others; see `wins`. come: (worlds, sides)."""
    mine = own[:, None] == np.arange(come.shape[1])
    return wins(np.stack([np.where(each, come, -np.inf).max(1) for each in (mine, ~mine)], 1))[:, 0]


def shares_beaten(come: Array, own: Array, sides: Array) -> Array:
    """Return the share of the other sides that the side `own` of each world came farther than; equally far is a half.

    For sides that play equally well it is 1/2 on average for any number; for two sides it is `own_wins`. sides: How
    many each world has, at least 2, (worlds,); those beyond are absent.
    """
    number = np.arange(come.shape[1])
    others = (number < sides[:, None]) & (number != own[:, None])
    return (_beats(np.take_along_axis(come, own[:, None], 1), come) * others).sum(1) / others.sum(1)


def wins(come: Array) -> Array:
    """Return who wins: 1, 0, or 0.5 in a draw, given how far the best side of each role came, float64 (..., roles)."""
    return _beats(come, come[..., ::-1])


def _beats(one: Array, other: Array) -> Array:
    return np.where(one > other, 1.0, np.where(one < other, 0.0, 0.5))


class Against:
    """A policy on one side of each world and a line-up on all others, as one policy with a memory.

    That side is lineup.own_side, and the result `own_wins`. If numbers of agents vary, an episode may have one side
    only; such episodes are not counted. Worlds must restart in the step after the end (NEXT_STEP). Policy and line-up
    get the observations of all agents. Raises UsageError if the game has only one side.

    counts: How many episodes the policy won, drew and lost against each one of the line-up, int (policies, 3).
    """

    def __init__(self, env: SurvivalVectorEnv, policy: Policy, others: Lineup) -> None:
        self._env, self.policy, self._others = env, policy, others
        sides = env.worlds.dims["sides"]
        if sides < 2:
            raise UsageError(f"{env.scenario.name} has one side: there is nobody to play against; leave out --others")
        self._own, self._sides = np.zeros((2, env.num_worlds), int)
        self._standings = Standings(env.worlds)
        self.counts = np.zeros((len(others.names), len(RESULTS)), int)
        self._results = np.full(env.num_worlds, len(RESULTS))  # of the last episode that ended in each world

    def reset(self, where: Array) -> None:
        """Choose sides and players for the episodes that begin in the worlds `where`, bool (worlds,)."""
        tell(self.policy, where)
        tell(self._others, where)
        _, worlds, episodes = key_of(self._env.worlds, where)
        self._sides[where] = side(self._env.worlds, where).max(1) + 1
        self._own[where] = own_side(worlds, episodes, self._sides[where])
        self._standings.begin(where)

    def __call__(self, observations: Arrays) -> Actions:
        """Return the actions of all agents, integers (worlds, agents, actions)."""
        return np.where(self.plays()[..., None], self.policy(observations), self._others(observations))

    def plays(self) -> Array:
        """Return which agents the policy plays in the current episodes, bool (worlds, agents)."""
        return side(self._env.worlds) == self._own[:, None]

    def watch(self, where: Array) -> None:
        """Count the episodes of the worlds `where`, bool (worlds,), that ended in a step; to be called after each."""
        self._standings.watch()
        end = self._env.worlds[End]
        ended = (end.terminated | end.truncated)[:, 0] & where
        rows = np.flatnonzero(ended & (self._sides > 1))
        self._results[ended] = len(RESULTS)
        self._results[rows] = 2 - 2 * own_wins(self._standings.of(rows), self._own[rows])
        np.add.at(self.counts, (self._others.drawn[rows], self._results[rows]), 1)

    def played(self, rows: Array) -> dict[str, Array]:
        """Return the columns PLAYED of the episodes that just ended in the worlds `rows`; "" for those of one side."""
        names, results = np.array(self._others.names), np.array([*RESULTS, ""])
        found = names[self._others.drawn[rows]], self._own[rows], results[self._results[rows]]
        return dict(zip(PLAYED, found, strict=True))

    @property
    def outcomes(self) -> dict[str, Array]:
        """The rows of `counts` by the names of the line-up: views, which are updated as counting goes on."""
        return dict(zip(self._others.names, self.counts, strict=True))
