"""PPO of Stable-Baselines3 learns to get into the safe zone and to stay there; half a minute on two cores."""

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor

import outlast

ZONE = {"safe_zone_radii": (4.0,), "safe_zone_centres": "middle", "safe_zone_stand": 1000, "safe_zone_damage": 2}
DUEL = outlast.variant("ffa_1").replace(room_size=20.0, n_heals=1, ending_limit=200, **ZONE)
SETTINGS = {"n_steps": 64, "batch_size": 1024, "n_epochs": 4, "gamma": 0.98, "learning_rate": 1e-3}


def returns(model: PPO) -> np.ndarray:
    """Of 128 agents in 64 worlds that training does not see: ticks that each of them lives, 200 at most."""
    env = VecMonitor(outlast.make_sb3(DUEL, 64, seed=1000))
    return np.array(evaluate_policy(model, env, 128, deterministic=False, return_episode_rewards=True)[0])


def main(steps: int = 400_000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The returns before training and after so many steps of an agent."""
    env = VecMonitor(outlast.make_sb3(DUEL, 64, seed=seed))  # one policy for all 128 agents
    model = PPO("MultiInputPolicy", env, **SETTINGS, seed=seed)
    before = returns(model)
    after = returns(model.learn(steps))
    print(f"mean reward: {before.mean():.1f} before, {after.mean():.1f} after")
    return before, after


if __name__ == "__main__":
    main()
