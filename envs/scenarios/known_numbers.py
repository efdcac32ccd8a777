"""The numbers of the mechanics that outlast has, for type checkers: `known_numbers.pyi` lists them.

`python -m tests.options --write` writes that stub. Numbers of other mechanics go into `Scenario.replace`.
"""

from typing import TypedDict


class Numbers(TypedDict, total=False):
    """Numbers of a scenario, by name, as keywords of a function."""
