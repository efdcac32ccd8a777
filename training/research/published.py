"""The paper's own learning curves, and what else of our runs is kept beside them. Needs numpy only."""

from importlib.resources import as_file, files

from ..base.curves import FILE, Curves, Quantity, is_known, read_curves

PAPER_STEPS = 10_000_000  # agent-steps that the authors trained each variant for, rounded up to a whole rollout


def behaviour(name: str) -> Quantity:
    """What agents do, as our runs log it; see training.columns."""
    return Quantity(name, f"behaviour/{name}")


SEEN = (
    *map(behaviour, ("attack_near", "attack_far", "near", "heals_given", "heals_held", "zone_distance")),
    *(Quantity(name, f"rollout/{name}") for name in ("first_death", "deaths_melee", "deaths_zone")),
    *(Quantity(name, f"rollout/{name}", sided=True) for name in ("damage_dealt", "strikes_landed", "heals_given")),
    Quantity("wins against scripted", "wins/scripted"),
)  # the paper has no curves of these; claims about behaviour, and mended games, are measured by them


def is_kept(tag: str) -> bool:
    """Whether kept results have this tag."""
    return is_known(tag) or any(quantity.has(tag) for quantity in SEEN)


def published_curves(variant: str) -> Curves:
    """The paper's curves of a variant, by its name: "ffa_2"."""
    with as_file(files(__package__).joinpath(FILE)) as path:
        return read_curves(path)[variant][1]
