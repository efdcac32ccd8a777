"""Curves of runs: the paper's are those that were published, logs and kept ones are read exactly or refused."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import VARIANTS, variant
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.training.base import log_file
from outlast.training.base.averages import average, end_value, smooth
from outlast.training.base.curves import (
    BOXES,
    FILE,
    Curves,
    curves_of_log,
    format_curves,
    is_known,
    read_curves,
    rounded,
)
from outlast.training.base.errors import TrainingError
from outlast.training.base.files import packed
from outlast.training.base.presets import preset
from outlast.training.research import results

# Mean and deviation of the last tenth, height and place (million steps) of the peak: computed apart from this code.
PUBLISHED = [
    ("ffa_1", "rollout/reward0", 938.516, 118.621, 998.497, 9.96),
    ("ffa_1", "rollout/kills1", 0.322, 0.157, 0.429, 9.31),
    ("ffa_2", "rollout/steps", 1049.219, 74.331, 1106.069, 9.99),
    ("ffa_2", "rollout/kills0", 0.002, 0.011, 0.038, 3.80),
    ("ffa_3", "rollout/boxes_placed", 0.425, 0.165, 0.593, 3.18),
    ("ffa_4", "rollout/heals_used", 1.163, 0.263, 1.435, 4.82),
    ("teams_1", "rollout/reward1", 596.305, 34.828, 685.885, 3.21),
    ("teams_2", "rollout/reward0", 402.807, 22.754, 531.305, 3.60),
    ("teams_3", "rollout/kills1", 0.034, 0.021, 0.088, 1.90),
    ("teams_4", "rollout/steps", 593.747, 32.220, 621.950, 5.83),
]
LINES = "tag,step,value\nrollout/reward0,10,1.5\nrollout/steps,10,2.5\nrollout/reward0,20,3\nrollout/steps,20,4\n"


@pytest.mark.parametrize(("name", "tag", "mean", "deviation", "peak", "place"), PUBLISHED)
def test_the_papers_curves_are_those_published(
    name: str, tag: str, mean: float, deviation: float, peak: float, place: float
) -> None:
    published = results.published_curves(name)
    found = end_value(published.values[tag])
    steps, height = average([published], tag).peak
    assert [found.mean, found.deviation, height] == pytest.approx([mean, deviation, peak], abs=6e-4)
    assert steps / 1e6 == pytest.approx(place, abs=6e-3)


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_has_the_papers_curves(name: str) -> None:
    published = results.published_curves(name)
    agents = 4 if name.startswith("teams") else 2
    assert published.steps.tolist() == [16384 * agents * k for k in range(1, 612 // agents + 1)]
    assert bool(published.tags(BOXES)) == ("boxes" in variant(name))
    assert all(np.isfinite(values).all() for values in published.values.values())


# ---- logs


def log(folder: Path, text: str) -> Path:
    path = folder / "log.csv"
    path.write_text(text)
    return path


def test_a_log_is_read_and_a_row_that_is_being_written_is_not(tmp_path: Path) -> None:
    path = log(tmp_path, LINES + "rollout/heals_used,20,0.25\nrollout/reward0,30,9\ntrain/loss,30,nan\nrollout/steps,3")
    read = curves_of_log(path, is_known)
    assert read.steps.tolist() == [10, 20, 30]
    assert set(read.values) == {"rollout/reward0", "rollout/steps", "rollout/heals_used", "train/loss"}
    np.testing.assert_array_equal(read.values["rollout/reward0"], [1.5, 3, 9])
    np.testing.assert_array_equal(read.values["rollout/steps"], [2.5, 4, np.nan])
    np.testing.assert_array_equal(read.values["rollout/heals_used"], [np.nan, 0.25, np.nan])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x", "is not the log of a run: its first line is not tag,step,value"),
        ("", "has no rollout/steps: no episode has ended in it yet"),
        ("step,tag,value\n", "is not the log of a run"),
        ("tag,step,value\n", "has no rollout/steps: no episode has ended in it yet"),
        ("tag,step,value\nrollout/steps,1,2\n", "has no rollout/reward0"),
        (LINES + "rollout/steps,30\n", "line 6: 'rollout/steps,30' is not a tag, a step, a value"),
        (LINES + "rollout/steps,many,1\n", "line 6: 'rollout/steps,many,1' is not"),
        (
            LINES + "rollout/steps,15,1\n",
            "line 6: rollout/steps at step 15 comes after that at step 20",
        ),
        (LINES + "rollout/steps,30,nan\n", "is broken: rollout/steps at step 30 is not a finite number"),
    ],
)
def test_what_is_no_log_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = log(tmp_path, text)
    with pytest.raises(TrainingError, match=message) as caught:
        curves_of_log(path, is_known)
    assert str(path) in str(caught.value)


def test_what_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="No such file"):
        log_file.read_log(tmp_path / "log.csv")
    (tmp_path / "log.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TrainingError, match="it is no text"):
        log_file.read_log(tmp_path / "log.csv")


# ---- kept curves


def test_kept_curves_are_the_same(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    values = (rng.normal(size=50) * 10.0 ** rng.integers(-12, 12, 50)).astype(np.float32)
    values[[0, 7]] = np.nan
    whole = Curves(np.arange(1, 51) * 7, {"rollout/steps": values, "rollout/kills0": np.zeros(50, np.float32)})
    other = Curves(np.array([3]), {"rollout/boxes_placed": np.array([0.1], np.float32)})
    runs = {"a": ({"variant": "ffa_1", "n": [1]}, whole), "b=0.5": ({}, other)}
    (tmp_path / FILE).write_bytes(format_curves(runs))
    found = read_curves(tmp_path / FILE)
    assert [*found] == ["a", "b=0.5"]
    for name, (about, kept) in runs.items():
        again = found[name][1]
        assert found[name][0] == about
        assert again.steps.tolist() == kept.steps.tolist()
        assert {tag: array.tobytes() for tag, array in again.values.items()} == {
            tag: array.tobytes() for tag, array in kept.values.items()
        }


def test_a_file_that_has_changed_is_read_anew(tmp_path: Path) -> None:
    for value in (1.0, 2.0):
        written = Curves(np.array([1]), {"a": np.array([value], np.float32)})
        (tmp_path / FILE).write_bytes(format_curves({"x": ({}, written)}))
        assert read_curves(tmp_path / FILE)["x"][1].values["a"].tolist() == [value]


def test_curves_are_rounded_to_digits() -> None:
    values = np.array([1234.5, -0.00098765, np.nan, 0.5], np.float32)
    found = rounded(Curves(np.arange(4), {"a": values}), 3).values["a"]
    np.testing.assert_array_equal(found, np.array([1230, -0.000988, np.nan, 0.5], np.float32))


ABOUT = '# {"r": {}}\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LINES, "its first line does not describe the curves"),
        ("# no json\nrun,step,a\nr,1,2\n", "Expecting value"),
        (ABOUT + "run,step,a\nr,1,2,3\n", "line 3 has 4 cells, and the heading 3: was it cut off"),
        (ABOUT + "run,step,a\nr,1,2\nr,2\n", "line 4 has 2 cells, and the heading 3: was it cut off"),
        (ABOUT + "run,steps,a\nr,1,2\n", "its columns are not run, step and tags"),
        (ABOUT + "run,step,a,a\nr,1,2,2\n", "its columns are not run, step and tags"),
        (ABOUT + "run,step,a\nr,1,2\ns,1,2\n", "line 4 is of 's', which its first line does not describe"),
        ('# {"r": {}, "s": {}}\nrun,step,a\nr,1,2\n', "it has a run without rows"),
        ('# {"../r": {}}\nrun,step,a\n../r,1,2\n', "a run cannot be called '../r'"),
        (ABOUT + "run,step,a\nr,2,2\nr,1,2\n", "its steps do not ascend"),
        (ABOUT + "run,step,a\nr,,2\n", "its steps do not ascend"),
        (ABOUT + "run,step,a\nr,1,inf\n", "inf is not a finite number"),
        (ABOUT + "run,step,a\nr,1,x\n", "could not convert"),
        (ABOUT, "not enough values"),
        (ABOUT + "run,step,a\nr,1,2\n", "r does not hold the curves of a run: 'variant'"),
        (
            '# {"r": {"variant": "ffa_9", "plan": {}, "changed": {}}}\nrun,step,a\nr,1,2\n',
            "there is no variant 'ffa_9'",
        ),
        ("# 7\nrun,step,a\nr,1,2\n", "does not hold the curves of runs"),
        ('# {"r": []}\nrun,step,a\nr,1,2\n', "does not hold the curves of a run"),
    ],
)
def test_what_is_not_kept_curves_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / FILE).write_bytes(packed(text))
    with pytest.raises(TrainingError, match=message):
        results.load_runs([tmp_path])


@pytest.mark.parametrize("content", [b"", b"# {}", packed("x" * 999)[:-9], packed(LINES)[:10] + b"\xff" * 99])
def test_what_xz_cannot_read_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FILE).write_bytes(content)
    with pytest.raises(TrainingError, match=f"{FILE} does not hold the curves of runs"):
        results.load_runs([tmp_path])


# ---- averages


def test_the_moving_average_is_that_of_the_points_around() -> None:
    values = np.random.default_rng(2).normal(size=130).astype(np.float32)
    values[[3, 4, 60]] = np.nan
    expected = [np.nanmean(values[max(0, k - 3) : k + 4], dtype=np.float64) for k in range(130)]  # 5 % of 130: 6, or 7
    np.testing.assert_allclose(smooth(values), expected, rtol=1e-12, atol=1e-12)


def test_an_average_over_seeds_goes_on_with_those_that_do() -> None:
    runs = [Curves(np.array([1, 2, 3])[:n], {"a": np.array([k, k, k])[:n]}) for k, n in ((1.0, 3), (5.0, 2), (3.0, 3))]
    found = average([*runs, Curves(np.array([9]), {"b": np.ones(1)})], "a")
    assert [found.steps.tolist(), found.mean.tolist()] == [[1, 2, 3], [3, 3, 2]]
    assert [found.low.tolist(), found.high.tolist()] == [[1, 1, 1], [5, 5, 3]]


# ---- folders of runs


def folder(place: Path, changes: dict[str, Any] | None = None, **plan: Any) -> Path:
    """What a run leaves behind, without the weights."""
    place.mkdir()
    given = {"preset": "original", "seed": 0, "worlds": 64, "rollout": 16384, "dead": "keep", "settings": {}} | plan
    scenario = preset(given["preset"]).scenario(variant("ffa_2").replace(**changes or {}))
    (place / "run.json").write_text(json.dumps({"plan": given, "scenario": fingerprint(scenario)}))
    log(place, LINES)
    return place


def test_a_run_is_what_it_says(tmp_path: Path) -> None:
    changed = folder(
        tmp_path / "x", {"safe_zone_damage": 2}, preset="paper", seed=4, settings={"gamma": 0.9, "vf_coef": 0.5}
    )
    (run,) = results.load_runs([changed])
    assert (run.variant, run.seed, run.steps, run.name) == ("ffa_2", 4, 20, "ffa_2-paper-4")
    assert run.unlike == {"worlds": 64, "gamma": 0.9, "safe_zone_damage": 2}
    (plain,) = results.load_runs([folder(tmp_path / "y", worlds=1)])
    assert plain.unlike == {}


def test_folders_of_folders_are_searched_and_seeds_sorted(tmp_path: Path) -> None:
    for seed in (10, 2):
        folder(tmp_path / f"run{seed}", seed=seed, threads=seed)
    folder(tmp_path / "other", preset="paper")
    groups = results.group_runs(results.load_runs([tmp_path]))
    assert [(group.name, [run.seed for run in group.runs]) for group in groups] == [
        ("ffa_2-original", [2, 10]),
        ("ffa_2-paper", [0]),
    ]


def refused(places: Sequence[Path], message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        results.group_runs(results.load_runs(places))


def test_runs_that_differ_in_more_than_seeds_are_not_mixed(tmp_path: Path) -> None:
    one = folder(tmp_path / "one")
    refused(
        [one, folder(tmp_path / "a", seed=1, dead="drop")], "dead is keep in .*one and drop in .*a: leave out --paper"
    )
    refused([one, folder(tmp_path / "b", seed=1, settings={"gamma": 0.9})], "gamma is 0.99 in .*one and 0.9 in .*b")
    refused(
        [one, folder(tmp_path / "c", {"safe_zone_damage": 2}, seed=1)],
        "safe_zone_damage is as usual in .*one and 2 in .*c",
    )
    refused([one, folder(tmp_path / "d")], "are the same run, or both of seed 0: give one")
    assert len(results.load_runs([one, tmp_path / "one"])) == 1  # a place that is named twice


def test_folders_without_runs_are_refused(tmp_path: Path) -> None:
    refused([tmp_path], "there are no runs in")
    refused([tmp_path / "none"], "there is no .*none")
    log(tmp_path, LINES)
    refused([tmp_path], r"has no run.json, which describes what is trained in it")
    for content in (b"no JSON", b"\xff", b"[" * 99999, b"[]", b'{"plan": {}}'):
        (tmp_path / "run.json").write_bytes(content)
        refused([tmp_path], r"run.json does not describe a run")
