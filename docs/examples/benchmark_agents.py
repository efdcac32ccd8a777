"""Agents for `outlast benchmark run`: functions (env, seed) that return a policy (observations) -> actions.

python benchmark_agents.py ffa_2-v1 0 1 2    # trains what `sb3` loads: PPO of Stable-Baselines3, with these seeds
"""

import sys
from collections.abc import Callable

import numpy as np

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

    import outlast
    from outlast.training.benchmark.tasks import task_of

    env = outlast.make_sb3(task_of(task).scenario, 64, seed=seed)
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


if __name__ == "__main__":
    for number in sys.argv[2:]:
        train_sb3(sys.argv[1], int(number))
