"""The batched environment: spaces, buffers, faults and options. Calls in any order: test_stateful.py."""

from typing import Any

import numpy as np
import pytest

from outlast import VARIANTS, make_vec, variant
from outlast.components import Phase
from outlast.ecs import Clock, Read
from outlast.envs.errors import NotResetError
from tests.helpers.mechanics import idle, kind

KEYS = {
    "own": (), "others": (), "others_mask": (), "zone": (),
    "heals": (15, 2), "heals_mask": (15,), "heal_slot": (1, 1), "heal_slot_mask": (1,),
    "boxes": (8, 11), "boxes_mask": (8,), "box_items": (8, 10), "box_items_mask": (8,),
    "box_slot": (1, 8), "box_slot_mask": (1,),
}  # fmt: skip


@pytest.mark.parametrize("name", VARIANTS)
def test_spaces_are_those_of_the_rules(name: str) -> None:
    """Reference rules, section 4, with the kinds that a variant lacks left out."""
    env = make_vec(name, 2, seed=0)
    teams, boxes = name.startswith("teams"), name not in ("ffa_1", "ffa_2", "teams_2")
    agents, features = (4, 9) if teams else (2, 8)
    shapes = {key: shape for key, shape in KEYS.items() if boxes or not key.startswith("box")}
    shapes |= {"own": (features,), "others": (agents - 1, features), "others_mask": (agents - 1,), "zone": (6,)}
    space = env.single_observation_space
    assert {key: space[key].shape for key in space} == {key: (agents, *shape) for key, shape in shapes.items()}
    assert env.single_action_space.nvec.tolist() == [[3, 3, 3, 2, 2, 2]] * agents
    observations, info = env.reset()
    assert info.keys() == {"alive"}
    assert (info["alive"].dtype, info["alive"].shape) == (bool, (2, agents))
    assert info["alive"].all()
    assert list(observations) == sorted(shapes)
    for key, values in observations.items():
        assert (values.dtype, values.shape) == (np.float32, (2, agents, *shapes[key]))


@pytest.mark.parametrize("options", [{}, {"threads": 2}, {"interpret": ["breaks.go"]}])
def test_what_a_system_raises_in_a_step(options: dict[str, Any]) -> None:

    breaks = kind("Breaks")

    @breaks.system(Phase.USE)
    def go(clock: Read[Clock]) -> None:
        if clock.tick[0] == 2 and clock.world[0] == 40 and clock.episode[0] == 1:
            raise ValueError("enough")

    env = make_vec(variant("ffa_1").with_(breaks()), 48, seed=0, **options)
    env.reset()
    env.step(idle(env))
    with pytest.raises(ValueError, match="enough"):
        env.step(idle(env))
    with pytest.raises(NotResetError, match="48 worlds have not started"):
        env.step(idle(env))
    env.reset()
    env.step(idle(env))
    env.step(idle(env))
    env.close()
