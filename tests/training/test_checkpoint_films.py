"""Episodes and films of checkpoints, made while a run goes on."""

import importlib
import logging
import random
import signal
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from outlast import variant
from outlast.components import Body
from outlast.envs.api.film import HOLD
from outlast.envs.rendering import video
from outlast.envs.scenarios.fingerprint import difference, fingerprint
from outlast.envs.scenarios.serialize import classes

pytest.importorskip("torch", reason="needs torch: outlast[train]")

import torch

from outlast.training.base import policy_file
from outlast.training.base.errors import TrainingError
from outlast.training.runs import film
from outlast.training.runs.episode import episode, recorded_scenario
from outlast.training.runs.film import film_checkpoint
from tests.helpers.checkpoints import KEPT, as_checkpoint

pytestmark = pytest.mark.usefixtures("one_torch_thread")


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return as_checkpoint("teams_3/original-0", tmp_path_factory.mktemp("run") / "steps_0000001024.zip")


@pytest.fixture(autouse=True)
def short(monkeypatch) -> None:
    monkeypatch.setattr(film, "MOST", 60)


def test_an_episode_is_played_to_its_end_and_is_the_same_again(policy: Path) -> None:
    paths = []
    for seed in (3, 3, 4):
        with episode(policy, seed=seed, most=5000) as played:
            places = [played.worlds[Body].x[0].copy() for _ in played.ticks]
        paths.append(np.array(places))
        assert (played.scenario.name, played.differs) == ("teams_3", "")
    assert 10 < len(paths[0]) < 5000
    assert np.array_equal(paths[0], paths[1])
    assert not np.array_equal(paths[0][:5], paths[2][:5])
    with episode(policy, seed=0, most=7) as played:  # it goes on, and is left
        assert list(played.ticks) == list(range(8))


def test_the_scenario_of_a_run_is_in_its_header_and_a_difference_is_reported() -> None:
    for scenario in (
        variant("ffa_1"),
        variant("teams_2+health_cap+bounty").replace(melee_damage=7, safe_zone_radii=(8.0, 4.0)),
        variant("ffa_3+steering").replace(n_agents=5, cameras_mode="revealed"),
    ):
        made, differs = recorded_scenario({"scenario": fingerprint(scenario), "modules": classes(scenario)})
        assert difference(fingerprint(scenario), fingerprint(made)) == differs == ""
    header = policy_file.read_header(KEPT / "ffa_1/original-0.safetensors", ())
    del header["scenario"]["numbers"]["give_last_passes_on"]
    made, differs = recorded_scenario(header)
    assert made.name == "ffa_1"
    assert differs == "give_last_passes_on is not there there and False here"


def test_mechanics_of_others_are_used_where_they_are_imported(monkeypatch) -> None:
    """Of a file that was imported twice, those that are there now."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "docs/examples"))
    import tag

    game = tag.TAG
    monkeypatch.delitem(sys.modules, "tag")  # which is put back at the end
    importlib.import_module("tag").Stamina.registered.clear()
    monkeypatch.setitem(sys.modules, "tag", tag)
    header = {"scenario": fingerprint(game.replace(stamina_most=7)), "modules": classes(game)}
    made, differs = recorded_scenario(header)
    assert (made.name, made.numbers()["stamina_most"], differs) == ("tag-stamina_most=7", 7, "")
    monkeypatch.delitem(sys.modules, "tag")
    with pytest.raises(TrainingError, match=r"tag\.\w+ is not one of outlast's own.*--import FILE\.py"):
        recorded_scenario(header)
    assert "tag" not in sys.modules


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"numbers": {"melee_damage": "much"}}, "melee.damage = 'much'"),
        ({"numbers": {"agents_count": 10**9}}, "cannot be made from a checkpoint"),
        ({"numbers": {"physics_substeps": 10**9}}, "physics.substeps = 1000000000: must be"),
    ],
)
def test_a_scenario_that_cannot_be_made_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(TrainingError, match=words):
        recorded_scenario({"scenario": fingerprint(variant("ffa_2")) | change, "modules": classes(variant("ffa_2"))})


def test_a_film_is_short_whole_and_named_after_the_checkpoint(policy: Path, tmp_path: Path) -> None:
    (path,) = film_checkpoint(policy, tmp_path / "films")
    assert path == tmp_path / "films" / "steps_0000001024.webm"
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    read = cv2.VideoCapture(str(path))
    assert read.get(cv2.CAP_PROP_FRAME_COUNT) == film.MOST // film.EVERY + 1
    assert read.get(cv2.CAP_PROP_FRAME_WIDTH) == film.SIZE


def test_a_film_leaves_random_numbers_and_threads_alone(policy: Path, tmp_path: Path) -> None:
    torch.set_num_threads(2)

    def states() -> list[Any]:
        numpy = np.random.get_state()  # noqa: NPY002  # that of the user's own code
        return [torch.get_rng_state().tolist(), torch.get_num_threads(), random.getstate(), numpy[1].tolist(), numpy[2]]

    before = states()
    assert film_checkpoint(policy, tmp_path)
    assert states() == before


def test_films_of_one_seed_begin_in_the_same_world_of_the_scenario_that_is_given(policy: Path, tmp_path: Path) -> None:
    ours = variant("teams_3").replace(ending_limit=20)
    (path,) = film_checkpoint(policy, tmp_path, ours)
    end = 1 + round(HOLD * film.FPS)  # frames that show the end, which is no third tick
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) == 20 // film.EVERY + 1 + end
    firsts = []
    for k in range(2):
        path = KEPT / f"ffa_2/original-{k}.safetensors"
        read = cv2.VideoCapture(str(film_checkpoint(path, tmp_path)[0]))
        firsts.append(read.read()[1][30:])  # below the title, which has the checkpoint's name
    assert np.array_equal(*firsts)


@pytest.mark.parametrize("content", [b"", b"PK", b"not a checkpoint"])
def test_what_goes_wrong_is_logged_and_ends_nothing(tmp_path: Path, caplog, content: bytes) -> None:
    (tmp_path / "steps_1.zip").write_bytes(content)
    with caplog.at_level(logging.WARNING, "outlast"):
        assert film_checkpoint(tmp_path / "steps_1.zip", tmp_path) == []
        assert film_checkpoint(KEPT / "ffa_2/original-0.safetensors", tmp_path / "steps_1.zip" / "films") == []
    assert caplog.text.count("there is no film of") == 2
    assert [path.name for path in tmp_path.iterdir()] == ["steps_1.zip"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), video.writer.FilmError("cut short")])
def test_a_full_disk_ends_nothing(policy: Path, tmp_path: Path, monkeypatch, caplog, error: Exception) -> None:
    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setattr(video.writer, "_verify", fail)
    with caplog.at_level(logging.WARNING, "outlast"):
        assert film_checkpoint(policy, tmp_path) == []
    assert str(error.args[-1]) in caplog.text
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(video.writer, "_verify", lambda *_: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        film_checkpoint(policy, tmp_path)
    assert list(tmp_path.iterdir()) == []
