"""Hostile logs, kept results and run.json files: `outlast plot` draws them, or refuses them with a reason."""

import json
from pathlib import Path
from typing import Any

import pytest

from outlast import variant
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.training.base.curves import FILE, format_curves
from outlast.training.base.errors import TrainingError
from outlast.training.base.files import packed, unpacked
from outlast.training.base.presets import preset
from outlast.training.plots.plot import plot
from outlast.training.research import results

LINES = "tag,step,value\nrollout/reward0,10,1.5\nrollout/steps,10,2.5\nrollout/reward0,20,3\nrollout/steps,20,4\n"


def run(folder: Path, name: str = "ffa_2", text: str = LINES, **plan: Any) -> list[results.PaperRun]:
    """The results read from a run of that name and log."""
    given = {"preset": "paper", "seed": 0} | plan
    scenario = fingerprint(preset("paper").scenario(variant("ffa_2"))) | {"name": name}
    (folder / "log.csv").write_text(text)
    (folder / "run.json").write_text(json.dumps({"plan": given, "scenario": scenario}))
    return results.load_runs([folder])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"name": "ffa_2+../../../evil"}, "is not a run of the paper's games"),
        ({"seed": "../evil"}, "its plan is invalid"),
        ({"seed": 1.5}, "its plan is invalid"),
        ({"dead": "$\\frac"}, "its plan cannot be"),
        ({"dead": "\x1b[31m"}, "its plan cannot be"),
        ({"settings": {"gamma": {}}}, "its plan cannot be"),
        ({"text": LINES + f"rollout/steps,{10**30},1\n"}, "is not a tag, a step, a value"),
        ({"text": LINES + "rollout/steps,-1,1\n"}, "is not a tag, a step, a value"),
        ({"text": LINES + "rollout/steps,30,1e300\n"}, "is broken: rollout/steps at step 30 is not a finite number"),
    ],
)
def test_runs_that_could_be_written_elsewhere_or_not_be_drawn_are_refused(
    tmp_path: Path, changes: dict[str, Any], reason: str
) -> None:
    assert run(tmp_path)[0].name == "ffa_2-paper-0"
    with pytest.raises(TrainingError, match=reason):
        run(tmp_path, **changes)


def test_kept_results_are_of_the_papers_quantities(tmp_path: Path) -> None:
    (found,) = run(tmp_path)
    path = tmp_path / "kept" / FILE
    path.parent.mkdir()
    kept = format_curves({found.name: (found.about, found.curves)})
    path.write_bytes(kept)
    assert results.load_runs([path.parent])[0].about == found.about
    text = unpacked(kept)
    for old, new in (
        ("rollout/steps", "train/loss"),
        ("rollout/reward0", "rollout/reward\u0663"),
        ('"changed":{', '"changed":{"x":"$",'),
    ):
        assert old in text
        path.write_bytes(packed(text.replace(old, new, 1).replace(",}", "}")))
        with pytest.raises(TrainingError, match=r"ffa_2-paper-0 does not hold the curves of a run"):
            results.load_runs([path.parent])


@pytest.mark.parametrize("name", ["$\\frac", "a|b", "<b>", "x" * 200])
def test_names_of_scenarios_and_tags_are_drawn_as_they_are(tmp_path: Path, name: str) -> None:
    """They come from files: no formula is parsed, no file is named after them."""
    pytest.importorskip("matplotlib", reason="needs matplotlib: outlast[plot]")
    for folder, seed in (("a", 0), ("b", 0)):
        (tmp_path / folder).mkdir()
        run(tmp_path / folder, "ffa_2", LINES + f"rollout/{name},20,1\n", seed=seed)
    header = json.loads((tmp_path / "a/run.json").read_text())
    header["scenario"]["name"] = name
    (tmp_path / "a/run.json").write_text(json.dumps(header))
    found = plot(tmp_path, tmp_path / "out", curves=("length", f"rollout/{name}"))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["curves.png", "ends.csv", "ends.md"]
    assert name.replace("|", r"\|") in str(found)
