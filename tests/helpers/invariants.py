"""Invariants that hold after every step of every world, and scenarios that put them to the test."""

from typing import Any

import numpy as np

import outlast

from outlast.components import (  # isort: skip
    Bag, Body, Box, BoxesPlaced, Died, End, Episode, Floor, HealsUsed, Health, Item, Kills, Reward, Side, Zone,
)  # fmt: skip
from outlast.ecs import Clock, Entity
from outlast.envs.core.vector_env import SurvivalVectorEnv
from tests.conftest import draw_actions

Array = np.ndarray[Any, Any]

CROWD = {"n_agents": 10, "n_boxes": 20, "boxes_dynamic": True, "n_heals": 20, "melee_damage": 20, "rewards_kill": 10.0}
SCENARIOS: dict[str, tuple[str, dict[str, Any]]] = {
    "ffa_1": ("ffa_1", {}),
    "ffa_4": ("ffa_4", {}),
    "teams_4": ("teams_4", {}),
    "crowd": ("ffa_4", CROWD | {"room_size": 12.0, "safe_zone_radii": (5.0, 2.0), "cameras_mode": "revealed"}),
    "three teams": ("teams_4", CROWD | {"teams_count": 3, "ending_rule": "all dead", "rewards_posthumous": False}),
    "as written": ("teams_4", {"melee_blocked": False, "melee_cooldown": 5, "pickup_touch": True, "inventory_slots": 1,
                               "boxes_offset": 0.0, "death_drop_scatter": "disc", "give_last_nearest": "suitable"}),
    "ablations": ("teams_4+health_cap+team_share+rivalry", {"n_agents": 8, "teams_count": 3, "rewards_alive": 1.0,
                                                         "rewards_dead": -1.0}),
    "hall": ("teams_4", CROWD | {"room_width": 30.0, "room_height": 12.0, "safe_zone_radii": (5.0, 2.0)}),
    "steered": ("ffa_2+health_cap+bounty+steering", {"n_agents": 4}),
}  # fmt: skip


def scenario(name: str, **numbers: Any) -> outlast.Scenario:
    """One of SCENARIOS, or a variant, with further numbers."""
    variant, own = SCENARIOS.get(name, (name, {}))
    return outlast.variant(variant).replace(**own | numbers)


class InvariantChecker:
    """Checks the invariants of all worlds of an environment after each call that changes some of them."""

    def __init__(self, env: SurvivalVectorEnv) -> None:
        self.env, self.numbers = env, env.scenario.numbers()
        self.agents = env.worlds.span("agent")
        self.returns = np.zeros((env.num_worlds, env.num_agents))
        self.everybody_alive = np.zeros((env.num_worlds, env.num_agents), bool)

    def check(self, observation: dict[str, Array], ran: Array | None = None) -> None:
        """Check after a step or reset. ran: The worlds that it changed, bool (worlds,); None: all."""
        ran = np.ones(self.env.num_worlds, bool) if ran is None else ran
        self.check_state(observation)
        alive = self.env.worlds[Entity].alive.astype(bool)
        self._health_and_life_agree(alive[:, self.agents], ran)
        self._rewards_are_right(alive[:, self.agents])
        self._returns_add_up(ran)
        self._statistics_fit(alive[:, self.agents])

    def check_state(self, observation: dict[str, Array]) -> None:
        """Check what holds at any time, whatever happened before."""
        alive = self.env.worlds[Entity].alive.astype(bool)
        self._numbers_are_finite(observation)
        if self.numbers["room_walls"]:
            self._agents_are_inside(alive)
        self._items_are_in_one_place(alive)
        self._zone_is_in_the_room()

    def memory(self, where: Any) -> tuple[Array, Array]:
        """What the checker remembers of the worlds `where`, to be given to `restore` when their state is restored."""
        return self.returns[where].copy(), self.everybody_alive[where].copy()

    def restore(self, memory: tuple[Array, Array], where: Any) -> None:
        self.returns[where], self.everybody_alive[where] = memory

    def _numbers_are_finite(self, observation: dict[str, Array]) -> None:
        for key, values in observation.items():
            assert np.isfinite(values).all(), key
            if key.endswith("mask"):
                assert np.isin(values, (0, 1)).all(), key
        for column in self.env.worlds[Body]:
            assert np.isfinite(column).all()

    def _agents_are_inside(self, alive: Array) -> None:
        """Only centres are checked: a body that is pushed hard may sink into a wall, at most to the wall's middle."""
        body, sides = self.env.worlds[Body], self.env.worlds[Floor].size[0]
        for place, side in ((body.x, sides[0]), (body.y, sides[-1])):
            assert np.abs(place[:, self.agents][alive[:, self.agents]]).max(initial=0) <= side / 2

    def _items_are_in_one_place(self, alive: Array) -> None:
        """On the ground, in exactly one bag, or consumed; a box item also as a box that stands or has just broken."""
        worlds = self.env.worlds
        bag, holder = worlds[Bag], worlds[Item].holder
        carried = np.zeros(alive.shape, int)
        held_by = np.full(alive.shape, -1)
        for agent in range(self.agents.start, self.agents.stop):
            assert (bag.count[:, agent] <= bag.items.shape[2]).all()
            for slot in range(int(bag.count[:, agent].max())):
                w = np.flatnonzero(slot < bag.count[:, agent])
                carried[w, bag.items[w, agent, slot]] += 1
                held_by[w, bag.items[w, agent, slot]] = agent
        items = worlds.layout.rows(Item)
        others = np.setdiff1d(np.arange(alive.shape[1]), items)
        assert (bag.count[:, others[others >= self.agents.stop]] == 0).all()
        assert (bag.count[:, self.agents][~alive[:, self.agents]] == 0).all()
        assert (carried[:, others] == 0).all()
        assert (holder[:, items] == held_by[:, items]).all()
        places = carried + alive
        heals = worlds.span("heal")
        assert (places[:, heals] <= 1).all()
        assert ((places[:, heals] == 0).sum(1) == worlds[HealsUsed].heals_used[:, 0]).all()
        if Box in worlds:
            boxes = worlds.span("box")
            there = places[:, worlds.span("box_item")] + alive[:, boxes] + worlds[Box].broken[:, boxes]
            assert (there == 1).all()

    def _health_and_life_agree(self, alive: Array, ran: Array) -> None:
        """Living agents have health, or lost it after this step's check; dead ones have none and stay dead."""
        health, tick = self.env.worlds[Health], self.env.worlds[Clock].tick
        points, fatal = health.points[:, self.agents], health.fatal_tick[:, self.agents]
        assert ((points > 0) | (fatal == tick.astype(np.int64)) | ~alive).all()
        assert ((points <= 0) | alive).all()
        if limit := self.numbers["mortality_limit"]:
            assert (points <= limit).all()
        stepped = ran & (tick[:, 0] > 0)
        assert alive[tick[:, 0] == 0].all()
        assert not (alive & ~self.everybody_alive)[stepped].any()
        died = self.everybody_alive & ~alive
        assert (died[stepped] == self.env.worlds[Died].now[:, self.agents][stepped].astype(bool)).all()
        assert (alive == self.everybody_alive)[~ran].all()
        self.everybody_alive = alive.copy()

    def _zone_is_in_the_room(self) -> None:
        zone, sides = self.env.worlds[Zone], self.env.worlds[Floor].size[0]
        for x, y, radius in ((zone.x, zone.y, zone.radius), (zone.next_x, zone.next_y, zone.next_radius)):
            assert (radius >= 0).all()
            assert (np.abs(x) + radius <= sides[0] / 2 + 1e-4).all()
            assert (np.abs(y) + radius <= sides[-1] / 2 + 1e-4).all()

    def _rewards_are_right(self, alive: Array) -> None:
        """By the formula of the paper and of the ablations, from the survivors and the kills."""
        worlds, numbers = self.env.worlds, self.numbers
        side, death = worlds[Side].side[:, self.agents], worlds[Died]
        now, killer = death.now[:, self.agents].astype(bool), death.source[:, self.agents]
        sides = range(worlds.dims["sides"])
        lives = np.stack([(alive & (side == s)).any(1) for s in sides], 1)
        died_out = np.stack([(now & (side == s)).any(1) for s in sides], 1) & ~lives
        total = np.zeros(side.shape)
        for s in sides:
            gets_kills = lives[:, s] | numbers["rewards_posthumous"]
            share = lives[:, s].astype(float)
            if numbers["rewards_basis"] == "members":
                share = (alive & (side == s)).sum(1) / (side == s).sum(1)
            reward = share * numbers["rewards_alive"] + (1 - share) * numbers["rewards_dead"]
            reward += (now & (killer == s) & (side != s)).sum(1) * gets_kills * numbers["rewards_kill"]
            reward += died_out.sum(1) * lives[:, s] * numbers["rewards_outlive"]
            reward += (now & (side == s)).sum(1) * numbers["rewards_death"]
            total[side == s] = np.broadcast_to(reward[:, None], side.shape)[side == s]
        total[self._fresh] = 0
        np.testing.assert_allclose(worlds[Reward].reward, total, rtol=1e-6, atol=1e-6)
        self._ends_are_right(lives.sum(1))

    def _ends_are_right(self, standing: Array) -> None:
        """By the rule, from the number of sides that stand, or at the limit of ticks."""
        worlds, limit = self.env.worlds, self.numbers["ending_limit"]
        least = {"all dead": 0, "last alive": 1}[self.numbers["ending_rule"]]
        terminated = ~self._fresh & (standing <= least)
        late = (worlds[Clock].tick[:, 0] >= limit) & (limit > 0)
        assert (worlds[End].terminated[:, 0] == terminated).all()
        assert (worlds[End].truncated[:, 0] == (late & ~self._fresh & ~terminated)).all()

    def _returns_add_up(self, ran: Array) -> None:
        self.returns[ran] += self.env.worlds[Reward].reward[ran]
        self.returns[self._fresh] = 0
        np.testing.assert_allclose(self.env.worlds[Episode].returns, self.returns, rtol=1e-6, atol=1e-6)

    def _statistics_fit(self, alive: Array) -> None:
        worlds, episode, kills = self.env.worlds, self.env.worlds[Episode], self.env.worlds[Kills]
        assert (episode.length == worlds[Clock].tick).all()
        assert (kills.deaths.sum(1) == (~alive).sum(1)).all()
        assert (kills.kills.sum(1) <= kills.deaths[:, worlds.layout.labels["damage_type"].index("melee")]).all()
        assert ((kills.first_death[:, 0] > 0) == (~alive).any(1)).all()
        assert (kills.first_death <= episode.length).all()
        if BoxesPlaced in worlds:
            assert (worlds[BoxesPlaced].boxes_placed >= 0).all()

    @property
    def _fresh(self) -> Array:
        """Worlds at the start of an episode."""
        return self.env.worlds[Clock].tick[:, 0] == 0


class CheckedPlay:
    """Random play with all checks. Now and then an agent's health is lowered, so that many die."""

    def __init__(self, env: SurvivalVectorEnv, seed: int) -> None:
        self.env, self.checker, self.deaths = env, InvariantChecker(env), 0
        self._rng = np.random.default_rng(seed)
        self.checker.check(env.reset()[0])

    def step(self) -> None:
        weak = self._rng.random((self.env.num_worlds, self.env.num_agents)) < 0.01
        points = self.env.worlds[Health].points[:, self.checker.agents]
        points[weak & (points > 10)] = 10
        self.checker.check(self.env.step(draw_actions(self.env, self._rng))[0])
        self.deaths += int(self.env.worlds[Died].now[:, self.checker.agents].sum())
