"""Hostile files of levels, of scenarios whose worlds and agents differ, of roles, and of floor plans."""

import contextlib
import json
from pathlib import Path
from random import Random
from typing import Any, ClassVar

import numpy as np

import outlast
from outlast import Scenario, levels
from outlast.distributions import choice, integers, log_uniform, uniform
from outlast.ecs import DeclarationError, MemoryLayout, NumberError
from outlast.envs.errors import FaultError
from outlast.envs.scenarios.fingerprint import planned
from outlast.envs.scenarios.parse import with_roles
from outlast.envs.scenarios.scenario_json import plain_roles
from outlast.errors import ScenarioError
from outlast.levels import FloorPlan
from tests.fuzz.mutations import STRANGE, mutated, mutated_json, to_json
from tests.fuzz.worlds import folder_of

PLANS = [FloorPlan(walls=[(3.0 * k, 1, 0.5, 6, 0.1 * k)], starts=[("items", -8, 0, 4, 20)]) for k in range(3)]
GAME = (
    outlast.variant("teams_3")
    .with_(PLANS[0].mechanic(3))
    .vary(
        n_agents=integers(2, 4),
        walls_layout=choice(*(plan.layout(3) for plan in PLANS)),
        motors_ahead=log_uniform(0.1, 0.5),
        cameras_cone=choice("sector", "kite"),
        melee_blocked=choice(True, False),
        safe_zone_damage=choice(1, 3),
    )
    .roles(hunter=outlast.role(1, melee_damage=20, cameras_depth=uniform(8, 14)), prey=outlast.role(), drawn="anyone")
    .observe_numbers("motors_ahead")
)
VALUES: tuple[Any, ...] = (
    *(0, 1, -1, 2, 3, 4, 5, 0.1, 0.3, 1.5, -0.0, 1e-45, 1e300, -1e300, 2**31, 2**63, 2**64, 10**400, float("nan")),
    *(True, False, None, "", "kite", "integers", [], [1], [1, 2], ["uniform", 0, 1], ["integers", 1, 9], {}),
    *(["integers", 5, 2], ["uniform", 0, 10**400], ["choice", 1], ["choice", *range(2000)], ["log_uniform", 0, 1]),
    *([float("inf")] * 18, [0.0] * 18, list(PLANS[1].layout(3)), list(PLANS[1].layout(2))),
)


class _Files:
    """Mutations of a JSON file: its bytes, its form, and values in it."""

    valid: bytes

    def mutate(self, rng: Random) -> bytes:
        """A hostile file."""
        if (kind := rng.random()) < 0.3:
            return self.valid if kind < 0.1 else mutated(self.valid, rng)
        content = json.loads(self.valid)
        with contextlib.suppress(RecursionError):  # of what is nested too deep to be changed further
            for _ in range(rng.choice((1, 1, 2, 4))):
                content = mutated_json(content, rng, rng.choice((STRANGE, VALUES, VALUES)))
        return to_json(content)


class Levels(_Files):
    """Files of levels, given to worlds that play them."""

    refusals: ClassVar = (ScenarioError, NumberError)

    def __init__(self) -> None:
        self.env, path = outlast.make_vec(GAME, 3, seed=0), folder_of(self) / "levels"
        self.env.reset()
        levels.save(path, GAME, self.env.levels())
        self.valid = path.read_bytes()

    def use(self, path: Path) -> None:
        """Load it, and play its first levels."""
        found = levels.load(path, GAME)
        before = self.env.worlds.block.copy()
        try:
            self.env.set_levels(found[:3])
        except NumberError:
            np.testing.assert_array_equal(self.env.worlds.block, before)
            raise
        try:
            self.env.reset()
        except FaultError:  # a seed with which somebody finds no place
            return
        for mine, given in zip(self.env.levels(), found if len(found) > 1 else found * 3, strict=False):
            assert given.key in (None, mine.key)
            assert all(
                name not in given.numbers or value in dict(GAME.varied)[name] for name, value in mine.numbers.items()
            )
        self.env.step(np.broadcast_to(self.env.noop, (3, self.env.num_agents, len(self.env.noop))))


class Games(_Files):
    """Scenarios as JSON, whose worlds and agents differ."""

    refusals: ClassVar = (ScenarioError, NumberError, DeclarationError)
    valid = GAME.to_json().encode()

    def use(self, path: Path) -> None:
        """Load it, lay out a world, and write it down again."""
        scenario = self.load(path)
        planned(scenario)
        scenario.worlds(1).close()
        assert Scenario.from_json(scenario.to_json()) == scenario

    def load(self, path: Path) -> Scenario:
        """Read the scenario."""
        return Scenario.load(path)


class RoleFiles(Games):
    """Roles as JSON, for commands: of a game that has them."""

    valid = json.dumps(plain_roles(GAME.by_role or {})).encode()

    def load(self, path: Path) -> Scenario:
        """Read the game with the roles."""
        return with_roles(outlast.variant("teams_3"), path)


DRAWING = b"#####\n#A.B#\n#.#.#\n#.*.#\n#####\n"


class Plans(_Files):
    """Floor plans, as JSON and as drawings: made into a world's layout, where there is room for its bodies."""

    refusals: ClassVar = (ScenarioError, NumberError)

    def __init__(self) -> None:
        walls, starts = [[0, 0, 6, 0.4, 0.5], [3, 4, 1, 2, 0]], [[0, -8, 0, 4, 8, 0], ["items", 8, 0, 4, 8, 0.1]]
        plan = {"format": "outlast floor plan", "version": 1, "width": 25.0, "height": 25.0}
        self.valid = json.dumps(plan | {"walls": walls, "starts": starts}).encode()

    def mutate(self, rng: Random) -> bytes:
        """A hostile file."""
        if rng.random() < 0.5:
            return super().mutate(rng)
        signs = bytearray(DRAWING)
        for _ in range(rng.randrange(1, 4)):
            signs[rng.randrange(len(signs))] = rng.choice(b"#.*ABZ \n")
        return rng.choice((bytes(signs), mutated(DRAWING, rng)))

    def use(self, path: Path) -> None:
        """Load it, and lay out a world with it."""
        plan = FloorPlan.load(path)
        assert len(plan.layout(500)) == 3000
        others = [plan.room()] if plan.width and plan.height else []
        MemoryLayout(outlast.variant("ffa_1").without("safe_zone").with_(*others, plan.mechanic()).modules)
