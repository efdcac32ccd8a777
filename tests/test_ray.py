"""Ray: rollouts on a cluster that loses workers, and RLlib's environment."""

import itertools
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from conftest import scaled

import outlast
from outlast.envs import main as cli
from outlast.envs import rollout as local
from outlast.envs.errors import ClusterError
from outlast.envs.policies import POLICIES
from outlast.envs.rollout import Task, play

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'outlast[ray]'")
pytest.importorskip("ray.rllib", reason="RLlib is not installed: pip install 'outlast[ray]'", exc_type=ImportError)

from ray.rllib.connectors.env_to_module import FlattenObservations  # noqa: E402
from ray.rllib.env.env_context import EnvContext  # noqa: E402
from ray.rllib.utils.pre_checks.env import check_multiagent_environments  # noqa: E402

from outlast.envs import cluster  # noqa: E402
from outlast.envs.rllib import SurvivalMultiAgentEnv  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")  # Ray's own, by the dozen

WORLDS, STEPS, SEED = 10, scaled(150, least=30), 3
SHORT = {"agents_health": 10, "zone_radii": (9.0, 4.0), "zone_stand": 10, "zone_shrink": 10, "ending_limit": 25}


@pytest.fixture(scope="module")
def workers():
    """A cluster on this machine, small whatever it has."""
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
    yield
    ray.shutdown()


def task(policy=POLICIES["random"], variant="teams_3"):
    return Task(outlast.variant(variant).replace(**SHORT), policy, STEPS, SEED)


def same(one, other):
    tables = ((one.sums, other.sums), (one.squares, other.squares))
    return one.rows() == other.rows() and all(np.array_equal(a[key], b[key]) for a, b in tables for key in a | b)


# ---- before there is a cluster


def test_importing_outlast_leaves_ray_alone():
    program = "import outlast, outlast.envs.main, outlast.envs.rollout, sys; sys.exit('ray' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere.invalid:6379", "ray://127.0.0.1:1", "gibberish"])
def test_no_cluster_is_said_at_once(capsys, address):
    assert not ray.is_initialized()
    assert cli.main(("rollout", "ffa_1", "--ray", address)) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith(f"outlast: no Ray cluster at {address}: ")


# ---- rollouts


@pytest.mark.parametrize("size", [1, 4, 256])
def test_a_cluster_computes_what_one_machine_does(workers, monkeypatch, size):
    monkeypatch.setattr(local, "BLOCK", size)
    seen = []
    spread = cluster.rollout(task(), WORLDS, seen.append)
    alone = play(task(), 0, WORLDS)
    assert spread.episodes == alone.episodes >= WORLDS
    assert same(spread, alone)
    assert seen == sorted(seen)
    assert seen[-1] == WORLDS * STEPS


@pytest.mark.parametrize("how", ["exit", "kill"])
def test_a_lost_worker_loses_no_episode_and_repeats_none(workers, monkeypatch, tmp_path, how):
    """The worker of the second block is lost in mid-rollout, the first time; every start leaves a file."""

    def fragile(env, seed):
        first, steps, act = env.first_world, itertools.count(), POLICIES["random"](env, seed)
        starts = len(list(tmp_path.glob(f"{first}-*")))
        (tmp_path / f"{first}-{starts}").touch()

        def policy(observations):
            if first == 3 and starts == 0 and next(steps) == STEPS - 5:
                os._exit(1) if how == "exit" else os.kill(os.getpid(), signal.SIGKILL)
            return act(observations)

        return policy

    monkeypatch.setattr(local, "BLOCK", 3)
    spread = cluster.rollout(task(fragile), WORLDS)
    assert {path.name for path in tmp_path.iterdir()} >= {"0-0", "3-0", "3-1", "6-0", "9-0"}
    alone = play(task(), 0, WORLDS)
    assert spread.episodes == alone.episodes
    assert same(spread, alone)


def test_a_worker_that_is_always_lost_is_an_error_that_names_its_worlds(workers, monkeypatch):
    def deadly(env, seed):
        if env.first_world:
            os._exit(1)
        return POLICIES["random"](env, seed)

    monkeypatch.setattr(local, "BLOCK", 5)
    monkeypatch.setattr(cluster, "RETRIES", 1)
    with pytest.raises(ClusterError, match=r"worlds 5 to 9 lost their worker 2 times .*memory"):
        cluster.rollout(task(deadly), WORLDS)


def test_what_a_policy_raises_comes_back(workers):
    def broken(env, seed):
        raise ZeroDivisionError("in the policy")

    with pytest.raises(ZeroDivisionError, match="in the policy"):
        cluster.rollout(task(broken), WORLDS)


def test_workers_with_another_version_are_refused(workers, monkeypatch):
    monkeypatch.setattr(outlast, "__version__", "0.0.7")
    with pytest.raises(ClusterError, match=r"this machine 0\.0\.7: install the same"):
        cluster.rollout(task(), WORLDS)


def test_ctrl_c_leaves_the_summary_of_the_finished_blocks(workers, monkeypatch, tmp_path):
    """The last block never ends by itself."""

    def endless(env, seed):
        act = POLICIES["random"](env, seed)

        def policy(observations):
            while env.first_world == 8:
                signal.pause()
            return act(observations)

        return policy

    def progress(world_steps):
        if world_steps == 8 * STEPS:
            raise KeyboardInterrupt

    monkeypatch.setattr(local, "BLOCK", 4)
    with pytest.raises(KeyboardInterrupt) as stop:
        cluster.rollout(task(endless), WORLDS, progress)
    assert same(stop.value.args[0], play(task(), 0, 8))
    assert cluster.rollout(task(), WORLDS).episodes  # its worker is free again


def test_the_command_prints_the_same_table(workers, capsys):
    arguments = ["rollout", "ffa_2", "--worlds", "5", "--steps", "150", "--set", "zone_harm=100", "--quiet"]
    tables = []
    for more in ([], ["--ray"]):
        assert cli.main([*arguments, *more]) == 0
        out = capsys.readouterr().out
        assert "750 world-steps in" in out
        tables.append(out.split("agent-steps/s")[1])
    assert tables[0] == tables[1]
    assert "deaths_zone" in tables[0]


@pytest.mark.parametrize("more", [("--threads", "2"), ("--log-deaths",)])
def test_options_for_one_machine_are_refused(capsys, more):
    assert cli.main(("rollout", "ffa_1", "--ray", *more)) == 2
    assert "leave them out with --ray" in capsys.readouterr().err


# ---- RLlib


def idle(env):
    return {agent: [1, 1, 1, 0, 0, 0] for agent in env.agents}


def play_out(env, seed):
    """Everything that comes out of one episode in which everybody acts at random."""
    rng, outcomes = np.random.default_rng(seed), [env.reset(seed=seed)]
    while not outcomes[1:] or not (outcomes[-1][2]["__all__"] or outcomes[-1][3]["__all__"]):
        outcomes.append(env.step({agent: rng.integers(0, [3, 3, 3, 2, 2, 2]) for agent in env.agents}))
    return outcomes


@pytest.mark.parametrize("dead", ["remove", "keep"])
@pytest.mark.parametrize("variant", ["ffa_1", "teams_3"])
def test_it_is_world_0_of_a_batch(variant, dead):
    """Observations, rewards and ends, with the same actions."""
    env = SurvivalMultiAgentEnv({"scenario": variant, "dead": dead, **SHORT})
    batch = outlast.make_vec(outlast.variant(variant).replace(**SHORT), 1, seed=9)
    rng, lost = np.random.default_rng(0), set()
    (mine, infos), (theirs, _) = env.reset(seed=9), batch.reset()
    assert list(mine) == list(infos) == env.possible_agents == [f"agent_{i}" for i in range(batch.num_agents)]
    while env.agents:
        for agent, observation in mine.items():
            assert env.observation_spaces[agent].contains(observation)
            for key, values in observation.items():
                np.testing.assert_array_equal(values, theirs[key][0, int(agent[6:])])
        actions = rng.integers(0, [3, 3, 3, 2, 2, 2], (1, batch.num_agents, 6))
        acting = env.agents
        mine, pay, over, cut, infos = env.step({agent: actions[0, int(agent[6:])] for agent in acting})
        theirs, reward, terminated, truncated, _ = batch.step(actions)
        assert mine.keys() == pay.keys() == infos.keys() == set(acting)
        assert over.keys() == cut.keys() == {*acting, "__all__"}
        assert [pay[agent] for agent in acting] == [reward[0, int(agent[6:])] for agent in acting]
        assert (over["__all__"], cut["__all__"]) == (terminated[0], truncated[0])
        assert all(cut[agent] == truncated[0] for agent in acting)
        ends = {agent for agent in acting if over[agent]}
        assert (
            ends == ({agent for agent in acting if not infos[agent]["alive"]} if dead == "remove" else set())
            or over["__all__"]
        )
        lost |= ends
        assert env.agents == ([] if terminated[0] or truncated[0] else [a for a in acting if a not in ends])
    assert lost


def test_the_time_limit_ends_it_for_all_whoever_dies_in_that_tick():
    """In tick 12 those outside of the zone die, and the time is up (as in the tests of the batch)."""
    numbers = {"agents_health": 11, "zone_radii": (8.0,), "ending_limit": 12}
    mixed = 0
    for seed in range(20):
        env = SurvivalMultiAgentEnv({"scenario": "teams_3", **numbers})
        env.reset(seed=seed)
        for tick in range(1, 13):
            _, _, over, cut, _ = env.step(idle(env))
            assert tick == 12 or not any((*over.values(), *cut.values()))
        assert over.pop("__all__") != cut.pop("__all__")
        assert len(over) == len(cut) == 4
        mixed += len(set(over.values())) == 2
        assert all(cut.values()) or (all(over.values()) and not any(cut.values()))
    assert mixed


def test_rllib_finds_nothing_wrong(workers):
    for dead in ("remove", "keep"):
        check_multiagent_environments(SurvivalMultiAgentEnv({"scenario": "ffa_3", "dead": dead}))


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
            places.append(env.parallel.state().tobytes())
        assert places[4] == places[0]
        assert len(set(places)) == 5
    alone = [SurvivalMultiAgentEnv(config).reset()[0]["agent_0"]["self"].tolist() for _ in range(2)]
    batch, _ = outlast.make_vec("ffa_1", 1, seed=4).reset()
    assert alone == [batch["self"][0, 0].tolist()] * 2


def test_a_wrong_configuration_is_told():
    for config, words in (
        ({"scenario": "ffa_9"}, "did you mean"),
        ({"dead": "no"}, "dead"),
        ({"n_agnts": 3}, "n_agents"),
    ):
        with pytest.raises(ValueError, match=words):
            SurvivalMultiAgentEnv(config)


@pytest.mark.slow
def test_ppo_trains(workers):
    """One iteration of the new API stack, with one policy for all."""
    from ray.rllib.algorithms.ppo import PPOConfig

    config = (
        PPOConfig()
        .environment(SurvivalMultiAgentEnv, env_config={"scenario": "teams_3", **SHORT})
        .env_runners(
            num_env_runners=1, num_envs_per_env_runner=2,
            env_to_module_connector=lambda env, spaces, device: FlattenObservations(multi_agent=True),
        )
        .multi_agent(policies={"all"}, policy_mapping_fn=lambda agent, episode, **more: "all")
        .training(train_batch_size_per_learner=scaled(400, least=60), minibatch_size=50, num_epochs=1)
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
    assert runners["agent_steps"].keys() == {f"agent_{i}" for i in range(4)}
    assert np.isfinite(learner["total_loss"])
