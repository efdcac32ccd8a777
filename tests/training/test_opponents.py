"""Opponents that are drawn per world: who plays whom, whose samples are trained on, who won, ratings, going on."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import outlast
from outlast import make_vec
from outlast.components import Side
from outlast.distributions import choice, integers
from outlast.ecs import Clock, Entity
from outlast.envs.rollout.policies import scripted_policy
from outlast.training.arena.opponent_pool import PAST_SELVES, Opponent, OpponentPool
from outlast.training.base.config import TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.policies.checkpoint import write_checkpoint
from outlast.training.ppo.rollout import NOBODY
from outlast.training.ppo.trainer import Trainer, capture
from tests.helpers.execution_modes import short
from tests.helpers.trainers import weights

WORLDS, STEPS = 12, 60
SHORT = short("teams_3").replace(ending_limit=25, agents_health=8)  # ends early, both ways
MIX = {"self": 1.0, "past": 1.0, "scripted": 1.0}


def make(seed: int = 5, scenario: Any = SHORT, **options: Any) -> Trainer:
    size = {"worlds": WORLDS, "rollout": WORLDS * STEPS, "settings": {"n_epochs": 1}, "opponents": MIX}
    given = size | options
    often = {"snapshots": 1} if "past" in given["opponents"] else {}
    return Trainer(TrainingConfig(scenario, "fast", seed=seed, **given, **often))


def pool(weights: dict[str, float], prioritised: bool = False, **figures: tuple[float, float]) -> OpponentPool:
    opponents = OpponentPool(weights, {}, make_vec(SHORT, 1), prioritised=prioritised)
    for one in opponents.all.values():
        one.won, one.games = figures.get(one.name, (0.0, 0.0))
    return opponents


def test_those_that_win_are_drawn_more_often_and_the_present_self_as_often() -> None:
    given = pool({"self": 2, "scripted": 1, "random": 1}, True, scripted=(10, 100), random=(99, 100))
    indices, weights = given.chances()
    found = dict(zip([given.all[k].name for k in indices], weights / weights.sum(), strict=True))
    assert found["self"] == pytest.approx(0.5)
    one, other = ((1 - wins) ** 2 + 0.02 for wins in (10.5 / 101, 99.5 / 101))
    assert found["scripted"] / found["random"] == pytest.approx(one / other)


def test_past_selves_are_spaced_evenly_and_kept_while_they_play() -> None:
    trainer = make()
    opponents = trainer.opponents
    for step in range(1, 41):
        opponents.remember(trainer.policies, step, {0})
    at = [int(opponents.all[k].name.partition("@")[2]) for k in opponents.past]
    assert len(at) == PAST_SELVES
    assert (at[0], at[-1]) == (1, 40)
    assert max(np.diff(at)) < 40 / 2
    assert {k for k, one in opponents.all.items() if one.past} == set(opponents.past)
    opponents.report()
    for k in opponents.past:
        opponents.record(k, 1.0, 2)
    leaving = opponents.past[1]
    for step in range(41, 81):
        opponents.remember(trainer.policies, step, {0, leaving})
    assert leaving not in opponents.past
    assert leaving in opponents.all
    assert opponents.report()["games/past"] == 2 * PAST_SELVES  # also those against who is gone
    given = opponents.state()
    again = make().opponents
    again.restore(given, trainer.policies, "")
    assert again.report()["games/past"] == 2 * PAST_SELVES
    with pytest.raises(TrainingError, match="do not fit the run"):
        again.restore(given | {"dropped": -1}, trainer.policies, "")


def test_ratings_follow_the_games() -> None:
    opponents = pool({"self": 1, "scripted": 1})
    opponents.all[9] = Opponent("past@7", 0.0, [torch.nn.Linear(1, 1)])  # type: ignore[list-item]
    for _ in range(300):
        opponents.record(1, 3.0, 4)  # three of four
        opponents.record(9, 2.0, 4)
    own, scripted, past = (opponents.all[k].rating for k in (0, 1, 9))
    assert own - scripted == pytest.approx(400 * np.log10(3), abs=10)
    assert past == 1000
    tags = opponents.report()
    assert tags["wins/scripted"] == 0.75
    assert tags["games/scripted"] == 1200
    opponents.record(1, 0.0, 10)
    assert opponents.report()["wins/scripted"] == pytest.approx(0.75 * 0.9 * 1200 / (0.9 * 1200 + 10))


class Watched:
    """What is true before each step of a rollout: by its lane, and by the worlds themselves."""

    def __init__(self, trainer: Trainer) -> None:
        self.rows: list[dict[str, Any]] = []
        lane, inner = trainer.lane, trainer.lane.act

        def act(*given: Any) -> Any:
            clock = lane.env.worlds[Clock]
            key = np.stack([clock.world[:, 0], clock.episode[:, 0]], 1).astype(int)
            row = {"opponent": lane.opponent.copy(), "own": lane.own.copy(), "key": key}
            chosen = inner(*given)
            seen = {key: values.copy() for key, values in lane.env.observe().items()}
            self.rows.append(row | {"actions": chosen.copy(), "seen": seen})
            return chosen

        lane.act = act  # type: ignore[method-assign]


def test_opponents_change_only_where_an_episode_begins_and_sides_are_swapped() -> None:
    trainer = make()
    watched = Watched(trainer)
    for _ in range(3):
        trainer.update(trainer.collect())
    rows = watched.rows
    drawn: dict[tuple[int, int], set[tuple[int, int]]] = {}
    for row in rows:
        for w in range(WORLDS):
            drawn.setdefault(tuple(row["key"][w]), set()).add((int(row["opponent"][w]), int(row["own"][w])))
    assert all(len(each) == 1 for each in drawn.values())
    assert all(own == sum(key) % 2 for key, each in drawn.items() for opponent, own in each)
    assert len(Counter(opponent for each in drawn.values() for opponent, _ in each)) > 2
    past = trainer.opponents.all[trainer.opponents.past[0]]  # which stays as it was
    assert not torch.equal(weights(past.policies[0]), weights(trainer.policies[0]))


def test_samples_of_opponents_are_not_trained_on() -> None:
    """And scripted ones do what the policy of that name does."""
    trainer, twin = make(), make()
    watched, script = Watched(trainer), scripted_policy(trainer.env)
    rollout, other = trainer.collect(), twin.collect()
    sides = trainer.env.worlds[Side].side[0, trainer.env.worlds.span("agent")]
    (number,) = (k for k, one in trainer.opponents.all.items() if one.name == "scripted")
    for row, learner in zip(watched.rows, rollout.learner.reshape(STEPS, WORLDS, -1), strict=True):
        theirs = (row["opponent"][:, None] > 0) & (row["own"][:, None] != sides)
        assert np.array_equal(learner == NOBODY, theirs)
        scripted, expected = theirs & (row["opponent"][:, None] == number), script(row["seen"])
        assert np.array_equal(row["actions"][scripted], expected[scripted])
        assert not np.array_equal(row["actions"][~scripted], expected[~scripted])
    masked = rollout.learner == NOBODY
    assert 0.1 < masked.mean() < 0.6
    before = weights(trainer.policies[0])
    for name in ("advantages", "values", "log_probs"):
        getattr(other, name)[masked] = 1e6  # whatever is there
    trainer.update(rollout)
    twin.update(other)
    after = weights(trainer.policies[0])
    assert torch.equal(after, weights(twin.policies[0]))
    assert not torch.equal(after, before)


@pytest.mark.parametrize("scenario", [SHORT, short("ffa_3").replace(n_agents=4, ending_limit=25, agents_health=8)])
def test_games_are_those_that_a_plain_loop_counts(scenario: Any) -> None:
    """Who outlived, in a second batch of worlds that do the same; and what the learners earned, without opponents."""
    trainer = make(opponents={"scripted": 1.0}, scenario=scenario.replace(safe_zone_damage=3))
    env = make_vec(trainer.env.scenario, WORLDS, autoreset_mode="Disabled")
    env.set_state(trainer.env.get_state())
    watched = Watched(trainer)
    for _ in range(3):
        trainer.collect()
    agents, life = env.worlds.span("agent"), np.zeros((WORLDS, env.worlds.dims["sides"]))
    sides, found, count = env.worlds[Side].side[0, agents], Counter[str](), life.shape[1]
    earned, returns = np.zeros((WORLDS, 4)), {k: list[float]() for k in range(count)}
    for row in watched.rows:
        _, rewards, terminated, truncated, _ = env.step(row["actions"])
        earned += rewards
        for w in range(WORLDS):
            for s in range(count):
                life[w, s] += env.worlds[Entity].alive[w, agents][sides == s].any()
            if terminated[w] or truncated[w]:
                own, others = life[w, row["own"][w]], np.delete(life[w], row["own"][w])
                found["won"] += sum(1 if own > other else 0.5 if own == other else 0 for other in others) / len(others)  # type: ignore[assignment]
                found["games"] += 1
                returns[row["own"][w]].append(earned[w, sides == row["own"][w]].mean())
                life[w] = earned[w] = 0
        if (done := terminated | truncated).any():
            env.reset(options={"reset_mask": done})
    scripted = trainer.opponents.all[1]
    assert scripted.total == found["games"] > 20
    assert scripted.won == pytest.approx(found["won"])
    assert 0 < found["won"] < found["games"]
    means = trainer.report()
    assert [means[f"rollout/reward{k}"] for k in returns] == pytest.approx([np.mean(each) for each in returns.values()])


@pytest.mark.parametrize(
    ("policies", "learners"), [("shared", [0, 0, 0, 0]), ("side", [0, 0, 1, 1]), ("agent", [0, 1, 2, 3])]
)
def test_every_learner_trains_on_its_own_agents(policies: str, learners: list[int]) -> None:
    trainer, last = make(policies=policies, opponents={"self": 1.0}), learners[-1]
    rollout = trainer.collect()
    assert (rollout.learner.reshape(STEPS, WORLDS, 4) == learners).all()
    rollout.learner[rollout.learner == last] = NOBODY  # so that the last one has nothing to learn
    before = [weights(policy) for policy in trainer.policies]
    trainer.update(rollout)
    same = [torch.equal(weights(policy), own) for policy, own in zip(trainer.policies, before, strict=True)]
    assert same == [False] * last + [True]


def test_policies_of_sides_play_their_sides_from_a_file(tmp_path: Path) -> None:
    trainer = make(policies="side", opponents={"self": 1.0})
    for policy, value in zip(trainer.policies, (0, 2), strict=True):  # one always moves back, one always ahead
        with torch.no_grad():
            policy.actor.last.weight.zero_()
            policy.actor.last.bias[value] = 50
    write_checkpoint(tmp_path / "a.zip", capture(trainer, trainer.config.header()))
    actions = outlast.load_policy(tmp_path / "a.zip")(trainer.env.observe())
    assert (actions[:, :2, 0] == 0).all()
    assert (actions[:, 2:, 0] == 2).all()


ALONE = "opponents need a side of their own, but this game has one side"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"policies": "each"}, "policies = 'each': allowed are 'shared', 'side', 'agent'"),
        ({"snapshots": 3}, "snapshots have no effect without past selves"),
        ({"prioritised": True, "opponents": {"self": 1.0, "scripted": 1.0}}, "prioritised needs several opponents"),
        ({"scenario": short("ffa_1").replace(n_agents=1)}, ALONE),
        ({"scenario": short("teams_1").replace(n_teams=1)}, ALONE),
        ({"policies": "side", "scenario": SHORT.vary(agents_count=integers(2, 4))}, "agents_count varies, and the"),
        ({"policies": "side", "scenario": SHORT.vary(teams_sizes=choice((1, 3), (2, 2)))}, "teams_sizes varies"),
    ],
)
def test_opponents_and_sides_that_cannot_be_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        make(**({"opponents": {"scripted": 1.0}} | given))
    make(scenario=short("ffa_1").replace(n_agents=1), opponents={"self": 1.0})  # who is alone plays itself


@pytest.mark.parametrize("role", [{"opponents": {"self": 1.0, "{}": 1.0}}, {"warm_start": "{}:100"}], ids=str)
def test_who_learns_from_what_is_revealed_does_so_beside_a_policy_that_does_not(role: Any, tmp_path: Path) -> None:
    """Otherwise it would play by rows that it was never trained on."""
    trainer, path = make(opponents={"self": 1.0}), str(tmp_path / "fast.zip")
    write_checkpoint(Path(path), trainer.policy_files(trainer.config.header()))
    given = json.loads(json.dumps(role).replace("{}", path))
    learner = Trainer(TrainingConfig(SHORT, "original", worlds=1, rollout=16, **given))
    assert learner.env.scenario.numbers()["cameras_mode"] == "revealed"


def test_worlds_are_played_the_same_in_any_batch_and_agents_without_teams_are_sides() -> None:
    """Actions and opponents are functions of the world, not of the batch."""
    small, large = (make(worlds=n, rollout=n * 40, opponents={"self": 1.0, "scripted": 1.0}) for n in (4, WORLDS))
    one, two = small.collect().actions, large.collect().actions
    assert np.array_equal(one, two[:, : one.shape[1]])
    scenario = outlast.variant("ffa_1").vary(n_agents=outlast.distributions.integers(2, 5))
    for seed in range(3):  # the first world may have fewer
        trainer = make(seed=seed, scenario=scenario, policies="side", opponents={"self": 1.0})
        assert trainer.team.tolist() == [0, 1, 2, 3, 4]
        assert len(trainer.learners) == 5
