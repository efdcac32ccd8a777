"""What holds after every step of every world, whatever anybody does."""

import numpy as np
import pytest
from conftest import COMPILED, draw_actions, scaled

import outlast
from outlast.components import (
    Bag,
    Body,
    Box,
    BoxesPlaced,
    Death,
    Episode,
    Floor,
    HealsUsed,
    Health,
    Item,
    Reward,
    Side,
    Zone,
)
from outlast.ecs import Clock, Entity
from outlast.envs.vector import SurvivalVectorEnv

STEPS = scaled(4000, least=100)  # world-steps of a scenario in the quick run: six scenarios
MILLION = 1_000_000

CROWD = {"n_agents": 10, "n_boxes": 20, "boxes_dynamic": True, "n_heals": 20, "melee_damage": 20, "rewards_kill": 10.0}
SCENARIOS = {
    "ffa_1": ("ffa_1", {}),
    "ffa_4": ("ffa_4", {}),
    "teams_4": ("teams_4", {}),
    "crowd": ("ffa_4", CROWD | {"room_size": 12.0, "zone_radii": (5.0, 2.0), "cameras_mode": "revealed"}),
    "three teams": ("teams_4", CROWD | {"sides_count": 3, "ending_rule": "all dead", "rewards_posthumous": False}),
    "as written": ("teams_4", {"melee_blocked": False, "melee_cooldown": 5, "pickup_touch": True, "inventory_slots": 1,
                               "boxes_offset": 0.0, "drop_scatter": "disc", "give_nearest": "suitable"}),
}  # fmt: skip


class Watch:
    """Follows all worlds of an environment and checks, after each step, what must hold."""

    def __init__(self, env: SurvivalVectorEnv) -> None:
        self.env, self.numbers = env, env.scenario.numbers()
        self.agents = env.worlds.span("agent")
        self.used = np.zeros(env.num_worlds, int)
        self.returns = np.zeros((env.num_worlds, env.num_agents))
        self.everybody_alive = np.zeros((env.num_worlds, env.num_agents), bool)

    def check(self, observation: dict[str, np.ndarray], terminated: np.ndarray) -> None:
        """After any step or reset."""
        alive = self.env.worlds[Entity].alive.astype(bool)
        self._numbers_are_finite(observation)
        self._agents_are_inside(alive)
        self._items_are_in_one_place(alive)
        self._health_and_life_agree(alive[:, self.agents])
        self._zone_is_in_the_room()
        self._rewards_add_up(alive[:, self.agents], terminated)

    def _numbers_are_finite(self, observation: dict[str, np.ndarray]) -> None:
        for key, values in observation.items():
            assert np.isfinite(values).all(), key
            if key.endswith("mask"):
                assert np.isin(values, (0, 1)).all(), key
        for column in self.env.worlds[Body]:
            assert np.isfinite(column).all()

    def _agents_are_inside(self, alive: np.ndarray) -> None:
        """Their centres; who is pushed hard may sink a little into a wall."""
        body, size, thin = self.env.worlds[Body], self.numbers["room_size"], self.numbers["room_thickness"]
        inner = size / 2 - size * thin / 2
        for place in (body.x, body.y):
            assert np.abs(place[:, self.agents][alive[:, self.agents]]).max(initial=0) < inner

    def _items_are_in_one_place(self, alive: np.ndarray) -> None:
        """On the ground, in exactly one bag, or for box items: as a box that stands or has just broken; or consumed."""
        worlds = self.env.worlds
        bag, holder = worlds[Bag], worlds[Item].holder
        carried = np.zeros(alive.shape, int)
        held_by = np.full(alive.shape, -1)
        for agent in range(self.agents.start, self.agents.stop):
            assert (bag.count[:, agent] <= bag.items.shape[2]).all()
            for slot in range(bag.items.shape[2]):
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

    def _health_and_life_agree(self, alive: np.ndarray) -> None:
        """Who lives has health, or lost it after this step's check; who does not has none, and stays dead."""
        health, tick = self.env.worlds[Health], self.env.worlds[Clock].tick
        points, doomed = health.points[:, self.agents], health.doomed[:, self.agents]
        assert ((points > 0) | (doomed == tick.astype(np.int64)) | ~alive).all()
        assert ((points <= 0) | alive).all()
        fresh = tick[:, 0] == 0
        assert alive[fresh].all()
        assert not (alive & ~self.everybody_alive)[~fresh].any()
        died = self.everybody_alive & ~alive
        assert (died[~fresh] == self.env.worlds[Death].now[:, self.agents][~fresh].astype(bool)).all()
        self.everybody_alive = alive.copy()

    def _zone_is_in_the_room(self) -> None:
        zone, size = self.env.worlds[Zone], self.env.worlds[Floor].size
        for x, y, radius in ((zone.x, zone.y, zone.radius), (zone.next_x, zone.next_y, zone.next_radius)):
            assert (radius >= 0).all()
            assert (np.maximum(np.abs(x), np.abs(y)) + radius <= size / 2 + 1e-4).all()

    def _rewards_add_up(self, alive: np.ndarray, terminated: np.ndarray) -> None:
        """The paper's formula from who lives and who killed whom; and the statistics are the sums of it all."""
        worlds, pay = self.env.worlds, self.numbers
        side, death = worlds[Side].side[:, self.agents], worlds[Death]
        now, killer = death.now[:, self.agents].astype(bool), death.source[:, self.agents]
        fresh = worlds[Clock].tick[:, 0] == 0
        standing = np.zeros(self.env.num_worlds, int)
        total = np.zeros(side.shape)
        for s in range(worlds.dims["sides"]):
            lives = (alive & (side == s)).any(1)
            standing += lives
            kills = (now & (killer == s) & (side != s)).sum(1) * (lives | pay["rewards_posthumous"])
            deaths = (now & (side == s)).sum(1)
            reward = np.where(lives, pay["rewards_alive"], pay["rewards_dead"])
            reward = reward + kills * pay["rewards_kill"] + deaths * pay["rewards_death"]
            total[side == s] = np.broadcast_to(reward[:, None], side.shape)[side == s]
        total[fresh] = 0
        np.testing.assert_allclose(worlds[Reward].reward, total, rtol=1e-6)
        self.returns = np.where(fresh[:, None], 0, self.returns) + total
        episode = worlds[Episode]
        np.testing.assert_allclose(episode.returns, self.returns, rtol=1e-6, atol=1e-6)
        assert (episode.length == worlds[Clock].tick).all()
        assert (episode.deaths.sum(1) == (~alive).sum(1)).all()
        assert (episode.kills.sum(1) <= episode.deaths[:, worlds.layout.causes.index("melee")]).all()
        assert ((episode.first_death[:, 0] > 0) == (~alive).any(1)).all()
        assert (episode.first_death <= episode.length).all()
        least = {"all dead": 0, "last alive": 1}[pay["ending_rule"]]
        assert (terminated == (~fresh & (standing <= least))).all()
        if BoxesPlaced in worlds:
            assert (worlds[BoxesPlaced].boxes_placed >= 0).all()


def watch(scenario: str, world_steps: int, num_worlds: int) -> None:
    """Random play with all checks; half of the worlds are brought close to their ends first, to see many of them."""
    variant, numbers = SCENARIOS[scenario]
    env = outlast.make_vec(outlast.variant(variant).replace(**numbers), num_worlds, seed=8)
    rng, guard = np.random.default_rng(9), Watch(env)
    observation, _ = env.reset()
    over = np.zeros(num_worlds, bool)
    guard.check(observation, over)
    deaths = 0
    for _ in range(-(-world_steps // num_worlds)):
        weak = rng.random((num_worlds, env.num_agents)) < 0.01
        points = env.worlds[Health].points[:, guard.agents]
        points[weak & (points > 10)] = 10
        observation, _, over, _, _ = env.step(draw_actions(env, rng))
        guard.check(observation, over)
        deaths += int(env.worlds[Death].now[:, guard.agents].sum())
    env.close()
    assert deaths > world_steps / 1000 or not COMPILED  # in a short run nobody may die


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_what_must_hold_holds_in_random_play(scenario: str) -> None:
    watch(scenario, STEPS, scaled(16, least=2))


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="a million world-steps")
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_what_must_hold_holds_for_a_million_world_steps(scenario: str) -> None:
    watch(scenario, MILLION // len(SCENARIOS) + 1, 512)
