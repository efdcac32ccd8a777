"""Keep a policy as a model, and write the tables of models and of the benchmark's anchors anew.

    python -m perf.training.models [--keep CHECKPOINT NAME] [--without-critic]

--keep writes results/policies/NAME.safetensors, in float16. Where fewer than 99.9 % of actions would be those of the
checkpoint, given the same observations and random numbers, its feature extractor stays float32. The tables have a row
for each file in results/. A policy that is not there with the same checksum plays 320 games against `scripted`, in ten
seconds; the share that it wins is in the table, and all else is read from the files.
"""

import argparse
import contextlib
import csv
import hashlib
import io
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from outlast.envs.api.make import make_vec
from outlast.envs.rollout.saved import RESULTS, TABLE, Model, models
from outlast.training.arena.evaluation import Evaluation
from outlast.training.arena.players import contenders
from outlast.training.base import policy_file
from outlast.training.base.files import write_files
from outlast.training.benchmark import suite
from outlast.training.policies.player import Player, _logs, weights_of
from outlast.training.runs.film import recorded_scenario

POLICIES = RESULTS / "policies"
GAMES = 320  # against `scripted`
WORLDS, TICKS = 32, 300  # in which actions are compared
EQUAL = 0.999  # share of actions
EXTRACTOR = "extractors.0."  # which the actions depend on; another one, only the critic's values


def keep(source: Path, name: str, critic: bool) -> None:
    """Write the file of a model, and print how many of its actions are those of the source."""
    header, weights = weights_of(source, critic)
    target = POLICIES / f"{name}{policy_file.SUFFIX}"
    for exact in (None, EXTRACTOR):
        policy_file.write(target, header, weights, exact)
        choices, actions = equal_actions(Player(source), Player(target))
        print(f"{choices:.5f} of choices and {actions:.5f} of whole actions are equal, float32: {exact or 'none'}")
        if actions >= EQUAL:
            break


def equal_actions(player: Player, other: Player) -> tuple[float, float]:
    """Let a policy play, and ask another one what it would do in its place, with the same random numbers.

    Returns:
        The shares that are equal of single choices, six an agent and tick, and of all choices of a living agent.
    """
    game, _ = recorded_scenario(player.header)
    generator, equal = torch.Generator().manual_seed(0), list[Any]()
    with contextlib.closing(make_vec(player.scenario(game), WORLDS, seed=1, copy=False)) as env:
        seen, _ = env.reset()
        for _ in range(TICKS):
            logs = [torch.from_numpy(each._ask(seen, _logs)[0]).permute(1, 2, 0) for each in (player, other)]
            uniform = torch.rand((logs[0].shape[2], logs[0].shape[1]), generator=generator)
            mine, its = (player.policies[0].choose(own, uniform).numpy() for own in logs)
            equal.append((mine == its)[(seen["own"] != 0).any(-1).ravel()])
            seen, *_ = env.step(mine.reshape(WORLDS, env.num_agents, -1))
    whole = np.concatenate(equal)
    return float(whole.mean()), float(whole.all(1).mean())


def model_of(path: Path) -> Model:
    """Return what the table says about a file of results/policies."""
    name, content = path.relative_to(POLICIES).with_suffix("").as_posix(), path.read_bytes()
    header, found = policy_file.read_header(path, ("preset", "steps")), checksum(content)
    known = models().get(name)
    wins = known.wins if known and known.sha256 == found else wins_of(path)
    return Model(name, header["preset"], header["steps"], wins, len(content), found)


def wins_of(path: Path) -> float:
    """Return the share of games that a policy wins against `scripted` in the game of its training."""
    game, _ = recorded_scenario(policy_file.read_header(path, ("scenario", "modules")))
    playing = Evaluation(game, contenders({"model": path, "scripted": "scripted"}), episodes=GAMES)
    with contextlib.closing(playing):
        return round(playing.play_pair((0, 1)).estimates(0)["wins"][0], 4)


def checksum(content: bytes) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write a table, whose heads are the keys of its rows."""
    text = io.StringIO()
    table = csv.DictWriter(text, rows[0], lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_files({path: text.getvalue().encode()})


def main() -> None:
    """Keep a policy, if one is named, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", nargs=2, metavar=("CHECKPOINT", "NAME"), help="write the file of a model first")
    parser.add_argument("--without-critic", action="store_true", help="leave out what only values need")
    given = parser.parse_args()
    if given.keep:
        keep(Path(given.keep[0]), given.keep[1], not given.without_critic)
    write(TABLE, [asdict(model_of(path)) for path in sorted(POLICIES.rglob(f"*{policy_file.SUFFIX}"))])
    anchors = sorted(suite.FOLDER.glob(f"*{policy_file.SUFFIX}"))
    write(suite.TABLE, [{"task": path.stem, "sha256": checksum(path.read_bytes())} for path in anchors])


if __name__ == "__main__":
    main()
