"""Ray: a cluster computes what one machine does, also when it loses workers."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import outlast
from outlast.envs.cli import main as cli
from outlast.envs.errors import ClusterError, EndlessError, FaultError
from outlast.envs.rollout import local
from outlast.envs.rollout.local import RolloutTask, run_task
from outlast.envs.rollout.policies import POLICIES
from tests.helpers.execution_modes import short

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'outlast[ray]'")

from outlast.envs.rollout import ray as cluster  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")  # Ray's own, by the dozen

WORLDS, STEPS, SEED = 10, 150, 3


@pytest.fixture(scope="module")
def workers():
    """A cluster on this machine, small whatever it has."""
    ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
    yield
    ray.shutdown()


def task(policy=POLICIES["random"], variant="teams_3"):
    return RolloutTask(short(variant).replace(ending_limit=25), policy, STEPS, SEED)


def same(one, other):
    tables = ((one.sums, other.sums), (one.squares, other.squares))
    return one.rows() == other.rows() and all(np.array_equal(a[key], b[key]) for a, b in tables for key in a | b)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere.invalid:6379", "ray://127.0.0.1:1", "gibberish"])
def test_no_cluster_is_said_at_once(capsys, address):
    assert not ray.is_initialized()
    assert cli.main(("rollout", "ffa_1", "--ray", address)) == 2
    (line,) = [line for line in capsys.readouterr().err.strip().splitlines() if "compil" not in line]
    assert line.startswith(f"outlast: no Ray cluster at {address}: ")


@pytest.mark.parametrize("size", [1, 4, 256])
def test_a_cluster_computes_what_one_machine_does(workers, monkeypatch, size):
    monkeypatch.setattr(local, "MAX_BATCH", size)
    seen = []
    spread = cluster.rollout_on_cluster(task(), WORLDS, seen.append)
    alone = run_task(task(), 0, WORLDS)
    assert spread.episodes == alone.episodes >= WORLDS
    assert same(spread, alone)
    assert spread.world_steps == alone.world_steps == WORLDS * STEPS
    done = [(summary.world_steps, summary.episodes) for summary in seen]
    assert done == sorted(done)
    assert done[-1] == (alone.world_steps, alone.episodes)


def test_an_episode_without_an_end_is_reported_as_on_one_machine(workers):
    def impatient(env, seed):
        local.MAX_STEPS = 30  # in the worker, which has this module, too
        return POLICIES["noop"](env, seed)

    never = RolloutTask(outlast.variant("ffa_1").replace(safe_zone_damage=0), impatient, 0, SEED)
    with pytest.raises(EndlessError, match="world 0 has been in one episode for 30 steps"):
        cluster.rollout_on_cluster(never, 1)


@pytest.mark.parametrize("how", ["exit", "kill"])
def test_a_lost_worker_loses_no_episode_and_repeats_none(workers, monkeypatch, tmp_path, how):
    """The worker of the second batch is lost in mid-rollout, the first time; every start leaves a file."""

    def fragile(env, seed):
        first, steps, act = env.first_world, itertools.count(), POLICIES["random"](env, seed)
        starts = len(list(tmp_path.glob(f"{first}-*")))
        (tmp_path / f"{first}-{starts}").touch()

        def policy(observations):
            if first == 3 and starts == 0 and next(steps) == STEPS - 5:
                os._exit(1) if how == "exit" else os.kill(os.getpid(), signal.SIGKILL)
            return act(observations)

        return policy

    monkeypatch.setattr(local, "MAX_BATCH", 3)
    spread = cluster.rollout_on_cluster(task(fragile), WORLDS)
    assert {path.name for path in tmp_path.iterdir()} >= {"0-0", "3-0", "3-1", "6-0", "9-0"}
    alone = run_task(task(), 0, WORLDS)
    assert spread.episodes == alone.episodes
    assert same(spread, alone)


def test_a_worker_that_is_always_lost_is_an_error_that_names_its_worlds(workers, monkeypatch):
    def deadly(env, seed):
        if env.first_world:
            os._exit(1)
        return POLICIES["random"](env, seed)

    monkeypatch.setattr(local, "MAX_BATCH", 5)
    monkeypatch.setattr(cluster, "MAX_RETRIES", 1)
    with pytest.raises(ClusterError, match=r"worlds 5 to 9 lost their worker 2 times .*memory"):
        cluster.rollout_on_cluster(task(deadly), WORLDS)


def test_what_a_policy_raises_comes_back(workers):
    def broken(env, seed):
        raise ZeroDivisionError("in the policy")

    with pytest.raises(ZeroDivisionError, match="in the policy"):
        cluster.rollout_on_cluster(task(broken), WORLDS)


def test_a_fault_of_a_world_is_one_line_below_the_finished_batches(workers, monkeypatch, capsys):

    make = POLICIES["random"]

    def faulty(env, seed):
        act = make(env, seed)

        def policy(observations):
            if env.first_world == 8:
                time.sleep(6)
                raise FaultError("world 9: a body is nowhere")
            return act(observations)

        return policy

    monkeypatch.setattr(local, "MAX_BATCH", 8)
    monkeypatch.setitem(POLICIES, "random", faulty)
    arguments = ["rollout", "ffa_2", "--worlds", "16", "--steps", "150", "--set", "safe_zone_damage=100", "--quiet"]
    assert cli.main([*arguments, "--ray"]) == 2
    out, error = capsys.readouterr()
    assert error.strip().splitlines()[-1] == "outlast: world 9: a body is nowhere"
    assert "Traceback" not in error
    monkeypatch.undo()
    assert cli.main([*arguments[:3], "8", *arguments[4:]]) == 0
    table = capsys.readouterr().out.partition("agent-steps/s")[2].partition("\n")[2]
    assert out.partition("agent-steps/s")[2].partition("\n")[2] == table
    assert "deaths_zone" in table


@pytest.mark.slow
def test_json_is_json_where_a_worker_is_lost(tmp_path):
    """Ray's own words about it are not among it: the first worker of a batch ends itself."""
    program = tmp_path / "deadly.py"
    program.write_text(
        "import os, pathlib, sys\n"
        "from outlast.envs.cli import main\n"
        "from outlast.envs.rollout.policies import POLICIES\n"
        "act, place = POLICIES['random'], pathlib.Path(__file__).with_suffix('.lost')\n"
        "def fragile(env, seed):\n"
        "    if not place.exists():\n"
        "        place.touch()\n"
        "        os.kill(os.getpid(), 9)\n"
        "    return act(env, seed)\n"
        "POLICIES['random'] = fragile\n"
        "sys.exit(main.main('rollout ffa_2 --worlds 4 --steps 20 --quiet --json - --ray local'.split()))\n"
    )
    done = subprocess.run([sys.executable, program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert program.with_suffix(".lost").exists()
    assert json.loads(done.stdout)["world_steps"] == 80


def test_workers_with_another_version_are_refused(workers, monkeypatch):
    monkeypatch.setattr(outlast, "__version__", "0.0.7")
    with pytest.raises(ClusterError, match=r"this machine 0\.0\.7: install the same"):
        cluster.rollout_on_cluster(task(), WORLDS)


def test_ctrl_c_leaves_the_summary_of_the_finished_batches(workers, monkeypatch, tmp_path):

    def endless(env, seed):
        act = POLICIES["random"](env, seed)

        def policy(observations):
            while env.first_world == 8:
                time.sleep(0.01)
            return act(observations)

        return policy

    def progress(summary):
        if summary.world_steps == 8 * STEPS:
            raise KeyboardInterrupt

    monkeypatch.setattr(local, "MAX_BATCH", 4)
    with pytest.raises(KeyboardInterrupt) as stop:
        cluster.rollout_on_cluster(task(endless), WORLDS, progress)
    assert same(stop.value.args[0], run_task(task(), 0, 8))
    assert cluster.rollout_on_cluster(task(), WORLDS).episodes  # its worker is free again


def tasks():
    """What processes do that train together; functions by value, as workers cannot import this file."""

    def train(crew, config):
        from outlast.training.ppo.trainer import Trainer

        trainer = Trainer(config, crew=crew)
        for _ in range(2):
            trainer.update(trainer.collect())
        return [parameter.detach() for parameter in trainer.policies[0].parameters()]

    def fail(crew, *_):
        raise RuntimeError("nothing ends here")

    def leave(crew, *_):
        import os

        os._exit(1)

    return train, fail, leave


def test_training_on_a_cluster_gives_the_numbers_of_one_process(workers):
    import torch

    from outlast.training.base.config import TrainingConfig
    from outlast.training.ppo.crew import Crew, recruit_on_cluster

    train, _, _ = tasks()
    config = TrainingConfig(short("teams_2"), "fast", worlds=7, rollout=7 * 16, settings={"batch_size": 64})
    crew = recruit_on_cluster("", 3, train, config)
    try:
        found = train(crew, config)
    finally:
        crew.close()
    for one, other in zip(found, train(Crew(), config), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("work", "message"),
    [
        (1, "process . of 3: nothing ends here"),
        pytest.param(2, r"process . of 3 was lost \(.*\); continue with --resume", marks=pytest.mark.nightly),
    ],
)
def test_training_says_why_a_worker_ended(workers, work, message):
    from outlast.training.base.errors import TrainingError
    from outlast.training.ppo.crew import recruit_on_cluster

    crew = recruit_on_cluster("", 3, tasks()[work])
    try:
        with pytest.raises(TrainingError, match=message):
            crew.gather_values(0)
    finally:
        crew.close()


def test_training_needs_a_core_for_each_process(workers):
    from outlast.training.ppo.crew import recruit_on_cluster

    with pytest.raises(ClusterError, match="the cluster has 2 cores: 4 processes need 3, and one here"):
        recruit_on_cluster("", 4, tasks()[0])
