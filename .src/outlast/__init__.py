"""outlast: thousands of 2-D multi-agent survival worlds, advanced together.

>>> import outlast
>>> env = outlast.make_vec("ffa_3", 1024, seed=0)
>>> observations, info = env.reset()

The names in `__all__`, and those of the modules among them, are public, and docs/api.md describes them; everything else
may change between versions. `__init__.pyi` lists them; they are loaded when they are first asked for.
"""

from ._lazy import attach as _attach
from .envs.adapters.registry import register as _register

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = _attach(__name__, __file__)

_register()
