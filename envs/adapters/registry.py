"""Registration of all scenarios with Gymnasium and PettingZoo. Adapters are imported when an environment is made.

Gymnasium has ``outlast/FreeForAll1-v1`` ... ``outlast/Teams4-v1`` for the eight variants, PettingZoo (1.27 and later)
``outlast/teams_3-v1`` in both of its registries. Scenarios of installed packages are ``outlast/NAME-v1`` in each.
"""

import gymnasium

from ..scenarios.parse import installed
from ..scenarios.variants import VARIANTS

VERSION = "v1"  # version of the environments, to be raised when their behaviour changes
DEFAULT = 3  # a family's name without a number means the variant with this number
IDS = {
    f"outlast/{family}{number or ''}-{VERSION}": f"{kind}_{number or DEFAULT}"
    for kind, family in {"ffa": "FreeForAll", "teams": "Teams"}.items()
    for number in (None, 1, 2, 3, 4)
}


def register() -> None:
    """Register all scenarios, without importing any; those that are already registered are left alone."""
    for name, scenario in (IDS | {f"outlast/{own}-{VERSION}": own for own in installed()}).items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="outlast.envs.adapters.gymnasium_single:SurvivalEnv",
                vector_entry_point="outlast.envs.adapters.gymnasium_learners:SurvivalLearnerVectorEnv",
                kwargs={"scenario": scenario},
            )
    try:
        import pettingzoo

        registries = {"parallel": pettingzoo.parallel_registry, "aec": pettingzoo.aec_registry}
    except (ImportError, AttributeError):  # PettingZoo is not installed, or too old to have registries
        return
    for kind, registry in registries.items():
        for scenario in (*VARIANTS, *installed()):
            name = f"outlast/{scenario}-{VERSION}"
            if name not in registry:
                entry_point = f"outlast.envs.adapters.pettingzoo:{kind}_env"
                pettingzoo.register(kind, name, entry_point, kwargs={"scenario": scenario})
