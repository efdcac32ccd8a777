"""Policies: scripted styles, those in users' files, those with a memory, and environments of other forms."""

import importlib.util
import itertools
import math
import pickle
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import outlast
from outlast import Scenario
from outlast.components import Body
from outlast.ecs import columns_of
from outlast.envs.cli import main as cli
from outlast.envs.errors import ActionError, ScenarioError, UsageError
from outlast.envs.rollout.lineup import checked_entries, own_policy, parse_lineup
from outlast.envs.rollout.local import ticks
from outlast.envs.rollout.memory import told
from outlast.envs.rollout.policies import POLICIES
from outlast.systems import Boxes, Cameras, Heals, Lidar, Maze, SafeZone, Teams
from tests.conftest import run
from tests.helpers.execution_modes import short
from tests.helpers.remembering import Remembering

STYLES = ("scripted", "camper", "hunter", "hoarder", "healer")
BACK, STILL, AHEAD, LEFT = 0, 1, 2, 2  # of motors


def scene(env: Any, **rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What the one agent in the middle of a room observes that sees only these rows; the zone is around it."""
    seen = {key: np.zeros_like(array[:1, :1]) for key, array in env.reset(seed=0)[0].items()}
    zone = {"radius": 5.0, "next_radius": 4.0}
    for key, given in ({"own": [{"health": 100}], "zone": [zone]} | rows).items():
        for k, row in enumerate(given):
            for name, value in row.items():
                table = seen[key][0, 0] if key in ("own", "zone") else seen[key][0, 0, k]
                table[..., columns_of(env.fields[key], name)] = value
            if f"{key}_mask" in seen:
                seen[f"{key}_mask"][0, 0, k] = 1
    return seen


def decided(name: str, game: str, **rows: list[dict[str, Any]]) -> dict[str, int]:
    """What a style does there, by the name of the action."""
    env = outlast.make_vec(game, 1, seed=0)
    actions = POLICIES[name](env, 0)(scene(env, **rows))
    return dict(zip((key for key, _ in env.action_columns), actions[0, 0].tolist(), strict=True))


def enemy(x: float, y: float = 0.0) -> dict[str, Any]:
    return {"team": 1, "health": 100, "x": x, "y": y}


def mate(x: float, health: float) -> dict[str, Any]:
    return {"team": 0, "health": health, "x": x}


WEAK, HELD, BOX = [{"health": 20}], [{"amount": 75}], [{"vertices": 0.5}]
OUT = [{"health": 100, "x": 7.0}]  # metres: outside of the zone
SCENES: list[tuple[str, dict[str, Any], dict[str, int]]] = [
    ("scripted", {"others": [enemy(3)]}, {"ahead": AHEAD, "attack": 0}),
    ("camper", {"others": [enemy(3)]}, {"ahead": STILL, "left": STILL, "attack": 0, "use": 0}),
    ("camper", {"others": [enemy(2)]}, {"ahead": STILL, "attack": 1}),
    ("camper", {"heals": [{"x": 2.0}]}, {"ahead": AHEAD}),
    ("camper", {"heals": [{"x": 4.0}]}, {"ahead": STILL}),
    ("camper", {"boxes": [{"x": 4.0}]}, {"ahead": AHEAD, "attack": 1}),
    ("camper", {"boxes": [{"x": 1.0}]}, {"ahead": STILL, "attack": 0}),  # cover
    ("camper", {"boxes": [{"x": 4.0}], "box_slot": BOX}, {"ahead": STILL, "use": 0}),
    ("camper", {"others": [enemy(4)], "box_slot": BOX}, {"use": 1}),
    ("camper", {"others": [enemy(3, 3)], "box_slot": BOX}, {"use": 0}),  # not straight ahead
    ("hunter", {"others": [enemy(8)]}, {"ahead": AHEAD, "attack": 0}),
    ("hunter", {"others": [enemy(8)], "heals": [{"x": -2.0}]}, {"ahead": AHEAD}),
    ("hunter", {"others": [enemy(8)], "heals": [{"x": -2.0}], "own": WEAK}, {"ahead": BACK, "use": 0}),
    ("hunter", {"heal_slot": HELD, "own": [{"health": 60}]}, {"use": 0}),
    ("hunter", {"heal_slot": HELD, "own": WEAK}, {"use": 1}),
    ("hunter", {"others": [enemy(9)], "own": OUT}, {"ahead": AHEAD}),
    ("hunter", {"others": [enemy(9)], "own": [OUT[0] | WEAK[0]]}, {"ahead": BACK}),
    ("hoarder", {"others": [enemy(3)], "heals": [{"x": 6.0}]}, {"ahead": BACK, "attack": 0}),
    ("hoarder", {"others": [enemy(8)], "heals": [{"x": 6.0}]}, {"ahead": AHEAD}),
    ("hoarder", {"box_items": [{"y": 2.0}], "heals": [{"x": 6.0}]}, {"left": LEFT}),
    ("hoarder", {"heal_slot": HELD, "own": [{"health": 60}]}, {"use": 0}),
    ("hoarder", {"heal_slot": HELD, "own": WEAK}, {"use": 1}),
    ("hoarder", {"heal_slot": HELD, "heals": [{"x": 0.3}]}, {"use": 1}),  # it stays there: the bag is full
    ("healer", {"others": [mate(6, 100)]}, {"ahead": AHEAD, "give": 0}),
    ("healer", {"others": [mate(1.5, 50)], "heal_slot": HELD}, {"give": 1, "use": 0}),
    ("healer", {"others": [mate(1.5, 50)], "heal_slot": HELD, "own": WEAK}, {"give": 0, "use": 1}),
    ("healer", {"others": [mate(1.5, 100)], "heal_slot": HELD}, {"give": 0}),
    ("healer", {"others": [mate(1.5, 50)]}, {"give": 0}),
    ("healer", {"others": [enemy(1.5)], "heal_slot": HELD}, {"give": 0, "attack": 1}),
    *((name, {}, {"turn": LEFT}) for name in STYLES),  # who sees nobody turns around
]


@pytest.mark.parametrize(("name", "rows", "expected"), SCENES)
def test_what_a_style_does_in_a_scene(name: str, rows: dict[str, Any], expected: dict[str, int]) -> None:
    found = decided(name, "teams_3", **rows)
    assert {key: found[key] for key in expected} == expected


def test_without_teams_a_healer_heals_itself_early_and_gives_to_nobody() -> None:
    found = decided("healer", "ffa_2", own=[{"health": 85}], others=[{"health": 50, "x": 1.5}], heal_slot=HELD)
    assert (found["use"], found["give"]) == (1, 0)


def ablated_games() -> list[str]:
    """All variants, plain and with each ablation that would change something."""
    names = ["+".join(filter(None, pair)) for pair in itertools.product(outlast.VARIANTS, ("", *outlast.ABLATIONS))]
    return [name for name in names if not (name.startswith("ffa") and "team_share" in name)]


def other_games() -> list[outlast.Scenario]:
    hunt = outlast.variant("teams_3").with_(Teams(count=2, sizes=(1, 3)))
    return [
        outlast.variant("teams_3").without(Boxes, SafeZone),
        outlast.variant("ffa_3").without(Heals, Cameras),
        outlast.variant("ffa_3").without("inventory", "heals", "boxes", "give_last", "pickup", "death_drop"),
        outlast.variant("ffa_3+steering").with_(Maze(), Lidar()).vary(n_agents=outlast.distributions.integers(1, 4)),
        outlast.variant("teams_3").replace(cameras_mode="omniscient", n_agents=6),
        outlast.variant("teams_3").replace(cameras_mode="revealed"),
        hunt.roles(hunter=outlast.role(1, agents_health=300, motors_ahead=0.1), prey=outlast.role()),
    ]


@pytest.mark.parametrize("game", [*ablated_games(), *other_games()], ids=lambda game: getattr(game, "name", game))
@pytest.mark.by_day(8)
def test_styles_play_every_game(game: Any) -> None:
    env = outlast.make_vec(game, 3, seed=0)
    observations, _ = env.reset()
    for k, name in enumerate(STYLES * 8):
        act = POLICIES[name](env, 0)
        actions = act(observations)
        assert env.action_space.contains(actions.astype(env.action_space.dtype))
        few = {key: array[1:, -1:] for key, array in observations.items()}
        np.testing.assert_array_equal(act(few), actions[1:, -1:])  # whoever else is asked about
        if k > 0:
            np.testing.assert_array_equal(act({key: array[0] for key, array in observations.items()}), actions[0])
        observations = env.step(actions)[0]


@pytest.mark.parametrize("name", STYLES)
def test_agents_with_steering_turn_to_what_is_behind(name: str) -> None:
    """Their velocity is what they set; controlled like motors, they would turn to and fro."""
    env = outlast.make_vec(outlast.variant("ffa_2+steering").without("safe_zone", "heals"), 1, seed=0)
    env.reset()
    for k, x in enumerate((-8.0, 8.0)):  # back to back
        env.place("agent", k, x=x, y=0.0, angle=math.pi * (1 - k))
    act, body = POLICIES[name](env, 0), env.worlds[Body]
    env.step(np.tile(env.noop, (1, 2, 1)))
    begun = body.angle[0, 0].item()
    for _ in range(20):
        env.step(act(env.observe()))
    assert abs(body.angle[0, 0].item() - begun) > 1.5


def test_names_are_known_wherever_policies_are_named(capsys) -> None:
    names = ", ".join(POLICIES)
    assert set(STYLES) < set(POLICIES)
    assert all(getattr(outlast.policies, f"{name}_policy") is POLICIES[name] for name in STYLES)
    for command in ("rollout", "frames", "train", "evaluate"):
        with pytest.raises(SystemExit):
            cli.main((command, "--help"))
        assert names in " ".join(capsys.readouterr().out.split())


def test_a_policy_of_another_game_is_refused() -> None:
    one, other = outlast.make_vec("ffa_3", 2, seed=0), outlast.make_vec("teams_3", 2, seed=0)
    with pytest.raises(UsageError, match="are of another game than ffa_3, for which this policy was made"):
        outlast.rollout(other, outlast.policies.scripted_policy(one), steps=3)
    with pytest.raises(UsageError, match=r"as in scripted_policy\(env\), not for dict: give env.unwrapped"):
        outlast.rollout("ffa_3", outlast.policies.scripted_policy, steps=3)


TEXT = """
import numpy as np

def clever(env, seed):
    return lambda observations: np.full((env.num_worlds, env.num_agents, 6), seed % 2)

def plain(env):
    return lambda observations: np.tile(env.noop, (env.num_worlds, env.num_agents, 1))

def direct(observations):
    return np.ones((*observations["own"].shape[:2], 6), int)

def wrong(env, seed):
    return seed

number = 3
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch) -> str:
    """The path of a file with policies, of a name that no other test imports."""
    monkeypatch.syspath_prepend(tmp_path)  # which importing the file does, too
    path = tmp_path / f"mine_{tmp_path.name.replace('-', '_')}.py"
    path.write_text(TEXT)
    return str(path)


def test_texts_have_them_with_weights_where_whole_worlds_are_played(mine: str) -> None:
    assert parse_lineup(f"{mine}:clever:2,noop,{mine}:plain") == {f"{mine}:clever": 2, "noop": 1, f"{mine}:plain": 1}
    assert parse_lineup("my.games:clever:0.5") == {"my.games:clever": 0.5}
    # learners' opponents get the observations of some agents, whichever these are
    with pytest.raises(UsageError, match="self, past or a saved policy"):
        checked_entries([(f"{mine}:clever", 1)], ("self", "past"))


def test_commands_play_them_made_for_their_worlds_or_as_they_are(mine: str, capsys) -> None:
    words = ("--worlds", "4", "--quiet", "--set", "ending_limit=5")
    status, out, _ = run(capsys, "rollout", "ffa_2", "--policy", f"{mine}:clever", "--others", f"{mine}:plain", *words)
    assert status == 0
    assert out.splitlines()[-1].split()[:2] == [f"{mine}:plain", "4"]
    env = outlast.make_vec("ffa_2", 3, seed=0)
    observations, _ = env.reset()
    for name, seed, expected in (("clever", 1, 1), ("clever", 2, 0), ("plain", 0, env.noop), ("direct", 0, 1)):
        actions = np.asarray(own_policy(f"{mine}:{name}")(env, seed)(observations))
        np.testing.assert_array_equal(actions, np.broadcast_to(expected, (3, 2, 6)))


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("number", UsageError, "is 3: a policy, or a function \\(env, seed\\) that returns one, is needed"),
        ("absent", ScenarioError, "has no 'absent'"),
        ("wrong", UsageError, "returned 0: a function \\(observations\\) -> actions is needed"),
    ],
)
def test_what_is_no_policy_is_refused(mine: str, name: str, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        outlast.rollout("ffa_2", f"{mine}:{name}", worlds=2)


def ahead(observations: dict[str, np.ndarray]) -> np.ndarray:
    """A game's own policy: it runs straight ahead."""
    return np.stack([np.full(observations["own"].shape[:-1], level) for level in (2, 1, 1, 0, 0, 0)], -1)


def ahead_here(env: Any) -> Any:
    assert env.num_worlds
    return ahead


OWN = outlast.variant("ffa_2").replace(ending_limit=20).with_policies(scripted=ahead_here, hunter=ahead)


def test_a_scenario_has_policies_of_its_own_wherever_their_names_are_given() -> None:
    """As whole policies, for some agents, and in line-ups; a scenario derived from it has them, too."""
    for game in (OWN, OWN.replace(melee_damage=20), Scenario.from_json(OWN.to_json()), pickle.loads(pickle.dumps(OWN))):
        assert dict(game.policies) == {"scripted": ahead_here, "hunter": ahead}
        env = outlast.make_vec(game, 3, seed=0)
        seen, _ = env.reset()
        np.testing.assert_array_equal(outlast.policies.scripted_policy(env)(seen), ahead(seen))
        assert not (np.asarray(outlast.policies.camper_policy(env)(seen)) == ahead(seen)).all()
        env.close()
    options: dict[str, Any] = {"worlds": 4, "seed": 1, "keep": True}
    named = outlast.rollout(OWN, "random", others="scripted:2,hunter", **options).arrays()
    given = outlast.rollout(OWN, "random", others={ahead: 1}, **options).arrays()
    assert all((named[key] == given[key]).all() for key in ("return", "length", "kills"))
    assert OWN.name == "ffa_2-ending_limit=20"


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs torch: outlast[train]")
def test_evaluations_and_training_let_a_scenarios_own_policies_play(tmp_path: Path) -> None:
    found = outlast.evaluate(OWN, {"one": "scripted", "two": ahead, "three": "noop"}, episodes=8, worlds=4, quiet=True)
    one, two = (found.estimates(name, "three") for name in ("one", "two"))
    assert one["length"] == two["length"]
    options: dict[str, Any] = {"steps": 512, "worlds": 4, "rollout": 256, "quiet": True, "threads": 1}
    camping = OWN.with_policies(hunter=lambda env: outlast.policies.camper_policy(env))
    logs = []
    for game, name in ((OWN, "scripted"), (OWN, "hunter"), (camping, "hunter")):
        log = outlast.train(game, tmp_path / str(len(logs)), opponents=f"{name}:1", **options).logged
        logs.append({tag: each for tag, each in log.items() if tag.startswith(("rollout/", "train/"))})
    assert logs[0] == logs[1] != logs[2]


def test_policies_that_a_scenario_cannot_have_are_refused() -> None:
    with pytest.raises(ScenarioError, match=r"'clever'.*functions are needed, for .*'scripted'"):
        OWN.with_policies(clever=ahead)
    with pytest.raises(ScenarioError, match="'scripted': 3: functions"):
        OWN.with_policies(scripted=3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("policy", "error", "words"),
    [
        (lambda seen: ahead(seen)[..., :5], ActionError, r"'scripted' of ffa_2-.* have shape \(2, 2, 5\)"),
        (lambda observations: ahead(observations) + 5, ActionError, "of an agent that plays 'scripted' is 7"),
        (lambda env: 3, UsageError, "'scripted' of ffa_2-.* returned 3: a function"),
    ],
)
def test_what_a_scenarios_own_policy_does_wrong_is_said(policy: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        outlast.rollout(OWN.with_policies(scripted=policy), "scripted", worlds=2)


def test_a_file_of_a_scenario_names_its_policies_and_imports_nothing(tmp_path: Path) -> None:
    text = OWN.to_json()
    assert f"{ahead.__module__}.ahead_here" in text
    with pytest.raises(ScenarioError, match=r"the policy gone\.ahead is not imported, as nothing that a file names is"):
        Scenario.from_json(text.replace(f"{ahead.__module__}.ahead_here", "gone.ahead"))


FORMS = ({"scaled": True}, {"observations": "flat"}, {"actions": "joint"}, {"actions": "continuous"})


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_what_policies_cannot_read_is_refused(form: dict[str, Any]) -> None:
    ((name, value),) = form.items()
    env = outlast.make_vec("ffa_2", 2, seed=0, **form)
    for policy, others in (("scripted", None), ("random", "noop"), ("random", "hunter")):
        with pytest.raises(UsageError, match=f"the environment has {name}={value!r}, and this policy needs {name}="):
            outlast.rollout(env, policy, others=others)
    for style in STYLES:
        with pytest.raises(UsageError, match="make another one for it"):
            getattr(outlast.policies, f"{style}_policy")(env)


@pytest.mark.parametrize("form", FORMS, ids=str)
@pytest.mark.parametrize("policy", ["random", "noop"])
def test_who_looks_at_nothing_plays_everywhere(form: dict[str, Any], policy: str) -> None:
    one, other = (
        outlast.rollout(outlast.make_vec("ffa_2", 4, seed=3, ending_limit=60, **each), policy, episodes=2)
        for each in ({}, form)
    )
    assert one.episodes == 8
    assert one.rows() == other.rows()


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_a_saved_policy_is_refused_and_plays_as_an_opponent(form: dict[str, Any], saved: str) -> None:
    """Opponents are shown what they were trained on, whatever the learner sees."""
    env = outlast.make_vec("ffa_2", 2, seed=0, **form)
    with pytest.raises(UsageError, match="the environment has"):
        outlast.rollout(env, saved)
    with pytest.raises(UsageError, match="the environment has"):
        outlast.rollout(env, "noop", others=saved)
    healths = []
    for each in ({}, form):
        made: Any = gymnasium.make("outlast/FreeForAll2-v1", others=saved, **each)
        made.reset(seed=5)
        idle = {"multi": np.array([1, 1, 1, 0, 0, 0]), "joint": 13 * 8, "continuous": np.array([0, 0, 0, -1, -1, -1.0])}
        for _ in range(30):
            made.step(idle[each.get("actions", "multi")])
        healths.append(made.unwrapped.base_env.worlds[outlast.components.Body].x.tolist())
    assert healths[0] == healths[1]


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The file of a policy that has hardly been trained."""
    pytest.importorskip("torch", reason="needs torch: outlast[train]")
    folder = tmp_path_factory.mktemp("saved") / "run"
    outlast.train("ffa_2", folder, steps=1, worlds=4, rollout=256, quiet=True)
    return str(next(folder.glob("steps_*256.zip"), None) or max(folder.glob("steps_*.zip")))


def test_worlds_that_do_not_restart_in_time_are_refused() -> None:
    disabled, same = (outlast.make_vec("ffa_2", 2, seed=0, autoreset_mode=mode) for mode in ("Disabled", "SameStep"))
    with pytest.raises(UsageError, match="autoreset_mode='Disabled', and worlds must go on by themselves"):
        outlast.rollout(disabled, "random")
    with pytest.raises(UsageError, match="autoreset_mode='SameStep': who won could not be seen"):
        outlast.rollout(same, "hunter", others="random")
    expected = outlast.rollout(outlast.make_vec("ffa_2", 2, seed=0), "hunter")
    assert outlast.rollout(same, "hunter").rows() == expected.rows()


def test_worlds_without_a_seed_go_on() -> None:
    env, other = (outlast.make_vec("ffa_2", 2) for _ in range(2))
    first, _ = env.reset(seed=[1, 2])
    other.reset(seed=[1, 2])
    second, _ = env.reset(seed=[1, None])
    expected, _ = other.reset()
    assert np.array_equal(second["own"][0], first["own"][0])
    assert np.array_equal(second["own"][1], expected["own"][1])
    assert not np.array_equal(second["own"][1], first["own"][1])


def test_a_policy_with_a_memory_is_told_of_states() -> None:
    """Also of one of the very tick that it would have gone on to, and of the same episode begun again."""
    env, policy = outlast.make_vec(short("ffa_3"), 3, seed=3), Remembering()
    act, observations = told(policy, env), env.reset()[0]
    for _ in range(4):
        observations, *_ = env.step(act(observations))
    act(env.set_state(env.get_state([1]), [1]))
    assert policy.told[-1].tolist() == [False, True, False]
    assert policy.calls is not None
    assert policy.calls.tolist() == [4, 0, 4]
    for _ in range(2):
        act(env.reset(seed=3)[0])
        assert policy.told[-1].all()
    before = len(policy.told)
    env.step(act(env.reset(seed=3)[0]))
    act(env.observe())
    assert len(policy.told) == before + 1


def test_the_name_of_a_policy_is_no_policy() -> None:
    env = outlast.make_vec("ffa_1", 2, seed=0)
    for play in (told, lambda policy, env: next(ticks(env, policy, 3))):
        with pytest.raises(UsageError, match="policy = 'noop': a function is needed, such as"):
            play("noop", env)
    env = outlast.make_vec("ffa_1", 2, seed=0)
    policy = POLICIES["noop"](env, 0)
    assert told(policy, env) is policy


class Keeps:
    """A policy that keeps what it saw, and counts how often that has become what it sees now."""

    def __init__(self) -> None:
        self.before: Any = None
        self.calls = self.changed = 0

    def __call__(self, observations: Any) -> Any:
        own = observations["own"]
        self.calls += 1
        self.changed += self.before is not None and np.array_equal(self.before, own)
        self.before = own
        return np.tile([2, 1, 2, 1, 0, 0], (*own.shape[:2], 1))  # turns as it goes


def test_policies_may_keep_what_they_see() -> None:
    mine, others, evaluated = Keeps(), Keeps(), Keeps()
    outlast.rollout("ffa_2", mine, worlds=2, steps=10)
    env = gymnasium.make_vec("outlast/FreeForAll2-v1", num_envs=2, others=others)
    env.reset(seed=0)
    for _ in range(10):
        env.step(np.zeros((2, 6), int))
    if importlib.util.find_spec("torch"):
        outlast.evaluate("ffa_2", {"mine": evaluated, "noop": "noop"}, worlds=2, episodes=2, ending_limit=8, quiet=True)
        assert evaluated.calls > 8
    assert (mine.changed, others.changed, evaluated.changed) == (0, 0, 0)
    assert min(mine.calls, others.calls) >= 10


def test_a_memory_is_of_one_side() -> None:
    policy = Remembering()
    with pytest.raises(UsageError, match="plays twice, and has a memory"):
        outlast.rollout("ffa_2", policy, others=policy, worlds=2, steps=2)
    outlast.rollout("ffa_2", policy, others=Remembering(), worlds=2, steps=2)
    if importlib.util.find_spec("torch"):
        with pytest.raises(UsageError, match="plays twice, and has a memory"):
            outlast.evaluate("ffa_2", {"a": policy, "b": policy}, worlds=2, episodes=2, quiet=True)
