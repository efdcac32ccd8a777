"""Agents for `outlast benchmark run`: functions (env, seed) that return a policy (observations) -> actions.

python benchmark_agents.py sb3 ffa_2-v1 0 1 2      # trains what `sb3` loads, with these seeds: PPO of Stable-Baselines3
python benchmark_agents.py mappo teams_2-v1 0 1 2  # the same of `mappo`: MAPPO of BenchMARL
"""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import outlast

Observations = dict[str, np.ndarray]  # by key, (worlds, agents, ...)
Policy = Callable[[Observations], np.ndarray]  # integers (worlds, agents, actions)


def striker(env, seed: int) -> Policy:
    """Ahead, always striking, and turning one way or the other by chance."""
    generator = np.random.default_rng(seed)
    names = [name for name, _ in env.action_columns]

    def act(observations: Observations) -> np.ndarray:
        actions = np.tile(env.noop, (env.num_worlds, env.num_agents, 1))
        actions[..., names.index("ahead")] = env.action_sizes[names.index("ahead")] - 1
        actions[..., names.index("attack")] = 1
        actions[..., names.index("turn")] += generator.integers(-1, 2, actions.shape[:2])
        return actions

    return act


def train_sb3(task: str, seed: int, steps: int = 10_000_000) -> None:
    """Train PPO of Stable-Baselines3, a network of dense layers, in the game of a task; saves sb3-GAME-SEED.zip."""
    from stable_baselines3 import PPO

    from outlast.training.benchmark.tasks import task_of

    env = outlast.adapters.make_sb3(task_of(task).scenario, 64, seed=seed)
    model = PPO("MultiInputPolicy", env, n_steps=256, batch_size=4096, n_epochs=4, seed=seed, device="cpu")
    model.learn(steps)
    model.save(f"sb3-{env.base_env.scenario.file_name}-{seed}")


def sb3(env, seed: int) -> Policy:
    """What train_sb3 has saved."""
    from stable_baselines3 import PPO

    model = PPO.load(f"sb3-{env.scenario.file_name}-{seed}.zip", device="cpu")

    def act(observations: Observations) -> np.ndarray:
        agents = {key: array.reshape(-1, *array.shape[2:]) for key, array in observations.items()}
        actions, _ = model.predict(agents)  # sampled, as in training
        return actions.reshape(env.num_worlds, env.num_agents, -1)

    return act


def train_mappo(task: str, seed: int, steps: int = 10_000_000) -> None:
    """Train MAPPO of BenchMARL, a network for all agents, in the game of a task; saves mappo-GAME-SEED.npz."""
    from benchmarl_mappo import experiment

    from outlast.envs.adapters.benchmarl import task as task_of_benchmarl
    from outlast.training.benchmark.tasks import task_of

    scenario = task_of(task).scenario
    own = task_of_benchmarl(scenario, groups="all")
    folder = Path("runs", f"mappo-{scenario.file_name}-{seed}")
    folder.mkdir(parents=True, exist_ok=True)
    frames = steps // outlast.make_vec(scenario, 1).num_agents  # ticks of a world
    run = experiment(own, "mappo", frames, folder, seed, evaluation=False)
    run.run()
    weights = run.algorithm.get_policy_for_loss("agents").state_dict()
    layers = {key: weights[f"module.0.mlp.params.{key}"].numpy() for key in LAYERS}
    np.savez(f"mappo-{scenario.file_name}-{seed}", **layers)


LAYERS = [f"{k}.{part}" for k in (0, 2, 4) for part in ("weight", "bias")]  # between them is tanh


def mappo(env, seed: int) -> Policy:
    """What train_mappo has saved; it needs no BenchMARL."""
    with np.load(f"mappo-{env.scenario.file_name}-{seed}.npz") as file:
        layers = [file[key] for key in LAYERS]
    sizes, generator = env.action_sizes, np.random.default_rng(seed)
    joint = np.stack(np.unravel_index(np.arange(np.prod(sizes)), sizes), -1)  # all actions of each joint one
    columns = joint + np.cumsum([0, *sizes[:-1]])  # of a mask

    def act(observations: Observations) -> np.ndarray:
        seen = outlast.adapters.scaled(observations, env.fields)
        row = np.concatenate([array.reshape(env.num_worlds, env.num_agents, -1) for array in seen.values()], -1)
        for weight, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
            row = np.tanh(row @ weight.T + bias)
        scores = row @ layers[-2].T + layers[-1]
        scores[~env.action_masks()[..., columns].all(-1)] = -np.inf  # as in training
        odds = np.cumsum(np.exp(scores - scores.max(-1, keepdims=True)), -1)
        drawn = generator.random((*odds.shape[:2], 1)) * odds[..., -1:]
        return joint[(odds > drawn).argmax(-1)]

    return act


if __name__ == "__main__":
    for number in sys.argv[3:]:
        {"sb3": train_sb3, "mappo": train_mappo}[sys.argv[1]](sys.argv[2], int(number))
