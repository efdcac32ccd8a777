"""A model of an environment that knows no rules: all that a world is follows from its seed, episode and actions."""

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
from tests.watch import Watch

Array = np.ndarray[Any, Any]


class History(NamedTuple):
    """What made a world what it is. acts: numbers of the actions since its episode began (see `Player.actions`)."""

    seed: int
    world: int
    episode: int
    acts: tuple[int, ...] = ()

    def then(self, act: int) -> "History":
        return self._replace(acts=(*self.acts, act))

    def afresh(self) -> "History":
        return self._replace(episode=self.episode + 1, acts=())


class Memory(dict[Any, Any]):
    """What was seen of each history. Seen again, anywhere, it must be the same."""

    def note(self, history: Any, what: str, value: Any) -> None:
        assert self.setdefault((history, what), value) == value, f"{what} after {history}"


class Saved(NamedTuple):
    """A state, and what the model and the watch know of it."""

    state: State
    histories: list[History | None]
    watched: tuple[Array, Array]
    scenario: outlast.Scenario


class Player:
    """An environment, and beside it the history of each of its worlds; None: has not started."""

    def __init__(self, memory: Memory, scenario: outlast.Scenario, worlds: int, seed: int, **options: Any) -> None:
        self.env = outlast.make_vec(scenario, worlds, seed=seed, **options)
        self.memory, self.scenario, self.guard = memory, scenario, Watch(self.env)
        self.histories: list[History | None] = [None] * worlds
        self.keys = [History(seed, self.env.first_world + w, 0) for w in range(worlds)]  # of the next resets
        self.moved = np.zeros(worlds, bool)  # since the watch has looked

    @property
    def started(self) -> bool:
        return None not in self.histories

    @property
    def over(self) -> Array:
        """Which worlds have ended, as was seen in the step that ended them."""
        return np.array([self.memory.get((history, "end"), (False, False)) != (False, False) for history in self.all])

    @property
    def all(self) -> list[tuple[str, History | None]]:
        return [(self.scenario.name, history) for history in self.histories]

    def actions(self, act: int) -> Array:
        """Of all agents: those of a world follow from `act` and from the tick of its episode."""
        sizes = self.env.single_action_space.nvec
        ticks = [len(history.acts) if history else 0 for history in self.histories]
        drawn = {tick: np.random.default_rng((act, tick)).integers(0, sizes) for tick in set(ticks)}
        return np.stack([drawn[tick] for tick in ticks])

    def reset(self, seed: Any = None, mask: Array | None = None) -> None:
        told, info = self.env.reset(seed=seed, options=None if mask is None else {"reset_mask": mask})
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
        self._look(told)

    def step(self, act: int, sent: bool = False) -> None:
        """One step, or one in the background. What cannot be stepped must say so."""
        before, actions, mode = self.over, self.actions(act), self.env.autoreset_mode
        if not self.started or (mode is AutoresetMode.DISABLED and before.any()):
            self.refused(lambda: self.env.step(actions), NotResetError)
            return
        told, reward, terminated, truncated, info = self._sent(actions) if sent else self.env.step(actions)
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
        self._look(told)

    def _sent(self, actions: Array) -> Any:
        env = self.env
        env.send(actions)
        for call in (env.reset, env.get_state, env.observe, env.render, lambda: env.step(actions)):
            with pytest.raises(PendingError):
                call()
        return env.recv()

    def get(self, where: Array) -> Saved:
        kept = self.guard.memory(where)
        return Saved(self.env.get_state(where), [self.histories[w] for w in where], kept, self.scenario)

    def put(self, saved: Saved, where: Array) -> None:
        told = self.env.set_state(saved.state, where)
        self.guard.recall(saved.watched, where)
        for k, w in enumerate(where):
            self.histories[w] = history = saved.histories[k if len(saved.histories) > 1 else 0]
            self.moved[w] = history is not None and not history.acts
            self.keys[w] = history or History(*self._clock(w)[:3])
        self._look(told)

    def refused(self, call: Any, *errors: type[Exception]) -> None:
        """It raises one of these, and changes nothing."""
        before = self.everything()
        with pytest.raises(errors):
            call()
        assert self.everything() == before

    def everything(self) -> str:
        state = self.env.get_state()
        return hashlib.blake2b(b"".join(state.arrays[name].tobytes() for name in sorted(state.arrays))).hexdigest()

    def _begin(self, w: int) -> None:
        self.keys[w] = self.keys[w].afresh()
        self.histories[w], self.moved[w] = self.keys[w], True

    def _ended(self, info: dict[str, Any]) -> None:
        """Statistics of just those worlds that ended; under SAME_STEP they show their last observations, and begin."""
        over = self.over
        assert ("statistics" in info) == over.any()
        for w in np.flatnonzero(over):
            assert info["_statistics"].tolist() == over.tolist()
            values = [np.asarray(info["statistics"][key][w]).tobytes() for key in sorted(info["statistics"])]
            self.memory.note(self.all[w], "statistics", values)
            if self.env.autoreset_mode is AutoresetMode.SAME_STEP:
                self.memory.note(self.all[w], "told", _bytes(info["final_obs"][w]))
                self._begin(w)

    def _look(self, told: dict[str, Array]) -> None:
        """Compare all worlds with their histories, and check what must hold."""
        for w, history in enumerate(self.histories):
            if history is not None:
                assert self._clock(w) == [*history[:3], len(history.acts)]
                self.memory.note(self.all[w], "told", _bytes({key: array[w] for key, array in told.items()}))
                self.memory.note(self.all[w], "state", digest_of_episode(self.env.worlds, w))
        if self.started:
            self.guard.check(told, ran=self.moved)
            self.moved[:] = False

    def _clock(self, w: int) -> list[int]:
        clock = self.env.worlds[Clock]
        return [int(column[w, 0]) for column in (clock.seed, clock.world, clock.episode, clock.tick)]


def digest_of_episode(worlds: Worlds, where: Any = slice(None)) -> str:
    """Of the worlds `where`, but without what a reset leaves as it was: actions, and which observations were filled."""
    total = hashlib.blake2b(worlds.block[where].tobytes(), digest_size=16)
    for component in worlds.components:
        if not component.packed and not issubclass(component, (Action, ObservationMasks)):
            for column in worlds[component]:
                total.update(column[where].tobytes())
    return total.hexdigest()


def alone(memory: Memory, scenario: outlast.Scenario, history: History) -> None:
    """Live through a history again, in an environment of one world."""
    player = Player(memory, scenario, 1, history.seed, first_world=history.world, autoreset_mode="Disabled")
    for _ in range(history.episode):
        player.reset()
    for act in history.acts:
        player.step(act)
    assert player.histories == [history]
    player.env.close()


def _bytes(told: dict[str, Array]) -> list[bytes]:
    return [told[key].tobytes() for key in sorted(told)]
