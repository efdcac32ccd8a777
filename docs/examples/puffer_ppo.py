"""PPO on PufferLib's vectors: the loop of cleanrl_ppo.py, on rows that PufferLib collects from several processes.

python docs/examples/puffer_ppo.py --variant teams_3 --total-timesteps 10000000
"""

import numpy as np
import torch
from cleanrl_ppo import Args, Rollouts, arguments, train
from pufferlib import vector

import outlast

PROCESSES = 2


class VectorRollouts(Rollouts):
    """PufferLib hands out no action masks: any action is drawn."""

    def __init__(self, envs, agent, args: Args) -> None:
        self.envs, self.agent, self.args, self.returns = envs, agent, args, []
        envs.async_reset(args.seed)
        self.receive()

    def receive(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Keep what the next actions are chosen from; rewards and ends."""
        observations, reward, terminated, truncated, _, infos, _, alive = self.envs.recv()
        self.obs, self.alive = (torch.from_numpy(array.copy()) for array in (observations, alive))
        self.mask = torch.ones(len(alive), sum(self.agent.sizes), dtype=torch.bool)
        self.returns += [value for info in infos for value in info["return"]]
        reward = reward.copy()
        if truncated.any():  # worth what the critic expects of the last observations
            last = np.concatenate([info["final_obs"] for info in infos if "final_obs" in info])
            reward[truncated] += self.args.gamma * self.agent.value(torch.from_numpy(last)).numpy()
        return torch.from_numpy(reward), torch.from_numpy(terminated | truncated)

    def step(self, action: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        self.envs.send(action.numpy())
        return self.receive()


def make(scenario: str | outlast.Scenario, args: Args):
    """The worlds, shared out among processes."""
    options = {"backend": vector.Multiprocessing, "num_envs": PROCESSES, "num_workers": PROCESSES, "overwork": True}
    worlds = [scenario, args.num_worlds // PROCESSES], {"scaled": True}
    return vector.make([outlast.adapters.make_puffer] * PROCESSES, *([each] * PROCESSES for each in worlds), **options)


if __name__ == "__main__":
    torch.set_num_threads(1)
    train(arguments(), make, VectorRollouts)
