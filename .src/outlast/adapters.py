"""Environments for other libraries: Stable-Baselines3, PettingZoo, TorchRL, PufferLib and RLlib (docs/libraries.md).

>>> env = outlast.adapters.make_sb3("ffa_3", 64, seed=0)

`adapters.pyi` lists them; a library is loaded when its adapter is first asked for.
"""

from ._lazy import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
