"""Checkpoints made of kept policies, for tests of what reads the folders of runs."""

from pathlib import Path

from outlast.training.checkpoint import files_of, write_checkpoint
from outlast.training.player import Player

KEPT = Path(__file__).resolve().parents[2] / "results" / "policies"


def as_checkpoint(name: str, place: Path) -> Path:
    """Write a kept policy, such as "ffa_2/original-0", as a checkpoint, and return the path."""
    player = Player(KEPT / f"{name}.safetensors")
    write_checkpoint(place, files_of(player.header, player.policies))
    return place
