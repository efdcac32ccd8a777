"""The caller's memory for what a step returns."""

from collections.abc import Mapping
from typing import Any

from .buffers import writable
from .env_properties import EnvProperties
from .validation import Array

NAMES = ("observations", "rewards", "terminated", "truncated", "state", "action_mask")


class StepBuffers:
    """The memory that SurvivalVectorEnv.step was given as `out`."""

    def __init__(self, env: EnvProperties, out: Any) -> None:
        """Check it, without writing anything yet. Raises ValueError."""
        self._env, self._given = env, {} if out is None else out
        if not isinstance(self._given, Mapping) or (unknown := sorted(map(repr, self._given.keys() - set(NAMES)))):
            found = f"the name {unknown[0]}" if isinstance(out, Mapping) else f"type {type(out).__name__}"
            raise ValueError(f"out has {found}: a mapping is needed, with names among {', '.join(NAMES)}")
        self._arrays = {name: self._checked(name, array) for name, array in self._given.items()}
        if len({id(array) for array in self._given.values()}) < len(self._given):
            raise ValueError("out has one array for two names: each needs memory of its own")

    def put(self, name: str, values: Array) -> Any:
        """Write the values into the caller's memory of that name and return it; without any, return a copy of them."""
        if name not in self._given:
            return values.copy()
        self._arrays[name][...] = values
        return self._given[name]

    def fill(self) -> Any:
        """Write what is known when the step is over. Returns the caller's observations, or None if none were given."""
        if "state" in self._arrays:
            self._arrays["state"][...] = self._env._global_state(slice(None))
        if "action_mask" in self._arrays:
            self._arrays["action_mask"][...] = self._env._actions.masks()
        if "observations" not in self._arrays:
            return None
        self._env._reader.write(self._arrays["observations"])
        return self._given["observations"]

    def _checked(self, name: str, array: Any) -> Any:
        env, what = self._env, f"out[{name!r}]"
        worlds, rows = (env.num_worlds,), (env.num_worlds, env.worlds.dims["agents"])
        if name == "observations":
            return env._reader.check(array, what)
        if name == "state":
            return writable(what, array, worlds + env.state_space.shape)
        if name == "action_mask":
            env._actions.check_masked()
            return writable(what, array, (*rows, env.action_mask_size), bool)
        return writable(what, array, rows) if name == "rewards" else writable(what, array, worlds, bool)
