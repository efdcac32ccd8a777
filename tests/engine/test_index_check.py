"""A row and an index among some entities are told apart where they differ."""

import inspect
from dataclasses import dataclass
from typing import Any

import pytest

import outlast
from outlast.components import Health, Phase, Side
from outlast.ecs import (
    Array,
    DeclarationError,
    Module,
    Read,
    RowIndex,
    Rows,
    Singleton,
    Write,
    column,
    kernel,
    number,
    of,
)
from tests.helpers.beasts import Beast, Beasts


class Mark(Singleton):
    """A number of each of the four agents, and one of each of the two beasts."""

    agent: Array = column("i4", "agents")
    beast: Array = column("i4", 2)


def index_as_row(health: Write[Health], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        health.points[i] = 1


def row_as_index(mark: Write[Mark], agents: Rows[Side]) -> None:
    for e in agents:
        mark.agent[e] = 1


def row_in_pairs(mark: Write[Mark], agents: Rows[Side]) -> None:
    for i, e in enumerate(agents):
        mark.agent[e] = i


def row_of_a_list(mark: Write[Mark], health: Read[Health], agents: Rows[Side]) -> None:
    for i in range(agents.shape[0]):
        mark.agent[agents[i]] = health.points[agents[i]]


def row_in_its_list(mark: Write[Mark], agents: Rows[Side]) -> None:
    for e in agents:
        mark.agent[0] = agents[e]


@kernel
def set_one(numbers: Array, e: int) -> None:
    numbers[e] = 1


def row_in_a_kernel(mark: Write[Mark], agents: Rows[Side]) -> None:
    for e in agents:
        set_one(mark.agent, e)


def index_of_beast(mark: Write[Mark], health: Read[Health], index: RowIndex[Beast], rows: Rows[Health]) -> None:
    for e in rows:
        if index[e] >= 0:
            mark.beast[index[e]] = health.points[index[e]]


def too_many(mark: Write[Mark], rows: Rows[Health]) -> None:
    for i in range(len(rows)):
        mark.agent[i] = 1


def number_by_index(health: Write[Health], agents: Rows[Side], harm: int) -> None:
    for i in range(agents.size):
        health.points[agents[i]] = of(harm, i)


def fitting(mark: Write[Mark], health: Write[Health], agents: Rows[Side], index: RowIndex[Beast]) -> None:
    for i, e in enumerate(agents):
        mark.agent[i] = health.points[e]
    for e in range(index.size):
        if index[e] >= 0:
            mark.beast[index[e]] = health.points[e]


def pairs_of_numbers(mark: Write[Mark], shares: tuple[float, ...], agents: Rows[Beast]) -> None:
    for i, share in enumerate(shares):
        mark.beast[i] = int(share) + agents.size


def in_bounds(mark: Write[Mark], rows: Rows[Health]) -> None:
    for i in range(rows.size):
        if i < mark.agent.size:
            mark.agent[i] = 1


def made(function: Any, order: int) -> None:
    @dataclass(frozen=True)
    class Marks(Module):
        harm: int = number(3, low=0, per_agent=True)
        shares: tuple[float, ...] = number((1.0, 2.0), low=0)

        def singletons(self) -> Any:
            return [Mark()]

    Marks.system(Phase.RESPAWN)(function)
    scenario = outlast.variant("teams_2").with_(Beasts(order=order), Marks())
    if "harm" in inspect.signature(function).parameters:
        scenario = scenario.roles(one=outlast.role(1, marks_harm=4), rest=outlast.role())
    outlast.make_vec(scenario, 1, seed=0).close()


AN_INDEX = r"indexes Mark.agent, which has 4 \('agents'\), with a row of Rows.Side.: take an index"
BEFORE, BEHIND = 0, 60  # where the rows of beasts are; those of agents begin with 10


@pytest.mark.parametrize(
    ("function", "order", "words"),
    [
        (index_as_row, BEFORE, "indexes Health.points, which is by row, with an index in Rows.Side.: take the row"),
        (row_as_index, BEFORE, AN_INDEX),
        (row_in_pairs, BEFORE, AN_INDEX),
        (row_of_a_list, BEFORE, AN_INDEX),
        (row_in_its_list, BEFORE, "indexes 'agents', which has 4, with a row of Rows.Side.: take an index"),
        (row_in_a_kernel, BEFORE, AN_INDEX),
        (index_of_beast, BEHIND, "indexes Health.points, which is by row, with an index in Rows.Beast.: take the row"),
        (number_by_index, BEFORE, "indexes 'harm', which is by row, with an index in Rows.Side.: take the row"),
        (too_many, BEHIND, r"which has 4 \('agents'\), with an index in Rows.Health., which has 6 \(agent, beast\)"),
    ],
)
def test_an_index_that_selects_another_entity_is_refused(function: Any, order: int, words: str) -> None:
    with pytest.raises(DeclarationError, match=rf"^marks\.{function.__name__} \(.*test_index_check.py.*\): .*{words}"):
        made(function, order)


@pytest.mark.parametrize("order", [BEFORE, BEHIND])
@pytest.mark.parametrize("function", [fitting, pairs_of_numbers, in_bounds])
def test_what_fits_is_not_refused(function: Any, order: int) -> None:
    made(function, order)
