"""A rollout with TorchRL: one network plays all agents of a world, in which deaths do not end the episode."""

import torch
from tensordict.nn import TensorDictModule
from torch.distributions import Categorical
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.modules import MultiAgentMLP

import outlast

SEEN = ("own", "zone", "others", "others_mask")  # the inputs of the network; any other observations can stand here


def make_env(variant: str = "teams_3", **numbers: float) -> PettingZooWrapper:
    """Both keywords matter: without them the first death ends the episode, or is an error."""
    return PettingZooWrapper(outlast.parallel_env(variant, **numbers), use_mask=True, done_on_any=False)


class Actor(torch.nn.Module):
    """A head of logits for each of an agent's actions; all agents share the weights."""

    def __init__(self, env: PettingZooWrapper) -> None:
        super().__init__()
        seen = env.observation_spec["agent", "observation"]
        agents, inputs = seen.shape[0], sum(seen[key][0].shape.numel() for key in SEEN)
        self.sizes = env.action_spec_unbatched["agent", "action"].nvec[0].tolist()
        self.net = MultiAgentMLP(
            inputs, sum(self.sizes), agents, centralized=False, share_params=True, depth=2, num_cells=64
        )

    def forward(self, *seen: torch.Tensor) -> torch.Tensor:
        """Actions drawn for what is seen, (..., agents, numbers) for each key: (..., agents, actions)."""
        rows = torch.cat([values.flatten(seen[0].ndim - 1) for values in seen], -1)
        heads = self.net(rows / 25).split(self.sizes, -1)
        return torch.stack([Categorical(logits=head).sample() for head in heads], -1)


def main(steps: int = 500, seed: int = 0) -> int:
    """Play up to `steps` ticks of one episode, print each agent's ticks and return, and return the ticks."""
    torch.manual_seed(seed)
    env = make_env()
    env.set_seed(seed)
    keys = [("agent", "observation", key) for key in SEEN]
    rollout = env.rollout(steps, TensorDictModule(Actor(env), in_keys=keys, out_keys=[("agent", "action")]))
    lived = rollout["agent", "mask"].sum(0).tolist()  # the dead have left: no actions, observations or rewards
    returns = rollout["next", "agent", "reward"].sum(0).flatten().tolist()
    for agent, ticks, total in zip(env.group_map["agent"], lived, returns, strict=True):
        print(f"{agent}: {ticks} of {len(rollout)} ticks, return {total:.0f}")
    env.close()
    return len(rollout)


if __name__ == "__main__":
    main()
