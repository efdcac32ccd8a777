"""outlast plot: curves are read exactly or refused; runs in groups, with intervals; runs beside the paper's."""

import io
import json
import logging
import math
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import outlast
from outlast import variant
from outlast.envs.cli.main import main
from outlast.envs.rollout.saved import newest
from outlast.envs.scenarios.fingerprint import fingerprint
from tests.conftest import call
from tests.helpers.outputs import rows_of

pytest.importorskip("matplotlib", reason="needs matplotlib: outlast[plot]")

import matplotlib
from PIL import Image

from outlast.training.base import curves, policy_file
from outlast.training.base.errors import TrainingError
from outlast.training.base.files import packed
from outlast.training.base.presets import preset
from outlast.training.plots import figure
from outlast.training.plots.comparison import chosen, drawn, hours
from outlast.training.plots.figure import STYLE
from outlast.training.plots.plot import FORMS, compare, plot
from outlast.training.plots.runs import RunGroup, kept_runs, load
from outlast.training.plots.runs import group_runs as groups_of
from outlast.training.research import compare as command
from outlast.training.research import figures
from outlast.training.research.claims import FFA, TEAMS, claims_table, findings, over
from outlast.training.research.compare import csv_table, markdown, report
from outlast.training.research.results import PaperGroup, group_runs, load_runs, published_curves

# Mean and deviation of the last tenth, height and place (million steps) of the peak: computed apart from this code.
PUBLISHED = [
    ("ffa_1", "rollout/reward0", [938.516, 118.621, 998.497], 9.96),
    ("ffa_2", "rollout/steps", [1049.219, 74.331, 1106.069], 9.99),
    ("ffa_2", "rollout/kills0", [0.002, 0.011, 0.038], 3.80),
    ("ffa_4", "rollout/heals_used", [1.163, 0.263, 1.435], 4.82),
    ("teams_3", "rollout/kills1", [0.034, 0.021, 0.088], 1.90),
]
LINES = "tag,step,value\nrollout/reward0,10,1.5\nrollout/steps,10,2.5\nrollout/reward0,20,3\nrollout/steps,20,4\n"


@pytest.mark.parametrize(("name", "tag", "expected", "place"), PUBLISHED)
def test_curves_are_those_published(name: str, tag: str, expected: list[float], place: float) -> None:
    theirs = published_curves(name)
    found = curves.end_value(theirs.values[tag])
    steps, height = curves.average([theirs], tag).peak
    assert [found.mean, found.deviation, height] == pytest.approx(expected, abs=6e-4)
    assert steps / 1e6 == pytest.approx(place, abs=6e-3)
    agents = 4 if name.startswith("teams") else 2
    assert theirs.steps.tolist() == [16384 * agents * k for k in range(1, 612 // agents + 1)]
    assert bool(theirs.tags(curves.BOXES)) == ("boxes" in variant(name))


def log(folder: Path, text: str) -> Path:
    path = folder / "log.csv"
    path.write_text(text)
    return path


def test_a_log_is_read_and_a_row_that_is_being_written_is_not(tmp_path: Path) -> None:
    path = log(tmp_path, LINES + "rollout/heals_used,20,0.25\nrollout/reward0,30,9\ntrain/loss,30,nan\nrollout/steps,3")
    read, gap = curves.curves_of_log(path, curves.is_known), np.nan
    assert read.steps.tolist() == [10, 20, 30]
    expected = {"rollout/reward0": [1.5, 3, 9], "rollout/steps": [2.5, 4, gap], "rollout/heals_used": [gap, 0.25, gap]}
    np.testing.assert_equal(
        {tag: values.tolist() for tag, values in read.values.items()}, expected | {"train/loss": [gap] * 3}
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x", "is not the log of a run: its first line is not tag,step,value"),
        ("", "has no rollout/steps: no episode has ended in it yet"),
        ("tag,step,value\nrollout/steps,1,2\n", "has no rollout/reward0"),
        (LINES + "rollout/steps,30\n", "line 6: 'rollout/steps,30' is not a tag, a step, a value"),
        (LINES + "rollout/steps,15,1\n", "line 6: rollout/steps at step 15 comes after that at step 20"),
        (LINES + "rollout/steps,30,nan\n", "is broken: rollout/steps at step 30 is not a finite number"),
    ],
)
def test_what_is_no_log_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = log(tmp_path, text)
    with pytest.raises(TrainingError, match=f"{path}.*{message}"):
        curves.curves_of_log(path, curves.is_known)


def test_kept_curves_are_the_same(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    values = (rng.normal(size=50) * 10.0 ** rng.integers(-12, 12, 50)).astype(np.float32)
    values[[0, 7]] = np.nan
    kept = curves.Curves(np.arange(1, 51) * 7, {"rollout/steps": values, "rollout/kills0": np.zeros(50, np.float32)})
    for k in (0.1, 0.2):  # it is read anew
        other = curves.Curves(np.array([3]), {"rollout/boxes_placed": np.array([k], np.float32)})
        runs = {"a": ({"variant": "ffa_1", "n": [1]}, kept), "b=0.5": ({}, other)}
        (tmp_path / curves.FILE).write_bytes(curves.format_curves(runs))
        found = curves.read_curves(tmp_path / curves.FILE)
        np.testing.assert_equal(
            *({name: (about, vars(curves)) for name, (about, curves) in each.items()} for each in (found, runs))
        )
    values = np.array([1234.5, -0.00098765, np.nan, 0.5], np.float32)
    found = curves.rounded(curves.Curves(np.arange(4), {"a": values}), 3).values["a"]
    np.testing.assert_array_equal(found, np.array([1230, -0.000988, np.nan, 0.5], np.float32))


ABOUT = '# {"r": {}}\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LINES, "its first line does not describe the curves"),
        ("# no json\nrun,step,a\nr,1,2\n", "Expecting value"),
        (ABOUT + "run,step,a\nr,1,2\nr,2\n", "line 4 has 2 cells, but the heading 3: was it cut off"),
        (ABOUT + "run,steps,a\nr,1,2\n", "its columns are not run, step and tags"),
        (ABOUT + "run,step,a\nr,1,2\ns,1,2\n", "line 4 belongs to 's', which its first line does not describe"),
        ('# {"r": {}, "s": {}}\nrun,step,a\nr,1,2\n', "it has a run without rows"),
        ('# {"../r": {}}\nrun,step,a\n../r,1,2\n', "'../r' is not a valid name of a run"),
        (ABOUT + "run,step,a\nr,2,2\nr,1,2\n", "its steps do not ascend"),
        (ABOUT + "run,step,a\nr,1,inf\n", "inf is not a finite number"),
        (ABOUT + "run,step,a\nr,1,2\n", "r does not hold the curves of a run: 'variant'"),
        ('# {"r": {"variant": "ffa_9", "plan": {}, "changed": {}}}\nrun,step,a\nr,1,2\n', "there is no variant"),
        ("# 7\nrun,step,a\nr,1,2\n", "does not hold the curves of runs"),
        (b"# {}", "does not hold the curves of runs"),
        (packed(LINES)[:10] + b"\xff" * 99, "does not hold the curves of runs"),
    ],
)
def test_what_is_not_kept_curves_is_refused(tmp_path: Path, text: Any, message: str) -> None:
    (tmp_path / curves.FILE).write_bytes(packed(text) if isinstance(text, str) else text)
    with pytest.raises(TrainingError, match=message):
        load_runs([tmp_path])


def run(place: Path, name: Any = "ffa_2", height: float = 1, points: int = 20, numbers=None, **plan: Any) -> Path:
    place.mkdir(parents=True)
    given = {"preset": "fast", "seed": 0, "worlds": 256, "rollout": 32768, "settings": {}}
    given |= {"steps": 1000 * points} | plan
    game = (variant(name) if isinstance(name, str) else name).replace(**numbers or {})
    header = {"plan": given, "scenario": fingerprint(preset(given["preset"]).scenario(game))}
    (place / "run.json").write_text(json.dumps(header))
    rows = ["tag,step,value\n"]
    for k in range(1, points + 1):
        values = {"steps": height * k, "reward0": height * k, "reward1": 3 * height * k, "kills0": 1, "kills1": 2}
        values = {f"rollout/{tag}": value for tag, value in values.items()}
        values |= {"time/fps": 500, "wins/scripted": k / points, "train/loss": "nan"}
        rows += [f"{tag},{1000 * k},{value}\n" for tag, value in values.items()]
    log(place, "".join(rows))
    return place


def folder(place: Path, **plan: Any) -> Path:
    """A run like those of the paper."""
    return run(place, **({"preset": "original", "worlds": 64, "rollout": 16384, "dead": "keep"} | plan))


def test_runs_are_what_they_say_and_seeds_are_sorted(tmp_path: Path) -> None:
    settings = {"gamma": 0.9, "vf_coef": 0.5}
    (run,) = load_runs(
        [folder(tmp_path / "x", numbers={"safe_zone_damage": 2}, preset="paper", seed=4, settings=settings)]
    )
    assert (run.scenario, run.seed, run.steps, run.name) == ("ffa_2", 4, 20_000, "ffa_2-paper-4")
    assert run.unlike == {"worlds": 64, "gamma": 0.9, "safe_zone_damage": 2}
    assert load_runs([folder(tmp_path / "y", worlds=1)])[0].unlike == {}
    for seed in (10, 2):
        folder(tmp_path / f"all/run{seed}", seed=seed, threads=seed)
    folder(tmp_path / "all/other", preset="paper")
    groups = {group.name: [run.seed for run in group.runs] for group in group_runs(load_runs([tmp_path / "all"]))}
    assert groups == {"ffa_2-original": [2, 10], "ffa_2-paper": [0]}


def refused(places: Sequence[Path], message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        group_runs(load_runs(places))


def test_what_is_no_group_of_runs_is_refused(tmp_path: Path) -> None:
    one = folder(tmp_path / "one")
    strong = {"numbers": {"safe_zone_damage": 2}, "seed": 1}
    for name, other, message in (
        ("a", {"seed": 1, "dead": "drop"}, "differ in dead; `outlast plot` compares them"),
        ("b", {"seed": 1, "settings": {"gamma": 0.9}}, "of ffa_2, original differ in gamma;"),
        ("c", strong, "differ in safe_zone_damage;"),
        ("d", {}, "are the same run, or both of seed 0: give one"),
    ):
        refused([one, folder(tmp_path / name, **other)], message)
    assert len(load_runs([one, tmp_path / "one"])) == 1  # a place that is named twice
    refused([tmp_path / "none"], "folder .*none does not exist")
    empty = tmp_path / "empty"
    empty.mkdir()
    refused([empty], "does not hold runs")
    log(empty, LINES)
    refused([empty], r"has no run.json, which describes the run")
    for content in (b"no JSON", b"\xff", b"[" * 99999, b"[]", b'{"plan": {}}'):
        (empty / "run.json").write_bytes(content)
        refused([empty], r"run.json does not describe a run")


outlast_plot = partial(call, command)
PLAN = {"preset": "original", "worlds": 64, "rollout": 16384, "dead": "keep", "settings": {}}


def keep(
    folder: Path, name: str, seed: int = 0, factor: float = 1.0, points: int = 1000, *, variant: str = "", **plan: Any
) -> Path:
    """The paper's own curves, times a factor, kept in a folder as a run of ours; `variant`: of another game."""
    theirs, name = published_curves(name), variant or name
    values = {tag: (factor * value[:points]).astype(np.float32) for tag, value in theirs.values.items()}
    about: dict[str, Any] = {"variant": name, "plan": {**PLAN, "seed": seed, **plan}, "changed": {}}
    run = f"{name}-{about['plan']['preset']}-{seed}"
    folder.mkdir(exist_ok=True)
    others = kept_runs(folder)
    (folder / curves.FILE).write_bytes(
        curves.format_curves(others | {run: (about, curves.Curves(theirs.steps[:points], values))})
    )
    return folder / run


def group(*paths: Path) -> PaperGroup:
    (found,) = group_runs(load_runs(paths))
    return found


def paper_figure(of: PaperGroup) -> Any:
    with matplotlib.rc_context(STYLE):
        return figures.draw(of)


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_figure_shows_the_averages_and_the_papers_points(tmp_path: Path) -> None:
    shown = group(keep(tmp_path, "ffa_3", 0, 0.8), keep(tmp_path, "ffa_3", 1, 1.2), keep(tmp_path, "ffa_3", 2, 0.7))
    panels = paper_figure(shown).axes
    titles = [axes.get_title("left").split(",")[0] for axes in panels]
    assert titles == ["return", "heals used", "kills", "boxes placed"]
    theirs = shown.paper.values["rollout/boxes_placed"]
    lines = {(line.get_linewidth(), line.get_color()): line.get_xydata().T for line in panels[3].lines}
    assert all((steps == shown.paper.steps / 1e6).all() for steps, _ in lines.values())
    ((points, _),) = ((values, width) for (width, _), (_, values) in lines.items() if width == 0.5)
    np.testing.assert_array_equal(points, theirs)
    np.testing.assert_allclose(lines[1.7, figures.THEIRS][1], curves.smooth(theirs), rtol=1e-6)
    np.testing.assert_allclose(lines[1.7, figures.OURS][1], 0.9 * curves.smooth(theirs), rtol=1e-5)
    assert len(panels[2].lines) == 2 + 2 + 2  # averages of both agents, ours and theirs, and the paper's points
    (band,) = panels[3].collections
    reach = curves.average([run.curves for run in shown.runs], "rollout/boxes_placed")
    assert band.get_paths()[0].get_extents().ymax == pytest.approx(reach.high.max())


def test_a_figure_says_what_is_unlike_the_paper(tmp_path: Path) -> None:
    shown = group(keep(tmp_path, "ffa_2", 3, points=60, dead="drop"), keep(tmp_path, "ffa_2", 5, dead="drop"))
    notes = "\n".join(text.get_text() for text in paper_figure(shown).texts)
    assert "Unfinished: seed 3 (2.0 million agent-steps); not counted in end values" in notes
    assert "Unlike the paper: worlds = 64, dead = drop" in notes
    assert "averages over 5 % of the points (of ours 15)" in notes


def test_pictures_are_the_same_each_time_and_name_what_they_show(tmp_path: Path) -> None:
    shown = group(keep(tmp_path, "ffa_1"))
    png, svg = first = [figures.picture(shown, form) for form in FORMS]
    assert [figures.picture(shown, form) for form in FORMS] == first
    image: Any = Image.open(io.BytesIO(png))
    assert image.text == {"Title": "ffa_1-original", "Source": figures.digest(shown)}
    assert image.size == (1140, 905)
    assert figures.digest(shown).encode() in svg
    assert ElementTree.fromstring(svg).tag.endswith("svg")
    assert figures.digest(group(keep(tmp_path, "ffa_1", factor=1.01))) != figures.digest(shown)


def test_the_table_has_the_ends_of_both(tmp_path: Path) -> None:
    """The text is compared with kept results in test_site.py."""
    keep(tmp_path, "teams_2", 0, 1.1), keep(tmp_path, "teams_2", 1, 1.3), keep(tmp_path, "ffa_4", 0, 0.9)
    assert outlast_plot(tmp_path, "--out", tmp_path / "out") == 0
    assert files(tmp_path / "out") == ["ends.csv", "ends.md", "ffa_4-original.png", "teams_2-original.png"]
    rows = {(row["variant"], row["quantity"], row["agent or team"]): row for row in rows_of(tmp_path / "out/ends.csv")}
    length = rows["teams_2", "episode length", ""]
    numbers = [float(length[key]) for key in ("paper", "outlast", "lowest seed", "highest seed", "apart")]
    assert numbers == pytest.approx([403.870, 484.644, 444.257, 525.031, 0.2], rel=1e-5)
    assert (length["within 15%"], length["seeds"], length["agent-steps"]) == ("no", "0 1", "10027008")
    assert [rows["ffa_4", each, "1"]["within 15%"] for each in ("return", "kills")] == ["yes", ""]


def test_it_is_too_early_for_unfinished_runs(tmp_path: Path) -> None:
    shown = group(keep(tmp_path, "ffa_2", points=305))  # the rollout that ends after 10 million is missing
    text = report([shown])
    assert "seed 0. Unfinished: seed 0 (10.0 million agent-steps)." in text
    assert "| 1,049 ± 74 | 1,047 ± 74 | −0% | too early |" in text
    assert not list(findings([shown]))
    assert list(findings([group(keep(tmp_path, "ffa_2", points=306))]))
    shown = group(keep(tmp_path, "ffa_2", points=14))
    last = shown.runs[0].curves.values["rollout/steps"][-1]  # the last tenth, which has no deviation
    assert re.search(rf"\n\| episode length \| 1,049 ± 74 \| {last:.0f} \| ", markdown(shown))
    assert f",74.3312,{last:.6g},,{last:.6g}," in csv_table([shown])


def test_claims_hold_for_the_paper_and_say_nothing_of_other_games(tmp_path: Path) -> None:
    """Ours are the paper's own curves here, of one seed as they are and of another with fewer points."""
    paths = [keep(tmp_path / name, name, seed, points=306) for name in (*FFA, *TEAMS) for seed in (0, 1)]
    found = list(findings(group_runs(load_runs(paths))))
    assert len(found) == sum(not np.isnan(each.paper) for each in found) > 35
    assert all(each.ours == (each.paper, each.paper) and each.holds for each in found)
    numbers = "kills at the end | ≤ 0.050 | 0.006 | 0.006 | 0.006 to 0.006 | yes, 2 of 2 seeds |"
    assert f"| Kills almost vanish. | ffa_2 | {numbers}" in claims_table(found)
    assert not list(findings([group(keep(tmp_path, "ffa_2", variant="ffa_2+bounty"))]))
    assert (over(1.0, 0.0), math.isnan(over(0.0, 0.0)), over(1.0, 4.0)) == (math.inf, True, 0.25)


def test_what_is_refused_leaves_nothing(tmp_path: Path) -> None:
    mine, before = keep(tmp_path / "one", "ffa_2"), keep(tmp_path / "kept", "ffa_2", dead="drop")
    content, out = (tmp_path / "kept" / curves.FILE).read_bytes(), ("--out", tmp_path / "out")
    for words, message in (
        ((mine, *out, "--keep", tmp_path / "kept"), "kept keeps a ffa_2-original-0 with another dead: choose"),
        ((mine, before, *out), "differ in dead"),
        ((mine, "--out", tmp_path / "one" / curves.FILE), "cannot be a folder: .* is a file"),
    ):
        with pytest.raises(TrainingError, match=message):
            outlast_plot(*words)
    assert files(tmp_path) == ["kept", "one"]
    assert (tmp_path / "kept" / curves.FILE).read_bytes() == content


def test_runs_that_are_kept_already_stay(tmp_path: Path) -> None:
    for seed in (8, 7):
        mine = keep(tmp_path / str(seed), "ffa_2", seed)
        outlast_plot(mine, "--out", tmp_path / "out", "--keep", tmp_path / "kept")
    assert [run.seed for run in load_runs([tmp_path / "kept"])] == [7, 8]
    assert [run.seed for run in load_runs([tmp_path / "kept/ffa_2-original-8"])] == [8]
    known = "has no run ffa_2-original-9; known: ffa_2-original-7, ffa_2-original-8"
    refused([tmp_path / "kept/ffa_2-original-9"], known)
    refused([tmp_path / "kept" / curves.FILE], "is a file: give the folder of a run, or one with runs in it")
    refused([tmp_path / "none/ffa_2-original-8"], "folder .*none/ffa_2-original-8 does not exist")


def test_runs_of_outlast_train_are_understood(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="needs torch: outlast[train]")
    from outlast.training.runs.run import TrainingRun
    from tests.helpers.runs import config

    settings = {"batch_size": 64, "n_epochs": 1}
    for seed in (1, 2):
        TrainingRun(config(2000, seed=seed, settings=settings), tmp_path / "runs" / str(seed)).train()
    assert outlast_plot(tmp_path / "runs", "--out", tmp_path / "out", "--keep", tmp_path / "kept") == 0
    assert files(tmp_path / "kept") == [curves.FILE, "ffa_1-original-1.safetensors", "ffa_1-original-2.safetensors"]
    unlike = "worlds = 8, rollout = 192, batch_size = 64, n_epochs = 1, agents_health = 10, "
    assert f"Unlike the paper: {unlike}" in (tmp_path / "out/ends.md").read_text()
    shown = group(tmp_path / "kept")
    assert figures.digest(group(tmp_path / "runs")) == figures.digest(shown)
    assert [run.steps for run in shown.runs] == [2304, 2304]
    assert outlast_plot(tmp_path / "kept", "--out", tmp_path / "out", "--keep", tmp_path / "again") == 0
    policy, whole = tmp_path / "again/ffa_1-original-1.safetensors", newest(tmp_path / "runs/1")
    assert policy.stat().st_size < whole.stat().st_size / 3
    np.testing.assert_equal(policy_file.read(policy), policy_file.read(whole))


KEPT = Path(__file__).resolve().parents[2] / "results/worlds-64"


def labels(*places: Path, by: tuple[str, ...] = ()) -> list[str]:
    return [group.label for group in groups_of(load(places), by)]


def groups(*places: Path) -> list[RunGroup]:
    return groups_of(load(places))


def test_games_that_differ_by_more_than_numbers_are_not_one_group(tmp_path: Path) -> None:
    """By what is drawn, roles, what is observed, or the order of systems: never averaged."""
    duel, strong = variant("ffa_2"), {"hunter": outlast.role(1, melee_damage=50), "prey": outlast.role()}
    few, many = (duel.vary(melee_damage=outlast.distributions.integers(5, most)) for most in (8, 80))
    weak = strong | {"hunter": outlast.role(1, melee_damage=5)}
    games = {"low": few, "high": many, "seen": few.observe_numbers("melee_damage")}
    games |= {"roles": duel.roles(**strong), "weak": duel.roles(**weak)}
    games |= {"order": duel.ordered("melee.strike", "safe_zone.burn")}
    for name, game in games.items():
        run(tmp_path / name, game)  # of one seed, which two runs of a group cannot have
        run(tmp_path / f"{name}1", game, seed=1)
        refused(
            [tmp_path / name], f"{name} is not a run of the paper's games: its game has .*; `outlast plot` compares it"
        )
    found = {group.label: [each.origin.name for each in group.runs] for group in groups(tmp_path)}
    assert sorted(found.values()) == [[name, f"{name}1"] for name in sorted(games)]
    two = ["melee_damage=integers(5, 8)", "melee_damage=integers(5, 80)"]
    assert labels(tmp_path / "low", tmp_path / "high1") == two
    assert labels(tmp_path / "roles", tmp_path / "weak") == ["hunter melee_damage=5", "hunter melee_damage=50"]


def test_settings_that_differ_name_the_groups(tmp_path: Path) -> None:
    for seed in (0, 1):
        run(tmp_path / f"a{seed}", numbers={"melee_damage": 5}, seed=seed)
        run(tmp_path / f"b{seed}", numbers={"melee_damage": 20}, seed=seed)
    assert labels(tmp_path) == ["melee_damage=5", "melee_damage=20"]  # by size
    assert [len(group.runs) for group in groups(tmp_path)] == [2, 2]
    assert labels(tmp_path, by=("seed",)) == ["seed=0", "seed=1"]
    assert groups_of(load([tmp_path]), ("seed",))[0].mixed == ("melee_damage",)
    run(tmp_path / "c", numbers={"melee_damage": 20}, seed=0, opponents="self:0.5,past:0.5")
    assert labels(tmp_path)[-1] == "melee_damage=20, opponents=self:1"
    assert labels(tmp_path, by=("opponents",)) == ["opponents=self:0.5,past:0.5", "opponents=self:1"]
    near = [run(tmp_path / str(g), seed=k, settings={"gamma": g}) for k, g in enumerate((0.9999992, 0.9999988))]
    assert labels(*near) == ["gamma=0.9999988", "gamma=0.9999992"]


def test_the_title_has_what_was_changed(tmp_path: Path) -> None:
    for seed in (0, 1):
        run(tmp_path / str(seed), numbers={"melee_damage": 50}, seed=seed, levels="mk.<locals>.choose")
    found = compare([tmp_path])
    assert found.title == "ffa_2-melee_damage=50, preset fast, 2 runs"
    assert found.notes()[0].endswith(
        "in the function that chooses levels: mk.<locals>.choose"
    )  # known by its name only
    run(tmp_path / "b", numbers={"melee_damage": 20})
    assert compare([tmp_path]).title == "ffa_2, preset fast, 3 runs"


def test_games_are_named_first_where_they_and_presets_differ(tmp_path: Path) -> None:
    """ffa_1 and ffa_2 differ in few numbers; a preset that tells the runs apart does not stand for the game."""
    run(tmp_path / "a", "ffa_1", preset="original")
    run(tmp_path / "b", "ffa_2", preset="paper")
    assert labels(tmp_path) == ["ffa_1, original", "ffa_2, paper"]
    assert "| ffa_1 | original |" in str(compare([tmp_path]))
    assert compare([tmp_path]).csv().splitlines()[1].startswith("ffa_1,original,")
    run(tmp_path / "t", "teams_3"), run(tmp_path / "b2", "ffa_2")
    assert labels(tmp_path / "t", tmp_path / "b", tmp_path / "b2") == ["ffa_2, fast", "ffa_2, paper", "teams_3, fast"]
    run(tmp_path / "c/d"), run(tmp_path / "c/e", numbers={"melee_damage": 20}, preset="original")
    assert labels(tmp_path / "c") == ["melee_damage=5, fast", "melee_damage=20, original"]


def test_what_has_several_sides_is_their_mean_and_kills_their_sum(tmp_path: Path) -> None:
    runs = load([run(tmp_path / "a", height=2.0)])
    panels = chosen(runs, ())
    titles = ["return, mean over sides", "length", "kills, sum over sides", "wins/scripted"]
    assert [panel.title for panel in panels] == titles
    curves = drawn(runs[0], panels)
    np.testing.assert_allclose(curves.values["return"], 4.0 * np.arange(1, 21))
    np.testing.assert_allclose(curves.values["kills"], 3.0)
    assert [panel.name for panel in chosen(runs, ("rollout/kills1", "length"))] == ["rollout/kills1", "length"]
    np.testing.assert_allclose(hours(runs[0]), np.arange(1, 21) * 1000 / 500 / 3600)
    values = runs[0].curves.values
    values["time/imitation"] = np.array([36.0, *[np.nan] * 19])
    np.testing.assert_allclose(hours(runs[0]), 0.01 + np.arange(1, 21) * 1000 / 500 / 3600)
    (first, *_) = [tag for tag in panels[0].tags if tag in values]
    values[first][3] = np.nan  # no episode with that side
    assert drawn(runs[0], panels).values["return"][3] == np.mean([values[tag][3] for tag in panels[0].tags[1:]])
    with pytest.raises(TrainingError, match=r"no curve 'lenght'; did you mean length\?"):
        chosen(runs, ("lenght",))


def test_means_are_between_the_points_of_runs_and_intervals_are_students() -> None:
    values = np.random.default_rng(2).normal(size=130).astype(np.float32)
    values[[3, 4, 60]] = np.nan
    expected = [np.nanmean(values[max(0, k - 3) : k + 4], dtype=np.float64) for k in range(130)]  # 5 % of 130: 6, or 7
    np.testing.assert_allclose(curves.smooth(values), expected, rtol=1e-12, atol=1e-12)
    one = curves.Curves(np.array([0, 10, 20]), {"a": np.array([0.0, 10, 20])})
    other = curves.Curves(np.array([5, 15, 25]), {"a": np.array([15.0, 25, 35])})
    found = curves.average([one, other, curves.Curves(np.array([9]), {"b": np.ones(1)})], "a")
    assert found.steps.tolist() == [0, 5, 10, 15, 20, 25]
    assert found.mean.tolist() == [0, 10, 15, 20, 25, 35]
    assert (found.high - found.low).tolist() == [0, 10, 10, 10, 10, 0]
    # quantiles of t from tables
    assert curves.interval([1.0, 3.0]) == pytest.approx((2 - 12.706, 2 + 12.706))
    low, high = curves.interval(list(map(float, range(21))))
    assert (high - low) / 2 == pytest.approx(2.0860 * np.std(range(21), ddof=1) / 21**0.5, rel=1e-3)
    assert np.isnan(curves.interval([1.0])).all()


def test_the_table_has_a_row_for_each_group_and_curve(tmp_path: Path) -> None:
    for seed, height in ((0, 1.0), (1, 3.0)):
        run(tmp_path / f"runs/a{seed}", height=height, seed=seed)
    run(tmp_path / "runs/b", numbers={"melee_damage": 20})
    found = plot(tmp_path / "runs", tmp_path / "out", curves=("length", "kills"))
    assert [path.name for path in found.files] == ["curves.png", "ends.md", "ends.csv"]
    assert all(path.exists() for path in found.files)
    rows = {(row["melee_damage"], row["curve"]): row for row in rows_of(tmp_path / "out/ends.csv")}
    length = rows["5", "length"]  # of each run, the mean of the last two of twenty points
    assert [float(length[key]) for key in ("mean", "lowest", "highest")] == [39, 19.5, 58.5]
    assert float(length["low 95 %"]) == pytest.approx(39 - 12.706 * 19.5, abs=0.01)
    assert (length["runs"], length["seeds"], rows["20", "kills"]["low 95 %"]) == ("2", "0 1", "")
    assert "| 5 | 0, 1 | 20,000 | 39.0 [" in str(found)
    assert "| 20 | 0 | 20,000 | 19.5 | 3.00 |" in str(found)


def drawn_axes(*places: Path, **options: Any) -> tuple[Any, Any]:
    with matplotlib.rc_context(STYLE):
        made = figure.draw(compare(places, **options))
    return made, [axes for axes in made.axes if axes.get_visible() and axes.lines]


def test_the_axis_fits_the_data_and_the_legend_names_the_groups(tmp_path: Path) -> None:
    run(tmp_path / "a"), run(tmp_path / "b", numbers={"melee_damage": 20}, points=10)
    made, axes = drawn_axes(tmp_path)
    assert {each.get_xlim() for each in axes} == {(0, 20)}
    assert axes[-1].get_xlabel() == "thousand agent-steps"
    (legend,) = made.legends
    assert [text.get_text() for text in legend.get_texts()] == ["melee_damage=5", "melee_damage=20"]
    assert any("Groups differ in steps, too" in text.get_text() for text in made.texts)
    made, axes = drawn_axes(tmp_path, x="time")
    assert axes[-1].get_xlabel() == "seconds of training"
    assert axes[0].get_xlim() == pytest.approx((0, 40))


def test_over_hours_a_mean_ends_where_the_first_run_does(tmp_path: Path) -> None:
    run(tmp_path / "a"), run(tmp_path / "b", seed=1, height=0.5, points=10, steps=20000)
    log = tmp_path / "b/log.csv"
    log.write_text(re.sub("time/fps,(.*),500", r"time/fps,\1,100", log.read_text()))  # 100 s for half of the steps
    made, axes = drawn_axes(tmp_path, curves=("length",), x="time")
    (line,) = axes[0].lines
    places, heights = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    assert (np.diff(places) > -1e-9).all()
    assert (np.diff(heights) > 0).all()  # as both runs rise
    assert places[[0, -1]] == pytest.approx([10, 40])  # seconds
    assert axes[0].get_xlim() == pytest.approx((0, 40))
    assert heights[-1] == pytest.approx((20 + 0.5 * 4) / 2)
    assert any("means over runs, up to the end of the shortest" in text.get_text() for text in made.texts)
    made, axes = drawn_axes(tmp_path, curves=("length",))
    assert axes[0].lines[0].get_ydata()[-1] == pytest.approx(20)  # over agent-steps, of the longer run alone
    assert any("means over the runs that are this long" in text.get_text() for text in made.texts)


def test_nothing_of_a_figure_is_cut_off_or_overlaps(tmp_path: Path) -> None:
    many = ",".join(f"{name}:0.1" for name in ("self", "past", "scripted", "camper", "hunter", "hoarder", "healer"))
    for k in range(11):
        opponents = f"self:0.{k + 1}" if k else many
        run(tmp_path / str(k), numbers={"melee_damage": k + 1, "safe_zone_damage": k + 1}, opponents=opponents)
    made, axes = drawn_axes(tmp_path, by=("melee_damage", "opponents", "preset"))
    made.draw_without_rendering()
    width, height = made.canvas.get_width_height()
    (legend,) = made.legends
    boxes = [text.get_window_extent() for text in (*made.texts, *legend.get_texts())]
    assert all(box.x0 >= 0 and box.x1 <= width and box.y0 >= 0 and box.y1 <= height for box in boxes)
    assert legend.get_window_extent().y0 >= max(each.title.get_window_extent().y1 for each in axes)
    assert len({figure.look(k) for k in range(28)}) == 28


def test_a_curve_that_only_some_runs_have_is_drawn_for_those(tmp_path: Path) -> None:
    place, _ = run(tmp_path / "a"), run(tmp_path / "b", numbers={"melee_damage": 20})
    rows = [f"rating/self,{1000 * k},{1014 + 2 * k}\n" for k in range(1, 21)]
    (place / "log.csv").write_text((place / "log.csv").read_text() + "".join(rows))
    _, axes = drawn_axes(tmp_path, curves=("length", "rating/self"))
    assert [len({line.get_color() for line in each.lines}) for each in axes] == [2, 1]
    assert "|  |" in str(compare([tmp_path], curves=("length", "rating/self")))
    (bottom, _), (low, high) = (each.get_ylim() for each in axes)
    assert bottom == 0 < 1000 < low < 1016  # ratings fill their panel
    assert 1054 < high < 1070


def test_runs_without_an_episode_are_left_out_with_a_line(tmp_path: Path, caplog) -> None:
    run(tmp_path / "a"), run(tmp_path / "b", seed=1), run(tmp_path / "c", seed=2)
    (tmp_path / "b/log.csv").write_text("tag,step,value\ntrain/loss,10,1\n")
    (tmp_path / "c/log.csv").unlink()
    with caplog.at_level(logging.WARNING, "outlast"):
        assert [each.origin.name for each in load([tmp_path])] == ["a"]
    assert len(caplog.messages) == 2
    assert f"left out: {tmp_path / 'b/log.csv'} has no rollout/steps: no episode has ended" in caplog.messages[0]
    with pytest.raises(TrainingError, match=r"nothing can be drawn: .*no episode has ended"):
        load([tmp_path / "b"])


def test_a_run_is_unfinished_by_what_it_was_last_asked_for_where_its_plan_may_go_on(tmp_path: Path) -> None:
    """As with presets original, paper and scaled; runs of before do not say what they were asked for."""
    for seed, asked in enumerate((20_000, 200_000, None)):
        place = run(tmp_path / f"seed {seed}", seed=seed, preset="original")
        header = json.loads((place / "run.json").read_text())
        del header["plan"]["steps"]
        (place / "run.json").write_text(json.dumps(header | ({} if asked is None else {"asked": asked})))
    (group,) = groups(tmp_path)
    assert [each.seed for each in group.unfinished] == [1]
    assert "Unfinished: seed 1 (20,000 agent-steps)" in str(compare([tmp_path]))


def test_the_command_says_what_it_cannot_do(tmp_path: Path, capsys) -> None:
    run(tmp_path / "a"), run(tmp_path / "same/b"), run(tmp_path / "same/c")
    for words, reason in (
        (("a", str(KEPT), "--x", "time"), "has no record of its duration"),
        (("a", "--by", "mele_damage"), "did you mean melee_damage"),
        (("a", "--curves", "nothing"), "no curve 'nothing'"),
        (("same",), "are the same run, or both of seed 0: give one"),
    ):
        assert main(["plot", str(tmp_path / words[0]), *words[1:], "--out", str(tmp_path / "out")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert reason in line
    assert not (tmp_path / "out").exists()
    assert main(["plot", str(KEPT), "--out", str(tmp_path / "out")]) == 0
    assert "| ffa_1 | 0, 1 | 10,027,008 |" in capsys.readouterr().out
