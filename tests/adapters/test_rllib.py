"""RLlib: one world as a MultiAgentEnv."""

import itertools
import runpy
from pathlib import Path

import numpy as np
import pytest

import outlast
from outlast.envs.adapters.gymnasium_learners import SurvivalLearnerVectorEnv
from outlast.envs.core.agents import present
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


@pytest.mark.parametrize("dead", ["end", "keep"])
@pytest.mark.parametrize("variant", ["ffa_1", "teams_3", execution_modes.HUNT, *execution_modes.EACH_LEVEL])
def test_it_is_world_0_of_a_batch(variant, dead):
    """Observations, rewards and ends, with the same actions."""
    scenario = execution_modes.short(variant).replace(ending_limit=25)
    env = SurvivalMultiAgentEnv({"scenario": scenario, "dead": dead})
    batch = outlast.make_vec(scenario, 1, seed=9)
    rng, lost = np.random.default_rng(0), set()
    (mine, infos), (theirs, _) = env.reset(seed=9), batch.reset()
    there = [i for i in range(batch.num_agents) if dead == "keep" or present(batch.worlds, 0)[i]]
    assert env.possible_agents == [f"agent_{i}" for i in range(batch.num_agents)]
    assert list(mine) == list(infos) == env.agents == [f"agent_{i}" for i in there]
    while env.agents:
        for agent, observation in mine.items():
            assert env.observation_spaces[agent].contains(observation)
            for key, values in observation.items():
                np.testing.assert_array_equal(values, theirs[key][0, int(agent[6:])])
        actions = rng.integers(0, [3, 3, 3, 2, 2, 2], (1, batch.num_agents, 6))
        acting = env.agents
        mine, pay, done, cut, infos = env.step({agent: actions[0, int(agent[6:])] for agent in acting})
        theirs, reward, terminated, truncated, _ = batch.step(actions)
        assert mine.keys() == pay.keys() == infos.keys() == set(acting)
        assert done.keys() == {*acting, "__all__"}
        assert cut.keys() == {"__all__"}
        assert [pay[agent] for agent in acting] == [reward[0, int(agent[6:])] for agent in acting]
        assert (done["__all__"], cut["__all__"]) == (terminated[0], truncated[0])
        ends = {agent for agent in acting if done[agent]}
        assert (
            ends == ({agent for agent in acting if not infos[agent]["alive"]} if dead == "end" else set())
            or done["__all__"]
        )
        lost |= ends
        assert env.agents == ([] if terminated[0] or truncated[0] else [a for a in acting if a not in ends])
    assert lost or (len(there) < 3 and dead == "end")


def test_the_time_limit_ends_it_for_all_whoever_dies_in_that_tick():
    """In tick 12 those outside of the zone die, and the time is up (as in the tests of the batch)."""
    numbers = {"agents_health": 11, "safe_zone_radii": (8.0,), "ending_limit": 12}
    mixed = 0
    for seed in range(20):
        env = SurvivalMultiAgentEnv({"scenario": "teams_3", **numbers})
        env.reset(seed=seed)
        for tick in range(1, 13):
            _, _, done, cut, _ = env.step(idle(env))
            assert tick == 12 or not any((*done.values(), *cut.values()))
        ended = done.pop("__all__"), cut.pop("__all__")
        assert ended in ((True, False), (False, True))
        assert len(done) == 4
        mixed += len(set(done.values())) == 2
        assert ended[1] or all(done.values())
        *_, again, cut_again, _ = env.step({})
        assert (again, cut_again) == ({"__all__": ended[0]}, {"__all__": ended[1]})
    assert mixed


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
    """In every form of actions and observations, with and without masks."""
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
    plain, masked = SurvivalMultiAgentEnv(options), SurvivalMultiAgentEnv(options | {"action_masks": True})
    batch = outlast.make_vec(options["scenario"], 1, seed=9, actions=actions)
    batch.reset()
    (mine, _), (theirs, _) = plain.reset(seed=9), masked.reset(seed=9)
    while plain.agents:
        masks = batch.action_masks()[0]
        for agent, observation in theirs.items():
            assert masked.observation_spaces[agent].contains(observation)
            assert np.array_equal(observation["action_mask"], masks[int(agent[6:])])
            for key, values in observation["observations"].items():
                assert np.array_equal(values, mine[agent][key])
        chosen = batch.action_space.sample()
        acting = {agent: chosen[0, int(agent[6:])] for agent in plain.agents}
        mine, theirs = plain.step(acting)[0], masked.step(acting)[0]
        batch.step(chosen)


@pytest.mark.parametrize("masks", [False, True])
def test_it_goes_on_from_a_state(masks):
    """In mid-episode, and at the time limit, where it says again how the episode has ended."""
    options = {"scenario": execution_modes.short("teams_3"), "ending_limit": 4, "action_masks": masks}
    env, other = SurvivalMultiAgentEnv(options), SurvivalMultiAgentEnv(options)
    env.reset(seed=9)
    env.step(idle(env))
    seen = other.set_state(env.get_state())
    assert np.array_equal(other.state(), env.state())
    assert (env.state_space.contains(env.state()), other.agents) == (True, env.agents)
    assert all(other.observation_spaces[agent].contains(observation) for agent, observation in seen.items())
    assert {agent: mask.tolist() for agent, mask in other.action_masks().items()} == {
        agent: mask.tolist() for agent, mask in env.action_masks().items()
    }
    while env.agents:
        _, *results, _ = env.step(idle(env))
        _, *again, _ = other.step(idle(other))
        assert again == results
    third = SurvivalMultiAgentEnv(options)
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
    """One iteration of the new API stack, with one policy for all."""
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
