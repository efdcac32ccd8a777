"""Footage: the chosen worlds, tick after tick, each where it belongs in the frame."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from outlast import make_vec
from outlast.ecs import Clock
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import FilmError
from outlast.envs.rendering.rgb import draw, footage
from outlast.envs.rollout.local import ticks
from outlast.envs.rollout.policies import scripted_policy

SIZE = 64


def played() -> SurvivalVectorEnv:
    return make_vec("teams_3", 5, seed=3)


def shots(env: SurvivalVectorEnv, chosen: Any, steps: int = 6, **options: Any) -> list[np.ndarray]:
    return list(footage(env.worlds, ticks(env, scripted_policy(env), steps), chosen, **{"size": SIZE} | options))


def test_frames_show_every_tick_from_the_reset_on() -> None:
    env, other = played(), played()
    frames = shots(env, [2])
    policy, expected = scripted_policy(other), []
    observations, _ = other.reset()
    for _ in range(7):
        expected.append(draw(other.worlds, 2, SIZE))
        observations, *_ = other.step(policy(observations))
    assert np.array_equal(frames, expected)


def test_ticks_run_only_when_they_are_asked_for() -> None:
    env = played()
    steps = ticks(env, scripted_policy(env), 3)
    frames = footage(env.worlds, steps, [0], size=SIZE)
    for step in range(4):
        next(frames)
        assert env.worlds[Clock].tick[0, 0] == step
    assert next(frames, None) is None
    assert list(ticks(env, scripted_policy(env), 3)) == [0, 1, 2, 3]


@pytest.mark.parametrize("every", [1, 2, 5, 100])
def test_every_nth_tick_is_drawn(every: int) -> None:
    whole = shots(played(), [1], steps=11)
    assert np.array_equal(shots(played(), [1], steps=11, every=every), whole[::every])


@pytest.mark.parametrize(("chosen", "mosaic"), [([0, 1, 2, 3], (2, 2)), ([4, 1, 3], (1, 3)), ([2, 0, 1], (3, 2))])
def test_a_mosaic_holds_each_world_once_and_thin_black_lines(chosen: list[int], mosaic: tuple[int, int]) -> None:
    [frame] = shots(played(), chosen, steps=0, mosaic=mosaic)
    rows, columns = mosaic
    assert frame.shape == (rows * (SIZE + 1) - 1, columns * (SIZE + 1) - 1, 3)
    (env := played()).reset()
    for k, (row, column) in enumerate(itertools.product(range(rows), range(columns))):
        top, left = row * (SIZE + 1), column * (SIZE + 1)
        cell = frame[top : top + SIZE, left : left + SIZE]
        assert np.array_equal(cell, draw(env.worlds, chosen[k], SIZE) if k < len(chosen) else np.zeros_like(cell))
        frame[top : top + SIZE, left : left + SIZE] = 0
    assert not frame.any()


def test_frames_are_new_arrays() -> None:
    frames = shots(played(), [0, 1])
    for one, other in itertools.combinations(frames, 2):
        assert not np.shares_memory(one, other)
        assert not np.array_equal(one, other)


MISTAKES: dict[str, tuple[dict[str, Any], str]] = {
    "none": ({"chosen": []}, "no world is chosen"),
    "a world too far": ({"chosen": [0, 5]}, "world 5 does not exist: there are 5, from 0 on"),
    "a world before the first": ({"chosen": [-1]}, "world -1 does not exist"),
    "a small mosaic": ({"chosen": [0, 1, 2], "mosaic": (1, 2)}, "1x2 has no room for 3 worlds: 2x2 has"),
    "no mosaic": ({"mosaic": (0, 4)}, "a mosaic of 0x4"),
    "small pictures": ({"size": 63}, "size = 63: 64 to 4096 pixels"),
    "large pictures": ({"size": 4096, "mosaic": (5, 1)}, "5x1 pictures of 4096 pixels is wider than 16384"),
    "no tick": ({"every": 0}, "every = 0"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_reported_before_a_tick_is_run(mistake: str) -> None:
    options, message = MISTAKES[mistake]

    def never() -> Iterator[int]:
        raise AssertionError("a tick was run")
        yield

    with pytest.raises(FilmError, match=message):
        footage(played().worlds, never(), options.pop("chosen", [0]), **options)
