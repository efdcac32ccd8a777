"""What a step costs in each interface.

    python -m perf.interfaces [--variant teams_3] [--save MACHINE]

Random actions, drawn ahead of the clock; episodes restart as the interface does it. Processor time of the process, the
best of several rounds. An interface whose library is not installed has no row.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np

import outlast
from perf.measure import DRAWS, Call, timer
from perf.table import Table, options

ROUNDS, SECONDS = 3, 0.5
Made = tuple[int, int, Call]  # worlds, agents that act in a step of all of them, and what steps them


def batch(variant: str, worlds: int, **more: Any) -> Made:
    """The vector environment itself."""
    env = outlast.make_vec(variant, worlds, seed=0, **more)
    env.reset()
    draws = drawn(env.action_sizes, (worlds, env.num_agents, len(env.action_sizes)))
    return worlds, worlds * env.num_agents, lambda k: env.step(draws[k % DRAWS])


def agents(variant: str, worlds: int) -> Made:
    """Every agent a sub-environment."""
    env = outlast.make_agents(variant, worlds, seed=0)
    env.reset()
    draws = drawn(env.single_action_space.nvec, (env.num_envs, len(env.single_action_space.nvec)))
    return worlds, env.num_envs, lambda k: env.step(draws[k % DRAWS])


def learners(variant: str, worlds: int) -> Made:
    """gymnasium.make_vec: one learner a world, against random others."""
    env = gymnasium.make_vec(name(variant), num_envs=worlds, others="random")
    env.reset(seed=0)
    draws = drawn(env.single_action_space.nvec, (worlds, len(env.single_action_space.nvec)))
    return worlds, worlds, lambda k: env.step(draws[k % DRAWS])


def single(variant: str, worlds: int) -> Made:
    """gymnasium.make: one world, one learner."""
    env = gymnasium.make(name(variant), others="random")
    env.reset(seed=0)
    draws = drawn(env.action_space.nvec, env.action_space.shape)

    def step(k: int) -> None:
        _, _, terminated, truncated, _ = env.step(draws[k % DRAWS])
        if terminated or truncated:
            env.reset()

    return 1, 1, step


def parallel(variant: str, worlds: int) -> Made:
    """PettingZoo: one world, dictionaries by agent."""
    env = outlast.parallel_env(variant, seed=0, dead="keep")
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
    env = outlast.make_sb3(variant, worlds, seed=0)
    env.reset()
    draws = drawn(env.action_space.nvec, (env.num_envs, len(env.action_space.nvec)))
    return worlds, env.num_envs, lambda k: env.step(draws[k % DRAWS])


def torchrl(variant: str, worlds: int) -> Made:
    """TorchRL around make_agents, with tensors of its own."""
    from torchrl.envs import GymWrapper

    env = GymWrapper(outlast.make_agents(variant, worlds, autoreset_mode="Disabled"))
    state = [env.rand_action(env.reset())]

    def step(k: int) -> None:
        _, state[0] = env.step_and_maybe_reset(state[0])
        state[0] = env.rand_action(state[0])

    return worlds, env.batch_size[0], step


def puffer(variant: str, worlds: int) -> Made:
    """PufferLib's native environment."""
    env = outlast.make_puffer(variant, worlds)
    env.reset(seed=0)
    draws = drawn(env.single_action_space.nvec, (env.num_agents, len(env.single_action_space.nvec)))
    return worlds, env.num_agents, lambda k: env.step(draws[k % DRAWS])


INTERFACES: dict[str, tuple[Callable[..., Made], dict[str, Any]]] = {
    "make_vec(copy=False)": (batch, {"copy": False}),
    "make_vec": (batch, {}),
    "make_agents": (agents, {}),
    "make_puffer": (puffer, {}),
    "make_sb3": (sb3, {}),
    "TorchRL's GymWrapper": (torchrl, {}),
    "gymnasium.make_vec": (learners, {}),
    "parallel_env": (parallel, {}),
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
    """A row of the table for each interface that can be loaded."""
    for label, (make, more) in INTERFACES.items():
        try:
            count, acting, call = make(variant, worlds, **more)
        except ModuleNotFoundError as error:
            print(f"{label} is left out: {error}")
            continue
        clock = timer(call, SECONDS, time.process_time)
        seconds = min(clock() for _ in range(ROUNDS))
        yield label, count, seconds / count * 1e6, f"{acting / seconds:,.0f}"


def main() -> None:
    """Time them one after the other."""
    parser = options(__doc__)
    parser.add_argument("--variant", default="teams_3")
    parser.add_argument("--worlds", type=int, default=256, help="of interfaces that have many (default 256)")
    given = parser.parse_args()
    table = Table("interfaces", "interface", "worlds", "us a world-step", "agent-steps a second")
    for row in rows(given.variant, given.worlds):
        table.add(*row)
    table.finish(given.save)


if __name__ == "__main__":
    main()
