"""Registration of all scenarios with Gymnasium and PettingZoo. Adapters are imported when an environment is made.

Gymnasium: ``gymnasium.make("outlast/Teams-v1")`` and ``gymnasium.make_vec("outlast/Teams-v1", 64)``. The ids
``outlast/FreeForAll-v1`` and ``outlast/Teams-v1`` are the variants ``ffa_3`` and ``teams_3`` unless ``scenario=`` gives
otherwise; ``outlast/FreeForAll1-v1`` ... ``outlast/Teams4-v1`` are the eight variants. Gymnasium has no entry point for
plug-ins: import outlast first, or let Gymnasium do so with ``gymnasium.make("outlast:outlast/Teams-v1")``.

PettingZoo (1.27 and later): ``pettingzoo.make("parallel", "outlast/teams_3-v1")``, or ``"aec"``.

The scenarios of installed packages are registered by their own names: ``outlast/NAME-v1`` in each of the three.
"""

import gymnasium

from ..scenarios.imports import installed
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
