"""outlast plot: one's own runs in one figure, groups named by what differs, ends with intervals."""

import json
import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import variant
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.training.base.curves import Curves, average, interval
from outlast.training.base.errors import TrainingError
from outlast.training.plots.groups import RunGroup, group_runs
from outlast.training.plots.panels import chosen, drawn, hours
from outlast.training.plots.runs import load
from outlast.training.research import results
from tests.helpers.outputs import rows_of

matplotlib = pytest.importorskip("matplotlib", reason="needs matplotlib: outlast[plot]")

from outlast.envs.cli.main import main  # noqa: E402
from outlast.training.plots import figure  # noqa: E402
from outlast.training.plots.figure import STYLE  # noqa: E402
from outlast.training.plots.plot import compare, plot  # noqa: E402

KEPT = Path(__file__).resolve().parents[2] / "results/worlds-64"


def run(
    place: Path, name: Any = "ffa_2", height: float = 1.0, points: int = 20, numbers: Any = None, **plan: Any
) -> Path:
    """The folder of a run whose curves rise to a height."""
    place.mkdir(parents=True)
    given = {"preset": "fast", "seed": 0, "worlds": 256, "rollout": 32768, "settings": {}}
    given |= {"steps": 1000 * points} | plan
    scenario = fingerprint((variant(name) if isinstance(name, str) else name).replace(**numbers or {}))
    (place / "run.json").write_text(json.dumps({"plan": given, "scenario": scenario}))
    rows = [("tag", "step", "value")]
    for k in range(1, points + 1):
        values = {"steps": height * k, "reward0": height * k, "reward1": 3 * height * k, "kills0": 1, "kills1": 2}
        rows += [(f"rollout/{tag}", 1000 * k, value) for tag, value in values.items()]
        rows += [("time/fps", 1000 * k, 500), ("wins/scripted", 1000 * k, k / points), ("train/loss", 1000 * k, "nan")]
    (place / "log.csv").write_text("".join(f"{tag},{step},{value}\n" for tag, step, value in rows))
    return place


def labels(*places: Path, by: tuple[str, ...] = ()) -> list[str]:
    return [group.label for group in group_runs(load(places), by)]


def groups(*places: Path) -> list[RunGroup]:
    return group_runs(load(places))


def test_games_that_differ_by_more_than_numbers_are_not_one_group(tmp_path: Path) -> None:
    """By what is drawn, roles, what is observed, the order of systems, or the code of a mechanic: never averaged."""
    duel, strong = variant("ffa_2"), {"hunter": outlast.role(1, melee_damage=50), "prey": outlast.role()}
    few, many = (duel.vary(melee_damage=outlast.distributions.integers(5, most)) for most in (8, 80))
    games = {
        "low": few,
        "high": many,
        "seen": few.observe_numbers("melee_damage"),
        "roles": duel.roles(**strong),
        "weak": duel.roles(**strong | {"hunter": outlast.role(1, melee_damage=5)}),
        "order": duel.ordered("melee.strike", "safe_zone.burn"),
    }
    for name, game in games.items():
        run(tmp_path / name, game)  # of one seed, which two runs of a group cannot have
        run(tmp_path / f"{name}1", game, seed=1)
        with pytest.raises(
            TrainingError, match=f"{name} is no run of the paper's: its game has .*; `outlast plot` compares it"
        ):
            results.load_runs([tmp_path / name])
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
    assert group_runs(load([tmp_path]), ("seed",))[0].mixed == ("melee_damage",)
    run(tmp_path / "c", numbers={"melee_damage": 20}, seed=0, opponents="self:0.5,past:0.5")
    assert labels(tmp_path)[-1] == "melee_damage=20, opponents=self:1"
    assert labels(tmp_path, by=("opponents",)) == ["opponents=self:0.5,past:0.5", "opponents=self:1"]


def test_settings_that_hardly_differ_differ(tmp_path: Path) -> None:
    for seed, gamma in ((0, 0.9999992), (1, 0.9999988)):
        run(tmp_path / str(seed), seed=seed, settings={"gamma": gamma})
    assert labels(tmp_path) == ["gamma=0.9999988", "gamma=0.9999992"]


def test_the_title_has_what_was_changed(tmp_path: Path) -> None:
    run(tmp_path / "a", numbers={"melee_damage": 50})
    assert compare([tmp_path]).title == "ffa_2-melee_damage=50, preset fast, one run"
    run(tmp_path / "b", numbers={"melee_damage": 20})
    assert compare([tmp_path]).title == "ffa_2, preset fast, 2 runs"


def test_what_chooses_levels_is_known_by_its_name_only(tmp_path: Path) -> None:
    run(tmp_path / "a", levels="mk.<locals>.choose"), run(tmp_path / "b", seed=1, levels="mk.<locals>.choose")
    (note,) = compare([tmp_path]).notes()
    assert note.endswith("by the name of what chooses levels only: mk.<locals>.choose")


def test_games_are_named_first_where_they_and_presets_differ(tmp_path: Path) -> None:
    """ffa_1 and ffa_2 differ in few numbers; a preset that tells the runs apart does not stand for the game."""
    run(tmp_path / "a", "ffa_1", preset="original", numbers={"cameras_mode": "revealed"})  # as this preset has it
    run(tmp_path / "b", "ffa_2", preset="paper")
    assert labels(tmp_path) == ["ffa_1, original", "ffa_2, paper"]
    assert "| ffa_1 | original |" in str(compare([tmp_path]))
    assert compare([tmp_path]).csv().splitlines()[1].startswith("ffa_1,original,")
    run(tmp_path / "t", "teams_3"), run(tmp_path / "b2", "ffa_2")
    assert labels(tmp_path / "t", tmp_path / "b", tmp_path / "b2") == ["ffa_2, fast", "ffa_2, paper", "teams_3, fast"]
    run(tmp_path / "c/d"), run(tmp_path / "c/e", numbers={"melee_damage": 20}, preset="original")
    assert labels(tmp_path / "c") == ["melee_damage=5, fast", "melee_damage=20, original"]


def test_a_setting_that_no_run_has_is_refused_with_a_hint(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="did you mean melee_damage"):
        labels(run(tmp_path / "a"), by=("mele_damage",))
    run(tmp_path / "b")
    with pytest.raises(TrainingError, match="are the same run, or both of seed 0: give one"):
        labels(tmp_path)


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
    one = Curves(np.array([0, 10, 20]), {"a": np.array([0.0, 10, 20])})
    other = Curves(np.array([5, 15, 25]), {"a": np.array([15.0, 25, 35])})
    found = average([one, other], "a")
    assert found.steps.tolist() == [0, 5, 10, 15, 20, 25]
    assert found.mean.tolist() == [0, 10, 15, 20, 25, 35]
    assert (found.high - found.low).tolist() == [0, 10, 10, 10, 10, 0]
    # quantiles of t from tables
    assert interval([1.0, 3.0]) == pytest.approx((2 - 12.706, 2 + 12.706))
    low, high = interval(list(map(float, range(21))))
    assert (high - low) / 2 == pytest.approx(2.0860 * np.std(range(21), ddof=1) / 21**0.5, rel=1e-3)
    assert np.isnan(interval([1.0])).all()


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
    """Over hours, runs are averaged at equal hours, and no mean falls because the faster one has ended."""
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
    assert any("means over runs, to where the first of them ends" in text.get_text() for text in made.texts)
    made, axes = drawn_axes(tmp_path, curves=("length",))
    assert axes[0].lines[0].get_ydata()[-1] == pytest.approx(20)  # over agent-steps, of the longer run alone
    assert any("means over the runs that have come so far" in text.get_text() for text in made.texts)


def test_tags_are_titles_as_they_are_and_ratings_fill_their_panel(tmp_path: Path) -> None:
    place, tag = run(tmp_path / "a"), "wins/runs/ffa_2-fast-0/steps_0000262144.zip"
    rows = [f"{tag},{1000 * k},0.5\nrating/self,{1000 * k},{1014 + 2 * k}\n" for k in range(1, 21)]
    (place / "log.csv").write_text((place / "log.csv").read_text() + "".join(rows))
    _, axes = drawn_axes(tmp_path, curves=(tag, "rating/self", "length"))
    assert [each.get_title("left") for each in axes] == [tag, "rating/self", "length"]
    low, high = axes[1].get_ylim()
    assert 1000 < low < 1016
    assert 1054 < high < 1070
    assert [axes[k].get_ylim()[0] for k in (0, 2)] == [0, 0]


def test_nothing_of_a_figure_is_cut_off_or_overlaps(tmp_path: Path) -> None:
    """Texts are inside of the picture, and the legend is above the panels, with many groups of long names, too."""
    many = ",".join(f"{name}:0.1" for name in ("self", "past", "scripted", "camper", "hunter", "hoarder", "healer"))
    for k in range(11):
        opponents = f"self:0.{k + 1}" if k else many
        run(tmp_path / str(k), numbers={"melee_damage": k + 1, "safe_zone_damage": k + 1}, opponents=opponents)
    made, axes = drawn_axes(tmp_path, by=("melee_damage", "opponents", "preset"))
    made.canvas.draw()
    width, height = made.canvas.get_width_height()
    (legend,) = made.legends
    boxes = [text.get_window_extent() for text in (*made.texts, *legend.get_texts())]
    assert all(box.x0 >= 0 and box.x1 <= width and box.y0 >= 0 and box.y1 <= height for box in boxes)
    assert legend.get_window_extent().y0 >= max(each.title.get_window_extent().y1 for each in axes)
    assert len({figure.look(k) for k in range(28)}) == 28


def test_a_curve_that_only_some_runs_have_is_drawn_for_those(tmp_path: Path) -> None:
    run(tmp_path / "a"), run(tmp_path / "b", numbers={"melee_damage": 20})
    log = tmp_path / "b/log.csv"
    log.write_text("".join(line for line in log.read_text().splitlines(True) if not line.startswith("wins/")))
    _, axes = drawn_axes(tmp_path, curves=("length", "wins/scripted"))
    assert [len({line.get_color() for line in each.lines}) for each in axes] == [2, 1]
    assert "|  |" in str(compare([tmp_path], curves=("length", "wins/scripted")))


@pytest.mark.nightly
def test_the_same_runs_make_the_same_file(tmp_path: Path) -> None:
    for form in ("png", "svg"):
        files = [plot(KEPT, tmp_path / str(k), form=form).files[0].read_bytes() for k in range(2)]
        assert files[0] == files[1]


def test_runs_without_an_episode_are_left_out_with_a_line(tmp_path: Path, caplog) -> None:
    """F22: one of them made the whole command fail."""
    run(tmp_path / "a"), run(tmp_path / "b", seed=1), run(tmp_path / "c", seed=2)
    (tmp_path / "b/log.csv").write_text("tag,step,value\ntrain/loss,10,1\n")
    (tmp_path / "c/log.csv").unlink()
    with caplog.at_level(logging.WARNING, "outlast"):
        assert [each.origin.name for each in load([tmp_path])] == ["a"]
    assert len(caplog.messages) == 2
    assert f"left out: {tmp_path / 'b/log.csv'} has no rollout/steps: no episode has ended" in caplog.messages[0]
    with pytest.raises(TrainingError, match=r"there is nothing to draw: .*no episode has ended"):
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
    run(tmp_path / "a")
    for words, reason in (
        ((str(KEPT), "--x", "time"), "does not say how long it took"),
        (("--by", "nothing"), "no such setting"),
        (("--curves", "nothing"), "no curve 'nothing'"),
    ):
        assert main(["plot", str(tmp_path / "a"), *words, "--out", str(tmp_path / "out")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert reason in line
    assert not (tmp_path / "out").exists()
    assert main(["plot", str(KEPT), "--out", str(tmp_path / "out")]) == 0
    assert "| ffa_1 | 0, 1 | 10,027,008 |" in capsys.readouterr().out
