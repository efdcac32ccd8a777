"""A rollout: observations, actions and rewards of all agents in a number of steps; and its collection in worlds."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from outlast.ecs import Clock
from outlast.envs.core.observations import GlobalState
from outlast.envs.core.spaces import alive, counts_vary, side
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.core.visible_rows import VisibleRows
from outlast.envs.rollout.lineup import Standings, draw, key_of, own_side, shares_beaten

from ..arena.opponent_pool import OpponentPool, Plain
from ..base.config import CHUNK, TrainingConfig
from ..base.errors import TrainingError
from ..base.metrics import BehaviourMetrics, EpisodeMetrics, Tallies
from ..base.observation_layout import layout_of
from ..base.presets import Form, Preset
from ..policies import compiled_networks
from ..policies.checkpoint import REST
from ..policies.player import ActionNoise
from ..policies.policy import Networks
from ..policies.rows import Observed, Rows, concatenated, packers_of
from ..policies.torch_settings import FLOAT, playing
from .crew import Crew
from .curriculum import Curriculum, Ended, just_ended

Array = np.ndarray[Any, Any]
NOBODY = -1  # the learner of a sample that is not used for training
DEAREST = 1e30  # the largest reward or sum of rewards: float32 can hold it, and float64 its square
BATCH = 4096  # samples of a rollout that are valued at once


@dataclass(frozen=True)
class Rollout:
    """Samples (steps, agents, ...) of the agents of this process; of all processes, where noted, once completed."""

    seen: Mapping[Form, Observed]  # before each step, steps * agents, by the form in which networks take it
    own: Array  # float32 (steps, agents, layout.own), numbers that belong to no entity, as observed
    actions: Array  # int64 (steps, agents, actions)
    log_probs: Array  # float32, log-probabilities of the actions when they were chosen
    values: Array  # float32, by the critic; of all processes. networks apart compute them at the end
    rewards: Array  # float32
    later: Array  # float32, the value of the next observation, where an episode was truncated after the step; else 0
    ends: Array  # bool, whether the agent's next step does not count for this one, since its episode ends
    begins: Array  # bool, whether the agent's memory is reset before the step
    alive: Array  # bool, whether the agent lived when it observed
    learner: Array  # int16, the learner that is trained on the sample, or NOBODY; of all processes
    idle: Array | None  # bool (steps, agents, actions), whether one was not drawn, for lack of effect; None: all were
    memory: Array  # float32 (chunks, agents, width), the agents' memory before each chunk of CHUNK steps
    last: Array  # float32 (agents,), values of the observations at the end
    advantages: Array = field(default_factory=lambda: np.empty(0, np.float32))  # of all processes
    first: int = 0  # index of this process's first agent among those of all processes

    @property
    def returns(self) -> Array:
        """float32, targets of the values."""
        return self.advantages + self.values

    def here(self, samples: Tensor) -> tuple[Tensor | None, Tensor]:
        """Return which samples of all processes are of this one (None: all), and their indices here."""
        agents, own = self.learner.shape[1], self.actions.shape[1]
        if own == agents:
            return None, samples
        step, agent = samples // agents, samples % agents - self.first
        where = ((agent >= 0) & (agent < own)).nonzero().flatten()
        return where, (step * own + agent)[where]


class RewardScale:
    """The running standard deviation of discounted sums of rewards, the divisor of rewards.

    It makes values and advantages about as large in all scenarios. All older rollouts together have at most MEMORY
    times the weight of the newest one, so it moves slowly after a while.
    """

    MEMORY = 50.0
    LEAST = 1e-8  # below it the spread is negligible, and rewards are not scaled

    def __init__(self, agents: int, gamma: float) -> None:
        """Begin. agents: Number of agents in all worlds. gamma: Discount of a step."""
        self.gamma, self.sums = gamma, np.zeros(agents)
        self.count, self.mean, self.variance = 0.0, 0.0, 1.0

    def update(self, rewards: Array, ends: Array) -> float:
        """Add rewards, (steps, agents), and return the deviation. ends: Whether a sum is reset after the step."""
        sums = np.empty(rewards.shape)
        for t, reward in enumerate(rewards):
            self.sums = sums[t] = self.sums * self.gamma + reward
            self.sums = np.where(ends[t], 0, self.sums)
        kept = min(self.count, self.MEMORY * sums.size)
        share, apart = sums.size / (kept + sums.size), sums.mean() - self.mean
        self.variance += share * (sums.var() - self.variance + (1 - share) * apart**2)
        self.mean += share * apart
        self.count = kept + sums.size
        spread = math.sqrt(self.variance)
        return spread if spread >= self.LEAST else 1.0

    def state(self) -> dict[str, Tensor]:
        """Return the state for a checkpoint, as float64 tensors."""
        numbers = {"sums": self.sums, "count": self.count, "mean": self.mean, "variance": self.variance}
        return {name: torch.tensor(value, dtype=torch.float64, device="cpu") for name, value in numbers.items()}

    def restore(self, given: Any) -> None:
        """Restore tensors like those of `state`. Raises TrainingError if a number is out of bounds."""
        self.sums = given["sums"].numpy().copy()
        self.count, self.mean, self.variance = (float(given[name]) for name in ("count", "mean", "variance"))
        if wrong := self.wrong(f" in {REST} of the checkpoint"):
            raise TrainingError(f"rewards {wrong}")

    def wrong(self, where: str = "") -> str:
        """Name the number that is out of the bounds for a run, with `where`, and the bounds; "" if none is."""
        for name, value in self.state().items():
            low, high = (0.0, DEAREST**2) if name in ("count", "variance") else (-DEAREST, DEAREST)
            if not ((value >= low) & (value <= high)).all():
                return f"{name}{where} is beyond {low:g} to {high:g}"
        return ""


def advantages(rewards: Array, values: Array, ends: Array, last: Array, gamma: float, gae_lambda: float) -> Array:
    """Return generalized advantage estimates (Schulman et al., arXiv:1506.02438), float32 (steps, agents).

    Args:
        rewards: float32 (steps, agents); at a truncation, they include the value of the next observation.
        values: float32 (steps, agents), of the observation before each step.
        ends: bool (steps, agents), whether the agent's next step does not count for this one.
        last: float32 (agents,), values of the observations after the last step.
        gamma: Discount of a step.
        gae_lambda: Horizon of the estimates: from 0 (one step) to 1 (to the end).
    """
    found, later = np.empty_like(rewards), np.zeros_like(last)
    for t in reversed(range(len(rewards))):
        goes_on = np.float32(gamma) * ~ends[t]
        following = values[t + 1] if t + 1 < len(rewards) else last
        later = rewards[t] + goes_on * following - values[t] + goes_on * np.float32(gae_lambda) * later
        found[t] = later
    return found


class AgentGroup(NamedTuple):
    """Agents that one network plays: their indices (a slice if these are all agents), and the same as a tensor."""

    where: Any
    members: Tensor  # int64


class Lane:
    """The worlds of this process, and their players.

    Opponents are drawn when an episode begins, by (seed, world, episode). Where one is drawn, learners play one side
    and the opponent all others.

    Networks and worlds take turns. Two alternatives were tried and are slower: halves of the worlds on two threads, and
    stepping worlds while networks compute for others. Half of a step's time is Python's, which threads cannot share.

    Attributes:
        opponent: int (worlds,), the index of the opponent in each world, see OpponentPool.
        own: int (worlds,), the side of the learners where `opponent` is not 0.
        teacher: If not None, learners play, but the actions of this policy are stored, to be imitated.
        keys: uint64 (worlds, 3), seed, world and episode, by which levels and opponents are drawn. The worlds have the
            same keys, except where levels bring keys of their own.
        scale: The scale of rewards, those of all processes.
        played: With a curriculum, the episodes that have ended in this rollout.
        games: For each game against an opponent that has ended in it: the step, the opponent, and the share of the
            other sides that the learners beat.
        seen: What was observed in each step of it, by the form in which networks take it.
    """

    def __init__(
        self,
        config: TrainingConfig,
        env: SurvivalVectorEnv,
        presets: Sequence[Preset],
        team: Array,
        opponents: OpponentPool,
        curriculum: Curriculum | None,
        crew: Crew,
    ) -> None:
        """Create a lane, in worlds that have been reset, in which the present selves play everywhere.

        presets: Of the learners. team: int (agents of a world,), the learner of each agent. opponents: Who may play.
        curriculum: What levels are drawn from; None: worlds draw theirs. crew: The processes that share the worlds.
        """
        self.curriculum, self.keys = curriculum, np.stack(key_of(env.worlds), 1)
        self.played, self.games = list[Ended](), list[tuple[int, int, float]]()
        self.seen = list[dict[Form, Observed]]()
        self.overview = GlobalState(env.worlds) if config.critic == "state" else None
        self.env, self.team, self.pool, self.dead = env, team, opponents, config.dead
        self.packers = packers_of(layout_of(env), presets)
        self.packer, *_ = self.packers.values()  # what is the same for all: the layout, and an agent's own numbers
        self.masked = np.array([each.masked for each in presets])
        self._noop = torch.from_numpy(np.array(env.noop, np.int64))
        self.teacher: Plain | None = None
        self._lists = VisibleRows(env._reader.views)
        self.agents, self._sides = env.num_worlds * env.num_agents, side(env.worlds)
        self.numbers, self.crew, each = config.numbers, crew, crew.gather_values(self.agents)
        self.first, self.scale = sum(each[: crew.rank]), RewardScale(sum(each), config.numbers.gamma)
        self.noise = ActionNoise(config.seed, env.worlds[Clock].world[:, 0], env.num_agents, len(env.action_sizes))
        self.episodes, self.behaviour = EpisodeMetrics(env), BehaviourMetrics(env)
        self.opponent, self.own = np.zeros(env.num_worlds, int), np.zeros(env.num_worlds, int)
        self.standings = Standings(env.worlds)
        self.memory = torch.zeros((self.agents, opponents.memory), **FLOAT)
        self.begins = np.ones(self.agents, bool)
        self.assign()
        self._draw(np.ones(env.num_worlds, bool))

    @torch.inference_mode()
    def collect(self, policies: Sequence[Networks], steps: int, begun: int) -> Rollout:
        """Play some steps in each world and return the samples. begun: Number of steps played before."""
        self._open(steps, policies)
        for t in range(steps):
            self.take(t, self.env.step(self.act(t, begun + t, policies)), policies)
        self.samples.last[:] = self._values(policies)
        seen = {form: concatenated([each[form] for each in self.seen]) for form in self.seen[0]}
        return self._completed(replace(self.samples, seen=seen), policies)

    def _open(self, steps: int, policies: Sequence[Networks]) -> None:
        """Allocate memory for the samples."""
        self.seen, self.games, self.played, shape, chunks = [], [], [], (steps, self.agents), -(-steps // CHUNK)
        memory, able = max(policy.memory for policy in policies), compiled_networks.able
        self.acting = {k: compiled_networks.Acting(policy) for k, policy in enumerate(policies) if able(policy)}
        actions = (*shape, len(self.env.action_sizes))
        floats: dict[str, Any] = {n: np.zeros(shape, np.float32) for n in ("log_probs", "values", "rewards", "later")}
        truths: dict[str, Any] = {name: np.zeros(shape, bool) for name in ("ends", "begins", "alive")}
        self.samples = Rollout(
            seen={},
            own=np.zeros((*shape, self.packer.layout.own), np.float32),
            actions=np.zeros(actions, np.int64),
            **floats,
            **truths,
            learner=np.zeros(shape, np.int16),
            idle=np.zeros(actions, bool) if self.masked.any() else None,
            memory=np.zeros((chunks, self.agents, memory), np.float32),
            last=np.zeros(self.agents, np.float32),
        )

    @playing()
    def act(self, t: int, step: int, policies: Sequence[Networks]) -> Array:
        """Choose the actions, int64 (worlds, agents, actions), of step t of the rollout, and store inputs."""
        env, samples = self.env, self.samples
        seen, uniform = self.observe(), self.noise(step)
        numbers = torch.from_numpy(uniform)
        self.seen.append(seen)
        samples.own[t] = self.packer.own(env._reader.views)
        samples.alive[t] = alive(env.worlds).ravel()
        samples.begins[t] = self.begins
        samples.learner[t] = self.learner if self.dead == "keep" else np.where(samples.alive[t], self.learner, NOBODY)
        if samples.idle is not None:
            samples.idle[t] = env._actions.idle().reshape(self.agents, -1)
            if not self.masked.all():
                samples.idle[t] &= self.masked[self.learner, None]
        if t % CHUNK == 0:
            samples.memory[t // CHUNK] = self.memory[:, : samples.memory.shape[2]]
        for (index, number), group in self.groups.items():
            one = self.pool.all[index]
            if one.plain is not None:
                where = group.where
                samples.actions[t, where] = one.plain(self._batch(where), uniform[where])
                continue
            policy = one.policies[number] if index else policies[number]
            if one.packers is None:
                part = self._part(seen, group, policy)
            else:
                part = one.packers[policy.preset.form](self._batch(group.where))
            if not index and number in self.acting and isinstance(part, Rows):
                here, idle = (t, group.where), None if samples.idle is None else samples.idle[t, group.where]
                own = self.acting[number](part, uniform[group.where], idle, self._noop.numpy())
                samples.actions[here], samples.log_probs[here], samples.values[here] = own
                continue
            memory, begins = self._remembered(policy, group)
            if index or policy.apart:
                logs, memory = policy.logs(part, memory, begins)
            else:
                logs, samples.values[t, group.where], memory = policy(part, memory, begins)
            if memory is not None:
                self.memory[group.where, : policy.memory] = memory
            chosen, free = policy.choices.draw(logs, numbers[group.where]), None
            if samples.idle is not None and not index:
                free = torch.from_numpy(~samples.idle[t, group.where])
                chosen = torch.where(free, chosen, self._noop)
            samples.actions[t, group.where] = chosen
            if not index:
                samples.log_probs[t, group.where] = policy.choices.of(chosen, logs, free)
        self.begins[:] = False
        found: Array = samples.actions[t].reshape(env.num_worlds, env.num_agents, -1)
        if self.teacher is not None:
            found = found.copy()
            samples.actions[t] = self.teacher(self._batch(slice(None)), uniform)
        return found

    def take(self, t: int, result: Any, policies: Sequence[Networks]) -> None:
        """Store the result of step t, and begin the next episode in worlds whose episode has ended."""
        _, rewards, terminated, truncated, info = result
        env, samples, done = self.env, self.samples, terminated | truncated
        samples.rewards[t], samples.ends[t] = rewards.ravel(), np.repeat(done, env.num_agents)
        living = info["alive"].ravel()
        if self.dead == "drop":
            samples.ends[t] |= ~living
        self.behaviour.after_step()
        if not self.pool.alone:
            self.standings.watch()
        if done.any():
            goes_on = np.repeat(truncated & ~terminated, env.num_agents) & (living | (self.dead == "keep"))
            if goes_on.any():
                samples.later[t] = self._values(policies) * torch.from_numpy(goes_on)
            learns = self.learner.reshape(-1, env.num_agents) != NOBODY
            self.episodes.add(info["statistics"], learns)
            self._record(t, done)
            self.keys[done, 2] += np.uint64(1)
            if self.curriculum is not None:
                self.played += just_ended(env, t, done, info["statistics"])
            self._begin(done)

    def restart(self) -> None:
        """Restart the running episodes, in the chosen levels; levels without a key keep the world's."""
        self._begin(np.ones(self.env.num_worlds, bool))
        self.scale.sums[:] = 0

    def _begin(self, where: Array) -> None:
        """Begin the episodes of `keys` in the worlds `where`, bool (worlds,)."""
        if self.curriculum is not None:
            self.curriculum.deal(self.env, where, self.keys[where])
        self.env.reset(options={"reset_mask": where})
        self._draw(where)

    def tallies(self) -> Tallies:
        """Return the measurements of the last rollout, by tag."""
        layout, shape = self.packer.layout, (-1, self.env.num_worlds, self.env.num_agents)
        own = self.samples.own.reshape(*shape, layout.own)
        actions = self.samples.actions.reshape(*own.shape[:3], self.samples.actions.shape[2])
        living = self.samples.alive.reshape(own.shape[:3])
        learns = self.samples.learner.reshape(own.shape[:3]) != NOBODY
        return self.episodes.tallies() | self.behaviour.tallies(layout.own_views(own), actions, living, learns)

    def state(self) -> dict[str, Array]:
        """Return the players and their memories by name, (worlds, ...), without the worlds themselves."""
        each = self.env.num_worlds, self.env.num_agents
        memory, begins = self.memory.numpy().reshape(*each, -1), self.begins.astype(np.uint8).reshape(each)
        who = {"opponent": self.opponent, "own": self.own, "life": self.standings.life}
        found = who | {"memory": memory, "begins": begins}
        return found if self.curriculum is None else found | {"episodes": self.keys[:, 2].astype(np.int64)}

    def restore(self, given: dict[str, Array]) -> None:
        """Restore the result of `state`. Raises TrainingError if it names players that do not exist."""
        opponent, own, life = (given[name].copy() for name in ("opponent", "own", "life"))
        if not (np.isin(opponent, list(self.pool.all)).all() and ((own >= 0) & (own < life.shape[1])).all()):
            raise TrainingError(f"lane in {REST} of the checkpoint names players that do not exist")
        self.opponent, self.own, self.standings.life = opponent, own, life
        self.keys[:, 2] = key_of(self.env.worlds)[2] if self.curriculum is None else given["episodes"]
        self.memory = torch.from_numpy(given["memory"].reshape(self.agents, -1)).clone()
        self.begins = given["begins"].ravel() > 0
        self._sides = side(self.env.worlds)
        self.assign()

    def _remembered(self, policy: Networks, group: AgentGroup) -> tuple[Tensor | None, Tensor | None]:
        """Return the memory of some agents, and where it is reset, for their policy."""
        if not policy.memory:
            return None, None
        return self.memory[group.where, : policy.memory], torch.from_numpy(self.begins[group.where])

    @playing()
    def _values(self, policies: Sequence[Networks]) -> Tensor:
        """Return the learners' values of the present observations, float32 (agents,); 0 for agents of opponents."""
        seen, values = self.observe(), torch.zeros(self.agents, **FLOAT)
        for (index, number), group in self.groups.items():
            if not index:
                policy = policies[number]
                part = self._part(seen, group, policy)
                values[group.where] = policy.values(part, *self._remembered(policy, group))
        return values

    def observe(self) -> dict[Form, Observed]:
        """Return what all agents observe now, as networks take it, with the state if critics learn from it."""
        lists = None if all(form.leaky for form in self.packers) else self._lists()  # once, whatever number of forms
        seen = {
            form: packer(self.env._reader.views if lists is None or form.leaky else lists)
            for form, packer in self.packers.items()
        }
        if self.overview is not None:
            state = self.overview(slice(None)) / self.overview.scale
            for each in seen.values():
                each.state = torch.from_numpy(state.repeat(self.env.num_agents, 0))
        return seen

    def _part(self, seen: Mapping[Form, Observed], group: AgentGroup, policy: Networks) -> Observed:
        """Return what some of the agents observe, in the form that their networks take."""
        found = seen[policy.preset.form]
        return found if len(group.members) == self.agents else found.select(group.members)

    def _batch(self, some: Any) -> dict[str, Array]:
        """Return the observations of some agents, padded, (some, ...) by key."""
        views = self.env._reader.views
        return {key: values.reshape(self.agents, *values.shape[2:])[some] for key, values in views.items()}

    def _record(self, t: int, done: Array) -> None:
        """Record winners, for the pool after the rollout: draws must not depend on this process's worlds."""
        sides = self._sides.max(1) + 1
        worlds = np.flatnonzero(done & (self.opponent > 0) & (sides > 1))
        won = shares_beaten(self.standings.of(worlds), self.own[worlds], sides[worlds])
        self.games += [(t, *game) for game in zip(self.opponent[worlds].tolist(), won.tolist(), strict=True)]

    def _draw(self, where: Array) -> None:
        """Draw the players of the worlds `where`, bool (worlds,), in which episodes begin."""
        self.standings.begin(where)
        self.begins[np.repeat(where, self.env.num_agents)] = True
        self._sides[where] = side(self.env.worlds, where)
        if self.pool.alone:
            if counts_vary(self.env.worlds):
                self.assign()
            return
        seeds, worlds, episodes = self.keys[where].T
        indices, weights = self.pool.chances()
        self.opponent[where] = indices[draw(weights, seeds, worlds, episodes)]
        self.own[where] = own_side(worlds, episodes, self._sides[where].max(1) + 1)
        self.assign()

    def assign(self) -> None:
        """Assign each agent to the network that plays it."""
        theirs = (self.opponent > 0)[:, None] & (self._sides != self.own[:, None])
        index = np.where(theirs, self.opponent[:, None], 0).ravel()
        teams = {k: self.team if (team := self.pool.all[k].team) is None else team for k in np.unique(self.opponent)}
        number = np.where(theirs, [teams[k] for k in self.opponent], self.team).ravel()
        self.learner = np.where((index > 0) | (self._sides < 0).ravel(), NOBODY, number).astype(np.int16)
        self.groups = dict[tuple[int, int], AgentGroup]()
        for i, k in np.unique(np.stack([index, number], 1), axis=0).tolist():
            members = (index == i) & (number == k)
            which = np.flatnonzero(members)
            self.groups[i, k] = AgentGroup(slice(None) if members.all() else which, torch.from_numpy(which))

    def _completed(self, rollout: Rollout, policies: Sequence[Networks]) -> Rollout:
        """Return the samples with the advantages, and with what is of all processes."""
        numbers, gather = self.numbers, self.crew.gather
        rewards, ends = gather(rollout.rewards, 1), gather(rollout.ends, 1)
        if not np.isfinite(rewards).all():
            raise TrainingError(
                "rewards are not finite (NaN or infinity): a mechanic computes them, as by 0 / 0 or the root of "
                "a negative number; outlast rollout with --interpret shows where"
            )
        spread = self.scale.update(rewards, ends) if numbers.scale_rewards else 1.0
        if self.scale.wrong() or (np.abs(rewards) > DEAREST).any():
            raise TrainingError(
                f"rewards, or their discounted sums, are beyond {DEAREST:g}, which training cannot use: pay less"
            )
        rewards = rewards / np.float32(spread) + np.float32(numbers.gamma) * gather(rollout.later, 1)
        for number, policy in enumerate(policies):
            if policy.apart:
                its, form = np.flatnonzero(rollout.learner == number), policy.preset.form
                for start in range(0, len(its), BATCH):  # a step of few agents costs about as much as a large batch
                    some = its[start : start + BATCH]
                    found = policy.values(rollout.seen[form].select(torch.from_numpy(some)))
                    rollout.values.reshape(-1)[some] = found.numpy()
        values, last = gather(rollout.values, 1), gather(rollout.last, 0)
        return replace(
            rollout,
            values=values,
            learner=gather(rollout.learner, 1),
            advantages=advantages(rewards, values, ends, last, numbers.gamma, numbers.gae_lambda),
            first=self.first,
        )
