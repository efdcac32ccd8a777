"""Replay of matches to verify them: from recordings, or from short games of a few kB each.

The policies are available, so `repeat` lets them play again. A file of short games (.npz) holds the rest:

- a digest of four bytes of every tick, to recognise the games that were played;
- the doubtful actions: those whose random number is so close to another choice that another machine may take it.
"""

import contextlib
import hashlib
import io
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from outlast.ecs import STEP
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import RecordingError
from outlast.envs.recording import Recording, record
from outlast.envs.recording.tick_records import JointActions, TickRecord
from outlast.envs.rollout.saved import common_scenario, forms
from outlast.envs.scenarios.fingerprint import difference, fingerprint
from outlast.envs.storage import safe_npz

from ..arena.match import Act, AgentIndices, Match
from ..arena.players import Contender
from ..base.files import write_files
from . import matches
from .kept import SHORT
from .matches import Array, Asked
from .tasks import TaskGame

LARGEST = 2**24  # maximum bytes of a file
PLACE = 3  # numbers that locate an action: tick, world, agent
FORM = {"digests": ("<u4", 1), "doubtful": ("<u4", 2)}  # type and number of axes of the arrays in a file
BYTES, FEW = 16, 4  # bytes of the digest of a tick: of a recording; of short games
Played = Callable[[int, AgentIndices, Any], Array]  # number of a tick record, agents, their policy's choice: actions


@dataclass(frozen=True)
class Games:
    """A match in short form.

    digests: uint32 (ticks,), see `_digests`. doubtful: uint32 (n, 3 + actions): tick, world, agent, and the actions of
    this agent.
    """

    digests: Array
    doubtful: Array

    @classmethod
    def read(cls, path: Path) -> "Games":
        """Read a file. Raises RecordingError."""
        try:
            with path.open("rb") as file:
                found = safe_npz.entries(file, {f"{name}.npy" for name in FORM}, LARGEST)
            arrays = {name: safe_npz.array(found[f"{name}.npy"]) for name in FORM}
        except safe_npz.BROKEN as error:
            raise RecordingError(f"{path} is not a file of games: {error}") from error
        if any((arrays[name].dtype.str, arrays[name].ndim) != form for name, form in FORM.items()):
            raise RecordingError(f"{path} is not a file of games: its arrays have other types or shapes")
        return cls(**arrays)

    def write(self, path: Path) -> None:
        """Write a file, completely or not at all; equal games give equal bytes. Raises TrainingError."""
        file = io.BytesIO()
        np.savez(file, **{name: getattr(self, name).astype(kind) for name, (kind, _) in FORM.items()})
        write_files({path: file.getvalue()})


@dataclass
class Repeated:
    """A match that was played again.

    Attributes:
        outcome: As `matches.play` returned it, without the digest of the recording.
        differing: Number of actions that differ from a saved policy's choice, but within rounding of it.
        drawn: Number of actions that saved policies chose.
        doubtful: Choices of saved policies that another machine may round otherwise, see Games.
    """

    outcome: dict[str, Any]
    differing: int
    drawn: int
    doubtful: Array


def shorten(game: TaskGame, pair: Sequence[Contender], games: int, path: Path) -> Games:
    """Return the short form of a recorded match, and verify the match; see `repeat`."""
    doubtful = repeat(game, pair, games, path).doubtful
    return Games(np.array(_digests(path, FEW), np.uint32), doubtful)


def repeat(game: TaskGame, pair: Sequence[Contender | None], games: int, path: Path) -> Repeated:
    """Play a match again in new worlds, and compare with the choices of the policies.

    From a recording, all actions are played; from short games, the choices of the policies, and the kept actions where
    these may be rounded otherwise.

    Raises RecordingError: the file holds another match, a tick differs, or a policy did not choose an action.

    pair: Two policies, or one that met itself; None: an unknown one, possible with a recording only.
    """
    known = [policy for policy in pair if policy is not None]
    short = Games.read(path) if path.suffix == SHORT else None
    recording = None if short else _opened(path, game, pair, games)
    with contextlib.ExitStack() as opened:
        env = opened.enter_context(matches.worlds(game, known, games, recording))
        again = Path(opened.enter_context(tempfile.TemporaryDirectory()), "again.rec")
        played: Played
        if short is not None:
            there, played = short.digests.tolist(), _Doubtful(path, short.doubtful, env)
        elif recording is not None:
            ticks = opened.enter_context(contextlib.closing(recording.tick_records()))
            there, played = _digests(path, BYTES), _recorded(path, ticks, env)
        asked = [None if each is None else matches.asked(game, k, each, env) for k, each in enumerate(pair)]
        policies = _Policies(asked, played, len(env.action_sizes))
        with _compared(path, there, again, env, FEW if short else BYTES):
            match = Match(env, policies.acts(), 1, game.seed)
            policies.number = lambda: match.records + 1
            found = match.play()
    if isinstance(played, _Doubtful):
        played.end()
    return Repeated(matches.outcome(found), policies.differing, policies.drawn, np.concatenate(policies.doubtful))


def _opened(path: Path, game: TaskGame, pair: Sequence[Contender | None], games: int) -> Recording:
    """Open the recording of a match. Raises RecordingError if it is of another game."""
    recording = Recording.open(path)
    if recording.cut:
        raise RecordingError(recording.cut)
    if recording.num_worlds != games:
        raise RecordingError(f"{path} has {recording.num_worlds} worlds: {games} are required, one for each game")
    players = [policy.player for policy in pair if policy is not None and policy.player is not None]
    own = common_scenario(game.scenario, players)
    others = [difference(fingerprint(recording.scenario), fingerprint(each)) for each in [own, *forms(game.scenario)]]
    if all(others[: None if None in pair else 1]):
        raise RecordingError(f"{path} is of another game {others[0]}")
    return recording


class _Policies:
    """Policies that repeat the played actions, compared with the choices of the known policies; see Repeated."""

    def __init__(self, asked: Sequence[Asked | None], played: Played, actions: int) -> None:
        self.asked, self.played, self.actions = asked, played, actions
        self.differing = self.drawn = 0
        self.doubtful = [np.zeros((0, PLACE + actions), np.int64)]
        self.number: Callable[[], int] = lambda: 1  # the tick record of the next step

    def acts(self) -> list[Act]:
        """Return one function for each policy."""
        return [self.played_by_unknown if asked is None else partial(self._act, *asked) for asked in self.asked]

    def played_by_unknown(self, seen: dict[str, Array], indices: AgentIndices) -> Array:
        return self.played(self.number(), indices, None)

    def _act(self, name: str, choose: Act, seen: dict[str, Array], indices: AgentIndices) -> Array:
        """Check that actions are within rounding of the choices. Raises RecordingError.

        A saved policy has three choices, see Player.doubted; scripted styles do not round, and have a single one.
        """
        choices = choose(seen, indices).reshape(len(indices[0]), -1, self.actions)
        first, choice, last = (choices[:, k] for k in (0, choices.shape[1] // 2, -1))
        actions, number = self.played(self.number(), indices, choice), self.number()
        for k in np.flatnonzero(((actions < first) | (actions > last)).any(1)):
            where = f"in world {indices[0][k]}, tick {number}, agent {indices[1][k]}"
            raise RecordingError(f"{name} did not play this match: {where} it chooses {choice[k]}, not {actions[k]}")
        self.differing += int((actions != choice).any(1).sum())
        self.drawn += len(actions) * (choices.shape[1] > 1)
        doubted = np.flatnonzero((first != last).any(1))
        place = np.full(len(doubted), number), indices[0][doubted], indices[1][doubted]
        self.doubtful.append(np.column_stack([*place, actions[doubted]]))
        return actions


def _recorded(path: Path, ticks: Iterator[TickRecord], env: SurvivalVectorEnv) -> Played:
    """Return the actions of a recording, as a function."""
    joint, records, now = JointActions(env.worlds), enumerate(ticks), (-1, np.zeros(0))
    lows = np.array([low for _, low, _ in joint.columns])[:, None, None]  # environments count from 0

    def played(number: int, indices: AgentIndices, choice: Any) -> Array:
        nonlocal now
        while now[0] < number:
            at, tick = next(records, (number, None))
            if tick is None or (at == number and (tick.mode != STEP).any()):
                raise RecordingError(f"{path}: tick {number} must be a step of all worlds, since the match is not over")
            now = at, np.moveaxis(joint.decode(tick.codes) - lows, 0, -1) if at == number else now[1]
        actions: Array = now[1][indices]
        return actions

    return played


class _Doubtful:
    """Choices of policies, except for the doubtful actions that are kept."""

    def __init__(self, path: Path, doubtful: Array, env: SurvivalVectorEnv) -> None:
        self.path, self.left, self._ticks = path, len(doubtful), dict[int, list[Array]]()
        if doubtful.shape[1] != PLACE + len(env.action_sizes):
            raise RecordingError(f"{path} holds games with a different number of actions")
        for row in doubtful.astype(np.int64):
            self._ticks.setdefault(int(row[0]), []).append(row)

    def __call__(self, number: int, indices: AgentIndices, choice: Any) -> Array:
        actions: Array = choice.copy()
        for row in self._ticks.get(number, ()):
            for k in np.flatnonzero((indices[0] == row[1]) & (indices[1] == row[2])):
                actions[k], self.left = row[PLACE:], self.left - 1
        return actions

    def end(self) -> None:
        """Check that every kept action was taken. Raises RecordingError."""
        if self.left:
            raise RecordingError(f"{self.path}: {self.left} of its actions belong to agents that do not act")


@contextlib.contextmanager
def _compared(path: Path, there: Sequence[int], again: Path, env: SurvivalVectorEnv, size: int) -> Iterator[None]:
    """Record the body, and compare its ticks, also those before an invalid action.

    Raises RecordingError if a tick differs. there: Digests. size: Bytes of each.
    """
    try:
        with record(env, again):
            yield
    except RecordingError:
        here = _digests(again, size)
        _compare(path, there[: len(here)], here)
        raise
    _compare(path, there, _digests(again, size))


def _compare(path: Path, there: Sequence[int], here: Sequence[int]) -> None:
    """Raise RecordingError at the first tick that differs."""
    for number, (one, other) in enumerate(zip_longest(there, here)):
        if one != other:
            raise RecordingError(f"{path}: tick {number} is the first that differs when the match is played again")


def _digests(path: Path, size: int) -> list[int]:
    """Return the digests of the ticks of a recording: `size` bytes of BLAKE2b of the tick record."""
    found, code = [], "<u4" if size == FEW else "<u8"
    with contextlib.closing(Recording.open(path).tick_records()) as ticks:
        for tick in ticks:
            parts = (tick.mode, "i1"), (tick.codes, code), (tick.keys, "<u8"), (tick.digest, "<u2")
            joined = b"".join(np.ascontiguousarray(values, kind).tobytes() for values, kind in parts)
            found.append(int.from_bytes(hashlib.blake2b(joined, digest_size=size).digest(), "little"))
    return found
