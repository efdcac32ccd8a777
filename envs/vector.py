"""The batched environment: many worlds, each with several agents, stepped together."""

from numbers import Integral
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from outlast.components import End, Fault, Reward
from outlast.ecs import RESET, SKIP, STEP, Action, Observation, Worlds

from .deaths import log_deaths
from .errors import ActionError, ClosedError, FaultError, NotResetError
from .notice import announce_compilation
from .scenario import Scenario, ScenarioError
from .spaces import action_space, observation_space, published, statistics

Arrays = dict[str, np.ndarray[Any, Any]]
Actions = np.ndarray[Any, Any]


class SurvivalVectorEnv(VectorEnv[Arrays, Actions, np.ndarray[Any, Any]]):
    """`num_worlds` worlds of a scenario as a gymnasium VectorEnv whose sub-environments are whole worlds.

    Observations: dict of float32 (worlds, agents, ...). Actions: integers (worlds, agents, actions). Rewards: float32
    (worlds, agents). Terminated, truncated: bool (worlds,), as an episode ends for all agents of a world at once.

    Randomness is a function of (seed, world, episode): world i of a batch is the world i of any other batch, so
    `first_world=i` gives it alone. Observations are read-only and overwritten by the next call, unless copy=True.
    check_actions=False leaves out the range check (out-of-range actions then mean nothing in particular, but harm
    nothing).
    """

    def __init__(
        self,
        scenario: Scenario,
        num_worlds: int,
        *,
        seed: int | None = None,
        threads: int = 1,
        autoreset: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = False,
        check_actions: bool = True,
        first_world: int = 0,
    ) -> None:
        _check_count("num_worlds", num_worlds, 1)
        _check_count("threads", threads, 1)
        _check_count("first_world", first_world, 0)
        self.scenario, self.copy, self.check_actions, self.first_world = scenario, copy, check_actions, first_world
        self.autoreset = _autoreset(autoreset)
        self.metadata = {"render_modes": [], "render_fps": 30, "autoreset_mode": self.autoreset, "name": scenario.name}
        self.worlds = Worlds(scenario.modules, int(num_worlds), int(threads))
        if missing := [signal.__name__ for signal in (Reward, End) if signal not in self.worlds]:
            raise ScenarioError(
                f"{scenario.name}: no module brings {' and '.join(missing)}; "
                "an environment needs the modules rewards and ending"
            )
        self.num_envs = self.num_worlds = int(num_worlds)
        self.num_agents = self.worlds.dims["agents"]
        self.single_observation_space = observation_space(self.worlds)
        self.single_action_space = action_space(self.worlds)
        actions = published(self.worlds, Action)
        self.action_columns = [(key, int(column.low)) for key, _, _, column in actions]
        self._lows = np.array([low for _, low in self.action_columns]).reshape(-1, 1, 1)
        self.action_sizes = self.single_action_space.nvec[0]
        self._observations = {
            k: _locked(getattr(self.worlds[c], n)) for k, c, n, _ in published(self.worlds, Observation)
        }
        self._mode = np.zeros(self.num_worlds, np.int8)
        self._over = np.zeros(self.num_worlds, bool)
        self._started = np.zeros(self.num_worlds, bool)
        self._seed(seed if seed is not None else int(np.random.SeedSequence().generate_state(1, np.uint64)[0] >> 1))
        with announce_compilation(self.worlds, scenario.name):
            self.worlds.run(self._mode)  # nobody moves, but the tick gets compiled or loaded

    @property
    def observation_space(self) -> Any:  # type: ignore[override]
        """The single space, batched; made when asked for, as it is as large as a batch of observations."""
        return batch_space(self.single_observation_space, self.num_worlds)

    @property
    def action_space(self) -> Any:  # type: ignore[override]
        """The single space, batched."""
        return batch_space(self.single_action_space, self.num_worlds)

    def reset(
        self, *, seed: int | list[int] | np.ndarray[Any, Any] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Start new episodes everywhere, or where options["reset_mask"] (bool, (worlds,)) says.

        seed: an int keys world i by (seed, first_world + i); a sequence keys it by (seed[i], 0). Without a seed, every
        world goes on to its next episode.
        """
        self._check_open()
        mask = self._mask(options)
        if seed is not None:
            self._seed(seed, mask)
        self._mode[:] = np.where(mask, RESET, SKIP)
        self.worlds.run(self._mode)
        self._over &= ~mask
        self._started |= mask
        return self._observe(), {}

    def step(self, actions: Actions) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        """One tick of every world. A refused call (see ActionError) changes nothing.

        NEXT_STEP: a world that ended is reset by the next call, which ignores its actions. SAME_STEP: it is reset at
        once; info["final_obs"] holds its last observation. DISABLED: reset it yourself. Whenever worlds end,
        info["statistics"] holds their episodes and info["_statistics"] says which.
        """
        self._check_open()
        self._check_steppable()
        self._take(actions)
        self._mode[:] = STEP
        if self.autoreset is AutoresetMode.NEXT_STEP:
            self._mode += self._over  # RESET is the number after STEP
        self.worlds.run(self._mode)
        self._check_faults()
        end = self.worlds[End]
        terminated, truncated = end.terminated[:, 0].copy(), end.truncated[:, 0].copy()
        self._over = terminated | truncated
        log_deaths(self.worlds, self.first_world)
        reward = self.worlds[Reward].reward.copy()
        info = self._finish() if self._over.any() else {}
        return self._observe(), reward, terminated, truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """Let the threads go."""
        self.worlds.close()

    def _finish(self) -> dict[str, Any]:
        """Report the episodes that just ended; under SAME_STEP also start the next ones."""
        info: dict[str, Any] = {"statistics": statistics(self.worlds, self._over), "_statistics": self._over.copy()}
        if self.autoreset is AutoresetMode.SAME_STEP:
            final = np.full(self.num_worlds, None, object)
            for w in np.flatnonzero(self._over):
                final[w] = {key: buffer[w].copy() for key, buffer in self._observations.items()}
            info |= {"final_obs": final, "_final_obs": self._over.copy()}
            info |= {"final_info": {"statistics": info["statistics"]}, "_final_info": self._over.copy()}
            self._mode[:] = np.where(self._over, RESET, SKIP)
            self.worlds.run(self._mode)
            self._over = np.zeros(self.num_worlds, bool)
        return info

    def _observe(self) -> Arrays:
        return {key: buffer.copy() if self.copy else buffer for key, buffer in self._observations.items()}

    def _seed(self, seed: Any, mask: Any = slice(None)) -> None:
        given = np.asarray(seed, object)
        if given.ndim == 0:
            seeds, worlds = np.full(self.num_worlds, _seed(seed)), self.first_world + np.arange(self.num_worlds)
        else:
            if given.shape != (self.num_worlds,):
                raise ValueError(
                    f"seed has shape {given.shape}: one integer, or one for each of {self.num_worlds} worlds"
                )
            seeds, worlds = np.array([_seed(s) for s in given], np.uint64), np.zeros(self.num_worlds, np.uint64)
        self.worlds.seed(seeds[mask], worlds[mask], mask)

    def _mask(self, options: dict[str, Any] | None) -> np.ndarray[Any, Any]:
        if set(options or ()) - {"reset_mask"}:
            raise ValueError(f"options = {options!r}: a dict with no other key than reset_mask is needed")
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_worlds, bool)
        mask = _array(mask)
        if mask.dtype != bool or mask.shape != (self.num_worlds,) or not mask.any():
            raise ValueError(
                f"reset_mask must be bool, of shape ({self.num_worlds},), with at least one True; "
                f"got {mask.dtype} of shape {mask.shape} with {int(np.count_nonzero(mask))} true"
            )
        return mask

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedError("the environment is closed; make a new one")

    def _check_steppable(self) -> None:
        if not self._started.all():
            raise NotResetError(
                f"step() before reset(): {int((~self._started).sum())} worlds have not started; reset them"
            )
        if self.autoreset is AutoresetMode.DISABLED and self._over.any():
            raise NotResetError(
                f"worlds {np.flatnonzero(self._over)[:8].tolist()} have ended and autoreset is disabled; "
                'reset them first: reset(options={"reset_mask": terminated | truncated})'
            )

    def _check_faults(self) -> None:
        if Fault in self.worlds and self.worlds[Fault].physics.any():
            w = int(self.worlds[Fault].physics[:, 0].argmax())
            raise FaultError(
                f"world {w}: a body has a position, speed or size that physics cannot take (NaN, or 1e6 and more); "
                "some mechanic wrote it into Body or Shape. Reset the world: it starts afresh"
            )

    def _take(self, actions: Any) -> None:
        actions = _array(actions)
        shape = (self.num_worlds, self.num_agents, len(self.action_sizes))
        if actions.shape != shape:
            raise ActionError(f"actions have shape {actions.shape}: (worlds, agents, actions) = {shape} is needed")
        if actions.dtype.kind not in "iu":
            raise ActionError(f"actions are {actions.dtype}: integers are needed")
        if self.check_actions:
            unsigned = np.dtype(f"u{actions.itemsize}")  # in which negative numbers are large ones
            bad = actions.view(unsigned) >= self.action_sizes.astype(unsigned)
            if bad.any():
                w, i, k = (int(index[0]) for index in np.nonzero(bad))
                raise ActionError(
                    f"action {k} of agent {i} in world {w} is {actions[w, i, k]}: "
                    f"0 to {self.action_sizes[k] - 1} is allowed"
                )
        np.add(actions.transpose(2, 0, 1), self._lows, out=self.worlds.actions, casting="unsafe")


def _check_count(name: str, value: Any, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < least:
        raise ValueError(f"{name} = {value!r}: an integer >= {least} is needed")


def _seed(value: Any) -> np.uint64:
    if isinstance(value, bool) or not isinstance(value, Integral) or not 0 <= int(value) < 2**64:
        raise ValueError(f"seed = {value!r}: an integer from 0 to 2**64 - 1 is needed")
    return np.uint64(int(value))


def _autoreset(value: Any) -> AutoresetMode:
    try:
        return AutoresetMode(value)
    except ValueError:
        known = ", ".join(f"AutoresetMode.{mode.name} ({mode.value!r})" for mode in AutoresetMode)
        raise ValueError(f"autoreset = {value!r}: allowed are {known}") from None


def _locked(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """A view that cannot be written to: the engine writes only what changes, and relies on the rest."""
    view = array.view()
    view.flags.writeable = False
    return view


def _array(value: Any) -> np.ndarray[Any, Any]:
    """`value` as an array; lists of unequal length become an array of objects, to be refused by shape or type."""
    try:
        return np.asarray(value)
    except ValueError:
        return np.empty(len(value), object)
