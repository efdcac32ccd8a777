"""Pictures and maps: looking changes nothing, the same state looks the same, and every scenario can be looked at."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from outlast import Scenario, make_vec, systems, variant
from outlast.components import Bag, Body, Died, Heal, Health, Look, Strike, Weapon, Zone
from outlast.distributions import integers
from outlast.drawing import LAYERS, CamerasLayer, Layer, LegendLayer, LooksLayer, OthersLayer, Scene, ZOrder
from outlast.ecs import RESET, Clock, Entity, Module, Worlds
from outlast.envs.errors import FilmError
from outlast.envs.rendering.canvas import Canvas
from outlast.envs.rendering.rgb import draw, footage, text
from outlast.levels import FloorPlan
from tests.conftest import digest
from tests.core.test_scenario import LEFT_OUT
from tests.helpers.scenario_builder import ScenarioBuilder

EVERYTHING = (*LAYERS, CamerasLayer())
OWN = (OthersLayer(), LegendLayer(), LooksLayer())  # layers of mechanics that no variant has


def played(name: str, ticks: int, worlds: int = 2, first_world: int = 0) -> Worlds:
    env = make_vec(name, worlds, seed=3, first_world=first_world)
    env.reset()
    for tick in range(ticks):
        sizes = env.single_action_space.nvec
        actions = np.random.default_rng(tick).integers(0, sizes, (2, *sizes.shape))
        env.step(actions[first_world : first_world + worlds])
    return env.worlds


def scattered(scenario: Scenario) -> Worlds:
    """One world whose entities lie anywhere: no tick is run, so nothing is compiled."""
    worlds = Worlds(scenario.modules, 1)
    for kind in ("agent", "box", "heal"):
        rows = worlds.span(kind)
        places = np.random.default_rng(0).uniform(-10, 10, (2, rows.stop - rows.start))
        worlds[Body].x[0, rows], worlds[Body].y[0, rows] = places
    return worlds


@pytest.mark.parametrize("name", ["ffa_1", "ffa_3", "teams_3"])
def test_looking_changes_nothing_and_shows_the_same_again(name: str) -> None:
    ticks = 60
    worlds = played(name, ticks)
    before = digest(worlds)
    images = [draw(worlds, w, 128, EVERYTHING) for w in (0, 1, 0)]
    maps = [text(worlds, w) for w in (0, 1, 0)]
    assert digest(worlds) == before
    assert np.array_equal(images[0], images[2])
    assert not np.array_equal(images[0], images[1])
    assert maps[0] == maps[2] != maps[1]
    assert (images[0].dtype, images[0].shape) == (np.uint8, (128, 128, 3))
    assert not np.shares_memory(images[0], images[2])
    alone = played(name, ticks, worlds=1, first_world=1)  # the same state in another batch
    assert np.array_equal(draw(alone, 0, 128, EVERYTHING), images[1])
    assert text(alone, 0) == maps[1]


def test_what_is_no_number_or_far_away_is_left_out() -> None:
    game = ScenarioBuilder()
    game.put("heal", 0, 2, 2)
    whole = draw(game.env.worlds, 0, 256)
    rows = [game.row("agent", 0), game.row("box", 0)]
    game.put("box", 0, 0, 0)
    game.column(Entity).alive[0, rows] = 0
    expected = draw(game.env.worlds, 0, 256, EVERYTHING), text(game.env.worlds, 0).splitlines()[:22]
    assert not np.array_equal(expected[0], whole)
    game.column(Entity).alive[0, rows] = 1
    for value in (np.nan, np.inf, -np.inf, 1e30, 1e6):
        game.column(Body).x[0, rows] = value
        assert np.array_equal(draw(game.env.worlds, 0, 256, EVERYTHING), expected[0])
        assert text(game.env.worlds, 0).splitlines()[:22] == expected[1]


def test_scenes_have_the_numbers_of_the_episode() -> None:
    drawn = {"agents_health": integers(20, 90), "ending_limit": integers(2, 4)}
    env = make_vec(variant("ffa_1").vary(**drawn), 3, seed=0)
    env.reset()
    for _ in range(6):
        scenes = [Scene(env.worlds, w) for w in range(3)]
        points = [scene.prefab(Health).points[0] for scene in scenes]
        assert points == [scene.mechanic(systems.Agents).health for scene in scenes]
        assert len({*points}) > 1
        env.step(np.tile(env.noop, (3, 2, 1)))


LOOKS = (draw, text, FloorPlan.of_world, lambda env, w: footage(env, (), [w]))


@pytest.mark.parametrize(
    ("look", "error", "message"),
    [
        *((lambda env, size=size: draw(env.worlds, 0, size), ValueError, "size = .*: an integer from 64 to 4096 is")
          for size in (63, 4097, 256.0, True)),
        *((lambda env, w=w, look=look: look(env.worlds, w), ValueError, "w = .*: an integer from 0 to 1 is needed")
          for w in (-1, 2, 0.0) for look in (draw, text)),
        *((lambda env, look=look: look(env, 0), TypeError, "SurvivalVectorEnv is given for worlds: .* are env.worlds")
          for look in LOOKS),
        (lambda env: draw(env.worlds, 0, 64, [CamerasLayer]), TypeError, r"Cameras.* is not a layer: pass instances"),
        (lambda env: draw(env.worlds, 0, 64, [type("Bare", (Layer,), {"needs": Body})()]), TypeError,
         r"Bare.needs = <class .*: a tuple is needed, as in \(Body,\)"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_is_refused(look: Callable[[Any], Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        look(make_vec("ffa_1", 2))


def test_pictures_of_all_sizes_show_the_same() -> None:
    """In the mean over what is a pixel of the smallest; there, lines take more room, as they are a pixel wide."""
    worlds = played("teams_3", 3)
    reduced = {}
    for size in (64, 512, 4096):
        k = size // 64
        reduced[size] = draw(worlds, 0, np.int64(size)).reshape(64, k, 64, k, 3).mean((1, 3))
    assert np.abs(reduced[4096] - reduced[512]).mean() < 4
    assert np.abs(reduced[512] - reduced[64]).mean() < 20


@pytest.mark.parametrize("left_out", [type(layer).__name__ for layer in EVERYTHING if layer not in OWN])
def test_a_layer_that_is_left_out_is_not_seen(left_out: str) -> None:
    worlds = played("teams_3", 1, worlds=1)
    strikes = worlds[Strike]
    strikes.agent[0, :2], strikes.target[0, :2], strikes.count[0] = (0, 1), 3, 2
    worlds[Zone].radius[0], worlds[Clock].tick[0] = 5, 7
    items = worlds.span("box_item")
    worlds[Entity].alive[0, items] = 1
    worlds[Body].x[0, items], worlds[Body].y[0, items] = np.arange(8) - 4, -9
    worlds[Bag].items[0, 0, 0], worlds[Bag].count[0, 0] = worlds.span("heal").start, 1
    worlds[Entity].alive[0, 2], worlds[Died].damage_type[0, 2], worlds[Health].fatal_tick[0, 2] = 0, 0, 7
    hidden = "SafeZoneLayer" if left_out == "RoomLayer" else ""  # which paints the floor anew
    every = [layer for layer in EVERYTHING if type(layer).__name__ != hidden]
    layers = [layer for layer in every if type(layer).__name__ != left_out]
    assert len(layers) == len(every) - 1
    assert not np.array_equal(draw(worlds, 0, 512, layers), draw(worlds, 0, 512, every))


@dataclass(frozen=True)
class Marked(Module):
    def looks(self) -> dict[str, Look]:
        return {"agent": Look(ring=Weapon.cooldown, line_to=Weapon.target)}


@pytest.mark.parametrize("column", ["cooldown", "target"])
def test_rings_and_lines_are_drawn_where_looks_name_columns(column: str) -> None:
    worlds = make_vec(variant("ffa_2").with_(Marked()), 1, seed=0).worlds
    worlds.run(np.full(1, RESET, np.int8))
    worlds[Weapon].target[0], worlds[Weapon].cooldown[0] = -1, 0
    without = [layer for layer in EVERYTHING if not isinstance(layer, LooksLayer)]
    plain = draw(worlds, 0, 256, EVERYTHING)
    assert np.array_equal(plain, draw(worlds, 0, 256, without))
    getattr(worlds[Weapon], column)[0, 1] = 2
    assert not np.array_equal(draw(worlds, 0, 256, EVERYTHING), plain)
    assert np.array_equal(draw(worlds, 0, 256, without), plain)


@pytest.mark.parametrize("left_out", [(), *LEFT_OUT], ids="-".join)
def test_scenarios_without_a_mechanic(left_out: tuple[str, ...]) -> None:
    """Its layers are left out by themselves, and everything else is there."""
    worlds = scattered(variant("teams_3").without(*left_out))
    fitting = [layer for layer in EVERYTHING if layer.fits(Scene(worlds, 0))]
    assert left_out or len(fitting) == len(EVERYTHING)
    image = draw(worlds, 0, 128, EVERYTHING)
    assert np.array_equal(image, draw(worlds, 0, 128, fitting))
    assert not np.array_equal(image, draw(worlds, 0, 128, []))
    assert len(text(worlds, 0).splitlines()) == 22 + 4


@dataclass(frozen=True)
class Tide(Module):
    height: float = 4.0


@dataclass(frozen=True)
class TideLayer(Layer):
    zorder = ZOrder.ZONE + 1
    needs = (Tide, Heal)
    color: tuple[int, int, int] = (1, 2, 3)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        canvas.rectangle(-5, 0, 5, scene.mechanic(Tide).height, self.color)


def test_new_layers_need_no_change_elsewhere() -> None:
    tidal = variant("ffa_3").with_(Tide())
    for scenario, fits in ((variant("ffa_3"), False), (tidal, True), (tidal.without(systems.Heals), False)):
        image = draw(Worlds(scenario.modules, 1), 0, 128, [*LAYERS, TideLayer()])
        assert ((image == TideLayer().color).all(-1).sum() > 500) == fits


def test_what_opencv_refuses_is_said_of_the_layer() -> None:
    blue: Any = TideLayer(color="blue")  # type: ignore[arg-type]
    with pytest.raises(FilmError, match=r"TideLayer\.draw: OpenCV cannot draw this; colours are \(red, green, blue\)"):
        draw(Worlds(variant("ffa_3").with_(Tide()).modules, 1), 0, 128, [*LAYERS, blue])


def test_a_map_shows_everything_where_it_is() -> None:
    game = ScenarioBuilder(n_agents=2)
    zone, alive = game.column(Zone), game.column(Entity).alive
    zone.x[0], zone.y[0], zone.radius[0] = 0, 0, 12.5
    game.put("heal", 0, 0.1, 0.1)
    game.put("box", 0, 5, -5, size=(3, 3))
    game.put("box_item", 1, -12.4, 12.4)
    lines = text(game.env.worlds, 0).splitlines()
    assert {len(line) for line in lines[:22]} == {42}
    grid = [line[1:-1] for line in lines[1:21]]
    assert grid[9][20] == "+"
    assert grid[0][0] == "="
    assert grid[15][8] == "0"  # at (-7, -7): a character is 0.625 m wide and 1.25 m high
    assert grid[4][8] == "1"
    assert [line[25:31] for line in grid[12:16]] == ["######"] * 4  # from 3.5 to 6.5, and as far below
    assert "".join(grid).count("#") == 24
    assert (grid[0][39], grid[10][1]) == (":", " ")
    assert lines[22:] == ["0 side 0 health 100", "1 side 1 health 100"]
    game.hand(0, "heal", 1)
    game.hand(0, "box_item", 1)
    game.wound(0, 7)
    alive[0, game.row("agent", 1)] = 0
    lines = text(game.env.worlds, 0).splitlines()
    assert lines[22:] == ["0 side 0 health 7 heal box_item", "1 side 1 dead"]
    assert "1" not in "".join(lines[:22])
