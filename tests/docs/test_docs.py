"""The documents: tables agree with the kept results, and docstrings name the mechanics that write a component."""

import inspect
import re
from pathlib import Path

import pytest

from outlast import components, systems
from outlast.ecs import Component, Module
from perf.report import filled

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", ["docs/performance.md", "README.md"])
def test_tables_are_those_of_the_results(name: str) -> None:
    """To update them: python -m perf.report MACHINE"""
    text = (ROOT / name).read_text()
    assert "<!-- table original of" in text
    assert "<!-- machine of original -->" in text
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


def writers(component: type[Component]) -> set[str]:
    """The mechanics and systems that write a component, by name."""
    kinds = [kind for kind in vars(systems).values() if isinstance(kind, type) and issubclass(kind, Module)]
    found = [
        system
        for kind in kinds
        for system in kind.registered
        for parameter in system.parameters
        if parameter.kind in ("write", "add") and component in parameter.components
    ]
    return {system.module for system in found} | {system.label for system in found}


def test_a_component_is_written_by_whom_it_says() -> None:
    mechanics = {kind.name for kind in vars(systems).values() if isinstance(kind, type) and issubclass(kind, Module)}
    count = 0
    for component in (getattr(components, name) for name in components.__all__):
        if not (isinstance(component, type) and issubclass(component, Component)):
            continue
        for sentence in re.findall(r"[Ww]ritten by ([^\n\"]+)", inspect.getsource(component)):
            words = re.findall(r"[a-z_]+(?:\.[a-z_]+)?", sentence)
            named = {word for word in words if word.partition(".")[0] in mechanics}
            assert named, (component.__name__, sentence)
            assert named <= writers(component), (component.__name__, sentence)
            count += 1
    assert count > 8
