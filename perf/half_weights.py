"""How many actions stay the same if the weights of a policy are rounded to float16; used by perf.convert_results."""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from outlast.envs.core.make import make_vec
from outlast.envs.scenarios.scenario import Scenario
from outlast.training import checkpoint
from outlast.training.player import Player, _logs

Array = np.ndarray[Any, Any]


def rounded(source: Path, policies: Sequence[dict[str, Array]]) -> Player:
    """Make a player of the checkpoint with these weights; those that are missing, of its critic, are 0."""
    files = checkpoint.read_checkpoint(source, ("policy.pt",))
    whole = checkpoint.policies_in(files)
    merged = [
        {name: torch.from_numpy(own[name]) if name in own else torch.zeros_like(value) for name, value in each.items()}
        for each, own in zip(whole, policies, strict=True)
    ]
    return Player(files | {"policy.pt": checkpoint.tensor_bytes(merged)})


def equal_actions(
    source: Path, policies: Sequence[dict[str, Array]], game: Scenario, worlds: int, steps: int
) -> tuple[float, float]:
    """Let a checkpoint play, and ask the same policy with other weights what it would do with the same random numbers.

    Args:
        source: The checkpoint.
        policies: The other weights.
        game: What is played.
        worlds: How many worlds.
        steps: Ticks of each world.

    Returns:
        The shares that are equal of single choices, six an agent and tick, and of the whole actions of living agents.
    """
    player, other = Player(source), rounded(source, policies)
    generator, equal = torch.Generator().manual_seed(0), list[Array]()
    with contextlib.closing(make_vec(player.scenario(game), worlds, seed=1, copy=False)) as env:
        seen, _ = env.reset()
        for _ in range(steps):
            logs = [torch.from_numpy(each._ask(seen, _logs)[0]).permute(1, 2, 0) for each in (player, other)]
            uniform = torch.rand((logs[0].shape[2], logs[0].shape[1]), generator=generator)
            mine, its = (each.policies[0].choose(own, uniform).numpy() for each, own in zip((player, other), logs))
            alive = (seen["own"] != 0).any(-1).ravel()
            equal.append((mine == its)[alive])
            seen, *_ = env.step(mine.reshape(env.num_worlds, env.num_agents, -1))
    whole = np.concatenate(equal)
    return float(whole.mean()), float(whole.all(1).mean())
