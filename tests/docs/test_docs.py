"""The documents: tables agree with the kept results."""

import re
from pathlib import Path

import pytest

from perf.report import DOCUMENTS, filled

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("page", DOCUMENTS, ids=lambda page: page.stem)
def test_tables_are_those_of_the_results(page: Path) -> None:
    """To update them: python -m perf.report MACHINE"""
    text = page.read_text()
    assert "<!-- table " in text
    assert filled(text) == text


def test_a_machine_replaces_the_tables_that_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perf.table.FOLDER", tmp_path)
    for machine, name in (("old", "step"), ("old", "floor"), ("new", "step")):
        (tmp_path / machine).mkdir(exist_ok=True)
        (tmp_path / machine / f"{name}.csv").write_text(f"row,us,paper\n{name} of {machine},1,2\n")
        (tmp_path / machine / "machine.txt").write_text(f"the {machine} one\n")
    (tmp_path / "new" / "step.txt").write_text("the new one and another\n")
    document = """<!-- machine of step --><!-- end -->
<!-- machine of floor -->?<!-- end -->
<!-- table step of old: row, us -->
anything
<!-- end -->
<!-- table floor of old -->
<!-- end -->
"""
    done = """<!-- machine of step -->the new one and another<!-- end -->
<!-- machine of floor -->the old one<!-- end -->
<!-- table step of new: row, us -->
| row | us |
|---|---:|
| step of new | 1 |
<!-- end -->
<!-- table floor of old -->
| row | us | paper |
|---|---:|---:|
| floor of old | 1 | 2 |
<!-- end -->
"""
    assert filled(document, "new") == done
    assert filled(done) == done


def test_variables_of_the_environment_are_on_the_page() -> None:
    folders = (ROOT / name for name in ("ecs", "components", "systems", "envs", "training"))
    source = "".join(file.read_text() for folder in folders for file in folder.rglob("*.py"))
    named = {*re.findall(r"\bOUTLAST_[A-Z]+(?:_[A-Z]+)*\b", source), *re.findall(r'environ\.get\("(\w+)', source)}
    assert {"OUTLAST_CACHE_DIR", "RAY_ADDRESS"} <= named
    assert named <= set(re.findall(r"^\| `(\w+)`", (ROOT / "docs/commands.md").read_text(), re.MULTILINE))
