"""Stable-Baselines3 learns to get into the safe zone and to stay there, in half a minute on two cores.

python sb3_ppo.py                        # PPO
python sb3_ppo.py --algorithm maskable   # MaskablePPO of sb3-contrib: actions that would do nothing are never drawn
python sb3_ppo.py --algorithm recurrent  # RecurrentPPO of sb3-contrib: an LSTM remembers what is out of sight; slower
"""

from argparse import ArgumentParser
from functools import partial

import numpy as np
from sb3_contrib import MaskablePPO, RecurrentPPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy as evaluate_masked
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor

import outlast

ZONE = {"safe_zone_radii": (4.0,), "safe_zone_centres": "middle", "safe_zone_stand": 1000, "safe_zone_damage": 2}
DUEL = outlast.variant("ffa_1").replace(room_size=20.0, n_heals=1, ending_limit=200, **ZONE)
SETTINGS = {"n_epochs": 4, "gamma": 0.98, "learning_rate": 1e-3}
BATCH, LSTM = {"n_steps": 64, "batch_size": 1024}, {"n_steps": 128, "batch_size": 512}
ALGORITHMS = {
    "ppo": partial(PPO, "MlpPolicy", **BATCH),
    "maskable": partial(MaskablePPO, "MlpPolicy", **BATCH),
    "recurrent": partial(RecurrentPPO, "MlpLstmPolicy", policy_kwargs={"lstm_hidden_size": 32}, **LSTM),
}


def make_env(seed: int) -> VecMonitor:
    """128 agents in 64 worlds, as so many environments for one policy."""
    return VecMonitor(outlast.adapters.make_sb3(DUEL, 64, seed=seed, observations="flat", scaled=True))


def returns(model: BaseAlgorithm) -> np.ndarray:
    """Of the agents of worlds that training does not see: ticks that each of them lives, 200 at most."""
    evaluate = evaluate_masked if isinstance(model, MaskablePPO) else evaluate_policy
    return np.array(evaluate(model, make_env(1000), 128, deterministic=False, return_episode_rewards=True)[0])


def main(steps: int = 400_000, seed: int = 0, algorithm: str = "ppo") -> tuple[np.ndarray, np.ndarray]:
    """The returns before training and after so many steps of an agent."""
    model = ALGORITHMS[algorithm](make_env(seed), **SETTINGS, seed=seed)
    before = returns(model)
    after = returns(model.learn(steps))
    print(f"mean reward: {before.mean():.1f} before, {after.mean():.1f} after")
    return before, after


if __name__ == "__main__":
    parser = ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    text = "PPO, or of sb3-contrib MaskablePPO or RecurrentPPO, which has an LSTM (default ppo)"
    parser.add_argument("--algorithm", default="ppo", choices=ALGORITHMS, help=text)
    main(algorithm=parser.parse_args().algorithm)
