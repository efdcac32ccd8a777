"""Time a step in each interface, and collecting in other libraries.

    python -m perf.interfaces [--variant teams_3] [--worlds 256]
        [--save MACHINE]

Actions are random and drawn before the clock starts; episodes restart as each
interface does it. Collectors are those of the libraries. They store what they
collect, and their policy computes nothing: it always takes the same action, in
RLlib a random one. Times are CPU time of the process, the best of several
rounds, one interface after the other. An interface whose library is not
installed has no row; `pip install -e '.[ray,sb3,puffer,benchmarl]'` installs
all of them.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np

import outlast
from perf.measure import DRAWS, Call, timer
from perf.table import Table, options, positive

ROUNDS, SECONDS = 3, 0.5
STEPS = 64  # ticks that a collector stores in a call
Made = tuple[int, int, Call]  # world-steps and agent-steps of a call, and the call


def batch(variant: str, worlds: int, **more: Any) -> Made:
    """The vector environment itself."""
    env = outlast.make_vec(variant, worlds, seed=0, **more)
    env.reset()
    draws = drawn(env.action_sizes, (worlds, env.num_agents, len(env.action_sizes)))
    return worlds, worlds * env.num_agents, lambda k: env.step(draws[k % DRAWS])


def agents(variant: str, worlds: int) -> Made:
    """Every agent a sub-environment."""
    env: Any = outlast.adapters.make_agents(variant, worlds, seed=0)
    env.reset()
    draws = drawn(env.single_action_space.nvec, (env.num_envs, len(env.single_action_space.nvec)))
    return worlds, env.num_envs, lambda k: env.step(draws[k % DRAWS])


def learners(variant: str, worlds: int) -> Made:
    """gymnasium.make_vec: one learner a world, against random others."""
    env: Any = gymnasium.make_vec(name(variant), num_envs=worlds, others="random")
    env.reset(seed=0)
    draws = drawn(env.single_action_space.nvec, (worlds, len(env.single_action_space.nvec)))
    return worlds, worlds, lambda k: env.step(draws[k % DRAWS])


def single(variant: str, worlds: int) -> Made:
    """gymnasium.make: one world, one learner."""
    env: Any = gymnasium.make(name(variant), others="random")
    env.reset(seed=0)
    draws = drawn(env.action_space.nvec, env.action_space.shape)

    def step(k: int) -> None:
        _, _, terminated, truncated, _ = env.step(draws[k % DRAWS])
        if terminated or truncated:
            env.reset()

    return 1, 1, step


def parallel(variant: str, worlds: int) -> Made:
    """PettingZoo: one world, dictionaries by agent."""
    env = outlast.adapters.parallel_env(variant, seed=0, dead="keep")
    env.reset()
    sizes = env.action_space(env.possible_agents[0]).nvec
    draws = [dict(zip(env.possible_agents, each)) for each in drawn(sizes, (len(env.possible_agents), len(sizes)))]

    def step(k: int) -> None:
        env.step({agent: draws[k % DRAWS][agent] for agent in env.agents})
        if not env.agents:
            env.reset()

    return 1, len(env.possible_agents), step


def sb3(variant: str, worlds: int) -> Made:
    """Stable-Baselines3's VecEnv."""
    env = outlast.adapters.make_sb3(variant, worlds, seed=0)
    env.reset()
    draws = drawn(env.action_space.nvec, (env.num_envs, len(env.action_space.nvec)))
    return worlds, env.num_envs, lambda k: env.step(draws[k % DRAWS])


def torchrl(variant: str, worlds: int) -> Made:
    """TorchRL's own environment, stepped by hand."""
    import torch

    env: Any = outlast.adapters.make_torchrl(variant, worlds, seed=0)
    shape = (worlds, env.vector_env.num_agents)
    draws = [torch.as_tensor(each) for each in drawn(env.vector_env.single_action_space.nvec, shape)]
    state = [env.reset()]

    def step(k: int) -> None:
        state[0]["agents", "action"] = draws[k % DRAWS]
        _, state[0] = env.step_and_maybe_reset(state[0])

    return worlds, shape[0] * shape[1], step


def torchrl_collector(variant: str, worlds: int) -> Made:
    """TorchRL's collector."""
    import torch
    from tensordict.nn import TensorDictModule
    from torchrl.collectors import Collector

    env: Any = outlast.adapters.make_torchrl(variant, worlds, seed=0)
    agents = env.vector_env.num_agents
    idle = torch.full((worlds, agents), int(env.vector_env.noop))
    policy = TensorDictModule(lambda state: idle, in_keys=["state"], out_keys=[("agents", "action")])
    collector = Collector(env, policy, frames_per_batch=worlds * STEPS, total_frames=-1)
    batches = iter(collector)
    return worlds * STEPS, worlds * agents * STEPS, lambda k: next(batches)


def puffer(variant: str, worlds: int) -> Made:
    """PufferLib's native environment."""
    env: Any = outlast.adapters.make_puffer(variant, worlds)
    env.reset(seed=0)
    draws = drawn(env.single_action_space.nvec, (env.num_agents, len(env.single_action_space.nvec)))
    return worlds, env.num_agents, lambda k: env.step(draws[k % DRAWS])


def puffer_vector(variant: str, worlds: int) -> Made:
    """PufferLib's vectorisation in this process; observations are stored, as its trainer does."""
    from pufferlib import vector

    env = vector.make(outlast.adapters.make_puffer, [variant, worlds], backend=vector.Serial, num_envs=1)
    env.async_reset(0)
    actions = drawn(env.single_action_space.nvec, (env.num_agents, len(env.single_action_space.nvec)))[0]
    kept = np.zeros((STEPS, env.num_agents, *env.single_observation_space.shape), np.float32)

    def step(k: int) -> None:
        for row in kept:
            row[:] = env.recv()[0]
            env.send(actions)

    return worlds * STEPS, env.num_agents * STEPS, step


def sb3_collector(variant: str, worlds: int) -> Made:
    """Stable-Baselines3's PPO, filling its rollout buffer."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import CallbackList

    env = outlast.adapters.make_sb3(variant, worlds, seed=0, observations="flat")
    model = PPO("MlpPolicy", env, n_steps=STEPS, policy_kwargs={"net_arch": [1]})
    actions = torch.ones(env.num_envs, len(env.action_space.nvec), dtype=torch.int64)
    zeros = torch.zeros(env.num_envs)
    model.policy.forward = lambda seen, deterministic=False: (actions, zeros[:, None], zeros)
    model.policy.predict_values = lambda seen: zeros[: len(seen), None]
    _, callback = model._setup_learn(2**62, CallbackList([]))
    collect = model.collect_rollouts
    return (
        worlds * STEPS, env.num_envs * STEPS,
        lambda k: collect(model.env, callback, model.rollout_buffer, STEPS),
    )  # fmt: skip


def rllib_batch(variant: str, worlds: int) -> Made:
    """RLlib's sampling of one learner a world, by the entry point for batches."""
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

    config = PPOConfig().environment(f"outlast:{name(variant)}", env_config={"observations": "flat"})
    mode = "vector_entry_point"
    config.env_runners(num_env_runners=0, num_envs_per_env_runner=worlds, gym_env_vectorize_mode=mode)
    runner = SingleAgentEnvRunner(config=config)
    steps = worlds * STEPS
    return steps, steps, lambda k: runner.sample(num_timesteps=steps, random_actions=True)


def rllib(variant: str, worlds: int) -> Made:
    """RLlib's sampling of all agents of a world, which has no batches."""
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner

    from outlast.envs.adapters.rllib import SurvivalMultiAgentEnv

    config = PPOConfig().environment(SurvivalMultiAgentEnv, env_config={"scenario": variant, "observations": "flat"})
    config.env_runners(num_env_runners=0, num_envs_per_env_runner=1)
    config.multi_agent(policies={"all"}, policy_mapping_fn=lambda agent, episode, **more: "all")
    runner = MultiAgentEnvRunner(config=config)
    agents = len(runner.env.unwrapped.envs[0].unwrapped.possible_agents)
    return STEPS, agents * STEPS, lambda k: runner.sample(num_timesteps=STEPS, random_actions=True)


INTERFACES: dict[str, tuple[Callable[..., Made], dict[str, Any]]] = {
    "make_vec": (batch, {}),
    "make_vec(copy=False)": (batch, {"copy": False}),
    "make_vec(observations='flat')": (batch, {"observations": "flat"}),
    "make_agents": (agents, {}),
    "make_puffer": (puffer, {}),
    "PufferLib's Serial": (puffer_vector, {}),
    "make_sb3": (sb3, {}),
    "Stable-Baselines3's collect_rollouts": (sb3_collector, {}),
    "make_torchrl": (torchrl, {}),
    "TorchRL's Collector": (torchrl_collector, {}),
    "gymnasium.make_vec": (learners, {}),
    "RLlib's SingleAgentEnvRunner": (rllib_batch, {}),
    "parallel_env": (parallel, {}),
    "RLlib's MultiAgentEnvRunner": (rllib, {}),
    "gymnasium.make": (single, {}),
}


def drawn(sizes: Any, shape: tuple[int, ...]) -> list[Any]:
    """Random actions for DRAWS steps."""
    generator = np.random.default_rng(0)
    return [generator.integers(0, sizes, shape) for _ in range(DRAWS)]


def name(variant: str) -> str:
    """Gymnasium's name of a variant: "teams_3" is outlast/Teams3-v1."""
    return next(key for key, spec in gymnasium.registry.items() if spec.kwargs.get("scenario") == variant)


def rows(variant: str, worlds: int) -> Iterator[tuple[object, ...]]:
    """Yield a row of the table for each interface that can be loaded; shares are of make_vec's rate in this run."""
    made: dict[str, Made] = {}
    for label, (make, more) in INTERFACES.items():
        try:
            made[label] = make(variant, worlds, **more)
        except ImportError as error:
            print(f"{label} is left out: {error}")
    clocks = {label: timer(call, SECONDS, time.process_time) for label, (_, _, call) in made.items()}
    rounds = [{label: clock() for label, clock in clocks.items()} for _ in range(ROUNDS)]
    rates = {label: made[label][1] / min(times[label] for times in rounds) for label in made}
    for label, (count, acting, _) in made.items():
        us, share = acting / rates[label] / count * 1e6, rates[label] / rates["make_vec"]
        yield label, us, f"{rates[label]:,.0f}", f"{share:.1%}"


def main() -> None:
    """Time them one after the other."""
    parser = options(__doc__)
    parser.add_argument("--variant", default="teams_3", help="variant that is played (default teams_3)")
    parser.add_argument(
        "--worlds", type=positive, default=256, help="worlds, where an interface has many (default 256)"
    )
    given = parser.parse_args()
    table = Table("interfaces", "interface", "us a world-step", "agent-steps a second", "of make_vec")
    for row in rows(given.variant, given.worlds):
        table.add(*row)
    table.finish(given.save)


if __name__ == "__main__":
    main()
