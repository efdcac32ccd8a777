"""Recording: the inputs of each tick are written to a file, with a digest of the state after the tick.

A digest has sixteen bits for each component, which change if any of its bytes is different in any of the worlds. A
component consists of words of four bytes. Each word is multiplied by an odd number that belongs to the world, and
summed over the worlds. These sums are mixed, each is multiplied by an odd number that belongs to the word, and they are
summed up; finally the upper and lower half are combined. A word that differs in one world always changes the last sum;
combining the halves hides that in one of 2**16 cases.
"""

import hashlib
import os
import platform
import warnings
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import numpy as np

from outlast.ecs import RESET, STEP, Clock, Component, Signal, Worlds
from outlast.ecs.memory.numbers import GIVEN_WORDS, Given

from ..core.validation import Array
from ..core.vector_env import SurvivalVectorEnv
from ..errors import RecordingError
from ..rollout.memory import Begins, tell
from ..scenarios.fingerprint import classes, fingerprint
from .file_format import JointActions, RecordingWriter, TickRecord, policy_dtype

WORLDS_PER_DIGEST = 64  # maximum; the worlds of larger batches take turns
SIGN_WORLDS = 8  # worlds whose upper halves of words a digest also sums, in turn
SHIFT = np.uint32(15)


class PolicyRecorder:
    """A record of a policy's choices before each tick of an environment. For arguments and errors see `record`.

    The policy's method `explainer` returns a function from observations to values (worlds, agents), probabilities
    (worlds, agents, values) and attention (worlds, agents, rows). Its attribute `entities` has the key of the
    observation and the number of rows of each kind that it attends to; with a memory, it also has `reset`.
    """

    def __init__(self, env: SurvivalVectorEnv, policy: Any, plays: Callable[[], Array] | None = None) -> None:
        if not hasattr(policy, "explainer"):
            raise RecordingError(
                "the policy does not report the probabilities of its choices, so it cannot be recorded: only "
                "saved policies do, a FILE.zip, a FILE.safetensors or what outlast.load_policy returns"
            )
        policy.check(env)
        self._env, self._plays, self._begins = env, plays, Begins(env)
        self._explain = policy.explainer()
        self.header = {"entities": [list(entry) for entry in self._explain.entities]}
        self.dtype = policy_dtype([["", 0, int(size)] for size in env.action_sizes], self.header)

    def look(self, steps: Array) -> Array:
        """Return the record of its present choices: dtype (worlds, agents), of the worlds `steps`, bool (worlds,)."""
        found = np.zeros((self._env.num_worlds, self._env.num_agents), self.dtype)
        if steps.any():
            tell(self._explain, self._begins.look())
            found["value"], found["probabilities"], found["attention"] = self._explain(self._env._reader.views)
            if self._plays is not None:
                found[~np.asarray(self._plays())] = np.full((), np.nan, self.dtype)
        return found[steps]


class Recorder:
    """A recorder of every tick of an environment in the file `path`; made by outlast.record.

    A context manager; `close` writes the remaining ticks. It is an ecs.Observer of the environment's ticks.
    The file exists from the first tick on; without ticks none is made. Raises RecordingError if it exists or cannot
    be written.
    """

    def __init__(
        self,
        env: SurvivalVectorEnv,
        path: str | os.PathLike[str],
        policy: PolicyRecorder | None,
        episodes: int | None,
        played: dict[str, Any] | None,
    ) -> None:
        import outlast  # imported here, since it imports this package

        self.path, self._worlds, self._policy, self._wait = Path(path), env.worlds, policy, env._guard.wait
        self._joint_actions, self._digests = JointActions(env.worlds), Digests(env.worlds)
        header = {
            "outlast": outlast.__version__,
            "machine": f"{platform.system()} {platform.machine()}",
            "scenario": fingerprint(env.scenario),
            "modules": classes(env.scenario),
            "given": env.worlds.dims.get(GIVEN_WORDS, 0),
            "worlds": env.worlds.count,
            "agents": env.worlds.dims["agents"],
            "actions": [list(column) for column in self._joint_actions.columns],
            "digests": {"components": self._digests.names, "worlds": WORLDS_PER_DIGEST, "repeat": self._digests.period},
            "first_world": env.first_world,
        }
        more = {"episodes": episodes, "played": played, "policy": policy and policy.header}
        self._file = RecordingWriter(self.path, header | {name: own for name, own in more.items() if own is not None})
        # closes the file even if the process ends without close()
        self._finalizer = weakref.finalize(self, self._file.close)
        self._owner = os.getpid()
        self._continuous = False  # whether the worlds are in the state after the last recorded tick
        self._keyed = np.zeros_like(self._keys())  # the recorded keys of each world

    @property
    def recording(self) -> bool:
        """Return whether the recording is still open."""
        return self._finalizer.alive

    @property
    def ticks(self) -> int:
        """Return the number of recorded ticks, including those that are not in the file yet."""
        return self._file.ticks

    def __repr__(self) -> str:
        return f"<Recorder to {self.path}: {self.ticks} ticks{'' if self.recording else ', closed'}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def check(self, mode: Array) -> None:
        """Raise RecordingError for a tick that cannot be recorded: after an interrupted one, any but a reset of all."""
        if os.getpid() != self._owner:
            raise RecordingError(f"{self.path} is recorded by another process; close() the recorder in this one")
        if not self._continuous and (mode != RESET).any():
            why = "a tick was interrupted" if self.ticks else "a recording begins with that"
            raise RecordingError(f"{self.path}: reset all worlds first, as {why}")

    def before(self, mode: Array) -> None:
        """Record the inputs of the tick."""
        steps, keys = mode == STEP, self._keyed[:0]
        if steps.all() and Given not in self._worlds:
            codes = self._joint_actions.encode(self._worlds.actions)
        else:  # keys that do not follow from the recording so far: given numbers may change between two ticks
            codes, now = self._joint_actions.encode(self._worlds.actions[:, steps]), self._keys()
            rows = np.flatnonzero((now != self._keyed).any(1) | (not self._continuous))
            keys = np.concatenate([rows[:, None].astype(np.uint64), now[rows]], 1)
            self._keyed[rows] = now[rows]
        thought = self._policy.look(steps) if self._policy else None  # about the observations before the tick
        self._continuous, self._begun = False, (codes, keys, thought)

    def after(self, mode: Array) -> None:
        """Record the tick. Raises RecordingError if the file cannot be written, which ends the recording."""
        codes, keys, thought = self._begun
        if (begun := mode == RESET).any():
            self._keyed[begun] = self._keys()[begun]  # a replay computes these from the previous keys
        digest = self._digests.compute(self.ticks)
        try:
            self._file.append(TickRecord(mode.copy(), codes, keys, digest, thought))
        except OSError as error:
            self._finalizer.detach()
            self._file.abandon()
            written = self._file.written
            kept = f", and the {written} ticks that are in the file can be replayed" if written else ""
            wrong = f"{self.path}: {error.strerror}; the recording ends here{kept}"
            raise RecordingError(f"{wrong}. The environment continues without it") from error
        self._continuous = True

    def close(self) -> None:
        """Write the remaining ticks, including a step that was sent, and mark the end. Raises RecordingError."""
        self._wait()
        try:
            self._finalizer()
        except OSError as error:
            raise RecordingError(f"{self.path}: {error.strerror}; its end is missing") from error

    def _keys(self) -> Array:
        """Return the keys of the random numbers of each world: rows of TickRecord.keys without the world's number."""
        clock = self._worlds[Clock]
        given = [self._worlds[Given].words] if Given in self._worlds else []
        return np.concatenate([clock.seed, clock.world, clock.episode, *given], 1)


def record(
    env: SurvivalVectorEnv,
    path: str | os.PathLike[str],
    *,
    policy: Any = None,
    plays: Callable[[], Any] | None = None,
    episodes: int | None = None,
    played: dict[str, Any] | None = None,
) -> Recorder:
    """Record `env` from its next reset on, which must reset all worlds.

    Until the recording is closed, `set_state` is refused, as is changing numbers that do not vary, and actions are
    checked even if check_actions is False. Ends that an adapter adds (stop_when) are not recorded, and a UserWarning
    reports it: in the recording, those episodes break off.

    Args:
        env: The environment itself: `wrapper.unwrapped` of a gymnasium wrapper.
        path: A new file.
        policy: A policy from `outlast.load_policy`. What it thinks before every tick is recorded, too: the
            probabilities of its actions, the value that it expects, and what it attends to. For that it is called an
            additional time, for any policy that acts. None: record no policy.
        plays: A function that returns whether it plays each agent at present, bool (worlds, agents). None: all.
        episodes: Number of first episodes of each world that are counted; 0: all that end. A replay counts the
            same. None: it counts the first of each world, if each has one.
        played: Who plays, if a person does: "agent", the number of theirs, and "others", the name of its opponent.

    Returns:
        The recorder. Use it as a context manager, or close either it or the environment.

    Raises:
        RecordingError: The file exists or cannot be written, `env` is being recorded already or has numbers changed by
            set_numbers, or the policy cannot report its probabilities.
        TrainingError: The policy does not fit the environment.
        TypeError: `env` is not a SurvivalVectorEnv.
    """
    if not isinstance(env, SurvivalVectorEnv):
        raise TypeError(
            f"record() needs an environment of make_vec, not {type(env).__name__}: give env.unwrapped of a gymnasium "
            "wrapper, or env.base_env of an adapter"
        )
    if env._stops is not None:
        warnings.warn(
            "ends that an adapter adds (its learner's death, max_episode_steps) are in no recording: in replays and "
            "datasets these episodes just break off",
            stacklevel=2,
        )
    thoughts = None if policy is None else PolicyRecorder(env, policy, plays)
    return env.add_observer(lambda: Recorder(env, path, thoughts, episodes, played))


class Digests:
    """Digests of the state of `worlds` and of its signals, without observations, which follow from the state.

    names: the components, in the order of a digest. turns: the digest of tick t covers the worlds `span(t)`, and all
    worlds have had a turn after this many ticks. period: ticks until a digest is made in the same way again.
    """

    def __init__(self, worlds: Worlds, worlds_per_digest: int = WORLDS_PER_DIGEST) -> None:
        self._count, self._size = worlds.count, worlds_per_digest
        self.turns = -(-worlds.count // worlds_per_digest)
        self._sign_turns = -(-min(worlds.count, worlds_per_digest) // SIGN_WORLDS)
        self.period = self.turns * self._sign_turns
        kinds = [c for c in worlds.components if c.packed or issubclass(c, Signal)]
        self._block = worlds.block.view(np.uint32)
        uniform, owners, self._shared, self._masks, sharers = _words(worlds, kinds)
        signals = [(k, _rows(a)) for k, c in enumerate(kinds) if not c.packed for a in worlds[c]]
        self._signals = [rows for _, rows in signals]
        owners = np.concatenate([owners, sharers, *(np.full(rows.shape[1], k) for k, rows in signals)])
        self._order = np.argsort(owners, kind="stable")
        found, self._starts = np.unique(owners[self._order], return_index=True)
        self.names = [kinds[k].__name__ for k in found]
        factors = _odd(len(owners), 1)
        factors[: len(uniform)][~uniform] = 0
        self._factors, self._weights = factors[self._order], _odd(worlds.count, 2)
        self._sign_weights = _odd(worlds.count, 3)
        self._sums = np.zeros(len(owners), np.uint32)

    def span(self, tick: int) -> slice:
        """Return the worlds that the digest of this tick covers."""
        start = tick % self.turns * self._size
        return slice(start, min(start + self._size, self._count))

    def compute(self, tick: int) -> Array:
        """Return the digest after the tick of this number: uint16 (components,)."""
        span = self.span(tick)
        self._add(span, tick // self.turns % self._sign_turns)
        words = self._sums[self._order]
        words ^= words >> SHIFT
        words *= self._factors
        totals: Array = np.add.reduceat(words, self._starts)
        return (totals ^ totals >> np.uint32(16)).astype(np.uint16)

    def _add(self, span: slice, turn: int) -> None:
        """Sum every word over these worlds.

        Of the topmost bits of words, which are the signs of numbers, a sum only shows whether their count is odd or
        even. So some worlds, in turn, also add their words' upper bits.
        """
        block, weights = self._block[span], self._weights[span]
        sums = self._sums[: block.shape[1]]
        np.einsum("wk,w->k", block, weights, out=sums)
        some = slice(turn * SIGN_WORLDS, turn * SIGN_WORLDS + SIGN_WORLDS)
        sums += np.einsum("wk,w->k", block[some] >> SHIFT, self._sign_weights[span][some])
        parts = [block[:, self._shared] & self._masks, *(rows[span] for rows in self._signals)]
        np.einsum("wk,w->k", np.concatenate(parts, 1), weights, out=self._sums[block.shape[1] :])


def _words(worlds: Worlds, kinds: list[type[Component]]) -> tuple[Array, Array, Array, Array, Array]:
    """Return the components to which the words of a world's block belong.

    For each word: whether it belongs to one component only, and to which. Then, for each component of each word that
    belongs to several: number of the word, mask of the component's bits, component.
    """
    owner = np.full(worlds.layout.world_bytes, -1)
    for place in worlds.layout.places:
        if place.offset >= 0:
            owner[place.offset : place.offset + place.nbytes] = kinds.index(place.component)
    fours = owner.reshape(-1, 4)
    owners = fours.max(1)
    uniform = ((fours == owners[:, None]) | (fours < 0)).all(1)
    parts = [(k, c) for k in np.flatnonzero(~uniform) for c in np.unique(fours[k]) if c >= 0]
    masks = [(np.where(fours[k] == c, 0xFF, 0) << np.arange(0, 32, 8)).sum() for k, c in parts]
    numbers, shares = (np.array([part[axis] for part in parts], np.intp) for axis in (0, 1))
    return uniform, np.maximum(owners, 0), numbers, np.array(masks, np.uint32), shares


def _rows(array: Array) -> Array:
    """Return a column's bytes as words, or as single bytes if four do not divide them: a row for each world."""
    rows = array.reshape(len(array), -1)
    return rows.view(np.uint32 if rows.shape[1] * rows.itemsize % 4 == 0 else np.uint8)


def _odd(count: int, stream: int) -> Array:
    """Return odd random numbers, uint32 (count,), which are the same in every call."""
    words = np.frombuffer(hashlib.shake_128(b"%d" % stream).digest(4 * count), "<u4")
    return words.astype(np.uint32) | np.uint32(1)
