"""A model of an environment without rules: a world is a function of its seed, number, episode and actions."""

import hashlib
from typing import Any, NamedTuple

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import outlast
from outlast.components import ObservationMasks
from outlast.ecs import Action, Clock, Worlds
from outlast.envs.errors import NotResetError, PendingError
from outlast.envs.snapshots.state import State
from tests.conftest import digest
from tests.helpers.invariants import InvariantChecker

Array = np.ndarray[Any, Any]


class History(NamedTuple):
    """The inputs that determine a world. acts: The numbers of its episode's actions, see `ModelledEnv.actions`."""

    seed: int
    world: int
    episode: int
    acts: tuple[int, ...] = ()

    def then(self, act: int) -> "History":
        return self._replace(acts=(*self.acts, act))

    def next_episode(self) -> "History":
        return self._replace(episode=self.episode + 1, acts=())


class Outcomes(dict[Any, Any]):
    """What was seen after each history. After an equal history, in any environment, the same must be seen."""

    def note(self, history: Any, what: str, value: Any) -> None:
        assert self.setdefault((history, what), value) == value, f"{what} after {history}"


class SavedState(NamedTuple):
    """A state, with the histories of its worlds and what the invariant checker remembered of them."""

    state: State
    histories: list[History | None]
    memory: tuple[Array, Array]
    scenario: outlast.Scenario


class ModelledEnv:
    """An environment with the history of each of its worlds, which is None before the first reset."""

    def __init__(self, memory: Outcomes, scenario: outlast.Scenario, worlds: int, seed: int, **options: Any) -> None:
        self.env = outlast.make_vec(scenario, worlds, seed=seed, **options)
        self.memory, self.scenario, self.checker = memory, scenario, InvariantChecker(self.env)
        self.histories: list[History | None] = [None] * worlds
        self.keys = [History(seed, self.env.first_world + w, 0) for w in range(worlds)]  # for the next reset
        self.moved = np.zeros(worlds, bool)  # since the invariants were checked

    @property
    def started(self) -> bool:
        return None not in self.histories

    @property
    def done(self) -> Array:
        """Which worlds have ended, according to the step that ended them."""
        return np.array([self.memory.get((history, "end"), (False, False)) != (False, False) for history in self.all])

    @property
    def all(self) -> list[tuple[str, History | None]]:
        return [(self.scenario.name, history) for history in self.histories]

    def actions(self, act: int) -> Array:
        """Actions of all agents: a function of `act` and of each world's tick."""
        sizes = self.env.single_action_space.nvec
        ticks = [len(history.acts) if history else 0 for history in self.histories]
        drawn = {tick: np.random.default_rng((act, tick)).integers(0, sizes) for tick in set(ticks)}
        return np.stack([drawn[tick] for tick in ticks])

    def reset(self, seed: Any = None, mask: Array | None = None) -> None:
        observations, info = self.env.reset(seed=seed, options=None if mask is None else {"reset_mask": mask})
        assert info.keys() == {"alive"}
        assert info["alive"][slice(None) if mask is None else mask].all()
        count = self.env.num_worlds
        if np.ndim(seed):
            keys = [History(int(one), 0, 0) for one in seed]
        else:
            keys = [History(int(seed or 0), self.env.first_world + w, 0) for w in range(count)]
        for w in np.flatnonzero(np.ones(count, bool) if mask is None else mask):
            self.keys[w] = self.keys[w] if seed is None else keys[w]
            self._begin(w)
        self._look(observations)

    def step(self, act: int, sent: bool = False) -> None:
        """Make a step, perhaps by send and recv. Worlds that cannot be stepped must be refused."""
        before, actions, mode = self.done, self.actions(act), self.env.autoreset_mode
        if not self.started or (mode is AutoresetMode.DISABLED and before.any()):
            self.refused(lambda: self.env.step(actions), NotResetError)
            return
        observations, reward, terminated, truncated, info = self._sent(actions) if sent else self.env.step(actions)
        for w in range(self.env.num_worlds):
            if before[w]:
                self._begin(w)
                assert (reward[w].any(), terminated[w], truncated[w]) == (False, False, False)
                continue
            self.histories[w] = self.histories[w].then(act)
            self.memory.note(self.all[w], "reward", reward[w].tobytes())
            self.memory.note(self.all[w], "end", (bool(terminated[w]), bool(truncated[w])))
        self.moved[:] = True
        self._ended(info)
        self._look(observations)

    def _sent(self, actions: Array) -> Any:
        env = self.env
        env.send(actions)
        for call in (env.reset, env.get_state, env.observe, env.render, lambda: env.step(actions)):
            with pytest.raises(PendingError):
                call()
        return env.recv()

    def get_state(self, where: Array) -> SavedState:
        memory = self.checker.memory(where)
        return SavedState(self.env.get_state(where), [self.histories[w] for w in where], memory, self.scenario)

    def set_state(self, saved: SavedState, where: Array) -> None:
        observations = self.env.set_state(saved.state, where)
        self.checker.restore(saved.memory, where)
        for k, w in enumerate(where):
            self.histories[w] = history = saved.histories[k if len(saved.histories) > 1 else 0]
            self.moved[w] = history is not None and not history.acts
            self.keys[w] = history or History(*self._clock(w)[:3])
        self._look(observations)

    def refused(self, call: Any, *errors: type[Exception]) -> None:
        """Check that the call raises one of these errors and changes nothing."""
        before = self.state_digest()
        with pytest.raises(errors):
            call()
        assert self.state_digest() == before

    def state_digest(self) -> str:
        state = self.env.get_state()
        return hashlib.blake2b(b"".join(state.arrays[name].tobytes() for name in sorted(state.arrays))).hexdigest()

    def _begin(self, w: int) -> None:
        self.keys[w] = self.keys[w].next_episode()
        self.histories[w], self.moved[w] = self.keys[w], True

    def _ended(self, info: dict[str, Any]) -> None:
        """Check the statistics of the worlds that ended; under SAME_STEP they start their next episode here."""
        done = self.done
        assert ("statistics" in info) == done.any()
        for w in np.flatnonzero(done):
            assert info["_statistics"].tolist() == done.tolist()
            values = [np.asarray(info["statistics"][key][w]).tobytes() for key in sorted(info["statistics"])]
            self.memory.note(self.all[w], "statistics", values)
            if self.env.autoreset_mode is AutoresetMode.SAME_STEP:
                self.memory.note(self.all[w], "observations", _bytes(info["final_obs"][w]))
                self._begin(w)

    def _look(self, observations: dict[str, Array]) -> None:
        """Compare all worlds with what was seen after their histories, and check the invariants."""
        for w, history in enumerate(self.histories):
            if history is not None:
                assert self._clock(w) == [*history[:3], len(history.acts)]
                self.memory.note(
                    self.all[w], "observations", _bytes({key: array[w] for key, array in observations.items()})
                )
                self.memory.note(self.all[w], "state", digest_of_episode(self.env.worlds, w))
        if self.started:
            self.checker.check(observations, ran=self.moved)
            self.moved[:] = False

    def _clock(self, w: int) -> list[int]:
        clock = self.env.worlds[Clock]
        return [int(column[w, 0]) for column in (clock.seed, clock.world, clock.episode, clock.tick)]


def digest_of_episode(worlds: Worlds, where: Any = slice(None)) -> str:
    """A digest of the worlds `where`, without what a reset does not write: actions and observation masks."""
    return digest(worlds, where, but=(Action, ObservationMasks))


def replay_alone(memory: Outcomes, scenario: outlast.Scenario, history: History) -> None:
    """Play a history again in an environment of one world."""
    player = ModelledEnv(memory, scenario, 1, history.seed, first_world=history.world, autoreset_mode="Disabled")
    for _ in range(history.episode):
        player.reset()
    for act in history.acts:
        player.step(act)
    assert player.histories == [history]
    player.env.close()


def _bytes(observations: dict[str, Array]) -> list[bytes]:
    return [observations[key].tobytes() for key in sorted(observations)]
