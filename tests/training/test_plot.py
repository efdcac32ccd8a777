"""outlast plot --paper: figures hold the curves of runs and the paper's, tables their ends, claims can fail."""

import contextlib
import csv
import importlib
import io
import math
import re
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import outlast
from outlast import make_vec, variant
from outlast.envs.rollout.saved import newest
from outlast.training.base import policy_file
from outlast.training.base.averages import average, end_value, smooth
from outlast.training.base.curves import FILE, Curves, format_curves
from outlast.training.base.errors import TrainingError
from outlast.training.cli import plot
from outlast.training.plots.runs import kept_runs
from outlast.training.research.claims import FFA, TEAMS, claims_table, findings, over
from outlast.training.research.report import csv_table, markdown, report
from outlast.training.research.results import PaperGroup, group_runs, load_runs, published_curves
from tests.conftest import call
from tests.helpers.outputs import rows_of

matplotlib = pytest.importorskip("matplotlib", reason="needs matplotlib: outlast[plot]")

from PIL import Image  # noqa: E402

from outlast.training.plots.figure import STYLE  # noqa: E402
from outlast.training.research import figures  # noqa: E402

outlast_plot = partial(call, plot, "--paper")
PLAN = {"preset": "original", "worlds": 64, "rollout": 16384, "dead": "keep", "settings": {}}


def keep(
    folder: Path, name: str, seed: int = 0, factor: float = 1.0, points: int = 1000, *, variant: str = "", **plan: Any
) -> Path:
    """The paper's own curves, times a factor, kept in a folder as a run of ours; `variant`: of another game."""
    theirs, name = published_curves(name), variant or name
    values = {tag: (factor * value[:points]).astype(np.float32) for tag, value in theirs.values.items()}
    about: dict[str, Any] = {"variant": name, "plan": {**PLAN, "seed": seed, **plan}, "changed": {}}
    run = f"{name}-{about['plan']['preset']}-{seed}"
    others = kept_runs(folder)
    (folder / FILE).write_bytes(format_curves(others | {run: (about, Curves(theirs.steps[:points], values))}))
    return folder / run


def group(*paths: Path) -> PaperGroup:
    (found,) = group_runs(load_runs(paths))
    return found


def drawn(of: PaperGroup) -> Any:
    with matplotlib.rc_context(STYLE):
        return figures.draw(of)


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# ---- figures


def test_a_figure_shows_the_averages_and_the_papers_points(tmp_path: Path) -> None:
    shown = group(keep(tmp_path, "ffa_3", 0, 0.8), keep(tmp_path, "ffa_3", 1, 1.2), keep(tmp_path, "ffa_3", 2, 0.7))
    panels = drawn(shown).axes
    titles = [axes.get_title("left").split(",")[0] for axes in panels]
    assert titles == ["return", "heals used", "kills", "boxes placed"]
    theirs = shown.paper.values["rollout/boxes_placed"]
    lines = {line.get_linewidth(): [] for line in panels[3].lines}  # type: ignore[var-annotated]
    for line in panels[3].lines:
        assert np.asarray(line.get_xdata()).tolist() == (shown.paper.steps / 1e6).tolist()
        lines[line.get_linewidth()].append((line.get_color(), np.asarray(line.get_ydata(), float)))
    (points,), averages = lines[0.5], dict(lines[1.6])
    np.testing.assert_array_equal(points[1], theirs)
    np.testing.assert_allclose(averages[figures.THEIRS], smooth(theirs), rtol=1e-6)
    np.testing.assert_allclose(averages[figures.OURS], 0.9 * smooth(theirs), rtol=1e-5)
    assert len(panels[2].lines) == 2 + 2 + 2  # averages of both agents, ours and theirs, and the paper's points
    (band,) = panels[3].collections
    reach = average([run.curves for run in shown.runs], "rollout/boxes_placed")
    assert band.get_paths()[0].get_extents().ymax == pytest.approx(reach.high.max())


def test_without_boxes_the_length_is_shown(tmp_path: Path) -> None:
    panels = drawn(group(keep(tmp_path, "teams_2"))).axes
    assert panels[1].get_title("left") == "episode length"
    assert panels[0].get_title("left") == "return, each team"


def test_a_figure_says_what_is_unlike_the_paper(tmp_path: Path) -> None:
    shown = group(keep(tmp_path, "ffa_2", 3, points=60, dead="drop"), keep(tmp_path, "ffa_2", 5, dead="drop"))
    notes = "\n".join(text.get_text() for text in drawn(shown).texts)
    assert "Unfinished: seed 3 (2.0 million agent-steps); not counted in end values" in notes
    assert "Unlike the paper: worlds = 64, dead = drop" in notes
    assert "averages over 5 % of the points (of ours 15)" in notes


def test_pictures_are_the_same_each_time_and_name_what_they_show(tmp_path: Path) -> None:
    shown = group(keep(tmp_path, "ffa_1"))
    png, svg = first = [figures.picture(shown, form) for form in plot.FORMS]
    assert [figures.picture(shown, form) for form in plot.FORMS] == first
    image: Any = Image.open(io.BytesIO(png))
    assert image.text == {"Title": "ffa_1-original", "Source": figures.digest(shown)}
    assert image.size == (1140, 855)
    assert len(png) < 100_000
    found = {tuple(pixel) for pixel in np.asarray(image.convert("RGB")).reshape(-1, 3)}
    for ink in (figures.OURS, figures.THEIRS):
        wanted = [int(ink[k : k + 2], 16) for k in (1, 3, 5)]
        assert min(max(abs(int(a) - b) for a, b in zip(pixel, wanted)) for pixel in found) < 8
    assert figures.digest(shown).encode() in svg
    assert ElementTree.fromstring(svg).tag.endswith("svg")
    assert figures.digest(group(keep(tmp_path, "ffa_1", factor=1.01))) != figures.digest(shown)


# ---- tables and claims


def test_the_table_has_the_ends_of_both(tmp_path: Path) -> None:
    keep(tmp_path, "teams_2", 0, 1.1), keep(tmp_path, "teams_2", 1, 1.3), keep(tmp_path, "ffa_4", 0, 0.9)
    assert outlast_plot(tmp_path, "--out", tmp_path / "out") == 0
    assert files(tmp_path / "out") == ["ends.csv", "ends.md", "ffa_4-original.png", "teams_2-original.png"]
    rows = {(row["variant"], row["quantity"], row["agent or team"]): row for row in rows_of(tmp_path / "out/ends.csv")}
    length = rows["teams_2", "episode length", ""]
    numbers = [float(length[key]) for key in ("paper", "outlast", "lowest seed", "highest seed", "apart")]
    assert numbers == pytest.approx([403.870, 484.644, 444.257, 525.031, 0.2], rel=1e-5)
    assert (length["within 15%"], length["seeds"], length["agent-steps"]) == ("no", "0 1", "10027008")
    assert rows["ffa_4", "return", "1"]["within 15%"] == "yes"
    assert rows["ffa_4", "kills", "1"]["within 15%"] == ""
    text = (tmp_path / "out/ends.md").read_text()
    assert "| episode length | 404 ± 23 | 485 ± 27 | 444 to 525 | +20% | no | 532 at 3.6 M | 639 at 3.6 M |" in text
    assert (
        "| Afterwards it decreases significantly. | teams_2 | what is left of the peak at the end | ≤ 0.900 | 0.758 |"
        in text
    )


def test_it_is_too_early_for_unfinished_runs(tmp_path: Path) -> None:
    shown = group(keep(tmp_path, "ffa_2", points=305))  # the rollout that ends after 10 million is missing
    text = report([shown])
    assert "seed 0. Unfinished: seed 0 (10.0 million agent-steps)." in text
    assert "| 1,049 ± 74 | 1,047 ± 74 | −0% | too early |" in text
    assert not list(findings([shown]))
    assert list(findings([group(keep(tmp_path, "ffa_2", points=306))]))


def test_the_spread_of_one_point_is_not_said(tmp_path: Path) -> None:
    """The last tenth of 14 points is one."""
    shown = group(keep(tmp_path, "ffa_2", points=14))
    (last,) = shown.runs[0].curves.values["rollout/steps"][-1:]
    assert re.search(rf"\n\| episode length \| 1,049 ± 74 \| {last:.0f} \| ", markdown(shown))
    (row,) = (row for row in csv.DictReader(io.StringIO(csv_table([shown]))) if row["quantity"] == "episode length")
    assert (float(row["outlast"]), row["outlast between points"]) == (pytest.approx(last, rel=1e-5), "")


def test_presets_stand_beside_each_other(tmp_path: Path) -> None:
    """Ours are the paper's own curves here, of the second preset half of them; of three seeds an interval."""
    paths = [keep(tmp_path, "teams_4", seed, 1 + 0.1 * seed, preset="paper") for seed in (0, 1, 2)]
    text = report(group_runs(load_runs(paths)), group_runs(load_runs([keep(tmp_path, "teams_4", factor=0.5)])))
    assert text.startswith("| variant | at the end | the paper | preset `original` | preset `paper` |\n")
    assert "| teams_4 | episode length | 594 | 297 | 653 (" in text
    kills = sum(end_value(published_curves("teams_4").values[f"rollout/kills{side}"]).mean for side in (0, 1))
    assert f"| teams_4 | kills | {kills:.3f} | {kills / 2:.3f} | {1.1 * kills:.3f} (" in text


def test_claims_hold_for_the_paper(tmp_path: Path) -> None:
    """Ours are the paper's own curves here, of one seed as they are and of another with fewer points."""
    paths = [keep(tmp_path, name, seed, points=306) for name in (*FFA, *TEAMS) for seed in (0, 1)]
    found = list(findings(group_runs(load_runs(paths))))
    assert len(found) == sum(not np.isnan(each.paper) for each in found) > 35
    assert all(each.ours == (each.paper, each.paper) and each.holds for each in found)
    numbers = "kills at the end | ≤ 0.050 | 0.006 | 0.006 | 0.006 to 0.006 | yes, 2 of 2 seeds |"
    assert f"| Kills almost vanish. | ffa_2 | {numbers}" in claims_table(found)


@pytest.mark.parametrize(
    ("text", "name", "spoil", "expected"),
    [
        ("Kills almost vanish.", "ffa_2", {"rollout/kills0": 0.03, "rollout/kills1": 0.03}, 0.06),
        ("Kills almost vanish.", "ffa_2", {"rollout/kills0": 0.03, "rollout/kills1": 0.01}, 0.04),
        ("Afterwards it decreases significantly.", "teams_2", {"rollout/reward0": 380.0, "rollout/reward1": 380.0}, 1),
        ("Boxes placed increase slowly.", "teams_4", {"rollout/boxes_placed": 0.5}, 1),
        ("Agents do not attack an opponent in range.", "ffa_3", {"behaviour/attack_near": 0.4}, 0.4),
        ("Agents do not attack an opponent in range.", "ffa_3", {"behaviour/attack_near": 0.1}, 0.1),
    ],
)
def test_claims_fail_for_other_curves(
    tmp_path: Path, text: str, name: str, spoil: dict[str, float], expected: float
) -> None:
    """spoil: curves that stay at one height."""
    (run,) = group(keep(tmp_path, name)).runs
    flat = {tag: np.full(len(run.curves.steps), value, np.float32) for tag, value in spoil.items()}
    spoilt = replace(run, curves=Curves(run.curves.steps, run.curves.values | flat))
    (found,) = (each for each in findings([PaperGroup((spoilt,))]) if each.claim.text == text)
    assert found.mean == pytest.approx(expected)
    assert found.holds == (expected in (0.04, 0.1) or text.startswith("Boxes"))


def test_what_was_0_before_has_grown_without_bound() -> None:
    """It counts as a seed in which a claim does not hold, and is not left out."""
    assert (over(1.0, 0.0), math.isnan(over(0.0, 0.0)), over(1.0, 4.0)) == (math.inf, True, 0.25)


def test_a_claim_whose_divisor_is_0_has_no_interval_and_others_have_theirs(tmp_path: Path) -> None:
    """Boxes placed in teams_4, in the last third over the first: none in the first third of one of three seeds."""
    runs = list(group(*(keep(tmp_path, "teams_4", seed) for seed in range(3))).runs)
    curves = runs[1].curves
    late = np.where(np.arange(len(curves.steps)) < len(curves.steps) / 2, 0, 1).astype(np.float32)
    boxes = {tag: late for tag in curves.values if tag.startswith("rollout/boxes_placed")}
    runs[1] = replace(runs[1], curves=Curves(curves.steps, curves.values | boxes))
    found = {each.claim.text: each.cells for each in findings([PaperGroup(tuple(runs))])}
    *_, mean, within, holds = found["Boxes placed increase slowly."]
    assert (mean, within, holds) == ("inf", "", "yes, 3 of 3 seeds")
    assert " to " in found["Heals stabilise at around 2 million steps."][-2]


def test_claims_say_nothing_of_other_games(tmp_path: Path) -> None:
    assert not list(findings([group(keep(tmp_path, "ffa_2", variant="ffa_2+bounty"))]))


# ---- the command


def test_kept_results_make_the_same_figures(tmp_path: Path) -> None:
    keep(tmp_path, "ffa_2", 7)
    for out in ("a", "b"):
        source = tmp_path / "ffa_2-original-7" if out == "a" else tmp_path / "kept"
        assert outlast_plot(source, "--out", tmp_path / out, "--keep", tmp_path / "kept", "--format", "svg") == 0
    assert files(tmp_path / "a") == ["ends.csv", "ends.md", "ffa_2-original.svg"]
    assert files(tmp_path / "kept") == [FILE]
    assert (tmp_path / "kept" / FILE).read_bytes() == (tmp_path / FILE).read_bytes()
    for name in files(tmp_path / "a"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_what_is_refused_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir(), (tmp_path / "kept").mkdir()
    before = keep(tmp_path / "kept", "ffa_2", dead="drop")
    content = (tmp_path / "kept" / FILE).read_bytes()
    mine = keep(tmp_path / "one", "ffa_2")
    with pytest.raises(
        TrainingError,
        match=r"keeps another ffa_2-original-0: dead is drop in .*kept.* and keep in .*one.*: choose",
    ):
        outlast_plot(mine, "--out", tmp_path / "out", "--keep", tmp_path / "kept")
    with pytest.raises(TrainingError, match="dead is keep in"):
        outlast_plot(mine, before, "--out", tmp_path / "out")
    with pytest.raises(TrainingError, match=r"cannot be a folder: .* is a file"):
        outlast_plot(mine, "--out", tmp_path / "one" / FILE)
    assert files(tmp_path) == ["kept", "one"]
    assert (tmp_path / "kept" / FILE).read_bytes() == content


def test_runs_that_are_kept_already_stay(tmp_path: Path) -> None:
    """One is kept beside another, and can be drawn without it; a run of theirs that is not there is named."""
    for seed in (8, 7):
        folder = tmp_path / str(seed)
        folder.mkdir()
        outlast_plot(keep(folder, "ffa_2", seed), "--out", tmp_path / "out", "--keep", tmp_path / "kept")
    assert [run.seed for run in load_runs([tmp_path / "kept"])] == [7, 8]
    assert [run.seed for run in load_runs([tmp_path / "kept/ffa_2-original-8"])] == [8]
    for place, message in (
        ("kept/ffa_2-original-9", "has no run ffa_2-original-9, but ffa_2-original-7, ffa_2-original-8"),
        (f"kept/{FILE}", "is a file: give the folder of a run, or one with runs in it"),
        ("none/ffa_2-original-8", "there is no folder"),
    ):
        with pytest.raises(TrainingError, match=message):
            load_runs([tmp_path / place])


def test_the_command_needs_no_torch() -> None:
    text = (
        "import sys; from outlast.training.cli import plot; assert 'matplotlib' not in sys.modules\n"
        "from outlast.training.research import figures; assert not {'torch', 'stable_baselines3'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", text], check=True)


def trainer() -> Any:
    for library in ("torch", "stable_baselines3", "tensorboard"):
        pytest.importorskip(library, reason=f"needs {library}: outlast[train]")
    return importlib.import_module("outlast.training.runs.run")


@pytest.mark.usefixtures("one_torch_thread")
def test_runs_of_outlast_train_are_understood(tmp_path: Path) -> None:
    run = trainer()
    scenario = variant("ffa_1").replace(
        agents_health=10, safe_zone_radii=(9.0, 4.0), safe_zone_stand=10, safe_zone_shrink=10
    )
    settings = {"batch_size": 64, "n_epochs": 1}
    for seed in (1, 2):
        config = run.TrainingConfig(
            scenario, "original", steps=2000, seed=seed, worlds=8, rollout=192, threads=1, settings=settings
        )
        run.TrainingRun(config, tmp_path / "runs" / str(seed)).train()
    assert outlast_plot(tmp_path / "runs", "--out", tmp_path / "out", "--keep", tmp_path / "kept") == 0
    assert files(tmp_path / "kept") == [FILE, "ffa_1-original-1.safetensors", "ffa_1-original-2.safetensors"]
    unlike = (
        "worlds = 8, rollout = 192, batch_size = 64, n_epochs = 1, agents_health = 10, safe_zone_radii = [9.0, 4.0]"
    )
    assert f"Unlike the paper: {unlike}" in (tmp_path / "out/ends.md").read_text()
    shown = group(tmp_path / "kept")
    assert figures.digest(group(tmp_path / "runs")) == figures.digest(shown)
    assert [run.steps for run in shown.runs] == [2304, 2304]


@pytest.mark.usefixtures("one_torch_thread")
def test_policies_are_kept_and_play(tmp_path: Path) -> None:
    """What is kept of a checkpoint plays as that does, and cannot be resumed."""
    run = trainer()
    folder, kept = tmp_path / "run", tmp_path / "kept"
    scenario = variant("ffa_1").replace(safe_zone_damage=50, safe_zone_stand=5)
    config = run.TrainingConfig(scenario, steps=4096, worlds=8, rollout=512, threads=1, settings={"n_epochs": 1})
    run.TrainingRun(config, folder).train()
    for _ in range(2):  # the second time from what was kept
        assert outlast_plot(folder, "--out", tmp_path / "out", "--keep", kept) == 0
        folder = kept
    (policy,) = kept.glob("*.safetensors")
    whole = newest(tmp_path / "run")
    assert policy.stat().st_size < whole.stat().st_size / 3
    players = [outlast.load_policy(path) for path in (policy, whole)]
    with contextlib.closing(make_vec(players[0].scenario(variant("ffa_1")), 8, seed=1)) as env:
        observations = env.reset()[0]
        one, other = (player(observations) for player in players)
    assert (one == other).all()
    assert policy_file.read(policy)[0] == policy_file.read(whole)[0]
    (one,), (other,) = (policy_file.read(path)[1] for path in (policy, whole))
    assert all(values.tobytes() == other[name].tobytes() for name, values in one.items())
    assert one.keys() == other.keys()
