"""Situations: their solutions pass them, and who does nothing, or anything, does not."""

from typing import Any

import numpy as np
import pytest

from outlast.envs.cli import main as cli
from outlast.training.arena.players import Contender
from outlast.training.benchmark.situations import SHARE, SITUATIONS, attempt
from outlast.training.benchmark.tasks import task_of

WORLDS = 32
LACKING = {  # by game: what some situations need and it has not
    "teams_3-mended-v2": {},
    "ffa_3-v2": {"unhurt": "cap", "weakest first": "enemies", "wounded mate": "mate"},
}


@pytest.mark.parametrize("situation", SITUATIONS, ids=lambda situation: situation.name)
@pytest.mark.parametrize("task", LACKING)
def test_a_situation_is_passed_by_its_solution_alone(task: str, situation: Any) -> None:
    """Agents that set their velocity, in teams, and agents with motors, alone."""
    scenario, lacking = task_of(task).scenario, LACKING[task].get(situation.name)
    found = attempt(situation, scenario, worlds=WORLDS)
    if lacking:
        assert found == lacking
        return
    assert np.mean(found) >= SHARE
    usual = situation.name in ("hurt", "weak enemy")  # who uses or strikes all the time passes these
    for name in ("noop", *([] if usual else ["random"])):
        assert np.mean(attempt(situation, scenario, Contender(name, name), worlds=WORLDS)) < SHARE / 1.5


def test_games_without_an_open_floor_or_with_varying_agents_have_no_situations(capsys) -> None:
    assert cli.main(("benchmark", "situations", "agents-v2", "--quiet", "--policies", "noop")) == 0
    printed = capsys.readouterr().out
    assert printed.count("no fixed number of agents") == len(SITUATIONS)
    assert "0 of 0" in printed
    assert attempt(SITUATIONS[0], task_of("layouts-v2").scenario, worlds=1) == "open floor"
