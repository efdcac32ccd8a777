"""The variants in Gymnasium's registry: gymnasium.make("outlast/Teams-v1"), gymnasium.make_vec("outlast/Teams-v1", 64).

``outlast/FreeForAll-v1`` and ``outlast/Teams-v1`` take variant=, ``ffa_3`` and ``teams_3`` if none is given;
``outlast/FreeForAll1-v1`` ... ``outlast/Teams4-v1`` are the eight variants. The part before a colon is imported first,
so gymnasium.make("outlast:outlast/Teams-v1") needs no import of outlast.
"""

import gymnasium

FAMILIES = {"ffa": "FreeForAll", "teams": "Teams"}
VERSION = "v1"  # of the environments: another one where behaviour changes
DEFAULT = 3  # number of the variant that a family's own name stands for
IDS = {
    f"outlast/{family}{'' if number is None else number}-{VERSION}": f"{kind}_{number or DEFAULT}"
    for kind, family in FAMILIES.items()
    for number in (None, 1, 2, 3, 4)
}


def register() -> None:
    """Enter every id of IDS; those that are there already, after a reload of the package, are left alone."""
    for name, variant in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="outlast.envs.adapters.gymnasium_single:SurvivalEnv",
                vector_entry_point="outlast.envs.adapters.gymnasium_learners:SurvivalLearnerVectorEnv",
                kwargs={"variant": variant},
            )
