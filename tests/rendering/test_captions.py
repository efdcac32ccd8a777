"""What is written beside the room, where blows land, and the names of layers."""

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast.drawing import (  # isort: skip
    FILM_LAYERS, LAYERS, CamerasLayer, HitsLayer, IdsLayer, KillFeedLayer, Layer, Scene, StepCounterLayer, select,
)  # fmt: skip
from outlast.ecs import Clock
from outlast.envs.rendering import style as colors
from outlast.envs.rendering.canvas import Canvas
from outlast.envs.rendering.layers import FILM_LAYERS_BY_NAME
from outlast.envs.rendering.rgb import draw
from tests.helpers.scenario_builder import ScenarioBuilder, duel
from tests.rendering.test_layers import HALF, SIZE, spot

Picture = np.ndarray[Any, Any]
ROOM = 12.5  # metres


class Written(Canvas):
    """A canvas that remembers what was written on it, with the pixels between its ends: (words, left, right, y)."""

    def __init__(self, *size: Any) -> None:
        super().__init__(*size)
        self.clear(colors.INK)
        self.written: list[tuple[str, float, float, float]] = []

    def text(self, x: float, y: float, words: str, height: float, color: Any, anchor: float = 0.5) -> None:
        length = self.length(words, height)
        self.written.append((words, x - anchor * length, x + (1 - anchor) * length, y))
        assert not words or height * self.scale >= 7
        super().text(x, y, words, height, color, anchor)


def words(game: ScenarioBuilder, layer: Layer, size: int = SIZE) -> list[str]:
    scene = Scene(game.env.worlds, 0)
    layer.draw(canvas := Written(size, scene.half), scene)
    return [words for words, *_ in canvas.written]


def places(image: Picture, other: Picture) -> tuple[Picture, Picture]:
    rows, columns = np.nonzero((image != other).any(-1))
    size = len(image)
    return columns / size * 2 * HALF - HALF, HALF - rows / size * 2 * HALF


def killed(game: ScenarioBuilder, agent: int, by: int) -> ScenarioBuilder:
    """`agent` dies by the hand of `by`, which stands before it."""
    game.put("agent", by, 0, 0)
    game.put("agent", agent, 1.5, 0, math.pi)
    game.wound(agent, 1)
    return game.step({by: "attack"})


@pytest.mark.parametrize("size", [64, 128, 256, 512, 1024])
@pytest.mark.parametrize("layer", [StepCounterLayer(), KillFeedLayer()])
def test_words_are_written_beside_the_room_only_and_where_there_is_room(size: int, layer: Layer) -> None:
    game = killed(ScenarioBuilder("teams_3"), 2, 0)
    rest = [other for other in LAYERS if other != layer]
    xs, ys = places(draw(game.env.worlds, 0, size), draw(game.env.worlds, 0, size, rest))
    assert bool(len(xs)) == (size >= 512)  # in smaller ones, letters would be too small to be read
    assert (np.abs(ys) > ROOM).all()
    assert (np.sign(ys) == (1 if isinstance(layer, StepCounterLayer) else -1)).all()


def test_the_feed_lists_deaths_and_their_causes_the_latest_first() -> None:
    game = ScenarioBuilder("teams_3", safe_zone_damage=50)
    assert words(game, KillFeedLayer()) == []
    killed(game, 2, 0)
    assert words(game, KillFeedLayer()) == ["2 killed by team 0"]
    image = draw(game.env.worlds, 0, SIZE)
    assert spot(image, -ROOM + 0.3, -HALF + 0.4) == colors.VERMILLION
    game.column(Clock).tick[0] += 3
    game.wound(1, 1)
    game.put("agent", 1, 12, 12)  # out of the zone
    game.step(times=2)
    assert words(game, KillFeedLayer()) == ["1 died of zone", "2 killed by team 0"]
    assert spot(draw(game.env.worlds, 0, SIZE), -ROOM + 0.3, -HALF + 0.4) == colors.BLUE
    assert [game.death(1), game.death(2)] == [("zone", -1), ("melee", 0)]


def test_the_feed_fades() -> None:
    game = killed(ScenarioBuilder("teams_3"), 2, 0)
    feed, brightness = KillFeedLayer(fresh=5, fading=10), []
    for _ in range(16):
        image = draw(game.env.worlds, 0, SIZE, [feed])
        brightness.append(int(image.max()))
        game.column(Clock).tick[0] += 1
    assert brightness[:6] == [brightness[0]] * 6
    assert brightness[5:] == sorted(brightness[5:], reverse=True)
    assert brightness[-1] == int(draw(game.env.worlds, 0, SIZE, []).max()) < brightness[-2]


def test_in_free_for_all_agents_kill_not_sides() -> None:
    assert words(killed(ScenarioBuilder("ffa_4"), 1, 0), KillFeedLayer()) == ["1 killed by 0"]


@pytest.mark.parametrize("far", [1.2, 1.6, 2.3])
def test_a_star_lies_where_the_strike_meets_the_skin(far: float) -> None:
    game = duel(ScenarioBuilder(), far).step({0: "attack"})
    worlds = game.env.worlds
    xs, ys = places(draw(worlds, 0, SIZE), draw(worlds, 0, SIZE, [v for v in LAYERS if not isinstance(v, HitsLayer)]))
    assert (xs.min() + xs.max()) / 2 == pytest.approx(game.place("agent", 1)[0] - 0.5, abs=0.1)
    assert (ys.min() + ys.max()) / 2 == pytest.approx(0, abs=0.1)
    assert spot(draw(worlds, 0, SIZE), far - 0.5, 0) == colors.WHITE


@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 4, 2.0])
def test_a_star_lies_on_the_edge_of_a_box(angle: float) -> None:
    """The nearest point of the box on the line y = 0, found by walking along it."""
    game = duel(ScenarioBuilder("ffa_3"), far=9)
    game.put("box", 0, 1.6, 0.1, angle, size=(1.5, 0.6))
    game.step({0: "attack"})
    walk = np.linspace(0, 3, 3001)
    a, b = walk - 1.6, np.full_like(walk, -0.1)
    inside = (abs(a * math.cos(angle) + b * math.sin(angle)) < 0.75) & (
        abs(b * math.cos(angle) - a * math.sin(angle)) < 0.3
    )
    xs, _ = places(draw(game.env.worlds, 0, SIZE, [HitsLayer()]), draw(game.env.worlds, 0, SIZE, []))
    assert (xs.min() + xs.max()) / 2 == pytest.approx(walk[inside][0], abs=0.1)


def test_layers_are_added_and_removed_by_name() -> None:
    assert set(select("+vision,-ids")) == {*FILM_LAYERS, CamerasLayer(lines=False)} - {IdsLayer()}
    assert select("lines , -lines") == FILM_LAYERS
    assert select(",".join(f"-{name}" for name in FILM_LAYERS_BY_NAME)) == ()
    for name, layer in FILM_LAYERS_BY_NAME.items():
        assert (layer in select(f"+{name}"), layer in select(f"-{name}")) == (True, False)


OWN = """
from outlast.drawing import LAYERS, Layer

class Marsh(Layer):
    pass

class Deep(Layer):
    def __init__(self, depth):
        self.depth = depth

marsh, everything = Marsh(), [*LAYERS, Deep(2)]
"""


def test_layers_of_ones_own_are_added_by_file_and_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    (own_file := tmp_path / "own_marsh.py").write_text(OWN)
    *shown, marsh = select(f"-ids,+{own_file}:Marsh")
    assert (set(shown), type(marsh).__name__) == (set(FILM_LAYERS) - {IdsLayer()}, "Marsh")
    assert select("own_marsh:marsh")[-1] is sys.modules["own_marsh"].marsh
    added = select("+own_marsh:everything")[len(FILM_LAYERS) :]
    assert [type(layer).__name__ for layer in added] == ["StepCounterLayer", "KillFeedLayer", "Deep"]  # the others are
