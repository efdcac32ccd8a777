"""Checks of a game: each finds what it is for, with the place, and nothing in games that are right."""

import time

import numpy as np
import pytest

import outlast
from outlast.components import Phase, Reward, Side
from outlast.ecs import Array, Clock, Module, Observation, Random, Read, Rows, Write, column
from outlast.ecs.kernels.random import uniform
from outlast.envs.api.check import CHECKS
from outlast.envs.cli.main import main
from tests.conftest import COMPILED
from tests.helpers.mechanics import kind


class Gauge(Observation):
    gauge: Array = column("f4", "agents", 2)


Gauges = kind("Gauges", singletons=[Gauge()], bounds=lambda self, layout: {"gauge": (0, 1)})
Beyond, Unpaid = kind("Beyond", Gauges), kind("Unpaid")
Late = kind("Late", Gauges)  # what it does is seen only in ticks that no trial takes
Timed = kind("Timed", Gauges)  # by what is no part of the worlds
Wrapping = kind("Wrapping", Gauges)  # the clock's integers have no sign: numpy wraps below 0


@Beyond.system(Phase.OBSERVE)
def exceed(view: Write[Gauge], clock: Read[Clock], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        view.gauge[i, 0] = 0
        view.gauge[i, 1] = 7 if clock.tick[0] == 5 and i == 1 else 0


@Unpaid.system(Phase.REWARD, after=Reward)
def pay_nan(reward: Write[Reward], clock: Read[Clock]) -> None:
    if clock.tick[0] == 3:
        reward.reward[1] = np.nan


@Late.system(Phase.OBSERVE)
def draw_twice(view: Write[Gauge], clock: Read[Clock], key: Random) -> None:
    for i in range(view.gauge.shape[0]):
        view.gauge[i, 0] = uniform(key, 0 if clock.tick[0] == 25 else i)


@Timed.system(Phase.OBSERVE, compiled=False)
def look_at_the_clock(view: Write[Gauge], agents: Rows[Side]) -> None:
    view.gauge[:] = 1000 * time.perf_counter() % 1


@Wrapping.system(Phase.OBSERVE)
def wrap(view: Write[Gauge], clock: Read[Clock], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        view.gauge[i, 0] = max(0, min(1, clock.tick[0] - 2))


GAME = outlast.variant("ffa_3")


@pytest.mark.parametrize(
    ("mechanic", "found"),
    [
        (Beyond(), {"bounds": "gauge of agent 1 in world 0, step 5, is 7, and 0 to 1 is declared"}),
        (Unpaid(), {"finite": "reward of agent 1 in world 0, step 3, is nan"}),
        pytest.param(
            Wrapping(),
            {"python": "with wrapping.wrap as Python gauge of agent 0 in world 0, step 0, is 1, not 0"},
            marks=pytest.mark.skipif(not COMPILED, reason="both are Python"),
        ),
        (Late(), {"python": "draws at an index at which it has drawn already (0)"}),
        (
            Timed(),
            {
                "again": "in the same environment, reset to the same seed, gauge of agent 0 in world 0, step 0, is",
                "alone": "alone in its environment gauge of agent 0 in world 1, step 0, is",
                "state": "played on from a saved state gauge of agent 0 in world 0, step 31, is",
                "python": "with timed.look_at_the_clock as Python gauge of",
            },
        ),
    ],
)
def test_what_is_wrong_is_found(mechanic: Module, found: dict[str, str]) -> None:
    said = dict[str, str]()
    findings = outlast.check(GAME.with_(mechanic), worlds=2, steps=60, passed=said.__setitem__)
    assert [finding.check for finding in findings] == [*found]
    assert [*said] == [*CHECKS]
    for finding in findings:
        assert found[finding.check] in finding.text
        assert said[finding.check] == finding.text
        assert str(finding) == f"{finding.check}: {finding.text}"


@pytest.mark.parametrize("name", ["ffa_1", "teams_4"])
def test_nothing_is_found_in_games_that_are_right(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert outlast.check(name, worlds=3, steps=100) == []
    assert main(["check", name, "--worlds", "2", "--steps", "40"]) == 0
    assert capsys.readouterr().out.split() == [word for check in CHECKS for word in (check, "ok")]


def test_the_command_fails_where_something_is_found(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "ffa_1", "--with", f"{__file__}:Unpaid", "--worlds", "2", "--steps", "40"]) == 1
    assert "finite  reward of agent 1 in world 0, step 3, is nan" in capsys.readouterr().out
