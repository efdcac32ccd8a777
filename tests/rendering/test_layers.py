"""Layers: everything is where it is, in its colour."""

import itertools
import math
from typing import Any

import cv2
import numpy as np
import pytest

from outlast import make_vec, variant
from outlast.components import Guard, Zone
from outlast.distributions import choice

from outlast.drawing import (  # isort: skip
    LAYERS, CamerasLayer, HitsLayer, IdsLayer, InventoryLayer, Layer, MeleeLayer, SafeZoneLayer,
)  # fmt: skip
from outlast.ecs import Entity
from outlast.envs.errors import FilmError
from outlast.envs.rendering import style as colors
from outlast.envs.rendering.rgb import draw
from outlast.envs.web.world_json import describe
from outlast.systems import Preparation
from tests.helpers.scenario_builder import ScenarioBuilder, duel

SIZE = 512
HALF = colors.SIZES.margin * 12.5  # metres from the middle of the picture to its edge
DARK = 320  # the sum of red, green and blue is below that of anything but ink
Picture = np.ndarray[Any, Any]


def spot(image: Picture, x: float, y: float) -> tuple[int, ...]:
    column, row = (int(SIZE * (0.5 + length / (2 * HALF))) for length in (x, -y))
    return tuple(image[row, column].tolist())


def without(*kinds: type[Layer]) -> list[Layer]:
    return [layer for layer in LAYERS if not isinstance(layer, kinds)]


def picture(game: ScenarioBuilder, *left_out: type[Layer]) -> Picture:
    return draw(game.env.worlds, 0, SIZE, without(SafeZoneLayer, *left_out))


def test_agents_are_discs_of_their_side_with_a_beak_ahead() -> None:
    game = ScenarioBuilder("teams_3")
    for agent, (x, y, angle) in enumerate([(3, -4, 0.0), (-5, 2, 0.5), (0, 6, 2.0), (6, 5, -2.5)]):
        before = picture(game)
        game.put("agent", agent, x, y, angle)
        ahead = (math.cos(angle), math.sin(angle))
        after = draw(game.env.worlds, 0, SIZE, without(SafeZoneLayer, IdsLayer))
        behind = (x - 0.34 * ahead[0], y - 0.34 * ahead[1])
        assert spot(before, *behind) == colors.FLOOR
        assert spot(after, *behind) == (colors.BLUE if agent < 2 else colors.VERMILLION)
        assert sum(spot(after, x + 0.6 * ahead[0], y + 0.6 * ahead[1])) < DARK
        assert spot(after, x - 0.6 * ahead[0], y - 0.6 * ahead[1]) == colors.FLOOR
        game.column(Entity).alive[0, agent] = 0
        assert spot(picture(game), *behind) == colors.FLOOR  # the dead are not shown


def test_heals_boxes_and_broken_boxes() -> None:
    game = ScenarioBuilder()
    empty = picture(game)
    game.put("heal", 0, 2, 3)
    game.put("box", 0, -3, 1, math.pi / 4, size=(4, 1))
    game.put("box_item", 1, 4, -4)
    image = picture(game)
    assert spot(image, 2, 3) == colors.HEAL
    assert spot(image, -1.9, 2.1) == colors.BOX  # along the slope
    assert spot(image, -1.9, -0.1) == spot(empty, -1.9, -0.1) == colors.FLOOR  # across it
    assert spot(image, 4, -4) == colors.BOX
    for side in (0, 1):
        game.column(Guard).vulnerable_only_to[0, game.env.worlds.span("box")] = side
        image = picture(game)
        assert spot(image, -3, 1) == spot(image, 4, -4) == colors.of_box(side)


def test_the_zone_is_clear_the_rest_dark_and_the_next_one_dashed() -> None:
    game = ScenarioBuilder()
    zone = game.column(Zone)
    zone.x[0], zone.y[0], zone.radius[0] = 2, 1, 6
    zone.next_x[0], zone.next_y[0], zone.next_radius[0] = 3, 0, 3
    for agent in (0, 1):
        game.put("agent", agent, -11 + 2 * agent, -11)
    image, angles = draw(game.env.worlds, 0, SIZE), np.linspace(0, 2 * math.pi, 400)
    for factor, color in ((0.95, colors.FLOOR), (1.05, colors.UNSAFE)):
        assert {spot(image, 2 + 6 * factor * math.cos(a), 1 + 6 * factor * math.sin(a)) for a in angles} == {color}
    dashes = [spot(image, 3 + 3 * math.cos(a), 3 * math.sin(a)) != colors.FLOOR for a in angles]
    assert 0.4 < np.mean(dashes) < 0.75
    assert np.diff(dashes).sum() >= 20
    zone.next_radius[0] = 0  # it is about to vanish
    assert spot(draw(game.env.worlds, 0, SIZE), 3, 0) == colors.RIM
    zone.radius[0] = 0
    assert spot(draw(game.env.worlds, 0, SIZE), 2, 1) == colors.UNSAFE


def test_strikes_are_shown_in_their_tick() -> None:
    game = duel(ScenarioBuilder())
    assert spot(picture(game), 1, 0) == colors.FLOOR
    game.step({0: "attack"})
    assert spot(picture(game), 1, 0) == colors.STRIKE
    game.step()
    assert spot(picture(game), 1, 0) == colors.FLOOR
    game.put("agent", 1, 7, 7)
    game.step({0: "attack"})
    assert sum(spot(picture(game), 1, 0)) < DARK  # it met nothing
    assert spot(picture(game), 2.2, 0) == colors.FLOOR  # it reaches two metres
    game.env.reset()  # what was done in the episode before is over
    assert np.array_equal(picture(game), picture(game, MeleeLayer, HitsLayer))


@pytest.mark.parametrize(
    ("points", "color", "rest", "share"),
    [
        (100, colors.GREEN, colors.GREEN, 1),
        (60, colors.GREEN, colors.INK, 0.6),
        (40, colors.ORANGE, colors.INK, 0.4),
        (10, colors.VERMILLION, colors.INK, 0.1),
        (150, colors.GREEN, colors.GREEN, 1),
    ],
)
def test_bars_are_as_long_as_health_is_left(points: int, color: Any, rest: Any, share: float) -> None:
    game = duel(ScenarioBuilder(), far=5)
    game.wound(0, points)
    image = picture(game)
    bar = [spot(image, x, 0.88) for x in np.linspace(-0.55, 0.55, 110)]
    assert np.mean([found == color for found in bar]) == pytest.approx(share, abs=0.07)
    assert set(bar) == {color, rest}
    beyond = [spot(image, x, 0.88) for x in np.linspace(0.65, 1.75, 110)]
    assert np.mean([found == colors.SKY for found in beyond]) == pytest.approx(max(0, points - 100) / 100, abs=0.07)


def test_carried_items_lie_below_their_carrier() -> None:
    game = duel(ScenarioBuilder(), far=5)
    bare = picture(game)
    game.hand(0, "heal", 0)
    game.hand(0, "box_item", 1)
    image = picture(game)
    assert spot(image, -0.2, -0.83) == colors.HEAL
    assert spot(image, 0.2, -0.83) == colors.BOX
    rows, columns = (where / SIZE * 2 * HALF - HALF for where in np.nonzero((image != bare).any(-1)))
    assert 0.5 < rows.min() < rows.max() < 1.2
    assert np.abs(columns).max() < 0.6
    assert np.array_equal(picture(game, InventoryLayer), bare)


def test_the_widest_cone_is_drawn() -> None:
    """As float32, pi is more than the most that cameras_fov may be."""
    env = make_vec(variant("ffa_2").vary(cameras_fov=choice(math.pi, math.pi)), 1, seed=0)
    env.reset()
    assert (draw(env.worlds, 0, 64, [CamerasLayer()]) != draw(env.worlds, 0, 64, [])).any()


def test_who_is_blind_has_no_cone() -> None:
    env = make_vec(variant("ffa_2").with_(Preparation(ticks=2, sides=(1,), blind=True)), 1, seed=0)
    env.reset()
    for tick in range(3):
        bare = draw(env.worlds, 0, 64, [])
        seen = [(draw(env.worlds, 0, 64, [CamerasLayer(agents=[i])]) != bare).any() for i in range(2)]
        assert seen == [True, tick == 2]
        assert [agent["blind"] for agent in describe(env.worlds, 0)["agents"]] == [0, 2]
        env.step(env.noop[None].repeat(2, 0)[None])


def test_lines_of_sight_lead_to_the_entities_seen() -> None:
    env = make_vec("teams_3", 40, seed=5)
    observations, _ = env.reset()
    masks = [key for key in observations if key.endswith("_mask") and "slot" not in key]
    assert len(masks) == 4
    found = set()
    for w, i in itertools.product(range(env.num_worlds), range(4)):
        seen = any(observations[key][w, i].any() for key in masks)
        lines = draw(env.worlds, w, 64, [CamerasLayer(agents=[i], cones=False)])
        assert np.array_equal(lines, draw(env.worlds, w, 64, [])) != seen
        found.add(seen)
    assert found == {False, True}


@pytest.mark.parametrize(
    "seen",
    [
        np.eye(3),
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    ],
    ids=["normal", "protan", "deutan", "tritan"],
)
def test_colours_can_be_told_apart_without_some_cones(seen: Any) -> None:
    """Distances in CIE Lab after the matrices of Machado, Oliveira and Fernandes (2009); 2.3 is just noticeable."""
    discs = [*colors.SIDES, colors.HEAL, colors.STRIKE, colors.FLOOR, colors.UNSAFE]
    boxes = [colors.of_box(owner) for owner in (-1, 0, 1, 2, 3)] + [colors.FLOOR, colors.UNSAFE]
    for group in (discs, boxes):
        shades = (np.array(group) / 255) ** 2.2 @ np.transpose(seen)
        lab = cv2.cvtColor((shades.clip(0, 1) ** (1 / 2.2)).astype(np.float32)[None], cv2.COLOR_RGB2Lab)[0]
        assert min(np.linalg.norm(one - other) for one, other in itertools.combinations(lab, 2)) > 9


def test_only_agents_that_there_are_can_be_asked_for() -> None:
    for wrong in (0, [-1], [0.5], "0"):
        with pytest.raises(FilmError, match="numbers of agents are needed, as in"):
            CamerasLayer(agents=wrong)  # type: ignore[arg-type]
    env = make_vec("ffa_1", 1, seed=0)
    env.reset()
    with pytest.raises(FilmError, match="no agent 7; they are 0 to 1"):
        draw(env.worlds, 0, 64, [CamerasLayer(agents=[0, 7])])
