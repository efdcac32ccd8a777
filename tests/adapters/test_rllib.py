"""RLlib: one world as a MultiAgentEnv."""

import itertools
import runpy
from pathlib import Path

import numpy as np
import pytest

import outlast
from outlast.envs.adapters.gymnasium_learners import SurvivalLearnerVectorEnv
from tests.helpers import execution_modes

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'outlast[ray]'")
pytest.importorskip("ray.rllib", reason="RLlib is not installed: pip install 'outlast[ray]'", exc_type=ImportError)

from ray.rllib.algorithms.ppo import PPOConfig  # noqa: E402
from ray.rllib.connectors.env_to_module import FlattenObservations  # noqa: E402
from ray.rllib.env.env_context import EnvContext  # noqa: E402
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner  # noqa: E402
from ray.rllib.utils.pre_checks.env import check_multiagent_environments  # noqa: E402

from outlast.envs.adapters.rllib import SurvivalMultiAgentEnv  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")  # Ray's own, by the dozen

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "rllib_ppo.py"
SHORT = {**execution_modes.SHORT, "ending_limit": 25}


@pytest.fixture
def workers():
    """Ray on this machine, small whatever it has."""
    ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
    yield
    ray.shutdown()


def idle(env):
    return {agent: [1, 1, 1, 0, 0, 0] for agent in env.agents}


LIMITED = outlast.variant("teams_3").replace(agents_health=11, safe_zone_radii=(8.0,), ending_limit=12)
GAMES = {"deaths at the time limit": LIMITED}
GAMES |= {name: execution_modes.short(name).replace(ending_limit=25) for name in ("ffa_1", "teams_3")}
GAMES |= {name: execution_modes.short(name) for name in (execution_modes.HUNT, *execution_modes.LEVELS)}


@pytest.mark.parametrize("dead", ["end", "keep"])
@pytest.mark.parametrize("name", GAMES)
def test_it_is_the_environment_of_pettingzoo(name, dead):
    """But that a time limit is one of all agents; and it says again how an episode has ended."""
    rng, ends = np.random.default_rng(0), set()
    for seed in range(4):
        env = SurvivalMultiAgentEnv({"scenario": GAMES[name], "dead": dead})
        parallel = outlast.adapters.parallel_env(GAMES[name], dead=dead)
        (mine, infos), (theirs, known) = env.reset(seed=seed), parallel.reset(seed=seed)
        while env.agents:
            assert (env.agents, env.possible_agents) == (parallel.agents, parallel.possible_agents)
            assert list(mine) == list(theirs)
            assert all(env.observation_spaces[agent].contains(seen) for agent, seen in mine.items())
            assert all(execution_modes.equal(mine[agent], theirs[agent]) for agent in mine)
            assert infos == known
            actions = {agent: rng.integers(0, [3, 3, 3, 2, 2, 2]) for agent in env.agents}
            mine, pay, done, cut, infos = env.step(actions)
            theirs, rewards, terminated, truncated, known = parallel.step(actions)
            limit = any(truncated.values())
            assert pay == rewards
            assert cut == {"__all__": limit}
            assert done == terminated | {"__all__": not limit and not parallel.agents}
        ends.add((limit, len({*terminated.values()})))
        assert env.step({})[2:4] == ({"__all__": not limit}, {"__all__": limit})
    assert name != "deaths at the time limit" or dead == "keep" or (True, 2) in ends


@pytest.mark.parametrize("dead", ["end", "keep"])
def test_rllib_bootstraps_at_the_time_limit_and_nowhere_else(dead):
    """Its own runner and episodes, from which it makes advantages: who is alive at the limit is truncated."""
    numbers = {"agents_health": 11, "safe_zone_radii": (8.0,), "ending_limit": 14, "seed": 3, "dead": dead}
    form = {"scenario": "teams_3", "actions": "joint", "observations": "flat", **numbers}
    config = PPOConfig().environment(SurvivalMultiAgentEnv, env_config=form)
    config.multi_agent(policies={"shared"}, policy_mapping_fn=lambda agent, episode, **more: "shared")
    ends = set()
    for episode in MultiAgentEnvRunner(config=config).sample(num_episodes=4, random_actions=True):
        for own in (episode, *episode.agent_episodes.values()):
            limit = len(own) == 14
            assert (own.is_terminated, own.is_truncated) == (not limit, limit)
            ends.add((limit, own is episode))
    assert ends >= {(True, True), (True, False), (False, True)}


@pytest.mark.parametrize("name", ["ffa_3", *execution_modes.EACH_LEVEL])
def test_rllib_finds_nothing_wrong(name):
    kinds = ("multi", "joint", "continuous")
    forms = itertools.product(("end", "keep"), kinds, ("dict", "flat"), (False, True), (False, True))
    for form in forms:
        options = dict(zip(("dead", "actions", "observations", "scaled", "action_masks"), form, strict=True))
        if options["actions"] == "continuous":
            options["action_masks"] = False
        check_multiagent_environments(SurvivalMultiAgentEnv({"scenario": execution_modes.short(name), **options}))


@pytest.mark.parametrize("actions", ["multi", "joint"])
def test_masks_are_in_the_observations(actions):
    options = {"scenario": execution_modes.short("teams_3"), "actions": actions}
    env = SurvivalMultiAgentEnv(options | {"action_masks": True})
    parallel = outlast.adapters.parallel_env(**options, action_masks="observation")
    mine, theirs = env.reset(seed=9)[0], parallel.reset(seed=9)[0]
    while env.agents:
        for agent, seen in mine.items():
            assert env.observation_spaces[agent].contains(seen)
            assert execution_modes.equal(seen["observations"], theirs[agent]["observation"])
            assert np.array_equal(seen["action_mask"], theirs[agent]["action_mask"])
        acting = {agent: env.action_spaces[agent].sample() for agent in env.agents}
        mine, theirs = env.step(acting)[0], parallel.step(acting)[0]


@pytest.mark.parametrize("masks", [False, True])
def test_it_goes_on_from_a_state(masks):
    """In mid-episode, and at the time limit, where it says again how the episode has ended."""
    options = {"scenario": execution_modes.short("teams_3"), "ending_limit": 4, "action_masks": masks}
    env, other, third = (SurvivalMultiAgentEnv(options) for _ in range(3))
    env.reset(seed=9)
    env.step(idle(env))
    seen = other.set_state(env.get_state())
    assert all(other.observation_spaces[agent].contains(observation) for agent, observation in seen.items())
    while env.agents:
        assert env.agents == other.agents
        assert env.step(idle(env))[1:4] == other.step(idle(other))[1:4]
    assert third.set_state(env.get_state()) == {}
    assert third.step({})[2:4] == ({"__all__": False}, {"__all__": True}) == env.step({})[2:4]


def test_copies_of_a_run_play_worlds_of_their_own():
    """Those of one worker share a context, and RLlib gives all of them one seed; without RLlib, a seed is a world."""
    config = {"scenario": "ffa_1", "seed": 4}
    contexts = [EnvContext(config, worker_index=1), EnvContext(config, worker_index=2)]
    envs = [SurvivalMultiAgentEnv(context) for context in contexts for _ in range(2)]
    again = SurvivalMultiAgentEnv(EnvContext(config, worker_index=1))
    other = SurvivalMultiAgentEnv(EnvContext({**config, "seed": 5}, worker_index=1))
    for seed in (42, None):
        places = []
        for env in (*envs, again, other):
            env.reset(seed=seed)
            places.append(env._parallel.state().tobytes())
        assert places[4] == places[0]
        assert len(set(places)) == 5
    alone = [SurvivalMultiAgentEnv(config).reset()[0]["agent_0"]["own"].tolist() for _ in range(2)]
    batch, _ = outlast.make_vec("ffa_1", 1, seed=4).reset()
    assert alone == [batch["own"][0, 0].tolist()] * 2


def after_the_check(seed, config, worker=1):
    """The states of the first two episodes of a run, whose environment RLlib has checked before."""
    env = SurvivalMultiAgentEnv(EnvContext({"scenario": "ffa_1", **config}, worker_index=worker))
    check_multiagent_environments(env)
    states = []
    for each in (seed, None):
        env.reset(seed=each)
        states.append(env._parallel.state().tobytes())
    return states


@pytest.mark.parametrize("seed", [0, 42])
def test_what_rllib_checks_uses_up_no_seed(seed):
    """Without a seed runs differ, in all episodes; with one, of the run or the configuration, they repeat."""
    free = [after_the_check(None, {}) for _ in range(3)]
    assert len({state for states in free for state in states}) == 6
    assert after_the_check(seed, {}) == after_the_check(seed, {})
    given = {"seed": 4}
    assert after_the_check(None, given) == after_the_check(None, given) == after_the_check(4, given)
    assert len(set(after_the_check(None, given) + after_the_check(None, {"seed": 5}))) == 4
    unchecked = SurvivalMultiAgentEnv(EnvContext({"scenario": "ffa_1"}, worker_index=1))
    states = []
    for each in (seed, None):
        unchecked.reset(seed=each)
        states.append(unchecked._parallel.state().tobytes())
    assert states == after_the_check(seed, {})


@pytest.mark.slow
def test_ppo_trains_on_a_batch_of_worlds(workers):
    """One learner a world, by the entry point of the batch: no environment is made for each world."""
    config = runpy.run_path(str(EXAMPLE))["config"]("Teams3", 0)
    config.env_config["max_episode_steps"] = 25
    config.env_runners(num_envs_per_env_runner=8)
    config.training(train_batch_size_per_learner=400, minibatch_size=100, num_epochs=1)
    algorithm = config.build_algo()
    try:
        assert isinstance(algorithm.env_runner.env.unwrapped, SurvivalLearnerVectorEnv)
        result = algorithm.train()
    finally:
        algorithm.stop()
    assert 1 <= result["env_runners"]["episode_len_mean"] <= 25
    assert np.isfinite(result["learners"]["default_policy"]["total_loss"])


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_ppo_learns_on_a_batch_of_worlds(workers):
    """The example: the return, paid for each tick alive, rises above that of its first tenth, without the start."""
    returns = runpy.run_path(str(EXAMPLE))["train"]("FreeForAll1", 1_000_000)
    assert np.mean(returns[-30:]) > np.mean(returns[10:40]) + 40


@pytest.mark.slow
@pytest.mark.parametrize("name", ["teams_3", execution_modes.ALL])
def test_ppo_trains(workers, name):
    from ray.rllib.algorithms.ppo import PPOConfig

    config = (
        PPOConfig()
        .environment(SurvivalMultiAgentEnv, env_config={"scenario": execution_modes.short(name), **SHORT})
        .env_runners(
            num_env_runners=1, num_envs_per_env_runner=2,
            env_to_module_connector=lambda env, spaces, device: FlattenObservations(multi_agent=True),
        )
        .multi_agent(policies={"all"}, policy_mapping_fn=lambda agent, episode, **more: "all")
        .training(train_batch_size_per_learner=400, minibatch_size=50, num_epochs=1)
        .debugging(seed=0)
    )  # fmt: skip
    algorithm = config.build_algo()
    try:
        result = algorithm.train()
    finally:
        algorithm.stop()
    runners, learner = result["env_runners"], result["learners"]["all"]
    assert runners["num_episodes"] >= 2
    assert 1 <= runners["episode_len_mean"] <= 25
    assert runners["agent_steps"].keys() == {f"agent_{i}" for i in range(4)}  # with other counts, in some episode
    assert np.isfinite(learner["total_loss"])
