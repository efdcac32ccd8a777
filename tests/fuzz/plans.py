"""Hostile floor plans: JSON files and drawings."""

import json
from pathlib import Path
from random import Random
from typing import ClassVar

from outlast import variant
from outlast.ecs import MemoryLayout, NumberError
from outlast.errors import ScenarioError
from outlast.levels import FloorPlan
from tests.fuzz.mutations import mutated, mutated_json, to_json

DRAWING = b"#####\n#A.B#\n#.#.#\n#.*.#\n#####\n"


class Plans:
    """Floor plans: loaded, and made into a world's layout, where there is room for its bodies."""

    refusals: ClassVar = (ScenarioError, NumberError)

    def __init__(self) -> None:
        walls, starts = [[0, 0, 6, 0.4, 0.5], [3, 4, 1, 2, 0]], [[0, -8, 0, 4, 8, 0], ["items", 8, 0, 4, 8, 0.1]]
        plan = {"format": "outlast floor plan", "version": 1, "width": 25.0, "height": 25.0}
        self.valid = json.dumps(plan | {"walls": walls, "starts": starts}).encode()

    def mutate(self, rng: Random) -> bytes:
        """A hostile file."""
        match rng.randrange(4):
            case 0:
                return mutated(DRAWING, rng)
            case 3:
                signs = bytearray(DRAWING)
                for _ in range(rng.randrange(1, 4)):
                    signs[rng.randrange(len(signs))] = rng.choice(b"#.*ABZ \n")
                return bytes(signs)
            case 1:
                return mutated(self.valid, rng)
            case _:
                return to_json(mutated_json(json.loads(self.valid), rng))

    def use(self, path: Path) -> None:
        """Load it, and lay out a world with it."""
        plan = FloorPlan.load(path)
        assert len(plan.layout(500)) == 3000
        others = [plan.room()] if plan.width and plan.height else []
        MemoryLayout(variant("ffa_1").without("safe_zone").with_(*others, plan.mechanic()).modules)
