"""Tests of the small games of the gallery. Run them: python -m pytest docs/examples/test_gallery.py."""

import numpy as np
import pytest
from button import BUTTON
from conveyor import CONVEYOR
from ferry import FERRY
from football import FOOTBALL
from ice import ICE
from key import KEY_AND_DOOR
from mine import MINES
from spring import SPRING
from team_wall import TEAM_WALL
from teleporter import TELEPORTER
from turret import TURRET

import outlast
from outlast.components import Body, Outcome, Sight
from outlast.components.sight import is_set
from outlast.ecs import Entity

STAY, AHEAD, BACK, LEFT = (1, 1, 1), (2, 1, 1), (0, 1, 1), (1, 2, 1)
GAMES = [BUTTON, CONVEYOR, FERRY, FOOTBALL, ICE, KEY_AND_DOOR, MINES, SPRING, TEAM_WALL, TELEPORTER, TURRET]


def made(scenario, worlds=1):
    """Worlds at the start of an episode."""
    env = outlast.make_vec(scenario, worlds, seed=0)
    env.reset()
    return env, env.worlds[Body], env.worlds.span


def play(env, ticks, *actions):
    """Ticks in which the agents do this."""
    for _ in range(ticks):
        step = env.step(np.array([actions] * env.num_worlds))
    return step


@pytest.mark.parametrize("scenario", GAMES, ids=lambda scenario: scenario.name)
def test_nothing_is_wrong_with_it(scenario):
    assert outlast.check(scenario) == []


@pytest.mark.parametrize("scenario", GAMES[:4], ids=lambda scenario: scenario.name)
def test_a_game_without_hit_points_has_nothing_of_the_survival_game(scenario):
    env = made(scenario)[0]
    assert "health" not in {*env.fields["own"], *env.fields["others"]}
    assert not {"heals", "boxes", "zone", "heal_slot", "box_slot"} & {*env.fields}
    info = play(env, 300, *[STAY] * env.num_agents)[-1]
    assert {*info["statistics"]} <= {"length", "return", "outcome"}


def test_a_goal_pays_one_side_and_costs_the_other():
    env, body, _ = made(FOOTBALL)
    ball = env.place("ball", x=6.9, y=0.5, vx=4.0)
    env.place("agent", 0, x=0, y=3)
    paid = np.zeros(4)
    for _ in range(60):
        paid += play(env, 1, *[STAY] * 4)[1][0]
    assert paid.tolist() == [1, 1, -1, -1]
    assert env.worlds[Outcome].outcome[0].tolist() == [1, 0]
    assert abs(body.x[0, ball]) < 1
    env.place("ball", x=6.9, y=4.0, vx=4.0)  # beside the goal it bounces off
    play(env, 60, *[STAY] * 4)
    assert body.x[0, ball] < 6.9
    assert env.worlds[Outcome].outcome[0].tolist() == [1, 0]


def test_an_agent_pushes_the_ball():
    env, body, span = made(FOOTBALL)
    for i in range(4):
        env.place("agent", i, x=-2 if i == 0 else 6, y=0 if i == 0 else 2.0 * i, angle=0)
    ball, fields, farthest = span("ball").start, env.fields["own"], 0.0
    for _ in range(40):
        own = play(env, 1, AHEAD, STAY, STAY, STAY)[0]["own"][0, 0]
        assert own[fields["ball_x"].start] == pytest.approx(body.x[0, ball] - body.x[0, 0])
        farthest = max(farthest, body.x[0, ball])
    assert farthest > 1


def test_a_belt_carries_what_stands_on_it():
    env, body, _ = made(CONVEYOR)
    for y, way in ((0.0, 1.5), (3.0, 0.0)):
        env.place("agent", x=-3, y=y)
        play(env, 30, STAY)
        assert body.x[0, 0] == pytest.approx(-3 + way, abs=0.01)


def test_a_door_opens_while_the_button_is_pressed():
    env, body, span = made(BUTTON)
    door = span("door").start
    env.place("agent", 1, x=-3, y=2)
    env.place("agent", 0, x=-4, y=0, angle=0)
    play(env, 60, STAY, STAY)
    assert body.y[0, door] == pytest.approx(2.0, abs=0.05)
    play(env, 60, AHEAD, STAY)
    assert body.x[0, 0] > 1
    env.place("agent", 1, x=-3, y=-4)
    play(env, 90, AHEAD, STAY)
    assert body.y[0, door] == pytest.approx(0.0, abs=0.05)
    play(env, 90, BACK, STAY)
    assert body.x[0, 0] == pytest.approx(0.6, abs=0.05)


def test_only_who_has_the_key_passes_the_door():
    env, body, span = made(KEY_AND_DOOR)
    env.place("agent", x=-4, y=0, angle=0)
    play(env, 90, AHEAD)
    assert body.x[0, 0] == pytest.approx(-0.6, abs=0.05)
    env.place("agent", x=-3.5, y=3, angle=0)
    own = play(env, 90, AHEAD)[0]["own"][0, 0]
    assert body.x[0, 0] > 3
    assert own[env.fields["own"]["key"].start] == 1
    assert not env.worlds[Entity].alive[0, span("key")].any()


def test_a_ferry_carries_who_stands_on_it():
    env, body, span = made(FERRY)
    platform = span("platform").start
    env.place("agent", x=0.5, y=0.5)
    for _ in range(250):
        play(env, 1, STAY)
        assert body.x[0, 0] - body.x[0, platform] == pytest.approx(0.5, abs=0.01)
        assert abs(body.x[0, platform]) < 3.1
    env.place("agent", x=0.5, y=3)
    play(env, 30, STAY)
    assert body.x[0, 0] == pytest.approx(0.5, abs=1e-4)


def test_nothing_slows_down_on_ice():
    env, body, _ = made(ICE)
    speeds = []
    for x in (1.0, -5.0):
        env.place("agent", x=x, y=0, vx=2.0)
        play(env, 30, STAY)
        speeds.append(body.vx[0, 0])
    assert speeds[0] == pytest.approx(2.0, rel=1e-3)
    assert speeds[1] < 0.2


def test_a_mine_throws_back_who_comes_near():
    env, body, _ = made(MINES.replace(mines_count=1))
    mine = env.place("mine", x=0, y=0)
    env.place("agent", x=-2, y=0, angle=0)
    play(env, 10, STAY)
    assert env.worlds[Entity].alive[0, mine]
    env.place("agent", x=-0.9, y=0, angle=0)
    play(env, 30, STAY)
    assert not env.worlds[Entity].alive[0, mine]
    assert body.x[0, 0] < -2.5
    assert outlast.check(MINES.replace(mines_count=0)) == []


def test_a_spring_pulls_two_agents_together():
    env, body, _ = made(SPRING)
    env.place("agent", 0, x=-2, y=0)
    env.place("agent", 1, x=2, y=0)
    play(env, 150, STAY, STAY)
    assert body.x[0, 1] - body.x[0, 0] == pytest.approx(2.0, abs=0.05)


def test_one_team_passes_its_wall_and_all_see_through_glass():
    env, body, _ = made(TEAM_WALL)
    for i in range(2):
        env.place("agent", i, x=0, y=3.0 * i - 1, angle=0)
    play(env, 90, AHEAD, AHEAD)
    assert body.x[0, 0] > 4
    assert body.x[0, 1] == pytest.approx(1.4, abs=0.05)
    env.place("agent", 0, x=-4, y=0, angle=0)
    env.place("agent", 1, x=0, y=0)
    play(env, 1, STAY, STAY)
    assert is_set(env.worlds[Sight].visible[0], 0, 1)
    play(env, 90, AHEAD, STAY)
    assert body.x[0, 0] == pytest.approx(-2.55, abs=0.05)


def test_a_teleporter_leads_there_and_back():
    env, body, _ = made(TELEPORTER)
    env.place("agent", x=-4, y=-4)
    play(env, 1, STAY)
    assert (body.x[0, 0], body.y[0, 0]) == (4, 4)
    play(env, 20, STAY)  # it stays there until it leaves the pad
    assert body.x[0, 0] == 4
    env.place("agent", x=0, y=0)
    play(env, 1, STAY)
    env.place("agent", x=4, y=4)
    play(env, 1, STAY)
    assert body.x[0, 0] == -4


def test_a_turret_aims_at_the_nearest_in_sight():
    env, body, span = made(TURRET)
    turret, crate = span("turret").start, env.place("crate", x=-2, y=0)
    env.place("agent", 0, x=-4, y=0)
    env.place("agent", 1, x=0, y=5)
    reward = play(env, 1, STAY, STAY)[1]
    assert reward[0].tolist() == pytest.approx([0, -0.1])  # the crate is cover
    assert body.sine[0, turret] == pytest.approx(1)
    env.place("crate", x=-2, y=4)
    reward = play(env, 1, STAY, STAY)[1]
    assert reward[0].tolist() == pytest.approx([-0.1, 0])
    assert env.query().distance(turret, crate) > 1
