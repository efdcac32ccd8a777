"""The variants in PettingZoo's registry: pettingzoo.make("parallel", "outlast/ffa_1-v1"), or "aec"."""

from ..scenarios.variants import VARIANTS
from .gymnasium_registry import VERSION

MAKERS = {"parallel": "parallel_env", "aec": "aec_env"}


def register() -> None:
    """Enter every variant twice; nothing happens without PettingZoo, or with one that has no registry (before 1.27)."""
    try:
        from pettingzoo import aec_registry, parallel_registry, register
    except ImportError:
        return
    for kind, registry in (("parallel", parallel_registry), ("aec", aec_registry)):
        for name in VARIANTS:
            if f"outlast/{name}-{VERSION}" not in registry:  # the package was reloaded
                entry_point = f"outlast.envs.adapters.pettingzoo:{MAKERS[kind]}"
                register(kind, f"outlast/{name}-{VERSION}", entry_point, kwargs={"scenario": name})
