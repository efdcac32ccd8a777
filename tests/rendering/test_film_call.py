"""outlast.film: the film of a scenario, or of a recording, in one call."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.drawing import FILM_LAYERS, CamerasLayer, select
from outlast.envs.errors import FilmError, RecordingError, ScenarioError
from outlast.envs.rendering.rgb import footage
from outlast.envs.rollout.local import ticks
from outlast.envs.rollout.policies import random_policy, scripted_policy
from tests.conftest import run
from tests.helpers.outputs import pictures


def test_a_film_shows_what_was_played_with_all_that_films_show(tmp_path: Path) -> None:
    made = outlast.film("ffa_3", tmp_path / "film", steps=4, seed=7, size=128, n_heals=3)
    assert made == tmp_path / "film"
    env = outlast.make_vec("ffa_3", 1, seed=7, n_heals=3)
    title = "ffa_3-n_heals=3, scripted policy"
    expected = footage(env.worlds, ticks(env, scripted_policy(env), 4), [0], size=128, layers=FILM_LAYERS, title=title)
    assert np.array_equal(pictures(made), np.array(list(expected)))


def test_the_command_makes_the_same_film(capsys, tmp_path: Path) -> None:
    options = {"policy": "random", "steps": 3, "seed": 2, "size": 64, "every": 2, "views": "+vision,-scores"}
    outlast.film("ffa_3", tmp_path / "call", mosaic=(1, 2), **options)
    words = [word for name, value in options.items() for word in (f"--{name}={value}",)]
    assert run(capsys, "frames", "ffa_3", "--out", tmp_path / "command", "--mosaic", "1x2", "--quiet", *words)[0] == 0
    assert np.array_equal(pictures(tmp_path / "call"), pictures(tmp_path / "command"))


def test_policies_may_be_functions_and_have_opponents(tmp_path: Path) -> None:
    asked: list[int] = []

    def forward(observations: Any) -> np.ndarray:
        asked.append(len(observations["own"]))
        return np.tile((2, 1, 1, 0, 0, 0), (len(observations["own"]), 2, 1))

    one = pictures(outlast.film("ffa_3", tmp_path / "a", policy=forward, worlds=2, steps=3, size=64))
    other = pictures(outlast.film("ffa_3", tmp_path / "b", policy=forward, others="noop", worlds=2, steps=3, size=64))
    assert set(asked) == {2}
    assert one.shape == other.shape
    assert not np.array_equal(one, other)


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    env = outlast.make_vec("ffa_3", 3, seed=0)
    with outlast.record(env, tmp_path / "run.rec"):
        for _ in ticks(env, random_policy(env), 6):
            pass
    return tmp_path / "run.rec"


def test_a_recording_is_filmed_as_it_was_played(recorded: Path, tmp_path: Path) -> None:
    env = outlast.make_vec("ffa_3", 3, seed=0)
    looks = {"size": 64, "layers": select("-ids"), "title": "ffa_3"}
    expected = np.array(list(footage(env.worlds, ticks(env, random_policy(env), 4), [2, 0], **looks)))
    games = (recorded, str(recorded), outlast.Recording.open(recorded))
    for k, game in enumerate(games):
        made = outlast.film(game, tmp_path / f"film{k}", worlds=[2, 0], steps=4, size=64, views="-ids")
        assert np.array_equal(pictures(made), expected)
    assert len(pictures(outlast.film(recorded, tmp_path / "whole", size=64))) == 7


def test_numbers_of_numpy_are_numbers(tmp_path: Path) -> None:
    plain: dict[str, Any] = {"steps": 60, "worlds": 2, "fps": 10, "every": 5, "size": 64, "ending_limit": 30}
    films = [outlast.film("ffa_1", tmp_path / "plain.apng", **plain)]
    whole = {key: np.int64(value) for key, value in plain.items()}
    films.append(outlast.film("ffa_1", tmp_path / "whole.apng", **whole))
    assert films[0].read_bytes() == films[1].read_bytes()


def test_a_layer_that_has_nothing_to_show_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    outlast.film("ffa_1", tmp_path / "film", steps=1, size=64, views="+lidar,+vision")
    assert caplog.messages == ["LidarLayer shows nothing: the game has no Lidar and LidarView"]
    caplog.clear()
    outlast.film("ffa_1", tmp_path / "film", steps=1, size=64, views="+vision", cameras_mode="omniscient")
    assert caplog.messages == ["CamerasLayer shows nothing: the game has no use for it"]


MISTAKES: dict[str, tuple[Any, dict[str, Any], type[Exception], str]] = {
    "no game": ("ffa_9", {}, ScenarioError, "did you mean"),
    "a keyword misspelt": ("ffa_1", {"wrlds": 3}, ValueError, "did you mean worlds"),
    "numbers of worlds": ("ffa_1", {"worlds": [1]}, FilmError, "numbers are for recordings"),
    "views": ("ffa_1", {"views": "+visoin"}, FilmError, "did you mean vision"),
    "a layer": ("ffa_1", {"layers": ["vision"]}, TypeError, "'vision' is not a layer: pass instances"),
    "no layers": ("ffa_1", {"layers": None}, TypeError, "layers = None: a list is needed, as in layers="),
    "a layer without a list": ("ffa_1", {"layers": CamerasLayer()}, TypeError, r"as in layers=\[CamerasLayer"),
    "a policy of a recording": ("run.rec", {"policy": "random"}, FilmError, "policy: the recording has that already"),
    "a folder": (".." + os.sep, {}, FilmError, "it is a folder"),
    "no world of a recording": ("run.rec", {"worlds": 0}, FilmError, "worlds = 0: the recording has 3"),
    "more worlds than a recording has": ("run.rec", {"worlds": 4}, FilmError, "worlds = 4: the recording has 3"),
    "worlds of a recording": ("run.rec", {"worlds": True}, FilmError, "worlds = True: how many"),
    "steps of a recording": ("run.rec", {"steps": 700}, RecordingError, "ticks 0 to 700: .* <= 6 is needed"),
    "a mosaic": ("ffa_1", {"mosaic": 3}, FilmError, "mosaic = 3: rows and columns"),
    "half a mosaic": ("ffa_1", {"mosaic": (2, 0.5)}, FilmError, "mosaic, columns = 0.5: an integer"),
    "steps below zero": ("ffa_1", {"steps": -1}, FilmError, "steps = -1: an integer >= 0 is needed"),
    "half a step": ("ffa_1", {"steps": 2.5}, FilmError, "steps = 2.5: an integer >= 0 is needed"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_leave_nothing(mistake: str, recorded: Path, monkeypatch) -> None:
    monkeypatch.chdir(recorded.parent)
    game, options, kind, words = MISTAKES[mistake]
    with pytest.raises(kind, match=words):
        outlast.film(game, "film.apng", **options)
    assert os.listdir() == ["run.rec"]


@pytest.mark.parametrize(
    ("options", "shape"),
    [
        ((), (64, 64)),
        (("--worlds", 3), (129, 129)),
        (("--mosaic", "1x3"), (64, 194)),
        (("--mosaic", "2x1", "--worlds", 5), (129, 64)),
        (("--mosaic", "1x2", "--worlds", 1), (64, 129)),
    ],
)
def test_mosaics(capsys, tmp_path: Path, options: tuple[object, ...], shape: tuple[int, int]) -> None:
    """Without one it is nearly a square; of more worlds than it has room for, it shows the first."""
    small = ("--size", "64", "--steps", "4", "--quiet", "--views=-title,-scores,-feed")
    run(capsys, "frames", "ffa_3", "--out", tmp_path / "frames", *small, *options)
    assert pictures(tmp_path / "frames").shape == (5, *shape, 3)
