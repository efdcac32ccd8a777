"""Measurements of episodes and of the agents in them."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from outlast.components import Death, Item, ItemGiven
from outlast.ecs import Entity, Statistic, columns_of
from outlast.envs.core.spaces import alive, counted, present, published, side
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.summary import MOMENTS
from outlast.systems import Agents, Melee

from .errors import TrainingError
from .observation_layout import OWN
from .quantities import SUMMED

Array = np.ndarray[Any, Any]
Tallies = dict[str, tuple[float, float]]  # by tag: a sum, and the number of its terms
PAPER_NAMES = {"length": "steps", "return": "reward"}  # the paper's names of statistics, where they differ from ours


def check_statistics(env: SurvivalVectorEnv, *names: str) -> None:
    """Raise TrainingError unless the worlds have these statistics."""
    known = {key for key, *_ in published(env.worlds, Statistic)}
    if missing := [name for name in names if name not in known]:
        raise TrainingError(f"{env.scenario.name} has no statistic '{missing[0]}': add the mechanic Record")


def means_of_sides(values: Array, sides: Array, count: int) -> tuple[Array, Array]:
    """Return the means of values (worlds, agents) over sides, 0 for empty ones, and whether a side has agents."""
    on = sides[:, :, None] == np.arange(count)
    agents = on.sum(1)
    return (values[:, :, None] * on).sum(1) / np.maximum(agents, 1), agents > 0


class EpisodeMetrics:
    """The paper's quantities: means over the episodes that ended, by the names of its TensorBoard files."""

    def __init__(self, base_env: SurvivalVectorEnv) -> None:
        self.base_env = base_env
        self.clear()

    def clear(self) -> None:
        """Reset all sums to zero."""
        self.count = 0
        self.sums: dict[str, Array] = {}
        # For statistics with an entry for each agent or side: the number of episodes with that agent or side.
        self.counts: dict[str, Array] = {}

    def add(self, statistics: dict[str, Array], learns: Array) -> None:
        """Add episodes that ended, before resets. statistics: info["statistics"], with zeros for other worlds.

        learns: Whether a learner plays an agent, bool (worlds, agents): only learners' returns count.
        """
        worlds, ended = self.base_env.worlds, np.flatnonzero(statistics["length"])
        self.count += len(ended)
        counts = {key: there[ended] for key, there in counted(worlds).items()}
        for key, values in statistics.items():
            values = values[ended]
            if key == "return":
                of = np.where(learns, side(worlds), -1)[ended]
                values, counts[key] = means_of_sides(values, of, worlds.dims["sides"])
            if key in MOMENTS:
                counts[key] = values > 0
            if key in counts:
                self.counts[key] = self.counts.get(key, 0) + counts[key].sum(0)
            self.sums[key] = self.sums.get(key, 0) + values.sum(0, dtype=np.float64)

    def tallies(self) -> Tallies:
        """Add up the episodes since the last call. A team's return is the mean over those of its agents that learn.

        The mean of a side is over the episodes with that side; if some lack sides, "rollout/kills" counts all sides.
        """
        tags: Tallies = {"rollout/episodes": (float(self.count), 1.0)}
        for key, total in self.sums.items():
            name = "rollout/" + PAPER_NAMES.get(key, key)
            if total.ndim == 0:
                tags[name] = float(total), float(self.counts.get(key, self.count))
            else:
                counts = self.counts.get(key, np.full(len(total), self.count))
                tags |= {f"{name}{k}": (float(total[k]), float(counts[k])) for k in range(len(total))}
                if key in self.counts and key in SUMMED:
                    tags[name] = float(total.sum()), self.count
        self.clear()
        return tags


class BehaviourMetrics:
    """Behaviour of agents: means over the living agents of a rollout. Gifts are counted tick by tick."""

    def __init__(self, base_env: SurvivalVectorEnv) -> None:
        self.base_env, self._reach = base_env, tuple[str, ...]()
        if Melee in (scenario := base_env.scenario) and Agents in scenario:  # their sum is the reach to a struck centre
            self._reach = f"{scenario[Melee].name}_reach", f"{scenario[Agents].name}_radius"
        has_heals = "heals" in base_env.scenario and Item in base_env.worlds
        self.heals = base_env.worlds.span("heal") if has_heals else None
        self.agents = base_env.worlds.span("agent")
        self.action_names = [name for name, _ in base_env.action_columns]
        self.there, self._heals = 0, list[tuple[Array, Array]]()  # for each step, heals that each agent holds and gives
        layout, self._reaches = base_env.worlds.layout, list[Array]()  # for each step, if they differ
        self._differ = any(name in layout.varied or name in layout.per_agent for name in self._reach)

    def after_step(self) -> None:
        """Count agents (dead or alive), heals in bags, and gifts. Must be called after every step, before resets."""
        if self._differ:
            self._reaches.append(self._striking())
        self.there += int(present(self.base_env.worlds).sum())
        if self.heals is not None:
            self._heals.append((self.bags(), self.gifts()))

    def bags(self) -> Array:
        """Return the number of heals of each agent, int (worlds, agents)."""
        holder = self.base_env.worlds[Item].holder[:, self.heals]
        where, items = np.nonzero(_among(holder, self.agents))
        count = self.base_env.num_agents
        place = where * count + holder[where, items] - self.agents.start
        return np.bincount(place, minlength=len(holder) * count).reshape(len(holder), count)

    def gifts(self) -> Array:
        """Count the heals that each agent gave in this step, int (worlds, agents); 0 for agents that have died."""
        worlds, given = self.base_env.worlds, np.zeros((self.base_env.num_worlds, self.base_env.num_agents), int)
        gifts, heals = worlds.entries(ItemGiven), worlds.span("heal")
        gifts = gifts[_among(gifts["item"], heals) & _among(gifts["giver"], self.agents)]
        where, givers = gifts["world"], gifts["giver"]
        np.add.at(given, (where, givers - self.agents.start), worlds[Entity].alive[where, givers])
        return given

    def tallies(self, own: dict[str, Array], actions: Array, living: Array, learns: Array) -> Tallies:
        """Return tallies of the living agents of a rollout: actions of learners, and the share of all agents that live.

        own: Observations that belong to no entity, by key. living, learns: Whether an agent lived when it observed, and
        whether a learner played it, bool. All are (steps, worlds, agents, ...).
        """
        tags: Tallies = {"behaviour/alive": (float(living.sum()), self.there)}
        for each in (self._heals, self._reaches):
            del each[: -len(living)]  # steps of rollouts without tallies
        reaches = np.stack(self._reaches) if self._reaches else None
        for name, (values, where) in self.quantities(own, actions, living, reaches).items():
            where = where & learns
            tags[f"behaviour/{name}"] = float(values[where].sum(dtype=np.float64)), int(where.sum())
        if self.heals is not None:
            held, given = (int(np.stack(each)[learns].sum()) for each in zip(*self._heals, strict=True))
            tags["behaviour/heals_held"] = held, int((living & learns).sum())
            tags["behaviour/heals_given"] = 1000 * given, int((living & learns).sum())  # in 1000 agent-steps
        self.there = 0
        return tags

    def quantities(
        self, views: dict[str, Array], actions: Array, living: Array, reaches: Array | None = None
    ) -> dict[str, tuple[Array, Array]]:
        """Return behaviour by name: values (..., worlds, agents), and whether each agent counts, bool.

        views: observations by key. actions: (..., worlds, agents, actions). reaches: what `_striking` returned in each
        step; None: what it returns now. attack_near and attack_far: whether an agent attacks with a living enemy in
        reach, and without; near: whether there is one.
        """
        found, fields = {}, self.base_env.fields
        place = views[OWN][..., columns_of(fields[OWN], "x", "y")]
        if "zone" in views:
            middle = views["zone"][..., columns_of(fields["zone"], "x", "y")]
            found["zone_distance"] = np.linalg.norm(place - middle, axis=-1), living
        if "attack" in self.action_names and self._reach:
            attack = actions[..., self.action_names.index("attack")]
            sides = (
                views[OWN][..., columns_of(fields[OWN], "team")]
                if "team" in fields[OWN]
                else np.arange(attack.shape[-1])
            )
            near = self._near(place, sides, living, self._striking() if reaches is None else reaches)
            found |= {"attack_near": (attack, living & near), "attack_far": (attack, living & ~near)}
            found["near"] = near, living
        return found

    def _striking(self) -> Array:
        """Return the reach to the centre of a struck agent, (worlds, striker, struck); any axis may be 1."""
        reach, radius = (np.asarray(self.base_env.worlds.number(name)) for name in self._reach)
        reach = reach.reshape(*reach.shape, *[1] * (3 - reach.ndim))  # (worlds, agents that strike, 1)
        return reach + (radius[:, None] if radius.ndim == 2 else radius.reshape(-1, 1, 1))

    def _near(self, place: Array, sides: Array, living: Array, reaches: Array) -> Array:
        """Return whether a living enemy that an agent faces is in reach: its centre is within `reaches`."""
        enemies = sides[..., :, None] != sides[..., None, :]
        apart = np.linalg.norm(place[..., :, None, :] - place[..., None, :, :], axis=-1)
        return ((apart <= reaches) & enemies & living[..., None, :]).any(-1)


class AgentMetrics:
    """Sums over the running episode of every world, for each agent. Create it after a reset of the worlds.

    totals: float64 (worlds, agents) by name: deaths_TYPE; heals_given. rates: float64 (worlds, agents, 2) by name,
    those of BehaviourMetrics.quantities and heals_held: the sum over the ticks in which the quantity counts for the
    agent, and the number of these ticks.
    """

    def __init__(self, base_env: SurvivalVectorEnv) -> None:
        self.base_env, self.behaviour = base_env, BehaviourMetrics(base_env)
        self.agents, self.sides = base_env.worlds.span("agent"), side(base_env.worlds)
        names = [f"deaths_{cause}" for cause in base_env.worlds.layout.labels["damage_type"]]
        names += ["heals_given"] * (self.behaviour.heals is not None)
        self.totals = {name: np.zeros((base_env.num_worlds, base_env.num_agents)) for name in names}
        self.rates: dict[str, Array] = {}

    def before_step(self, actions: Array) -> None:
        """Count the actions of this step. Must be called before every step."""
        living = alive(self.base_env.worlds)
        found = self.behaviour.quantities(self.base_env.observe(), actions, living)
        if self.behaviour.heals is not None:
            found["heals_held"] = self.behaviour.bags(), living
        for name, (values, where) in found.items():
            rate = self.rates.setdefault(name, np.zeros((*living.shape, 2)))
            rate[..., 0] += values * where
            rate[..., 1] += where

    def after_step(self) -> None:
        """Count deaths and gifts. Must be called after every step."""
        deaths = self.base_env.worlds.entries(Death)
        deaths = deaths[_among(deaths["agent"], self.agents)]
        for k, name in enumerate(self.base_env.worlds.layout.labels["damage_type"] if len(deaths) else ()):
            of_it = deaths[deaths["damage_type"] == k]
            self.totals[f"deaths_{name}"][of_it["world"], of_it["agent"] - self.agents.start] += 1
        if self.behaviour.heals is not None:
            self.totals["heals_given"] += self.behaviour.gifts()

    def reset(self, where: Array) -> None:
        """Reset the sums of the worlds `where`, bool (worlds,), which have been reset."""
        self.sides[where] = side(self.base_env.worlds, where)
        for sums in (*self.totals.values(), *self.rates.values()):
            sums[where] = 0


def _among(rows: Array, span: slice) -> Array:
    """Return whether each row lies in a span, bool."""
    return (rows >= span.start) & (rows < span.stop)


def means(tallies: Iterable[Tallies]) -> dict[str, float]:
    """Return the means over all tallies, by tag; tags with no terms are left out."""
    sums: dict[str, Array] = {}
    for tally in tallies:
        for tag, pair in tally.items():
            sums[tag] = sums.get(tag, np.zeros(2)) + pair
    means = {tag: float(total / count) for tag, (total, count) in sums.items() if count}
    if "rollout/episodes" in sums:  # a count: the sum over all tallies
        means["rollout/episodes"] = float(sums["rollout/episodes"][0])
    return means
