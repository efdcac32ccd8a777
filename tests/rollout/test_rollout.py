"""Rollouts give the same numbers however their worlds are divided, and the right ones."""

from importlib.util import find_spec

import numpy as np
import pytest

import outlast
from outlast.envs.cli import main as cli
from outlast.envs.errors import EndlessError
from outlast.envs.rollout import local as rollouts
from outlast.envs.rollout.local import MAX_BATCH, Task, rollout, run_task, split_worlds
from outlast.envs.rollout.policies import GOLDEN, POLICIES, mix64, random_policy
from outlast.envs.rollout.summary import Summary
from tests.conftest import COMPILED, scaled
from tests.helpers.execution_modes import short
from tests.helpers.outputs import length

WORLDS, STEPS = scaled(13, least=4), scaled(160, least=28)


def task(policy: str = "random", variant: str = "ffa_1") -> Task:
    return Task(short(variant).replace(ending_limit=25), POLICIES[policy], STEPS, seed=3)


def whole(policy: str = "random", variant: str = "ffa_1", seed: int = 3, episodes: int = 1) -> Task:
    """Whole episodes of very different lengths: agents strike each other dead, or the zone gets them in the end."""
    numbers = {
        "agents_health": 5,
        "safe_zone_radii": (9.0, 4.0),
        "safe_zone_stand": 100,
        "safe_zone_shrink": 50,
        "room_size": 20.0,
    }
    return Task(outlast.variant(variant).replace(**numbers), POLICIES[policy], 0, seed, episodes)


def equal(one: Summary, other: Summary) -> bool:
    tables = ((one.sums, other.sums), (one.squares, other.squares))
    same = all(a.keys() == b.keys() and all(np.array_equal(a[key], b[key]) for key in a) for a, b in tables)
    numbers = [(summary.episodes, summary.episodes_per_world, summary.world_steps) for summary in (one, other)]
    return same and numbers[0] == numbers[1] and one.rows() == other.rows()


# ---- the same in every division


@pytest.mark.parametrize("policy", sorted(POLICIES))
@pytest.mark.parametrize("variant", ["ffa_1", "teams_3"])
@pytest.mark.by_day(4)
def test_batches_of_worlds_add_up_to_the_whole(policy, variant):
    work = task(policy, variant)
    whole = run_task(work, 0, WORLDS)
    assert whole.episodes >= WORLDS
    for parts in ([(0, 2), (2, WORLDS - 2)], [(0, 1), (1, WORLDS - 2), (WORLDS - 1, 1)]):
        assert equal(whole, Summary.merge(run_task(work, *part) for part in parts))
    assert not equal(whole, run_task(work, 1, WORLDS))


@pytest.mark.parametrize("policy", sorted(POLICIES))
def test_a_world_is_played_the_same_in_every_batch(policy):
    scenario = outlast.variant("teams_3")
    whole = outlast.make_vec(scenario, 9, seed=5)
    parts = [outlast.make_vec(scenario, count, seed=5, first_world=first) for first, count in ((0, 4), (4, 1), (5, 4))]
    policies = [POLICIES[policy](env, 5) for env in (whole, *parts)]
    seen = [env.reset()[0] for env in (whole, *parts)]
    for _ in range(scaled(200, least=10)):
        actions = [act(observations) for act, observations in zip(policies, seen, strict=True)]
        np.testing.assert_array_equal(actions[0], np.concatenate(actions[1:]))
        seen = [env.step(chosen)[0] for env, chosen in zip((whole, *parts), actions, strict=True)]


@pytest.mark.parametrize(("worlds", "workers"), [(1, 1), (1, 8), (5, 2), (256, 1), (257, 1), (1000, 3), (1024, 64)])
def test_batches_have_every_world_once_and_work_for_all(worlds, workers):
    parts = split_worlds(worlds, workers)
    assert [w for first, count in parts for w in range(first, first + count)] == list(range(worlds))
    assert max(count for _, count in parts) <= MAX_BATCH
    assert len(parts) >= min(workers, worlds) / 2


def test_sums_do_not_depend_on_the_order_of_worlds():
    """Of numbers for which they would, if they were rounded on the way."""
    rng = np.random.default_rng(0)
    values, ended = rng.normal(size=(50, 1000, 2)) * 10.0 ** rng.integers(-9, 9, (1000, 2)), np.ones(1000, bool)
    summaries = []
    for order in (np.arange(1000), rng.permutation(1000)):
        parts = []
        for worlds in np.split(order, [100, 300, 301]):
            parts.append(Summary())
            for row in values:
                parts[-1].add({"value": row[worlds]}, ended[worlds])
        summaries.append(Summary.merge(parts))
    assert summaries[0].rows() == summaries[1].rows()
    naive = [values.sum(0)[order].sum(0).tolist() for order in (np.arange(1000), rng.permutation(1000))]
    assert naive[0] != naive[1]


# ---- the right numbers


def test_means_and_errors_are_those_of_the_single_episodes():
    work = task(variant="teams_3")
    env = outlast.make_vec(work.scenario, WORLDS, seed=3)
    policy, episodes = random_policy(env, 3), []
    observations, _ = env.reset()
    for _ in range(STEPS):
        observations, _, _, _, info = env.step(policy(observations))
        for w in np.flatnonzero(info.get("_statistics", ())):
            episodes.append({key: values[w] for key, values in info["statistics"].items()})
    summary = run_task(work, 0, WORLDS)
    assert summary.episodes == len(episodes)
    for name, mean, error in summary.rows():
        key, _, k = name.partition(" ")
        values = np.array([np.atleast_1d(episode[key])[int(k or 0)] for episode in episodes], float)
        assert mean == pytest.approx(values.mean())
        assert error == pytest.approx(values.std(ddof=1) / np.sqrt(len(values)), abs=1e-7)
    assert {name for name, _, _ in summary.rows()} >= {"length", "return 0", "return 3", "kills 1", "deaths_zone"}


def test_nothing_ended_is_said_so():
    assert "no episode ended" in str(run_task(Task(outlast.variant("ffa_1"), POLICIES["noop"], 2, 0), 0, 2))
    assert "no episode ended" in str(Summary.merge([]))


def test_progress_counts_world_steps():
    env, seen = outlast.make_vec("ffa_1", 3, seed=0), []
    rollout(env, random_policy(env), 4, lambda summary: seen.append(summary.world_steps))
    assert seen == [3, 6, 9, 12]


# ---- whole episodes


def first_episodes(task: Task, count: int) -> dict[str, np.ndarray]:
    """Statistics of the first episode of each world, (worlds, ...): every world is stepped alone, until it ends."""
    found: dict[str, list[np.ndarray]] = {}
    for w in range(count):
        env = outlast.make_vec(task.scenario, 1, seed=task.seed, first_world=w, autoreset_mode="Disabled")
        policy, done = task.policy(env, task.seed), False
        observations, _ = env.reset()
        while not done:
            observations, _, terminated, truncated, info = env.step(policy(observations))
            done = bool(terminated[0] or truncated[0])
        for key, values in info["statistics"].items():
            found.setdefault(key, []).append(values[0].copy())
        env.close()
    return {key: np.array(values) for key, values in found.items()}


def test_the_first_episode_of_every_world_is_counted_and_no_other():
    count = scaled(30, least=3)
    summary, alone = run_task(whole(), 0, count), first_episodes(whole(), count)
    assert summary.episodes == count
    assert summary.sums.keys() == alone.keys()
    for key, values in alone.items():
        np.testing.assert_array_equal(summary.sums[key], values)
    assert np.unique(alone["length"]).size > count / 2  # so worlds went on while others were played to their ends
    assert str(summary).startswith(f"{count} whole episodes, the first of every world\n")


def test_of_every_world_as_many_are_counted():
    work = whole(episodes=3)
    env, lengths = outlast.make_vec(work.scenario, WORLDS, seed=3), [[] for _ in range(WORLDS)]
    policy = random_policy(env, 3)
    observations, _ = env.reset()
    while min(map(len, lengths)) < 3:
        observations, _, _, _, info = env.step(policy(observations))
        for w in np.flatnonzero(info.get("_statistics", ())):
            lengths[w].append(int(info["statistics"]["length"][w]))
    summary = run_task(work, 0, WORLDS)
    assert max(map(len, lengths)) > 3
    assert summary.sums["length"].tolist() == [sum(each[:3]) for each in lengths]
    assert str(summary).startswith(f"{3 * WORLDS} whole episodes, the first 3 of every world\n")
    assert summary.rows() == Summary.merge([run_task(work, 0, 2), run_task(work, 2, WORLDS - 2)]).rows()


@pytest.mark.skipif(not COMPILED, reason="thousands of episodes")
def test_whole_episodes_are_unbiased_and_those_that_fit_into_a_time_are_not():
    """Against the first episodes of 2000 other worlds, in standard errors."""
    wide = run_task(whole(seed=11), 0, 2000)
    truth, error = length(wide)
    mean, own = length(run_task(whole(seed=12, episodes=2), 0, 300))
    assert abs(mean - truth) < 3 * np.hypot(own, error)
    env = outlast.make_vec(whole().scenario, 300, seed=12)
    cut = rollout(env, random_policy(env, 12), int(truth))
    short, claimed = length(cut)
    assert truth - short > 10 * np.hypot(claimed, error)
    assert "those cut off at the end are missing, so means lean towards short episodes" in str(cut)


def test_an_episode_without_an_end_is_not_waited_for_in_silence(monkeypatch, capsys):
    monkeypatch.setattr(rollouts, "MAX_STEPS", 40)
    never = outlast.variant("ffa_1").replace(safe_zone_damage=0)
    env = outlast.make_vec(never, 2, seed=0, first_world=7)
    with pytest.raises(EndlessError, match=r"world 7 has been in one episode for 40 steps, .* set ending_limit, or"):
        rollout(env, POLICIES["noop"](env, 0))
    assert rollout(env, POLICIES["noop"](env, 0), 50).episodes == 0
    env = outlast.make_vec(never.replace(ending_limit=60), 2, seed=0)
    assert length(rollout(env, POLICIES["noop"](env, 0))) == (60, 0)
    arguments = ("rollout", "ffa_1", "--set", "safe_zone_damage=0", "--worlds", "2", "--policy", "noop", "--quiet")
    assert cli.main(arguments) == 2
    assert capsys.readouterr().err.startswith("outlast: world 0 has been in one episode for 40 steps")


def test_worlds_whose_limits_differ_are_waited_for_each_by_its_own(monkeypatch):
    monkeypatch.setattr(rollouts, "MAX_STEPS", 40)
    never = outlast.variant("ffa_1").replace(safe_zone_damage=0, ending_limit=50)
    env = outlast.make_vec(never.vary(ending_limit=outlast.integers(50, 60)), 8, seed=0)
    assert 50 < length(rollout(env, POLICIES["noop"](env, 0)))[0] < 60
    env = outlast.make_vec(never.vary(ending_limit=outlast.choice(0, 50)), 8, seed=0)
    env.reset()
    endless = np.flatnonzero(env.numbers()["ending_limit"] == 0)
    assert 0 < endless.size < 8
    with pytest.raises(EndlessError, match=f"world {endless[0]} has been in one episode for 40 steps"):
        rollout(env, POLICIES["noop"](env, 0))


def test_the_limit_is_of_one_episode(monkeypatch):
    """Not of the whole rollout."""
    work = whole(episodes=10)
    expected = run_task(work, 0, 1)
    assert expected.world_steps > 700
    monkeypatch.setattr(rollouts, "MAX_STEPS", 700)
    assert equal(expected, run_task(work, 0, 1))


def test_what_is_stopped_says_that_it_leans():
    env = outlast.make_vec(whole().scenario, 40, seed=3)

    def stop(summary: Summary) -> None:
        if summary.episodes > 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as stopped:
        rollout(env, random_policy(env, 3), progress=stop)
    partial = stopped.value.args[0]
    assert 20 < partial.episodes < 40
    assert str(partial).startswith(
        f"{partial.episodes} episodes ended; those cut off at the end are missing, so means lean "
    )


@pytest.mark.skipif(find_spec("ray") is not None, reason="Ray is installed")
def test_a_missing_ray_is_named_with_its_cure(capsys):
    assert cli.main(("rollout", "ffa_1", "--ray")) == 2
    cure = "pip install 'outlast[ray]' (ray[rllib]>=2.40, torch>=2.4)"
    assert capsys.readouterr().err == f"outlast: --ray needs Ray: {cure}\n"


# ---- chance


def test_words_are_those_of_splitmix64():
    """The first ones of seed 1234567, as published with the reference implementation."""
    state = np.array([1234567], np.uint64) + GOLDEN * np.arange(1, 6, dtype=np.uint64)
    assert mix64(state).tolist() == [
        6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431, 16408922859458223821
    ]  # fmt: skip


@pytest.mark.parametrize("seed", [0, 1])
def test_chance_is_uniform_and_independent(seed):
    """Chi-squared of joint actions, and of pairs of them: of two steps, two agents, two worlds, two seeds."""
    env = outlast.make_vec("teams_1", 512, seed=0)
    policy, other = random_policy(env, seed), random_policy(env, seed + 1)
    weights = np.cumprod([1, *env.action_sizes[:-1]])
    draws = np.array([policy({}) @ weights for _ in range(100)])
    others = np.array([other({}) @ weights for _ in range(100)])
    assert deviation(draws, 216) < 5
    pairs = [(draws[1:], draws[:-1]), (draws[:, 1:], draws[:, :-1]), (draws[..., 1:], draws[..., :-1]), (draws, others)]
    for one, two in pairs:
        assert deviation(one * 216 + two, 216**2) < 5


def deviation(values: np.ndarray, count: int) -> float:
    """Standard deviations by which chi-squared of a uniform draw among `count` is off its mean."""
    counts = np.bincount(values.ravel(), minlength=count)
    expected = values.size / count
    return abs(((counts - expected) ** 2 / expected).sum() - (count - 1)) / np.sqrt(2 * (count - 1))
