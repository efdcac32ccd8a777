"""Collecting: advantages against a plain loop over a second batch of worlds, and what rewards are divided by."""

import math
from typing import Any

import numpy as np
import pytest

from outlast import make_vec
from outlast.ecs import Entity

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.training.ppo.rollout import RewardScale  # noqa: E402
from outlast.training.ppo.trainer import Trainer  # noqa: E402
from tests.helpers.goal import won_at_the_limit  # noqa: E402
from tests.helpers.trainers import STEPS, WORLDS, make  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
GAMMA, LAMBDA = 0.99, 0.95
Row = dict[str, Any]


class Plain:
    """The same worlds, stepped one by one in plain Python with the actions of a rollout."""

    def __init__(self, trainer: Trainer, dead: str) -> None:
        self.trainer, self.dead, self.worlds = trainer, dead, []
        state = trainer.env.get_state()
        for w in range(WORLDS):
            env = make_vec(trainer.env.scenario, 1, autoreset_mode="Disabled")
            env.set_state(state[w])
            self.worlds.append(env)
        self.sums = [[0.0] * env.num_agents for env in self.worlds]  # of the discounted rewards of each agent
        self.all_sums: list[float] = []

    def values(self, env: Any) -> Any:
        with torch.no_grad():
            return self.trainer.policies[0](self.trainer.lane.packer(env.observe()))[1].numpy()

    def rollout(self, w: int, actions: Any) -> list[Row]:
        """A row for each step of world `w`: rewards, values, and what comes after, (agents,) each."""
        env, rows = self.worlds[w], []
        agents = env.worlds.span("agent")
        for t in range(STEPS):
            alive, values = env.worlds[Entity].alive[0, agents] != 0, self.values(env)
            _, rewards, terminated, truncated, _ = env.step(actions[t, w][None])
            goes_on = np.full(len(alive), not terminated[0])
            if self.dead == "drop":
                goes_on &= env.worlds[Entity].alive[0, agents] != 0
            row = {"alive": alive, "values": values, "rewards": rewards[0].copy(), "next": self.values(env) * goes_on}
            rows.append(row | {"chain": goes_on & (not truncated[0]), "cut off": bool(truncated[0])})
            for i, reward in enumerate(rewards[0]):
                self.sums[w][i] = float(reward) + GAMMA * self.sums[w][i]
                self.all_sums.append(self.sums[w][i])
                self.sums[w][i] *= bool(rows[-1]["chain"][i])
            if terminated[0] or truncated[0]:
                env.reset()
        return rows

    def deviation(self) -> float:
        """The standard deviation of the discounted sums so far, of all agents after each step."""
        mean = sum(self.all_sums) / len(self.all_sums)
        return math.sqrt(sum((each - mean) ** 2 for each in self.all_sums) / len(self.all_sums))


def advantages(rows: list[Row], divisor: float) -> list[Any]:
    """Generalized advantage estimates by their definition: discounted sums of the errors that follow."""
    found = []
    for t in range(len(rows)):
        total, weight = np.zeros(len(rows[0]["values"])), np.ones(len(rows[0]["values"]))
        for row in rows[t:]:
            total += weight * (row["rewards"] / divisor + GAMMA * row["next"] - row["values"])
            weight = weight * GAMMA * LAMBDA * row["chain"]
        found.append(total)
    return found


@pytest.mark.parametrize(
    ("preset", "dead", "scaled"),
    [
        ("original", "keep", False),
        pytest.param("original", "drop", False, marks=pytest.mark.nightly),
        pytest.param("fast", "keep", True, marks=pytest.mark.nightly),
        ("scaled", "drop", True),
    ],
)
def test_advantages_are_those_of_a_plain_loop(preset: str, dead: str, scaled: bool) -> None:
    trainer = make(preset, dead=dead, scale_rewards=scaled)
    plain = Plain(trainer, dead)
    for _ in range(2):  # the second rollout starts in the middle of episodes
        rollout, ends = trainer.collect(), 0
        actions = rollout.actions.reshape(STEPS, WORLDS, 4, -1)
        worlds = [plain.rollout(w, actions) for w in range(WORLDS)]
        divisor = plain.deviation() if scaled else 1
        for w, rows in enumerate(worlds):
            mine = slice(w * 4, w * 4 + 4)
            kept = np.array([row["alive"] for row in rows]) | (dead == "keep")
            assert np.array_equal(rollout.alive[:, mine], np.array([row["alive"] for row in rows]))
            assert np.array_equal(rollout.learner[:, mine], np.where(kept, 0, -1))
            values = np.array([row["values"] for row in rows])
            if trainer.policies[0].apart:
                values[~kept] = 0  # nobody learns from these
            np.testing.assert_allclose(rollout.values[:, mine], values, rtol=1e-4, atol=1e-4)
            expected = np.array(advantages(rows, divisor))
            np.testing.assert_allclose(rollout.advantages[:, mine][kept], expected[kept], rtol=1e-3, atol=1e-3)
            ends += sum(not row["chain"].any() for row in rows)
        np.testing.assert_allclose(rollout.returns, rollout.advantages + rollout.values, atol=1e-5)
        assert ends >= WORLDS
        assert any(row["cut off"] for rows in worlds for row in rows)
        assert (~rollout.alive).sum() > 20
    assert not scaled or abs(divisor - 1) > 0.5


@pytest.mark.parametrize("preset", ["original", "paper", "fast"])
def test_actions_have_the_probabilities_that_the_rollout_says(preset: str) -> None:
    trainer = make(preset)
    rollout = trainer.collect()
    some = torch.arange(0, rollout.alive.size, 3)
    with torch.no_grad():
        logs, values, _ = trainer.policies[0](rollout.seen.select(some))
        actions = torch.from_numpy(rollout.actions.reshape(rollout.alive.size, -1))[some]
        free = None if rollout.idle is None else torch.from_numpy(~rollout.idle.reshape(rollout.alive.size, -1))[some]
        found = trainer.policies[0].choices.of(actions, logs, free)
    np.testing.assert_allclose(values, rollout.values.ravel()[some], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found, rollout.log_probs.ravel()[some], rtol=1e-4, atol=1e-4)


# ---- what rewards are divided by


def test_older_sums_count_as_so_many_of_the_newest_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """A list of all sums with their weights, in plain Python."""
    monkeypatch.setattr(RewardScale, "MEMORY", 2.0)
    rng, agents, steps = np.random.default_rng(0), 3, 5
    scale, running = RewardScale(agents, 0.9), [0.0] * agents
    weighted: list[tuple[float, float]] = []
    for k in range(6):
        rewards = rng.normal(k, 1 + k, (steps, agents)).astype(np.float32)
        ends, new = rng.random((steps, agents)) < 0.2, []
        for t in range(steps):
            for i in range(agents):
                running[i] = 0.9 * running[i] + float(rewards[t, i])
                new.append((1.0, running[i]))
                running[i] *= not ends[t, i]
        before = sum(weight for weight, _ in weighted)
        fade = min(1, 2 * len(new) / before) if before else 1
        weighted = [(weight * fade, value) for weight, value in weighted] + new
        total = sum(weight for weight, _ in weighted)
        mean = sum(weight * value for weight, value in weighted) / total
        variance = sum(weight * (value - mean) ** 2 for weight, value in weighted) / total
        assert scale.update(rewards, ends) == pytest.approx(math.sqrt(variance), rel=1e-9)


def test_rewards_that_are_all_zero_stay_zero() -> None:
    """However long: what they are divided by does not become 0."""
    scale, nothing, ends = RewardScale(2, 0.9), np.zeros((4, 2), np.float32), np.ones((4, 2), bool)
    first = scale.update(nothing, ends)
    scale.variance, scale.mean = 1e-300, 0.0
    assert not (nothing / np.float32(first)).any()
    assert not (nothing / np.float32(scale.update(nothing, ends))).any()


def test_an_end_by_the_rule_in_the_last_tick_is_not_cut_off() -> None:
    """Nothing comes after it, whatever the time limit says."""
    trainer = make(scenario=won_at_the_limit())
    trainer.collect()
    samples = trainer.lane.samples
    assert samples.ends.any()
    assert (samples.later == 0).all()
