"""MAPPO from TorchRL's own parts: a collector, a critic that sees the state of the world, masks, and a clipped loss.

python torchrl_mappo.py --scenario ffa_1 --frames 400000
"""

from argparse import ArgumentParser

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, RewardSum, TransformedEnv
from torchrl.modules import MLP, MaskedCategorical, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss, ValueEstimators

import outlast

EPOCHS, MINIBATCHES, RATE, NET = 4, 8, 1e-3, {"num_cells": [128, 128], "activation_class": torch.nn.Tanh}


class Critic(torch.nn.Module):
    """What an agent can expect, by its observation and the state of its world."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.net = MLP(inputs, 1, **NET)

    def forward(self, seen: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        """(..., agents, numbers) and (..., numbers): (..., agents, 1)."""
        state = state.unsqueeze(-2).expand(*seen.shape[:-1], -1) if state.ndim < seen.ndim else state
        return self.net(torch.cat([seen, state], -1))


def modules(env: EnvBase) -> tuple[ProbabilisticActor, ValueOperator]:
    """One actor, and one critic, for all agents."""
    seen = env.observation_spec["agents", "observation"].shape[-1]
    actions = env.observation_spec["agents", "action_mask"].shape[-1]
    logits = TensorDictModule(MLP(seen, actions, **NET), [("agents", "observation")], [("agents", "logits")])
    actor = ProbabilisticActor(
        logits,
        in_keys={"logits": ("agents", "logits"), "mask": ("agents", "action_mask")},
        out_keys=[("agents", "action")],
        distribution_class=MaskedCategorical,
        return_log_prob=True,
        log_prob_key=("agents", "log_prob"),
    )
    size = seen + env.observation_spec["state"].shape[-1]
    critic = ValueOperator(Critic(size), [("agents", "observation"), "state"], [("agents", "value")])
    return actor, critic


def ppo(actor: ProbabilisticActor, critic: ValueOperator) -> ClipPPOLoss:
    """TorchRL's loss, with the keys of the agents."""
    loss = ClipPPOLoss(actor, critic, entropy_coeff=0.01, normalize_advantage=True)
    names = ("action", "reward", "done", "terminated", "value", "advantage", "value_target")
    loss.set_keys(sample_log_prob=("agents", "log_prob"), **{name: ("agents", name) for name in names})
    loss.make_value_estimator(ValueEstimators.GAE, gamma=0.99, lmbda=0.95)
    return loss


def samples(batch: TensorDict, loss: ClipPPOLoss) -> TensorDict:
    """A row for each agent that was alive, with its advantage."""
    agents = batch["agents"].batch_size
    for name in ("done", "terminated"):
        batch["next", "agents", name] = batch["next", name].unsqueeze(-1).expand(*agents, 1)
    with torch.no_grad():
        loss.value_estimator(batch, params=loss.critic_network_params, target_params=loss.target_critic_network_params)
    state = batch["state"].unsqueeze(2).expand(*agents, -1)
    rows = TensorDict({"agents": batch["agents"], "state": state}, agents).reshape(-1)
    return rows[rows["agents", "mask"]]


def train(scenario: str, frames: int, seed: int = 0, worlds: int = 64, ticks: int = 64) -> list[float]:
    """Train, print how it goes, and return an agent's mean return in the episodes that ended, by update.

    scenario: Its name, or a Scenario. ticks: Of each world, between two updates.
    """
    torch.manual_seed(seed)
    plain = outlast.adapters.make_torchrl(scenario, worlds, seed=seed, scaled=True, max_episode_steps=600)
    env = TransformedEnv(plain, RewardSum([("agents", "reward")], [("agents", "return")]))
    actor, critic = modules(env)
    loss = ppo(actor, critic)
    optimizer = torch.optim.Adam(loss.parameters(), RATE)
    size = worlds * ticks
    collector = Collector(env, actor, frames_per_batch=size, total_frames=frames // size * size)
    returns = list[float]()
    for k, batch in enumerate(collector, 1):
        rows = samples(batch, loss)
        for _ in range(EPOCHS):
            for part in rows[torch.randperm(len(rows))].chunk(MINIBATCHES):
                found = loss(part)
                total = found["loss_objective"] + found["loss_critic"] + found["loss_entropy"]
                optimizer.zero_grad()
                total.backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimizer.step()
        ended = batch["next", "agents", "return"][batch["next", "done"].squeeze(-1)]
        if len(ended):
            returns.append(float(ended.mean()))
            print(f"{k * size:10,} frames: return {returns[-1]:.1f}", flush=True)
    collector.shutdown()
    return returns


if __name__ == "__main__":
    parser = ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenario", default="teams_2", help="what is played (default teams_2)")
    parser.add_argument("--frames", type=int, default=1_000_000, help="ticks of a world, over all worlds (default 1e6)")
    parser.add_argument("--seed", type=int, default=0, help="of worlds and training (default 0)")
    options = parser.parse_args()
    train(options.scenario, options.frames, options.seed)
