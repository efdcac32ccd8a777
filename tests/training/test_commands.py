"""outlast evaluate, and saved policies in rollout, frames and play."""

import json
import re
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

import outlast
from outlast import load_policy, make_vec, variant
from outlast.envs.cli import main as cli
from outlast.envs.errors import ActionError, FilmError, UsageError
from outlast.envs.rollout.lineup import entries_of, load_policies, parse_lineup
from outlast.envs.rollout.local import rollout
from outlast.envs.rollout.policies import POLICIES
from tests.conftest import call, interrupted_after
from tests.helpers.outputs import rows_of

pytest.importorskip("torch", reason="needs torch: outlast[train]")

import torch

from outlast.training.base.config import TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.base.quantities import COLUMNS, explained
from outlast.training.cli import evaluate as evaluate_command
from tests.training.test_player import saved

pytestmark = pytest.mark.usefixtures("one_torch_thread")


evaluate = partial(call, evaluate_command)
QUICK = ("--set=safe_zone_damage=50", "--set=safe_zone_stand=10", "--set=safe_zone_shrink=5")


def test_evaluate_prints_tables_and_writes_them(capsys, tmp_path: Path) -> None:
    saved(tmp_path / "a.zip", "paper")
    out = tmp_path / "out" / "deep"
    small = ("--episodes", 8, "--worlds", 4, *QUICK, "--out", out)
    assert evaluate("teams_3", tmp_path / "a.zip", "noop", "scripted", *small) == 0
    printed = capsys.readouterr()
    assert "48 of 48 episodes" in printed.err  # the progress bar
    assert "6 pairings of 8 episodes; fewer (--episodes) take less time\n" in printed.err
    assert "6 pairings of 8 episodes, 2 in each of 4 worlds" in printed.out
    assert "wins of, against" in printed.out
    found = json.loads((out / "evaluation.json").read_text())
    assert (found["complete"], found["episodes"], found["scenario"]["name"]) == (True, 8, "teams_3")
    assert [entry["label"] for entry in found["policies"]] == ["a", "noop", "scripted"]
    ratings = rows_of(out / "ratings.csv")
    assert np.mean([float(row["elo"]) for row in ratings]) == pytest.approx(1000)
    assert f"{float(ratings[2]['elo']):.0f}" in printed.out.split("wins of")[0]
    rows = {(row["policy"], row["against"], row["figure"]): row for row in rows_of(out / "figures.csv")}
    assert sum(float(rows[(*pair, "wins")]["mean"]) for pair in (("a", "noop"), ("noop", "a"))) == pytest.approx(1)
    figures = {"length", "return", "kills", "deaths_zone", "attack_far", "zone_distance", "heals_held", "heals_used"}
    assert figures <= {figure for _, _, figure in rows}
    assert not [path for path in out.iterdir() if path.suffix not in (".json", ".csv")]


@pytest.mark.nightly
def test_films_show_a_typical_episode_of_each_pairing(capsys, tmp_path: Path) -> None:
    small = ("--episodes", 6, "--worlds", 2, *QUICK, "--quiet")
    assert evaluate("ffa_1", "scripted", "noop", *small, "--out", tmp_path / "plain") == 0
    assert evaluate("ffa_1", "scripted", "noop", *small, "--out", tmp_path / "film", "--film") == 0
    numbers = [(tmp_path / name / "figures.csv").read_text() for name in ("plain", "film")]
    assert numbers[0] == numbers[1]  # recording changes nothing
    names = ["scripted-scripted", "scripted-noop", "noop-noop"]
    endings = {path.name for path in (tmp_path / "film").iterdir() if path.suffix in (".webm", ".html")}
    assert endings == {name + ending for name in names for ending in (".webm", ".html")}
    rows = [row for row in rows_of(tmp_path / "film/figures.csv") if row["figure"] == "length"]
    lengths = {(row["policy"], row["against"]): row for row in rows}
    video = cv2.VideoCapture(str(tmp_path / "film" / "scripted-noop.webm"))
    frames = 0
    while video.read()[0]:
        frames += 1
    mean = float(lengths["scripted", "noop"]["mean"])
    assert 0.5 * mean < frames - 1 < 2 * mean
    page = (tmp_path / "film" / "scripted-noop.html").read_text()
    assert re.search(r"ffa_1\S*: scripted \(side (0\) against noop \(side 1|1\) against noop \(side 0)\)", page)
    assert "scripted-noop.webm" in capsys.readouterr().out


def test_films_that_cannot_be_made_lose_no_tables(capsys, monkeypatch, tmp_path: Path) -> None:
    def full(*_: object, **__: object) -> None:
        raise FilmError("the disk is full")

    monkeypatch.setattr("outlast.envs.api.film.write_film", full)
    small = ("--episodes", 2, "--worlds", 2, *QUICK, "--quiet", "--out", tmp_path)
    with pytest.raises(FilmError):
        evaluate("ffa_1", "noop", "scripted", *small, "--film")
    assert "3 pairings of 2 episodes" in capsys.readouterr().out
    assert json.loads((tmp_path / "evaluation.json").read_text())["complete"]


def test_a_place_that_tables_cannot_have_is_reported(monkeypatch, capsys, tmp_path: Path) -> None:
    (tmp_path / "figures.csv").mkdir()
    small = ("--episodes", 2, "--worlds", 2, *QUICK, "--quiet", "--out", tmp_path)
    with pytest.raises(TrainingError, match=f"{tmp_path}/figures.csv cannot be written: it is a folder"):
        evaluate("ffa_1", "noop", "scripted", *small)
    assert capsys.readouterr().out == ""  # ahead of the first game


def test_ctrl_c_prints_the_pairings_that_are_complete(capsys, caplog, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setitem(POLICIES, "random", interrupted_after(20))
    small = ("--episodes", 2, "--worlds", 2, *QUICK, "--quiet", "--out", tmp_path / "out")
    assert evaluate("ffa_1", "noop", "scripted", "random", *small) == 130
    printed = capsys.readouterr()
    assert (caplog.messages, printed.err) == (["stopped; 3 of 6 pairings are complete"], "")
    assert "3 pairings of 2 episodes" in printed.out
    found = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert (found["complete"], len(found["pairings"]), found["ratings"]) == (False, 3, [])
    monkeypatch.setitem(POLICIES, "random", interrupted_after(3))
    assert evaluate("ffa_1", "random", *small[:-1], tmp_path / "none") == 130
    assert "no pairing is complete" in capsys.readouterr().out
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("noop", "noop"), "named twice"),
        (("scriptd",), r"scriptd: did you mean scripted\?"),
        (("runs/nowhere",), r"runs/nowhere is no saved policy: a model's name, FILE\.zip, .* or the folder of a run"),
        (("nowhere.zip",), "there is no checkpoint nowhere.zip"),
        (("noop", "--film"), "films need a folder"),
        (("noop", "--out", __file__), "cannot be a folder: .* is a file"),
    ],
)
def test_mistakes_of_evaluate(arguments: tuple[str, ...], words: str) -> None:
    with pytest.raises(cli.MISTAKES, match=words):
        evaluate("ffa_1", *arguments)


def test_a_saved_policy_rolls_out_with_the_observations_it_was_trained_with(capsys, tmp_path: Path) -> None:
    saved(tmp_path / "a.zip", "original")
    scenario = variant("teams_3").replace(safe_zone_damage=50, cameras_mode="revealed")
    env = make_vec(scenario, 3, seed=2)
    expected = rollout(env, load_policy(tmp_path / "a.zip", 2), 150)
    arguments = ("rollout", "teams_3", "--policy", str(tmp_path / "a.zip"), "--worlds", "3", "--steps", "150")
    assert cli.main((*arguments, "--seed", "2", "--set", "safe_zone_damage=50", "--quiet")) == 0
    assert str(expected) in capsys.readouterr().out
    film = ("--out", str(tmp_path / "film"), "--steps", "3", "--size", "64", "--quiet")
    assert cli.main(("frames", "teams_3", "--policy", str(tmp_path / "a.zip"), *film)) == 0
    assert len(list((tmp_path / "film").iterdir())) == 4


def test_saved_policies_play_against_others(capsys, tmp_path: Path) -> None:
    """With observations that all of them can play with, and each with numbers of its own."""
    saved(tmp_path / "a.zip", "original")
    saved(tmp_path / "b.zip", "paper")
    small = ("--worlds", "8", *QUICK, "--quiet")
    for policy, others in (("b.zip", "a.zip:2,scripted"), ("a.zip", "a.zip"), ("a.zip", "b.zip,random")):
        arguments = ("--policy", str(tmp_path / policy), "--others", f"{tmp_path}/{others}", *small)
        outputs = []
        for _ in range(2):
            assert cli.main(("rollout", "teams_3", *arguments)) == 0
            outputs.append(capsys.readouterr().out.split("\n", 2)[2])
        assert outputs[0] == outputs[1]
        assert f"\n{tmp_path}/{others.split(',')[0].split(':')[0]} " in outputs[0]
    names = [str(tmp_path / "b.zip"), "noop", str(tmp_path / "a.zip")]
    scenario, (one, name, other) = load_policies(names, variant("teams_3"), 3)
    assert scenario.numbers()["cameras_mode"] == "revealed"
    assert name == "noop"
    assert one.generator.initial_seed() == 3 != other.generator.initial_seed()


def test_saved_policies_that_cannot_play_are_refused_in_one_line(capsys, tmp_path: Path) -> None:
    saved(tmp_path / "a.zip")
    policy, record = ("--policy", str(tmp_path / "a.zip")), ("--record", str(tmp_path / "a.rec"))
    for arguments, words in (
        (("rollout", "ffa_1", *policy, *record, "--quiet"), "trained on teams_3 and does not fit here"),
        (("rollout", "teams_3", *policy, "--ray"), "leave out --ray"),
        (("frames", "teams_3", "--policy", "nowhere.zip", "--out", str(tmp_path / "b")), "there is no checkpoint"),
        (("play", "ffa_1", "--others", str(tmp_path / "a.zip"), "--no-browser"), "trained on teams_3 and does not"),
    ):
        assert cli.main(arguments) == 2
        err = capsys.readouterr().err.strip()
        assert words in err
        assert len(err.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["a.zip"]
    with pytest.raises(SystemExit):
        cli.main(("rollout", "ffa_1", "--policy", "best"))
    needed = "or a saved policy (a model's name, FILE.zip, FILE.safetensors or the folder of a run) is needed"
    assert f"best: {', '.join(POLICIES)} {needed}" in capsys.readouterr().err


def run_folder(place: Path, *steps: int) -> Path:
    """The folder of a run with checkpoints after so many agent-steps."""
    place.mkdir(parents=True)
    for count in steps:
        saved(place / f"steps_{count:010d}.zip", "paper")
    return place


def test_folders_of_runs_stand_for_their_newest_checkpoints(capsys, tmp_path: Path) -> None:
    run_folder(tmp_path / "runs/a", 100, 2000)
    run_folder(tmp_path / "runs/b.5", 300)
    small = ("--episodes", 2, "--worlds", 2, *QUICK, "--quiet")
    assert evaluate("teams_3", tmp_path / "runs", "noop", *small) == 0
    printed = capsys.readouterr().out
    assert f"a: {tmp_path}/runs/a/steps_0000002000.zip\nb.5: {tmp_path}/runs/b.5/steps_0000000300.zip" in printed
    assert evaluate("teams_3", tmp_path / "runs/a", *small) == 0
    (tmp_path / "runs/empty").mkdir()
    with pytest.raises(UsageError, match=r"there is no checkpoint in .*empty yet"):
        evaluate("teams_3", tmp_path / "runs/empty", *small)


def test_the_folder_of_a_run_is_its_newest_policy_everywhere(capsys, tmp_path: Path, monkeypatch) -> None:
    folder = run_folder(tmp_path / "a", 100, 2000)
    newest = str(folder / "steps_0000002000.zip")
    seen = []
    for policy in (newest, folder):
        words = ("--policy", policy, "--others", f"{policy}:0.5,noop", "--worlds", 2, "--quiet", "--json", "-", *QUICK)
        assert cli.main(tuple(map(str, ("rollout", "teams_3", *words)))) == 0
        seen.append({key: value for key, value in json.loads(capsys.readouterr().out).items() if "seconds" not in key})
    assert seen[0] == seen[1]
    assert parse_lineup(f"{folder}:0.5,noop") == {newest: 0.5, "noop": 1.0}
    assert entries_of({folder: 1}) == [(newest, 1.0)]
    weights = [load_policy(path).policies[0].state_dict() for path in (folder, newest)]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[1])
    assert TrainingConfig(variant("teams_3"), warm_start=f"{folder}:3e6").warm_start == f"{newest}:3e6"
    assert TrainingConfig(variant("teams_3"), preset="paper", warm_start=str(folder)).warm_start == newest
    run_folder(tmp_path / "b", 100)
    for act in (load_policy, parse_lineup):
        with pytest.raises(UsageError, match=rf"{tmp_path} holds 2 runs: name one of them, such as .*/a$"):
            act(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "noop").mkdir()  # names come first
    assert parse_lineup("noop,a") == {"noop": 1.0, "a/steps_0000002000.zip": 1.0}


def test_evaluations_in_one_call(tmp_path: Path) -> None:
    """outlast.evaluate: names, folders, functions; the same numbers as the command's."""
    numbers = {"safe_zone_damage": 50, "safe_zone_stand": 10, "safe_zone_shrink": 5}

    def idle(seen: dict[str, np.ndarray]) -> np.ndarray:
        return np.broadcast_to(np.array([1, 1, 1, 0, 0, 0]), (*seen["own"].shape[:2], 6))

    small = {"episodes": 8, "worlds": 4, "quiet": True}
    found = outlast.evaluate("teams_3", {"mine": idle, "theirs": "noop"}, **small, **numbers, out=tmp_path)
    other = outlast.evaluate(variant("teams_3"), ["noop", idle], **small, **numbers)
    assert found.estimates("mine", "theirs")["wins"][0] + found.estimates("theirs", "mine")["wins"][0] == 1
    assert [contender.label for contender in other.chosen] == ["noop", "idle"]
    np.testing.assert_equal(found.estimates("mine", "theirs")["length"], other.estimates("noop", "idle")["length"])
    assert re.search(r"\nmine +theirs +\d", str(found))
    assert (tmp_path / "figures.csv").exists()
    with pytest.raises(TrainingError, match="nobody against mine is not complete; the policies are mine, theirs"):
        found.estimates("nobody", "mine")


def test_tables_of_another_evaluation_are_not_replaced(tmp_path: Path, capsys) -> None:
    """Of another game, or of other policies; the same one again, with more episodes, takes their place."""
    numbers = {"safe_zone_damage": 50, "safe_zone_stand": 10, "safe_zone_shrink": 5}
    small = {"worlds": 4, "quiet": True, "out": tmp_path}
    outlast.evaluate("ffa_2", ["noop", "random"], episodes=4, **small, **numbers)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(TrainingError, match=r"holds another evaluation, of ffa_2 with noop, random: choose another"):
        outlast.evaluate("ffa_2", ["noop", "scripted"], episodes=4, **small, **numbers)
    with pytest.raises(TrainingError, match="holds another evaluation"):
        outlast.evaluate("ffa_2", ["noop", "random"], episodes=4, **small, **numbers, melee_damage=20)
    words = ["--episodes", "4", "--worlds", "4", "--quiet", "--out", str(tmp_path)]
    assert cli.main(["evaluate", "ffa_3", "noop", "random", *words]) == 2
    assert "holds another evaluation, of ffa_2 with noop, random" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    outlast.evaluate("ffa_2", ["noop", "random"], episodes=8, **small, **numbers)
    assert json.loads((tmp_path / "evaluation.json").read_text())["episodes"] == 8
    (tmp_path / "evaluation.json").write_text("[]")
    with pytest.raises(TrainingError, match=r"evaluation\.json is no evaluation, and would be replaced: choose"):
        outlast.evaluate("ffa_2", ["noop", "random"], episodes=4, **small, **numbers)


@pytest.mark.parametrize(
    ("policies", "options", "words"),
    [
        (["noop"], {"episode": 3}, "did you mean episodes"),
        (["noop"], {"film": True}, "films need a folder"),
        ([lambda seen: np.zeros(3)], {}, r"the actions that lambda returned have shape \(3,\)"),
        ([3], {}, "3 is no policy"),
        ({"a": "."}, {}, "there is no checkpoint in . yet"),
    ],
)
def test_mistakes_of_evaluations_in_one_call(policies, options: dict, words: str, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises((*cli.MISTAKES, ActionError), match=words):
        outlast.evaluate("ffa_1", policies, quiet=True, **options)


def test_every_column_is_explained() -> None:
    """F24: in help, and in the documentation from the same table."""
    small = {"episodes": 2, "worlds": 2, "quiet": True, "safe_zone_damage": 50, "safe_zone_stand": 5}
    found = outlast.evaluate("teams_4", ["random"], **small)
    columns = {re.sub("^deaths_.*", "deaths_TYPE", name) for name in found.estimates("random", "random")}
    assert columns == COLUMNS.keys()
    assert all(any(line.startswith(f"  {name} ") for line in explained()) for name in COLUMNS)
