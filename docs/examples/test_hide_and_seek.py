"""Tests of hide_and_seek.py. Run it: python -m pytest docs/examples/test_hide_and_seek.py."""

import math

import numpy as np
import pytest
from hide_and_seek import HIDE_AND_SEEK, PREPARATION, Handled, Handling

import outlast
from outlast.components import Body, Health, Solid, Weld
from outlast.ecs import NumberError, columns_of

AHEAD, IDLE, GRAB, DRAG, LOCK, UNLOCK = (
    (6, 3, 3, 0, 1), (3, 3, 3, 0, 1), (3, 3, 3, 1, 1), (0, 3, 3, 1, 1), (3, 3, 3, 0, 2), (3, 3, 3, 0, 0),
)  # fmt: skip
OPEN = HIDE_AND_SEEK.without("walls").replace(cameras_fov=math.pi, preparation_ticks=0)


def placed(*places, boxes=(), scenario=OPEN, **numbers):
    """One world, after a tick: agents are at these places and boxes at those, facing +x; other boxes are far away."""
    env = outlast.make_vec(scenario.replace(boxes_height=0.8, **numbers), 1, seed=0)
    env.reset()
    body, (agents, own) = env.worlds[Body], (env.worlds.span(kind) for kind in ("agent", "box"))
    far = [(8, y) for y in (-5, -3, 3, 5)]
    body.x[0, agents], body.y[0, agents] = np.transpose(places)
    body.x[0, own], body.y[0, own] = np.transpose([*boxes, *far][: own.stop - own.start])
    for column, value in (("angle", 0), ("cosine", 1), ("sine", 0)):
        getattr(body, column)[0] = value
    step(env)  # agents look around, as they can only handle what they see
    return env, body, agents.start, own.start


def step(env, *actions):
    """A tick in which the first agents do this, and all others nothing."""
    return env.step(np.array([[*actions, *[IDLE] * (env.num_agents - len(actions))]]))


ASIDE = ((-5, 3), (6, 0), (6, 1.5))


def test_a_held_box_follows_until_it_is_let_go():
    env, body, me, box = placed((0, 0), *ASIDE, boxes=[(1.8, 0)])  # its left end is 0.2 m from the agent's rim
    observations, *_ = step(env, GRAB)
    assert env.worlds[Weld].other[0, me] == box
    assert env.worlds[Handled].holder[0, box] == me
    fields = env.fields
    assert observations["own"][0, :, columns_of(fields["own"], "holds")].ravel().tolist() == [1, 0, 0, 0]
    assert observations["boxes"][0, 0, :, columns_of(fields["boxes"], "held")].ravel().tolist() == [1, 0, 0, 0]
    for _ in range(30):
        step(env, DRAG)
    assert body.x[0, me] < -2
    assert body.x[0, box] - body.x[0, me] == pytest.approx(1.8, abs=0.01)
    step(env, IDLE)
    assert env.worlds[Handled].holder[0, box] == -1
    for _ in range(30):
        step(env, (0, 3, 3, 0, 1))
    assert body.x[0, box] - body.x[0, me] > 2.5


def test_a_held_box_turns_with_its_holder():
    env, body, me, box = placed((0, 0), *ASIDE, boxes=[(1.8, 0)])
    for _ in range(30):
        step(env, (3, 3, 6, 1, 1))
    x, y = body.x[0, box] - body.x[0, me], body.y[0, box] - body.y[0, me]
    assert body.angle[0, me] > 0.5
    assert math.atan2(y, x) == pytest.approx(body.angle[0, me], abs=0.2)
    assert body.angle[0, box] == pytest.approx(body.angle[0, me], abs=0.2)


def test_what_is_out_of_reach_held_or_locked_is_not_grabbed():
    env, _, me, _ = placed((0, 0), *ASIDE, boxes=[(2.3, 0)])  # 0.7 m from the agent's rim
    step(env, GRAB)
    assert env.worlds[Weld].other[0, me] == -1
    env, _, me, box = placed((0, 0), (3.6, 0), *ASIDE[1:], boxes=[(1.8, 0)])
    step(env, GRAB, GRAB)
    assert env.worlds[Weld].other[0, me : me + 2].tolist() == [box, -1]
    env, _, me, box = placed((0, 0), *ASIDE, boxes=[(1.8, 0), (0, -1.4)])
    step(env, LOCK)
    step(env, GRAB)  # the nearest box is locked, so the next one is grabbed
    assert env.worlds[Weld].other[0, me] == box + 1


def test_agents_handle_what_they_see():
    # the seeker, agent 2, looks away from the box
    env, body, me, box = placed((0, 0), (-5, 3), (3.6, 0), (6, 1.5), boxes=[(1.8, 0)])
    step(env, IDLE, IDLE, LOCK)
    step(env, IDLE, IDLE, GRAB)
    assert env.worlds[Handled].locked_by[0, box] == env.worlds[Handled].holder[0, box] == -1
    body.angle[0, me + 2], body.cosine[0, me + 2] = math.pi, -1
    step(env)
    step(env, IDLE, IDLE, LOCK)
    assert env.worlds[Handled].locked_by[0, box] == 1


def test_seekers_who_may_not_look_handle_nothing():
    waits = {"scenario": OPEN.replace(cameras_fov=math.pi), "preparation_ticks": 10}
    env, body, me, box = placed((-5, 0), (-5, 3), (3.6, 0), (6, 1.5), boxes=[(1.8, 0)], **waits)
    body.angle[0, me + 2], body.cosine[0, me + 2] = math.pi, -1
    for _ in range(9):
        step(env, IDLE, IDLE, LOCK)
        assert env.worlds[Handled].locked_by[0, box] == -1
    step(env, IDLE, IDLE, LOCK)
    assert env.worlds[Handled].locked_by[0, box] == 1


def test_holding_moves_nobody():
    """Not even a box that is held where it overlaps its holder, which contacts push apart in every tick."""
    env, body, me, box = placed((0, 0), *ASIDE, boxes=[(1.8, 0)])
    body.x[0, box] = 1.5
    for _ in range(200):
        step(env, GRAB)
        assert env.worlds[Weld].other[0, me] == box
    assert abs(body.x[0, [me, box]] - [0, 1.5]).max() < 0.3


def test_one_box_can_be_locked_and_unlocked_by_all_in_one_tick():
    env, body, me, box = placed((0, 0), (1.8, 1.2), (3.6, 0), (1.8, -1.2), boxes=[(1.8, 0)], boxes_count=1)
    for e, angle in enumerate((0, -math.pi / 2, math.pi, math.pi / 2)):
        body.angle[0, me + e], body.cosine[0, me + e], body.sine[0, me + e] = angle, math.cos(angle), math.sin(angle)
    step(env)
    step(env, LOCK, UNLOCK, LOCK, UNLOCK)
    assert env.events()["box_locked"]["locked"].tolist() == [1, 0, 1, 0]
    assert env.worlds[Handled].locked_by[0, box] == -1


def test_the_dead_have_no_hands():
    env = outlast.make_vec(outlast.variant("teams_3").replace(boxes_dynamic=True).with_(Handling()), 1, seed=0)
    env.reset()
    env.worlds[Health].points[0, 0] = 0
    env.step(np.tile(env.noop, (1, 4, 1)))
    masks = env.action_masks()[0]
    first = np.concatenate([[0], env.action_sizes[:-1]]).cumsum()
    names = [key for key, _ in env.action_columns]
    grab, lock = (first[names.index(name)] for name in ("grab", "lock"))
    for agent, free in ((0, False), (1, True)):
        assert masks[agent, grab : grab + 2].tolist() == [True, free]
        assert masks[agent, lock : lock + 3].tolist() == [free, True, free]


def test_a_locked_box_stands_until_its_side_unlocks_it():
    env, body, me, box = placed((0, 0), (-5, 3), (3.6, 0), (6, 1.5), boxes=[(1.8, 0)])
    body.angle[0, me + 2], body.cosine[0, me + 2] = math.pi, -1  # now the seeker looks at the box
    step(env)
    observations, *_ = step(env, GRAB, IDLE, LOCK)  # a seeker locks what a hider holds
    (event,) = env.events()["box_locked"]
    assert (event["agent"], event["box"], event["locked"]) == (me + 2, box, 1)
    assert env.worlds[Weld].other[0, me] == -1
    locked = columns_of(env.fields["boxes"], "locked")
    assert observations["boxes"][0, [0, 2], 0, locked].ravel().tolist() == [-1, 1]
    for action in (AHEAD, UNLOCK, LOCK):
        for _ in range(20):
            step(env, action)
        assert (body.x[0, box], body.y[0, box]) == (pytest.approx(1.8), 0)
        assert env.worlds[Solid].dynamic[0, box] == 0
    step(env, IDLE, IDLE, UNLOCK)
    for _ in range(20):
        step(env, AHEAD)
    assert body.x[0, box] > 1.9


def test_locks_end_with_the_episode():
    env, _, _, box = placed((0, 0), *ASIDE, boxes=[(1.8, 0)])
    step(env, LOCK)
    env.reset()
    assert env.worlds[Solid].dynamic[0, box] == 1
    assert env.worlds[Handled].locked_by[0, box] == -1


def test_a_lock_breaks_with_its_box():
    env, _, me, box = placed((0, 0), *ASIDE, boxes=[(1.8, 0)])
    step(env, LOCK)
    env.worlds[Health].points[0, box] = 0
    step(env, IDLE)
    step(env, GRAB)
    assert env.worlds[Handled].locked_by[0, box] == -1
    assert env.worlds[Solid].dynamic[0, box] == 1
    assert env.worlds[Weld].other[0, me] == -1


def test_boxes_that_cannot_be_moved_are_refused():
    for scenario in (HIDE_AND_SEEK.replace(boxes_dynamic=False), outlast.variant("teams_3").with_(Handling())):
        with pytest.raises(NumberError, match="handling: no box can be moved; set boxes_dynamic=True"):
            outlast.make_vec(scenario, 1)
    with pytest.raises(NumberError, match="hide_and_seek: two sides are needed"):
        outlast.make_vec(HIDE_AND_SEEK.replace(teams_count=4, teams_sizes=()), 1)


def test_sides_are_paid_by_who_is_seen():
    hidden, seen = ((-5, 0), (-5, 1.2)), ((0, 0), (-5, 3))
    for places, boxes, pays in ((hidden, [(-3, 0.6)], 0.1), (seen, [], -0.1)):
        env, *_ = placed(*places, (5, 0.6), (5, -4), boxes=boxes, boxes_width=0.5 if pays < 0 else 2.2)
        body = env.worlds[Body]
        body.angle[0, 2:4], body.cosine[0, 2:4] = math.pi, -1  # seekers look to the left
        if boxes:  # an upright box that is so long that it hides both
            env.worlds[outlast.components.Shape].half_height[0, env.worlds.span("box").start] = 4
        reward = step(env)[1]
        assert reward[0] == pytest.approx([pays, pays, -pays, -pays])


def test_nobody_is_paid_before_seekers_may_look():
    env = outlast.make_vec(HIDE_AND_SEEK, 8, seed=0)
    env.reset()
    policy = outlast.random_policy(env)
    for tick in range(1, 301):
        _, reward, _, truncated, info = env.step(policy(None))
        assert (reward.sum(1) == 0).all()
        assert (reward != 0).all() == (tick > PREPARATION)
    assert truncated.all()
    hidden = (info["statistics"]["return"][:, 0] / 0.1 + 200) / 2
    assert info["statistics"]["ticks_seen"] == pytest.approx(200 - hidden, abs=1e-3)


def test_locked_and_held_boxes_are_drawn():
    env, *_ = placed((0, 0), *ASIDE, boxes=[(1.8, 0)])
    pictures = [outlast.draw(env.worlds, 0, 240)]
    for action in (GRAB, LOCK):
        step(env, action)
        pictures.append(outlast.draw(env.worlds, 0, 240))
    assert (pictures[0] != pictures[1]).any()
    assert (pictures[1] != pictures[2]).any()
