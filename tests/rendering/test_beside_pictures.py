"""What films show beside and over the picture: title, scoreboard, deaths, ends of episodes, own items and bodies."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from outlast import film, make_vec, record, variant
from outlast.components import Body, End, Episode, Health, Kills, Score, Shape
from outlast.drawing import LAYERS, EndLayer, FeedStrip, Layer, OthersLayer, Scene, ScoresStrip, Strip, TitleStrip
from outlast.ecs import Clock, Entity, Worlds
from outlast.envs.rendering import style as colors
from outlast.envs.rendering.canvas import Canvas
from outlast.envs.rendering.rgb import draw, footage, paint
from outlast.envs.rendering.scene import of_kind
from outlast.envs.rendering.words import MIDDLE, winner
from outlast.envs.rollout.local import ticks
from outlast.envs.rollout.policies import noop_policy
from tests.helpers.own_bodies import Gem, Mine
from tests.helpers.scenario_builder import ScenarioBuilder
from tests.rendering.test_captions import Written, killed

SIZES = (64, 96, 128, 256, 1024)


def strip_words(worlds: Worlds, strip: Strip, size: int) -> list[tuple[str, float, float, float]]:
    """What a strip writes; everything lies on it, and nothing overlaps."""
    scene = Scene(worlds, 0)
    strip.draw(canvas := Written(size, size / 2, strip.pixels(scene, size)), scene)
    written = [each for each in canvas.written if each[0]]
    for words, left, right, y in written:
        assert -size / 2 <= left <= right <= size / 2, words
        assert abs(y) < canvas.height / 2 - 3
    for k, (_, left, right, y) in enumerate(written):
        for _, other_left, other_right, other_y in written[:k]:
            assert right <= other_left or other_right <= left or abs(y - other_y) >= 7
    return written


def said(worlds: Worlds, strip: Strip, size: int = 512) -> list[str]:
    return [words for words, *_ in strip_words(worlds, strip, size)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", ["ffa_1", "teams_4"])
def test_what_is_written_beside_the_picture_is_legible_and_overlaps_nothing(name: str, size: int) -> None:
    game = killed(ScenarioBuilder(name), 1, 0) if name == "ffa_1" else killed(ScenarioBuilder(name), 2, 0)
    assert bool(said(game.env.worlds, FeedStrip(), size)) == (size >= 128 or (name == "ffa_1" and size == 96))
    assert said(game.env.worlds, ScoresStrip(), size)
    title = TitleStrip("a_scenario_with_a_rather_long_name, scripted policy against random")
    for tick in (0, 99, 4321):
        game.column(Clock).tick[0] = tick
        assert said(game.env.worlds, title, size)[-1].endswith(f"tick {tick}")


def test_the_title_says_what_is_played_and_where_in_it_one_is() -> None:
    game = ScenarioBuilder("teams_3").step(times=3)
    clock = game.column(Clock)
    seed, world, episode = (int(column[0, 0]) for column in (clock.seed, clock.world, clock.episode))
    start = f"teams_3, scripted policy, seed {seed}, world {world}"
    assert said(game.env.worlds, TitleStrip("teams_3, scripted policy")) == [start, f"episode {episode}, tick 3"]
    assert said(game.env.worlds, TitleStrip()) == [f"world {world}", f"episode {episode}, tick 3"]
    long = "ffa_2-original-0 (side 0) against scripted (side 1)"  # who plays is there ahead of the episode's number
    assert said(game.env.worlds, TitleStrip(f"{long}, teams_3"), 512) == [long, "tick 3"]
    assert said(game.env.worlds, TitleStrip("größer"))[0].startswith("gr??er")  # what fonts of pictures lack


def test_a_mosaic_says_the_seed_of_all_worlds_or_each_its_own() -> None:
    env = make_vec("ffa_2", 3, seed=5)
    layers, drawn = [TitleStrip()], list[str]()

    def titles() -> list[str]:
        drawn.clear()
        list(footage(env.worlds, iter([None]), [1, 2], size=512, layers=layers, title="ffa_2"))
        return [words for words in drawn if "tick" not in words]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Canvas, "text", lambda canvas, x, y, words, *_, **__: drawn.append(words) if words else None)
        env.reset()
        assert titles() == ["world 1", "world 2", "ffa_2, seed 5"]
        env.reset(seed=[11, 22, 33])
        assert titles() == ["world 0, seed 22", "world 0, seed 33", "ffa_2"]
        env.reset(seed=[11, 33, 33])
        assert titles() == ["world 0", "world 0", "ffa_2, seed 33"]


def test_the_scoreboard_has_hit_points_kills_and_deaths() -> None:
    game = killed(ScenarioBuilder("teams_3"), 2, 0)
    game.wound(1, 150)
    assert said(game.env.worlds, ScoresStrip()) == [
        *("team 0: 1 kill", "team 1: 0 kills"),
        *("0", "100", "1", "150", "2", "dead", "3", "100"),
    ]
    assert said(game.env.worlds, ScoresStrip(), 160)[:2] == ["1 kill", "0 kills"]  # of both, if there is room for both
    duel = killed(ScenarioBuilder("ffa_4"), 1, 0)
    assert said(duel.env.worlds, ScoresStrip()) == ["0", "100", "1 kill", "1", "dead", "0 kills"]
    duel.column(Kills).kills[0] = 0, 3
    assert said(duel.env.worlds, ScoresStrip())[-1] == "3 kills"


def test_long_numbers_are_shortened_and_returns_are_shown_where_nobody_fights() -> None:
    game = ScenarioBuilder("teams_3")
    for points, words in ((9999, "9999"), (1_234_567, "1e+06"), (-3, "-3")):
        game.wound(0, points)
        assert said(game.env.worlds, ScoresStrip())[3] == words
    peaceful = variant("ffa_1").without("melee", "safe_zone", "heals", "cameras")
    worlds = Worlds(peaceful.modules, 1)
    worlds[Episode].returns[0] = -12345.678, 0.25
    assert said(worlds, ScoresStrip()) == ["0", "return -1e+04", "1", "return 0.25"]


@pytest.mark.parametrize(
    ("alive", "fatal", "expected"),
    [((1, 0), (-1, 7), 0), ((0, 1), (7, -1), 1), ((0, 0), (7, 9), 1), ((0, 0), (9, 9), None), ((1, 1), (-1, -1), None)],
)
def test_who_lives_longest_wins(alive: Any, fatal: Any, expected: int | None) -> None:
    game = ScenarioBuilder("ffa_4")
    game.column(Score).alive[0], game.column(Health).fatal_tick[0, :2] = alive, fatal
    assert winner(Scene(game.env.worlds, 0)) == expected


@pytest.mark.parametrize("size", SIZES)
def test_the_last_picture_of_an_episode_says_who_won_and_why(size: int) -> None:
    game = killed(ScenarioBuilder("ffa_4"), 1, 0)
    assert game.done
    scene = Scene(game.env.worlds, 0)
    EndLayer().draw(canvas := Written(size, scene.half), scene)
    words = [each[0] for each in canvas.written]
    assert words[:1] == (["agent 0 wins"] if size > 96 else [])
    assert words[1:] == (["the others are dead, tick 1"] if size >= 200 else [])
    assert all(-scene.half < left <= right < scene.half for _, left, right, _ in canvas.written)
    game.column(End).terminated[0], game.column(End).truncated[0] = False, True
    game.column(Score).alive[0] = 1
    with_banner, without = (draw(game.env.worlds, 0, 512, layers) for layers in ([EndLayer()], []))
    assert not np.array_equal(with_banner, without)


def shots(ends: int, chosen: tuple[int, ...] = (0,), **options: Any) -> tuple[list[np.ndarray], list[int]]:
    env = make_vec(variant("ffa_1").replace(ending_limit=ends), 4, seed=0)
    seen, frames = list[int](), list[np.ndarray]()
    options = {"size": 64, "layers": [EndLayer(), TitleStrip()]} | options
    for frame in footage(env.worlds, ticks(env, noop_policy(env), 13), chosen, **options):
        frames.append(frame)
        seen.append(int(env.worlds[Clock].tick[0, 0]))
    return frames, seen


def test_a_single_world_stands_still_at_the_end_of_an_episode() -> None:
    frames, seen = shots(5, hold=3)
    assert seen == [0, 1, 2, 3, 4, 5, 5, 5, 5, 0, 1, 2, 3, 4, 5, 5, 5, 5, 0, 1]
    assert all(np.array_equal(frame, frames[5]) for frame in frames[5:9])
    assert shots(5, hold=3, layers=[TitleStrip()])[1] == [0, 1, 2, 3, 4, 5, 0, 1, 2, 3, 4, 5, 0, 1]
    assert shots(5, hold=2, every=4)[1] == [0, 4, 5, 5, 5, 2, 5, 5, 5, 0]


def test_ends_of_worlds_that_are_reset_with_the_same_seed_are_each_shown(tmp_path: Path) -> None:
    env = make_vec(variant("ffa_1").replace(ending_limit=5), 1, autoreset_mode=AutoresetMode.DISABLED)
    with record(env, tmp_path / "r.rec"):
        for _ in range(3):
            env.reset(seed=7)
            for _ in range(5):
                env.step(np.tile(env.noop, (1, 2, 1)))
    hold = round(0.8 * 30)
    assert _frames(film(tmp_path / "r.rec", tmp_path / "whole.apng", size=64)) == 18 + 3 * hold
    assert _frames(film(tmp_path / "r.rec", tmp_path / "ends.apng", size=64, every=100)) == 1 + 3 * (1 + hold)


def _frames(path: Path) -> int:
    found, images = cv2.imreadmulti(str(path))
    assert found
    return len(images)


def test_in_a_mosaic_the_end_stays_and_the_others_go_on() -> None:
    frames, seen = shots(5, (0, 1), hold=3)
    assert len(frames) == len(set(enumerate(seen))) == 14
    assert all(np.array_equal(frame, frames[5]) for frame in frames[5:9])
    assert not np.array_equal(frames[9], frames[8])


def test_in_a_mosaic_the_end_stays_for_as_many_ticks_however_few_are_drawn() -> None:
    frames, seen = shots(5, (0, 1), hold=3, every=2)
    assert seen == [0, 2, 4, 0, 2, 4, 0]
    same = [np.array_equal(frame, frames[3]) for frame in frames]
    assert same == [False, False, False, True, True, False, True]  # the end, ticks of the next episode, and its end
    only = shots(5, (0, 1), hold=3, every=20)[0]
    assert len(only) == 2  # the last end, after the last tick that is drawn
    assert np.array_equal(only[1], frames[6])


@pytest.fixture
def mine() -> Worlds:
    worlds = Worlds(variant("ffa_1").with_(Mine()).modules, 1)
    places = {"big_gem": (-6, 6), "ball": (0, 6), "crate": (6, 6), "door": (0, -6)}
    for kind, (x, y) in places.items():
        row = worlds.span(kind).start
        worlds[Body].x[0, row], worlds[Body].y[0, row] = x, y
    worlds[Shape].bound[0] = 1
    worlds[Entity].alive[0, worlds.span("big_gem").start + 1] = 0
    return worlds


def pixel(image: np.ndarray, x: float, y: float) -> tuple[int, ...]:
    half = colors.SIZES.margin * 12.5
    column, row = (int(len(image) * (0.5 + length / (2 * half))) for length in (x, -y))
    return tuple(image[row, column].tolist())


def test_own_items_and_bodies_have_their_shape_and_a_colour_of_their_kind(mine: Worlds) -> None:
    image = draw(mine, 0, 512)
    gem, ball, crate = (pixel(image, x, y) for x, y in ((-6, 6), (0.5, 6), (6.7, 6)))
    assert len({gem, ball, crate}) == 3
    assert {gem, ball, crate} <= set(colors.KINDS)
    assert pixel(image, 6, 6.4) == pixel(image, 0.7, 6.7) == colors.UNSAFE  # beside a rectangle and a disc
    assert pixel(image, 0, -6) == colors.WALL


@pytest.mark.parametrize("alive", [0, 1])
def test_kinds_of_ones_own_are_named_once_however_many_bodies_they_have(mine: Worlds, alive: int) -> None:
    """In the margin, beside the step counter, in the world or not; walls, and small pictures, have no names."""
    mine[Entity].alive[0, mine.span("big_gem")] = alive
    for size, names in ((512, ["tick 0", "ball", "big gem", "crate"]), (128, [])):
        scene = Scene(mine, 0)
        canvas = Written(size, scene.half)
        paint(canvas, [layer for layer in LAYERS if layer.fits(scene)], scene)
        written = sorted((left, right, words) for words, left, right, y in canvas.written if y > scene.room)
        assert [words for *_, words in written] == names
        ends = [end for left, right, _ in written for end in (left, right)]
        assert ends == sorted(ends)  # they do not overlap
        assert all(abs(end) <= scene.room + 0.1 for end in ends)
        for left, _, words in written[1:]:
            row = mine.span(words.replace(" ", "_")).start
            y = scene.room + MIDDLE * (scene.half - scene.room)
            assert pixel(canvas.image, left - 0.5, y) == of_kind(scene, row)


def test_a_layer_that_shows_them_takes_their_default_look_away(mine: Worlds) -> None:
    draws_nothing = type("GemLayer", (Layer,), {"shows": (Gem,), "draw": lambda *_: None})()
    with_own, without = (draw(mine, 0, 256, layers) for layers in ([*LAYERS, draws_nothing], LAYERS))
    assert pixel(without, -6, 6) in colors.KINDS
    assert pixel(with_own, -6, 6) == colors.UNSAFE
    assert pixel(with_own, 0.5, 6) in colors.KINDS  # the others are as they were


def test_a_body_that_is_nowhere_is_left_out(mine: Worlds) -> None:
    row, expected = mine.span("ball").start, None
    for value in (math.nan, math.inf, 1e30):
        mine[Body].x[0, row] = value
        image = draw(mine, 0, 256, [OthersLayer()])
        expected = image if expected is None else expected
        assert np.array_equal(image, expected)
