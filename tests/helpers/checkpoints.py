"""Checkpoints made of kept policies, for tests of what reads the folders of runs."""

import json
from pathlib import Path

from outlast.training.base import policy_file
from outlast.training.policies.checkpoint import policies_content, write_checkpoint
from outlast.training.policies.player import Player

KEPT = Path(__file__).resolve().parents[2] / "results" / "policies"


def as_checkpoint(name: str, place: Path) -> Path:
    """Write a kept policy, such as "ffa_2/original-0", as a checkpoint, and return the path."""
    player = Player(KEPT / f"{name}.safetensors")
    weights = policies_content([policy.state_dict() for policy in player.policies])
    write_checkpoint(place, {policy_file.RUN_JSON: json.dumps(player.header).encode(), policy_file.WEIGHTS: weights})
    return place
