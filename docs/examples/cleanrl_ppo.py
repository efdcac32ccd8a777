"""PPO in one file, in the style of CleanRL: one network plays all agents of all worlds, against itself.

python docs/examples/cleanrl_ppo.py --variant teams_3 --total-timesteps 10000000

Without --variant, two agents learn to fight for a place in the safe zone, in half a minute on two cores.
"""

import argparse
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

import outlast

ZONE = {"safe_zone_radii": (4.0,), "safe_zone_centres": "middle", "safe_zone_stand": 1000, "safe_zone_damage": 2}
DUEL = outlast.variant("ffa_1").replace(room_size=20.0, n_heals=1, ending_limit=200, **ZONE)


HELP = {
    "variant": "what is played: a variant, or duel, over a place in the safe zone",
    "num_worlds": "worlds that are stepped together",
    "total_timesteps": "agent-steps to train for",
    "num_steps": "steps of each world between two updates",
    "num_minibatches": "minibatches of an epoch",
    "update_epochs": "epochs of an update",
    "learning_rate": "of Adam",
    "gamma": "discount of a step",
    "gae_lambda": "lambda of generalised advantage estimation",
    "clip_coef": "how far the ratio of probabilities may move away from 1",
    "ent_coef": "weight of the entropy in the loss",
    "vf_coef": "weight of the values in the loss",
    "max_grad_norm": "norm to which gradients are clipped",
    "seed": "of worlds and networks",
}


@dataclass
class Args:
    """Every field is an option of the command line."""

    variant: str = "duel"
    num_worlds: int = 32
    total_timesteps: int = 300_000  # agent-steps
    num_steps: int = 64
    num_minibatches: int = 8
    update_epochs: int = 4
    learning_rate: float = 2e-3
    gamma: float = 0.98
    gae_lambda: float = 0.95
    clip_coef: float = 0.2
    ent_coef: float = 0.0
    vf_coef: float = 0.5
    max_grad_norm: float = 0.5
    seed: int = 0


def layer(inputs: int, outputs: int, std: float = np.sqrt(2)) -> nn.Linear:
    linear = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(linear.weight, std)
    nn.init.zeros_(linear.bias)
    return linear


class Agent(nn.Module):
    """A critic, and an actor with a head of logits for each of the six actions."""

    def __init__(self, inputs: int, sizes: list[int]) -> None:
        super().__init__()
        self.sizes = sizes
        self.critic = nn.Sequential(layer(inputs, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, 1, 1.0))
        self.actor = nn.Sequential(layer(inputs, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, sum(sizes), 0.01))

    def value(self, obs: torch.Tensor) -> torch.Tensor:
        """What the rest of the episode is worth, (agents,)."""
        return self.critic(obs).squeeze(-1)

    def act(
        self, obs: torch.Tensor, mask: torch.Tensor, action: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, ...]:
        """Actions (drawn, if not given), their log-probability and the entropy. Masked ones are never drawn."""
        logits = self.actor(obs).masked_fill(~mask, -1e8)
        heads = [Categorical(logits=own) for own in logits.split(self.sizes, -1)]
        if action is None:
            action = torch.stack([head.sample() for head in heads], -1)
        logprob = sum(head.log_prob(choice) for head, choice in zip(heads, action.unbind(-1), strict=True))
        return action, logprob, sum(head.entropy() for head in heads)


class Rollouts:
    """Steps all worlds and keeps what PPO learns from, tensors (steps, agents, ...)."""

    def __init__(self, envs, agent: Agent, args: Args) -> None:
        self.envs, self.agent, self.args = envs, agent, args
        observations, info = envs.reset(seed=args.seed)
        self.see(observations, info)
        self.returns: list[float] = []  # returns of each agent in episodes that ended in the last rollout

    def see(self, observations: np.ndarray, info: dict) -> None:
        """Keep what the next actions are chosen from: scaled rows (agents, numbers), and the masks of actions."""
        self.obs, self.alive = torch.from_numpy(observations), torch.from_numpy(info["alive"])
        self.mask = torch.from_numpy(info["action_mask"]).bool()

    @torch.no_grad()
    def collect(self) -> dict[str, torch.Tensor]:
        """Take `num_steps` steps of every world."""
        rows, self.returns = [], []
        for _ in range(self.args.num_steps):
            action, logprob, _ = self.agent.act(self.obs, self.mask)
            row = {"obs": self.obs, "mask": self.mask, "action": action, "logprob": logprob, "alive": self.alive}
            row["value"] = self.agent.value(self.obs)
            row["reward"], row["done"] = self.step(action)
            rows.append(row)
        batch = {key: torch.stack([row[key] for row in rows]) for key in rows[0]}
        return batch | self.advantages(batch)

    def step(self, action: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Rewards and ends. An episode that is cut short is worth what the critic expects of its last observation."""
        observations, reward, terminated, truncated, info = self.envs.step(action.numpy())
        self.see(observations, info)
        if "statistics" in info:
            self.returns += info["statistics"]["return"][info["_statistics"]].tolist()
        if truncated.any():
            last = torch.from_numpy(np.stack(list(info["final_obs"][truncated])))
            reward[truncated] += self.args.gamma * self.agent.value(last).numpy()
        return torch.from_numpy(reward), torch.from_numpy(terminated | truncated)

    def advantages(self, batch: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Generalised advantage estimates, and the returns that they make of the values."""
        advantage, value = torch.zeros_like(batch["value"]), self.agent.value(self.obs)
        ahead = torch.zeros_like(value)
        for t in reversed(range(len(advantage))):
            going = (~batch["done"][t]).float()
            delta = batch["reward"][t] + self.args.gamma * going * value - batch["value"][t]
            ahead = delta + self.args.gamma * self.args.gae_lambda * going * ahead
            advantage[t], value = ahead, batch["value"][t]
        return {"advantage": advantage, "target": advantage + batch["value"]}


def losses(agent: Agent, batch: dict[str, torch.Tensor], args: Args) -> torch.Tensor:
    """Of policy, value and entropy. The dead have no choice: only the critic learns from them."""
    _, logprob, entropy = agent.act(batch["obs"], batch["mask"], batch["action"])
    alive, ratio = batch["alive"], (logprob - batch["logprob"]).exp()
    advantage = batch["advantage"]
    advantage = (advantage - advantage[alive].mean()) / (advantage[alive].std() + 1e-8)
    clipped = ratio.clamp(1 - args.clip_coef, 1 + args.clip_coef)
    policy = -torch.min(advantage * ratio, advantage * clipped)[alive].mean()
    value = 0.5 * (agent.value(batch["obs"]) - batch["target"]).square().mean()
    return torch.stack([policy, value, entropy[alive].mean()])


def learn(agent: Agent, optimizer: torch.optim.Optimizer, batch: dict[str, torch.Tensor], args: Args) -> torch.Tensor:
    """Some epochs over a batch in minibatches; the losses of the last one."""
    batch = {key: values.flatten(0, 1) for key, values in batch.items()}
    for _ in range(args.update_epochs):
        for rows in torch.randperm(len(batch["obs"])).chunk(args.num_minibatches):
            parts = losses(agent, {key: values[rows] for key, values in batch.items()}, args)
            optimizer.zero_grad()
            (parts @ torch.tensor([1.0, args.vf_coef, -args.ent_coef])).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), args.max_grad_norm)
            optimizer.step()
    return parts.detach()


def make(scenario: str | outlast.Scenario, args: Args):
    """All agents of all worlds, each of them a sub-environment."""
    form = {"observations": "flat", "scaled": True, "action_masks": True}
    return outlast.adapters.make_agents(scenario, args.num_worlds, autoreset_mode="SameStep", **form)


def train(
    args: Args, make=make, kind: type[Rollouts] = Rollouts, after=lambda agent, steps: None
) -> tuple[Agent, np.ndarray]:
    """The trained agent, and a row for each update: mean return of the episodes that ended, and the three losses.

    make, kind: What makes the environments, and steps them. after: Called after each update, with all agent-steps.
    """
    torch.manual_seed(args.seed)
    envs = make(DUEL if args.variant == "duel" else args.variant, args)
    agent = Agent(envs.single_observation_space.shape[0], envs.single_action_space.nvec.tolist())
    optimizer = torch.optim.Adam(agent.parameters(), args.learning_rate, eps=1e-5)
    rollouts, rows = kind(envs, agent, args), []
    size = args.num_steps * len(rollouts.obs)
    for update in range(1, max(1, args.total_timesteps // size) + 1):
        batch = rollouts.collect()
        parts = learn(agent, optimizer, batch, args)
        rows.append([np.mean(rollouts.returns) if rollouts.returns else np.nan, *parts.tolist()])
        print("step {}: return {:.1f}, losses {:.3f} {:.3f}, entropy {:.3f}".format(update * size, *rows[-1]))
        after(agent, update * size)
    envs.close()
    return agent, np.array(rows)


def arguments() -> Args:
    about = "PPO in one file: one network plays all agents of all worlds, against itself."
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    for field in fields(Args):
        name, text = f"--{field.name.replace('_', '-')}", HELP[field.name]
        parser.add_argument(name, type=field.type, default=field.default, help=text)
    return Args(**vars(parser.parse_args()))


if __name__ == "__main__":
    torch.set_num_threads(1)  # the network is so small that more threads would only wait for each other
    train(arguments())
