"""PPO of RLlib: one learner in each of 64 worlds, stepped as one batch, plays against random others.

python rllib_ppo.py --scenario FreeForAll1 --steps 1000000
"""

from argparse import ArgumentParser

from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

WORLDS, ROLLOUT = 64, 4096  # worlds; agent-steps between two updates


def config(scenario: str, seed: int) -> PPOConfig:
    """What RLlib is to do. scenario: Of `gymnasium.make`, without "outlast/" and "-v1"."""
    options = {"actions": "joint", "observations": "flat", "scaled": True, "others": "random"}
    chosen = PPOConfig().environment(f"outlast:outlast/{scenario}-v1", env_config={**options, "max_episode_steps": 600})
    chosen.env_runners(num_env_runners=0, num_envs_per_env_runner=WORLDS, gym_env_vectorize_mode="vector_entry_point")
    chosen.training(
        train_batch_size_per_learner=ROLLOUT, minibatch_size=512, num_epochs=4, lr=1e-3, gamma=0.99, lambda_=0.95,
        clip_param=0.2, vf_clip_param=float("inf"), entropy_coeff=0.01,
    )  # fmt: skip
    chosen.rl_module(
        model_config=DefaultModelConfig(fcnet_hiddens=[128, 128], fcnet_activation="tanh", vf_share_layers=False)
    )
    return chosen.debugging(seed=seed, log_level="ERROR")


def train(scenario: str, steps: int, seed: int = 0) -> list[float]:
    """Train, print how it goes, and return the learner's mean return in the episodes that ended, by update."""
    algorithm, returns = config(scenario, seed).build_algo(), list[float]()
    try:
        for k in range(1, steps // ROLLOUT + 1):
            found = algorithm.train()["env_runners"]
            if "episode_return_mean" in found:
                returns.append(float(found["episode_return_mean"]))
                print(f"{k * ROLLOUT:10,} agent-steps: return {returns[-1]:.1f}", flush=True)
    finally:
        algorithm.stop()
    return returns


if __name__ == "__main__":
    parser = ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--scenario", default="FreeForAll1", help="SCENARIO of outlast/SCENARIO-v1 (default FreeForAll1)"
    )
    parser.add_argument("--steps", type=int, default=1_000_000, help="agent-steps (default 1e6)")
    parser.add_argument("--seed", type=int, default=0, help="of training (default 0)")
    options = parser.parse_args()
    train(options.scenario, options.steps, options.seed)
