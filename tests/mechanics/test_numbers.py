"""The numbers of the mechanics: the default of each, and its range. Another one is another game."""

from dataclasses import fields
from pathlib import Path

import pytest

from outlast import systems
from outlast.ecs import NumberError
from outlast.envs.scenarios.number_table import number_rows
from outlast.systems import hide_and_seek

TABLE = Path(__file__).parents[1] / "golden" / "numbers.txt"


def test_numbers_are_what_they_were() -> None:
    """To write the table anew, after a number was added: write `found` into the file."""
    found = ""
    for mechanic in (getattr(some, name)() for some in (systems, hide_and_seek) for name in some.__all__):
        for row, item in zip(number_rows(mechanic), fields(mechanic), strict=True):
            rules = (f", {rule}" for rule in ("per_agent", "free", "scales_with") if item.metadata[rule])
            found += f"{row.name} = {row.default or '()'}, of {row.allowed}{''.join(rules)}\n"
            assert row.about, row.name
    assert found == TABLE.read_text()


@pytest.mark.parametrize(
    ("mechanic", "numbers"),
    [
        ("Room", {"width": -1.0}),
        ("Room", {"height": 0.5}),
        ("Teams", {"sizes": (0, 1)}),
        ("Teams", {"sizes": (1, 0.5)}),
    ],
)
def test_numbers_with_rules_of_their_own(mechanic: str, numbers: dict[str, object]) -> None:
    with pytest.raises(NumberError, match=next(iter(numbers))):
        getattr(systems, mechanic)(**numbers)
    systems.Room(width=1.0)
