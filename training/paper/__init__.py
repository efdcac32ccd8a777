"""The paper's own training curves, one file a variant, of one run each.

Source: TensorBoard event files of the runs behind the figures of Fanti (2022). A point is a rollout of 16384
environment steps; its value is the mean over the episodes that ended in it, with sampled actions. Returns and kills are
those of an agent, or of a team; heals and boxes are those of all agents.
"""

from importlib.resources import as_file, files

from ..curves import Curves, read_kept

STEPS = 10_000_000  # agent-steps that the authors trained each variant for, rounded up to a whole rollout


def curves(variant: str) -> Curves:
    """The paper's curves of a variant, by its name: "ffa_2"."""
    with as_file(files(__package__).joinpath(f"{variant}.csv")) as path:
        return read_kept(path)[1]
