"""Actions, observations and states in the forms that learners ask for, against those of the plain environment."""

import itertools
import math
from collections import Counter
from typing import Any

import gymnasium
import numpy as np
import pytest

import outlast
from outlast.components import Attack, Bag, Body, Health, Phase, Weapon
from outlast.ecs import Action, Entity, Read, Rows, Write, column, columns_of
from outlast.envs.core.observations import LIMIT
from outlast.envs.rollout.policies import STYLES, others_policy
from outlast.errors import ActionError, DeclarationError
from outlast.systems import DropLast, FineMotors, FineSteering, Respawn
from tests.conftest import COMPILED, digest, draw_actions, scaled
from tests.helpers.mechanics import kind, taking
from tests.helpers.own_bodies import Mine

TEAMS = outlast.variant("teams_3")
MASKED = {
    "teams_3": TEAMS.replace(melee_cooldown=4),
    "drop, agents that come back": outlast.variant("ffa_3")
    .with_(DropLast(offset=2.0), Respawn(ticks=5))
    .replace(ending_rule="never", ending_limit=150, melee_damage=60, melee_cooldown=3),
    "one bag each": TEAMS.replace(give_last_passes_on=False, melee_damage=50),
    "steering": outlast.variant("teams_3+steering").replace(melee_damage=50),
    "fine steering": TEAMS.with_(FineSteering()).replace(melee_damage=50),
    "counts vary": TEAMS.vary(n_agents=outlast.distributions.integers(2, 4)).replace(melee_damage=50),
}
OWN_BODIES = ("ball", "crate", "door")
JOINT = list(itertools.product(range(3), range(3), range(3), range(2), range(2), range(2)))  # the first counts most


def busy(env: Any, rng: np.random.Generator) -> Any:
    """Random actions that nearly always press every button, and seldom turn, so that agents meet."""
    actions = draw_actions(env, rng)
    actions[..., 3:] |= rng.random(actions[..., 3:].shape) < 0.7
    return actions


@pytest.mark.parametrize("name", MASKED)
@pytest.mark.by_day(2)
def test_what_is_masked_changes_no_bit(name: str) -> None:
    """Two batches, one of which does nothing wherever the mask says that this would be the same, stay equal."""
    worlds = scaled(64, 2)
    one, other = (outlast.make_vec(MASKED[name], worlds, seed=3, interpret=()) for _ in range(2))
    one.reset()
    other.reset()
    rng, masked, starts = np.random.default_rng(0), Counter[str](), np.cumsum([0, *one.action_sizes])
    for _ in range(scaled(300, 30)):
        masks, actions = one.action_masks(), busy(one, rng)
        assert np.array_equal(masks, other.action_masks())
        allowed = np.take_along_axis(masks, starts[:-1] + actions, 2)
        for (key, _), some in zip(one.action_columns, ~allowed.reshape(-1, len(one.noop)).T, strict=True):
            masked[key] += int(some.sum())
        one.step(actions)
        other.step(np.where(allowed, actions, other.noop))
        for env in (one, other):
            env.worlds.actions[...] = 0
        assert digest(one.worlds) == digest(other.worlds)
    if not COMPILED:
        return  # too few steps to meet every case
    buttons = {key for key, _ in one.action_columns} - {"attack", "ahead", "left", "turn"}
    assert buttons <= masked.keys()
    assert all(masked[key] for key in (*buttons, "ahead"))  # or the test says nothing


def test_masks_are_what_the_rules_say() -> None:
    env = outlast.make_vec(MASKED["teams_3"], 32, seed=0)
    env.reset()
    rng = np.random.default_rng(1)
    for _ in range(scaled(200, 20)):
        env.step(busy(env, rng))
    agents, masks = env.worlds.span("agent"), env.action_masks()
    dead = env.worlds[Entity].alive[:, agents] == 0
    waits, empty = env.worlds[Weapon].cooldown[:, agents] > 0, env.worlds[Bag].count[:, agents] == 0
    nothing = np.tile([False, True, False] * 3 + [True, False] * 3, (*dead.shape, 1))
    all_empty = np.broadcast_to(empty.all(1)[:, None], empty.shape)  # in the paper's runs gifts are passed on at once
    assert np.array_equal(masks[dead], nothing[dead])
    assert masks[~dead][:, :9].all()
    for at, idle in ((10, waits), (12, empty), (14, all_empty)):
        assert np.array_equal(masks[..., at], ~(dead | idle))
    assert masks[..., [1, 4, 7, 9, 11, 13]].all()


def test_a_mechanic_that_reads_an_action_has_a_say() -> None:
    """An action that another mechanic reads, too, is masked only where both say that it does nothing."""

    breath = kind("Breath")  # attacking heals, whether the weapon waits or not

    @breath.system(Phase.EFFECT, after="heals.heal")
    def breathe(health: Write[Health], attack: Read[Attack], agents: Rows[Weapon]) -> None:
        for i in range(agents.size):
            health.points[agents[i]] += attack.attack[i]

    try:
        env = outlast.make_vec(outlast.variant("ffa_1").with_(breath()).replace(melee_cooldown=50), 4, seed=0)
        env.reset()
        for _ in range(5):
            env.step(np.tile([1, 1, 1, 1, 1, 1], (4, 2, 1)))
        masks = env.action_masks()
        assert masks[..., 10].all()  # attack
        assert not masks[..., 12].any()  # use, of which nobody else knows
    finally:
        breath.registered.clear()


@pytest.mark.parametrize("count", [20, 21])
def test_masks_are_for_twenty_actions_at_most(count: int) -> None:
    columns = {f"button_{k}": column("i1", "agents", low=0, high=1) for k in range(count - 6)}
    buttons = type("Buttons", (Action,), columns | {"__annotations__": dict.fromkeys(columns, Any)})

    panel = kind("Panel", singletons=lambda self: [buttons()])
    panel.system(Phase.EFFECT)(taking("press", pressed=Read[buttons]))
    env = outlast.make_vec(TEAMS.with_(panel()), 2, seed=0)
    env.reset()
    assert len(env.noop) == count
    if count == 20:
        assert env.action_masks().shape == (2, 4, env.action_mask_size)
    else:
        with pytest.raises(DeclarationError, match=r"masks of 21 actions: at most 20 .*leave masks out"):
            env.action_masks()


@pytest.mark.parametrize("scenario", ["ffa_1", "teams_3"])
def test_joint_actions_are_those_of_their_digits(scenario: str) -> None:
    one, joint = (outlast.make_vec(scenario, 8, seed=1, actions=kind) for kind in ("multi", "joint"))
    assert joint.single_action_space == gymnasium.spaces.MultiDiscrete([216] * joint.num_agents)
    assert JOINT[int(joint.noop)] == tuple(one.noop)
    one.reset()
    joint.reset()
    rng = np.random.default_rng(0)
    for _ in range(scaled(100, 10)):
        masks = one.action_masks().reshape(-1, 15)
        starts = np.cumsum([0, *one.action_sizes])[:-1]
        naive = [[all(row[starts + np.array(digits)]) for digits in JOINT] for row in masks[:4]]
        assert np.array_equal(joint.action_masks().reshape(-1, 216)[:4], naive)
        numbers = rng.integers(0, 216, (8, joint.num_agents))
        one.step(np.array([[JOINT[k] for k in row] for row in numbers]))
        joint.step(numbers)
        assert digest(one.worlds) == digest(joint.worlds)


def nearest(number: float, size: int) -> int:
    """The value whose part of -1 to 1 the number is in, counted out."""
    return sum(number >= -1 + 2 * k / size for k in range(1, size))


@pytest.mark.parametrize("name", ["ffa_1", "steering", "fine motors"])
def test_continuous_actions_are_the_values_whose_parts_they_are_in(name: str) -> None:
    """Also at the ends, which are of the first and the last; `noop` and random policies give the middle of theirs."""
    scenario = outlast.variant("ffa_1").with_(FineMotors()) if name == "fine motors" else MASKED.get(name, name)
    one, free = (outlast.make_vec(scenario, 8, seed=1, actions=kind) for kind in ("multi", "continuous"))
    shape = free.num_agents, len(one.noop)
    assert free.single_action_space == gymnasium.spaces.Box(-1, 1, shape, np.float32)
    assert [nearest(*pair) for pair in zip(free.noop, one.action_sizes, strict=True)] == one.noop.tolist()
    one.reset()
    free.reset()
    rng, policies = np.random.default_rng(0), [outlast.policies.random_policy(env) for env in (one, free)]
    for t in range(scaled(100, 12)):
        if t % 3 == 0:
            acted, given = (policy({}) for policy in policies)
        else:
            given = rng.uniform(-1, 1, (8, *shape)) if t % 3 == 1 else rng.choice([-1, 0, 1], (8, *shape))
            given = given.astype(rng.choice(["f4", "f8"]))
            acted = np.array([[[*map(nearest, row, one.action_sizes)] for row in world] for world in given])
        one.step(acted)
        free.step(given)
        assert digest(one.worlds) == digest(free.worlds)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.full((2, 2, 6), 1.01), r"action 0 \(ahead\) of agent 0 in world 0 is 1.01: -1 to 1 is allowed; numpy.clip"),
        (np.full((2, 2, 6), np.nan), r"action 0 \(ahead\) of agent 0 in world 0 is nan: -1 to 1 is allowed"),
        (np.ones((2, 2, 6), int), "actions are int64: floats are needed"),
        (np.zeros((2, 2)), r"actions have shape \(2, 2\): \(worlds, agents, actions\) = \(2, 2, 6\) is needed"),
    ],
)
@pytest.mark.parametrize("check", [True, False])
def test_continuous_actions_that_cannot_be_are_refused(given: Any, message: str, check: bool) -> None:
    env = outlast.make_vec("ffa_1", 2, seed=0, actions="continuous", check_actions=check)
    env.reset()
    before = digest(env.worlds)
    with pytest.raises(ActionError, match=message):
        env.step(given)
    with pytest.raises(ValueError, match="action masks exist for discrete actions only"):
        env.action_masks()
    with pytest.raises(ValueError, match="action masks exist for discrete actions only"):
        env.step(np.zeros((2, 2, 6)), out={"action_mask": np.empty((2, 2, 0), bool)})
    assert digest(env.worlds) == before


def test_actions_of_many_values_are_drawn_and_left_alone() -> None:

    aim = type("Aim", (Action,), {"bearing": column("i1", "agents", low=-127, high=127)})
    turret = kind("Turret", singletons=lambda self: [aim()])
    turret.system(Phase.EFFECT)(taking("turn", aimed=Read[aim]))
    many = outlast.make_vec(outlast.variant("ffa_2").with_(turret(), FineMotors()), 2048, seed=0)
    seen, _ = many.reset()
    names = [key for key, _ in many.action_columns]
    for policy in (outlast.policies.random_policy(many), others_policy("random", many, [0, 1])):
        for drawn, size in zip(np.moveaxis(policy(seen), -1, 0), many.action_sizes, strict=True):
            counts = np.bincount(drawn.ravel(), minlength=size)
            assert len(counts) == size
            assert ((counts - counts.mean()) ** 2 / counts.mean()).sum() < size + 6 * math.sqrt(2 * size)
    for style in STYLES:
        assert (getattr(outlast.policies, f"{style}_policy")(many)(seen)[..., names.index("bearing")] == 127).all()


@pytest.mark.parametrize("scale", [False, True])
@pytest.mark.parametrize("name", ["ffa_2", "teams_4", "counts vary", "alone"])
def test_forms_of_observations_hold_the_same(name: str, scale: bool) -> None:
    """Flat rows are the keys one behind the other, as gymnasium flattens them; scaled ones are what scaled() makes."""
    scenario: Any = outlast.variant("ffa_3").replace(n_agents=1) if name == "alone" else MASKED.get(name, name)
    options: Any = [{}, {"scaled": scale}, {"scaled": scale, "observations": "flat"}]
    plain, by_key, flat = envs = [outlast.make_vec(scenario, 4, seed=2, **each) for each in options]
    for env in envs:
        env.reset()
    boxes: Any = by_key.single_observation_space
    agent = gymnasium.spaces.Dict({key: gymnasium.spaces.Box(box.low[0], box.high[0]) for key, box in boxes.items()})
    for _ in range(scaled(40, 8)):
        actions = draw_actions(plain, np.random.default_rng(0))
        seen, own, rows = (env.step(actions)[0] for env in envs)
        wanted = outlast.adapters.scaled(seen, plain.fields) if scale else seen
        for key, box in boxes.items():
            assert np.array_equal(np.clip(wanted[key], box.low, box.high) if scale else wanted[key], own[key])
        for i in range(flat.num_agents):
            assert np.array_equal(gymnasium.spaces.flatten(agent, {key: a[3, i] for key, a in own.items()}), rows[3, i])
        assert by_key.observation_space.contains(own)
        assert flat.observation_space.contains(rows)
        for env, got in ((by_key, own), (flat, {"": rows})):
            room = {key: np.empty_like(array) for key, array in got.items()}
            env.observe(out=room.get("", room))
            assert {key: array.tobytes() for key, array in room.items()} == {k: a.tobytes() for k, a in got.items()}
    assert not scale or flat.single_observation_space.is_bounded()
    assert len(flat.flat_names) == flat.flat_size == len(set(flat.flat_names))


def test_names_of_columns_lead_to_their_numbers() -> None:
    env = outlast.make_vec(TEAMS.with_(Mine()), 3, seed=0, observations="flat")
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(scaled(60, 10)):
        seen, *_ = env.step(draw_actions(env, rng))
    body, state, span = env.worlds[Body], env.state(), env.worlds.span
    rows = {"agent_3": 3, "box_5": span("box").start + 5, **{f"{kind}_0": span(kind).start for kind in OWN_BODIES}}
    for name in ("x", "y", "angle"):
        places, here = getattr(body, name), env.worlds[Entity].alive == 1
        own = np.where(here[:, :4], places[:, :4], 0)
        assert np.array_equal(seen[..., env.flat_names.index(f"own.{name}")], own)
        for thing, row in rows.items():
            assert np.array_equal(state[:, env.state_names.index(f"{thing}.{name}")], places[:, row] * here[:, row])
    assert all((state[:, env.state_names.index(f"{kind}_0.stands")] == 1).all() for kind in OWN_BODIES)
    assert len(env.state_names) == env.state_space.shape[0] == len(set(env.state_names))
    assert not any(name.startswith("wall_") for name in env.state_names)
    assert env.state_space.contains(state[0])


def test_scaled_states_are_states_divided_by_their_scales() -> None:
    plain, scale = (outlast.make_vec(TEAMS, 4, seed=0, scaled=each) for each in (False, True))
    for env in (plain, scale):
        env.reset()
        rng = np.random.default_rng(0)
        for _ in range(scaled(30, 5)):
            env.step(draw_actions(env, rng))
    angle = np.array([name.endswith("angle") for name in plain.state_names])
    raw = plain.state()
    raw[:, angle] = np.remainder(raw[:, angle] + math.pi, math.tau) - math.pi
    divided = np.clip(raw / plain._global_state.scale, scale.state_space.low, scale.state_space.high)
    assert np.array_equal(scale.state(), divided)
    assert scale.state_space.contains(scale.state()[0])
    assert np.isfinite([scale.state_space.low, scale.state_space.high]).all()
    assert abs(scale.state()).max() <= LIMIT


def test_a_step_writes_into_memory_of_the_callers() -> None:
    torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
    plain, env = (outlast.make_vec("teams_3", 4, seed=0, observations=kind) for kind in ("flat", "flat"))
    plain.reset()
    env.reset()
    out = {
        "observations": torch.zeros(4, 4, env.flat_size),
        "rewards": np.zeros((4, 4), np.float32),
        "terminated": torch.zeros(4, dtype=torch.bool),
        "truncated": np.zeros(4, bool),
        "state": torch.zeros(4, *env.state_space.shape),
        "action_mask": torch.zeros(4, 4, 15, dtype=torch.bool),
    }
    rng = np.random.default_rng(0)
    for _ in range(scaled(60, 10)):
        actions = draw_actions(plain, rng)
        wanted, got = plain.step(actions), env.step(torch.from_numpy(actions), out=out)
        for name, values, given in zip(("observations", "rewards", "terminated", "truncated"), wanted, got):
            assert given is out[name]
            assert np.array_equal(given, values)
        assert np.array_equal(out["state"], plain.state())
        assert np.array_equal(out["action_mask"], plain.action_masks())
    space = outlast.make_vec("teams_3", 4).observation_space
    by_key = {key: torch.zeros(box.shape) for key, box in space.items()}
    seen = env.step(actions, out={"observations": by_key})[0]
    assert seen is by_key
    assert all(np.array_equal(by_key[key], array) for key, array in env._reader.views.items())


def test_joint_actions_out_of_range_are_named() -> None:
    env = outlast.make_vec("ffa_1", 2, seed=0, actions="joint")
    env.reset()
    with pytest.raises(ActionError, match="action 0 of agent 1 in world 0 is 216: 0 to 215 is allowed"):
        env.step(np.array([[0, 216], [0, 0]]))
    with pytest.raises(ActionError, match="action 0 of agent 1 in world 0 is -56: 0 to 215"):  # 200 in eight bits
        env.step(np.array([[0, -56], [0, 0]], np.int8))


def test_numbers_are_divided_by_their_scales_and_angles_wrapped() -> None:
    env = outlast.make_vec("teams_4", 16, seed=0)
    env.reset()
    for actions in (draw_actions(env, np.random.default_rng(k)) for k in range(30)):
        observations, *_ = env.step(actions)
    own = env.fields["own"]
    places, angle, number = (columns_of(own, *names) for names in (("x", "y"), ("angle",), ("id",)))
    observations["own"][0, 0, angle] = 50 * math.tau + 1
    before = {key: values.copy() for key, values in observations.items()}
    seen = outlast.adapters.scaled(observations, env.fields)
    np.testing.assert_allclose(seen["own"][..., places], before["own"][..., places] / 12.5)
    assert seen["own"][0, 0, angle] == pytest.approx(1 / math.pi, abs=1e-5)
    assert (seen["own"][..., number] == before["own"][..., number]).all()
    assert max(np.abs(seen[key]).max() for key in ("zone", "others", "heals", "boxes")) < 4  # ids up to 3
    for key, values in observations.items():
        np.testing.assert_array_equal(values, before[key])  # it makes copies
        assert (seen[key].dtype, seen[key].shape) == (np.float32, values.shape)
        assert (seen[key] is values) == key.endswith("_mask")
        assert key in ("own", "others") or ((seen[key] == 0) == (values == 0)).all()


@pytest.mark.parametrize("copy", [True, False])
def test_lists_of_rows_are_what_masks_leave_of_the_padded_ones(copy: bool) -> None:
    envs = [
        outlast.make_vec(TEAMS, 8, seed=1, copy=copy, autoreset_mode="SameStep", observations=form, scaled=copy)
        for form in ("dict", "rows")
    ]
    rng, ended = np.random.default_rng(0), 0

    def check(padded: Any, lists: Any, agents: tuple[int, ...]) -> None:
        for key, values in padded.items():
            if (mask := padded.get(f"{key}_mask")) is None:
                assert key.endswith("_mask") or np.array_equal(lists[key], values)
                continue
            *who, index = np.nonzero(mask)
            assert np.array_equal(lists[key], values[mask > 0])
            assert np.array_equal(lists[f"{key}_owner"], np.ravel_multi_index(who, agents))
            assert np.array_equal(lists[f"{key}_index"], index)
            assert np.array_equal(np.diff(lists[f"{key}_start"]), mask.reshape(-1, mask.shape[-1]).sum(1))

    results = [env.reset() for env in envs]
    for _ in range(500):
        check(results[0][0], results[1][0], (8, 4))
        actions = busy(envs[0], rng)
        results = [env.step(actions) for env in envs]
        for padded, lists in zip(*(result[-1].get("final_obs", ()) for result in results), strict=True):
            if padded is not None:
                check(padded, lists, (4,))
                ended += 1
    assert ended > 3
    assert results[1][0]["heals"].flags.writeable == copy


def test_lists_of_rows_are_refused_where_shapes_are_fixed() -> None:
    env = outlast.make_vec(TEAMS, 2, observations="rows")
    assert env.single_observation_space == outlast.make_vec(TEAMS, 2).single_observation_space
    env.reset()
    rows = {"observations": "rows"}
    for make in (
        lambda: outlast.adapters.make_agents(TEAMS, num_worlds=2, **rows),
        lambda: outlast.adapters.parallel_env(TEAMS, **rows),
        lambda: env.observe(out={}),
    ):
        with pytest.raises(ValueError, match="fixed shapes are needed here; take 'dict' or 'flat'"):
            make()
