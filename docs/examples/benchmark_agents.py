"""Agents for `outlast benchmark plan`: functions (env, seed) that return a policy (observations) -> actions.

python benchmark_agents.py sb3 ffa_2 0 1 2 --steps 1e6 --out weights  # trains what `sb3` plays, with these seeds
AGENTS_FOLDER=weights outlast benchmark plan ffa_2-v2 --agent sb3=benchmark_agents.py:sb3 --seed 0 1 2

`cleanrl` is the PPO of cleanrl_ppo.py, `mappo` that of BenchMARL. All are trained against themselves. Weights are saved
after each fifth of a training, as NAME-GAME-SEED-STEPS. The newest ones play, or those of at most AGENTS_STEPS steps.
"""

import os
import time
from argparse import ArgumentParser
from collections.abc import Callable
from functools import reduce
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import outlast

Game = str | outlast.Scenario
Observations = dict[str, np.ndarray]  # by key, (worlds, agents, ...)
Policy = Callable[[Observations], np.ndarray]  # integers (worlds, agents, actions)
AGENTS, TICKS = 200, 100  # agents of all worlds, and ticks between two updates
PARTS = 5  # of a training, after each of which weights are saved
LAYERS = [f"{k}.{part}" for k in (0, 2, 4) for part in ("weight", "bias")]  # of a network; between them is tanh


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


class Saving:
    """Saves weights after each fifth of a training, and prints how many agent-steps a second it took."""

    def __init__(self, name: str, game: Game, seed: int, steps: int, out: str | Path) -> None:
        """name: Of the agent. steps: Agent-steps of all agents; whole rollouts are collected."""
        env = outlast.make_vec(game, 1)
        self.agents, self.path = env.num_agents, Path(out, f"{name}-{env.scenario.file_name}-{seed}")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.worlds = max(1, AGENTS // self.agents)
        self.rollout = self.worlds * self.agents * TICKS  # agent-steps
        self.steps = -(-steps // self.rollout) * self.rollout
        self.due = [self.steps * part // PARTS for part in range(1, PARTS + 1)]
        self.last = 0, time.perf_counter()  # agent-steps when weights were saved, and the time

    def __call__(self, steps: int, save: Callable[[str], None]) -> None:
        """Save, if a part has ended. steps: Agent-steps until now. save: Gets a path without a suffix."""
        if self.due[0] > steps:
            return
        self.due = [due for due in self.due if due > steps] or [np.inf]
        save(f"{self.path}-{steps}")
        (before, start), self.last = self.last, (steps, time.perf_counter())
        new = steps - before
        rate = new / (self.last[1] - start)
        print(f"{self.path.name}: {steps:,} agent-steps, the last {new:,} at {rate:,.0f} a second", flush=True)


def saved(name: str, env, seed: int) -> Path:
    """The newest weights of an agent in AGENTS_FOLDER, of at most AGENTS_STEPS agent-steps."""
    folder, limit = Path(os.environ.get("AGENTS_FOLDER", "weights")), float(os.environ.get("AGENTS_STEPS", "inf"))
    start = f"{name}-{env.scenario.file_name}-{seed}-"
    found = {int(path.stem[len(start) :]): path for path in folder.glob("*") if path.name.startswith(start)}
    try:
        return found[max(steps for steps in found if steps <= limit)]
    except ValueError:
        text = f"{folder / start}* of at most {limit:,.0f} agent-steps: there is none; train it, or set AGENTS_FOLDER"
        raise FileNotFoundError(text) from None


def rows(env) -> Callable[[Observations], np.ndarray]:
    """A function that turns observations into what networks are trained with, float32 (worlds, agents, numbers).

    Numbers are scaled, as with scaled=True, and hidden rows are zeros, also where other policies see them.
    """
    space = outlast.adapters.make_agents(env.scenario, 1, observations="flat", scaled=True).single_observation_space

    def row(observations: Observations) -> np.ndarray:
        seen = outlast.adapters.scaled(observations, env.fields)
        hidden = {key: seen[f"{key}_mask"][..., None] for key in seen if f"{key}_mask" in seen}
        parts = [array * hidden.get(key, 1) for key, array in seen.items()]
        row = np.concatenate([part.reshape(env.num_worlds, env.num_agents, -1) for part in parts], -1)
        return np.clip(row, space.low, space.high)

    return row


def drawn(logits: np.ndarray, sizes: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """An integer for each action, (worlds, agents, actions), by the logits of all their values."""
    noisy = logits + generator.gumbel(size=logits.shape)  # the greatest is drawn with the probability of its logit
    return np.stack([part.argmax(-1) for part in np.split(noisy, np.cumsum(sizes)[:-1], -1)], -1)


def dense(path: Path) -> Callable[[np.ndarray], np.ndarray]:
    """The network of layers in a file, from rows to logits."""
    with np.load(path) as file:
        *first, weight, bias = (file[key] for key in LAYERS)

    def network(row: np.ndarray) -> np.ndarray:
        for own, shift in zip(first[::2], first[1::2], strict=True):
            row = np.tanh(row @ own.T + shift)
        return row @ weight.T + bias

    return network


def train_sb3(game: Game, seed: int, steps: int = 10_000_000, out: str | Path = "weights") -> None:
    """Train PPO of Stable-Baselines3, and save sb3-GAME-SEED-STEPS.zip."""
    from stable_baselines3 import PPO

    saving = Saving("sb3", game, seed, steps, out)
    env = outlast.adapters.make_sb3(game, saving.worlds, seed=seed, observations="flat", scaled=True)
    model = PPO("MlpPolicy", env, n_steps=TICKS, batch_size=saving.rollout // 20, seed=seed, device="cpu")
    while model.num_timesteps < saving.steps:
        model.learn(saving.rollout, reset_num_timesteps=False)
        saving(model.num_timesteps, model.save)


def sb3(env, seed: int) -> Policy:
    """What train_sb3 has saved."""
    import torch
    from stable_baselines3 import PPO

    policy, row = PPO.load(saved("sb3", env, seed), device="cpu").policy, rows(env)
    generator = np.random.default_rng(seed)

    def act(observations: Observations) -> np.ndarray:
        with torch.no_grad():
            odds = policy.get_distribution(torch.from_numpy(row(observations)).flatten(0, 1)).distribution
        logits = np.concatenate([each.logits for each in odds], -1).reshape(env.num_worlds, env.num_agents, -1)
        return drawn(logits, env.action_sizes, generator)

    return act


def train_cleanrl(game: Game, seed: int, steps: int = 10_000_000, out: str | Path = "weights") -> None:
    """Train the PPO of cleanrl_ppo.py, and save the layers of its actor in cleanrl-GAME-SEED-STEPS.npz."""
    from cleanrl_ppo import Args, train

    saving = Saving("cleanrl", game, seed, steps, out)

    def after(agent, steps: int) -> None:
        layers = {key: array.numpy() for key, array in agent.actor.state_dict().items()}
        saving(steps, lambda path: np.savez(path, **layers))

    usual = {"learning_rate": 1e-3, "gamma": 0.99, "ent_coef": 0.01, "num_minibatches": 10}
    train(Args(game, saving.worlds, saving.steps, TICKS, seed=seed, **usual), after=after)


def cleanrl(env, seed: int) -> Policy:
    """What train_cleanrl has saved; it needs no PyTorch. Actions that would do nothing are never drawn."""
    network, row, generator = dense(saved("cleanrl", env, seed)), rows(env), np.random.default_rng(seed)

    def act(observations: Observations) -> np.ndarray:
        logits = np.where(env.action_masks(), network(row(observations)), -np.inf)
        return drawn(logits, env.action_sizes, generator)

    return act


def train_mappo(game: Game, seed: int, steps: int = 10_000_000, out: str | Path = "weights") -> None:
    """Train MAPPO of BenchMARL, and save the layers of its actor in mappo-GAME-SEED-STEPS.npz."""
    from benchmarl.experiment import Callback
    from benchmarl_mappo import experiment

    from outlast.envs.adapters.benchmarl import task

    saving = Saving("mappo", game, seed, steps, out)
    sizes = {"n_envs_per_worker": saving.worlds, "collected_frames_per_batch": saving.worlds * TICKS}

    class After(Callback):
        def on_train_end(self, training_td, group: str) -> None:
            weights = run.algorithm.get_policy_for_loss("agents").state_dict()
            layers = {key: weights[f"module.0.mlp.params.{key}"].numpy() for key in LAYERS}
            saving(run.total_frames * saving.agents, lambda path: np.savez(path, **layers))

    with TemporaryDirectory() as folder:
        frames = saving.steps // saving.agents  # ticks of a world
        changes = {f"on_policy_{key}": size for key, size in sizes.items()} | {"evaluation": False}
        run = experiment(task(game, groups="all"), "mappo", frames, Path(folder), seed, **changes)
        run.callbacks.append(After())
        run.run()


def mappo(env, seed: int) -> Policy:
    """What train_mappo has saved; it needs no BenchMARL. All actions of an agent are drawn as one."""
    network, row, generator = dense(saved("mappo", env, seed)), rows(env), np.random.default_rng(seed)
    sizes = env.action_sizes

    def joint(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return (one[..., None] & other[..., None, :]).reshape(*one.shape[:-1], -1)

    def act(observations: Observations) -> np.ndarray:
        can = reduce(joint, np.split(env.action_masks(), np.cumsum(sizes)[:-1], -1))  # as in training
        logits = np.where(can, network(row(observations)), -np.inf)
        return np.stack(np.unravel_index(drawn(logits, can.shape[-1:], generator)[..., 0], sizes), -1)

    return act


if __name__ == "__main__":
    import torch

    torch.set_num_threads(1)  # the networks are so small that more threads would only wait for each other
    parser = ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("agent", choices=["sb3", "cleanrl", "mappo"])
    parser.add_argument("game", help="what is played: ffa_2, mygame.py:arena")
    parser.add_argument("seed", type=int, nargs="+", help="of trainings, one after the other")
    parser.add_argument("--steps", type=float, default=10e6, help="agent-steps of all agents (default 10e6)")
    parser.add_argument("--out", default="weights", help="folder of weights (default weights)")
    options = parser.parse_args()
    for seed in options.seed:
        globals()[f"train_{options.agent}"](options.game, seed, int(options.steps), options.out)
