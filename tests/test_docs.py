"""The documents: tables are those of the results that are kept."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MACHINE = "xeon-2-cores"  # whose numbers the documents show


@pytest.mark.parametrize("name", ["docs/performance.md", "README.md"])
def test_tables_are_those_of_the_results(name: str) -> None:
    """To renew them: python -m perf.report MACHINE"""
    from perf.report import filled

    text = (ROOT / name).read_text()
    assert "<!-- table step" in text
    assert filled(text, MACHINE) == text
