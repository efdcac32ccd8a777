"""Games in short: what it takes to verify a match of saved policies, in a few kB where its recording has hundreds.

The policies are here, so `repeat` lets them play again. A file holds what they cannot tell:

- a digest of four bytes of every tick, by which the games are known to be those that were played;
- the doubtful actions: those whose drawn number is within rounding of another choice, which another machine may take.
"""

import contextlib
import hashlib
import io
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import RecordingError
from outlast.envs.recording import Recording, record
from outlast.envs.recording.tick_records import TickRecord
from outlast.envs.storage import safe_npz

from ..arena.match import Act, AgentIndices, Match
from ..arena.players import Contender
from ..base.files import write_files
from . import matches
from .matches import Array, Asked, Repeated, outcome
from .tasks import TaskGame

LARGEST = 2**24  # bytes of a file
PLACE = 3  # numbers that say where an action is: tick, world, agent
FORM = {"digests": ("<u4", 1), "doubtful": ("<u4", 2)}  # type and number of axes of the arrays in a file


@dataclass(frozen=True)
class Games:
    """A match in short.

    digests: uint32 (ticks,), see `_digest`. doubtful: uint32 (n, 3 + actions): tick, world, agent, and the actions that
    this agent took there.
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
            raise RecordingError(f"{path} holds no games: {error}") from error
        if any((arrays[name].dtype.str, arrays[name].ndim) != form for name, form in FORM.items()):
            raise RecordingError(f"{path} holds no games: its arrays have other types or shapes")
        return cls(**arrays)

    def write(self, path: Path) -> None:
        """Write a file, completely or not at all; equal games give equal bytes. Raises TrainingError."""
        file = io.BytesIO()
        np.savez(file, **{name: getattr(self, name).astype(kind) for name, (kind, _) in FORM.items()})
        write_files({path: file.getvalue()})


def shorten(game: TaskGame, pair: Sequence[Contender], games: int, path: Path) -> Games:
    """Return what is kept of a recorded match, which is verified on the way; see `matches.repeat`.

    Args:
        game: What was played.
        pair: Two saved policies, or one that met itself, which drew by the keys of worlds.
        games: How many games were played.
        path: The file of the recording.

    Raises:
        RecordingError: The recording is not of these policies and this game.
    """
    repeated = matches.repeat(game, pair, games, path)
    return Games(_digests(path), repeated.doubtful)


def repeat(game: TaskGame, pair: Sequence[Contender], games: int, path: Path) -> Repeated:
    """Play a match again: policies choose as they did, and take the kept choice where theirs may be rounded otherwise.

    Args:
        game: What was played.
        pair: Two saved policies, or one that met itself.
        games: How many games were played.
        path: The file of the match.

    Raises:
        RecordingError: The file holds no games, a tick is not as it was, or a kept action is none that the policy may
            have chosen.
    """
    kept = Games.read(path)
    with matches.worlds(game, pair, games) as env, tempfile.TemporaryDirectory() as folder:
        asked = [matches.asked(game, role, policy, env) for role, policy in enumerate(pair)]
        choices = _Choices(path, kept.doubtful, env, asked)
        with _compared(path, kept.digests, Path(folder, "again.rec"), env):
            match = Match(env, choices.acts(), 1, game.seed)
            choices.number = lambda: match.records + 1
            found = match.play()
        choices.end()
    return Repeated(outcome(found), choices.differing, choices.drawn, kept.doubtful)


class _Choices:
    """Policies that choose by themselves, but for the doubtful actions that are kept."""

    def __init__(self, path: Path, doubtful: Array, env: SurvivalVectorEnv, asked: Sequence[Asked]) -> None:
        self.path, self.asked, self.left = path, asked, len(doubtful)
        self.differing = self.drawn = 0  # see Repeated
        self.number: Callable[[], int] = lambda: 1  # which tick record the next step has
        self._ticks = dict[int, list[Array]]()
        for row in doubtful.astype(np.int64):
            self._ticks.setdefault(int(row[0]), []).append(row)
        if doubtful.shape[1] != PLACE + len(env.action_sizes):
            raise RecordingError(f"{path} holds games with another number of actions")

    def acts(self) -> list[Act]:
        """One function for each policy."""
        return [self._act(*asked) for asked in self.asked]

    def _act(self, name: str, choose: Act) -> Act:
        def act(seen: dict[str, Array], indices: AgentIndices) -> Array:
            choices = choose(seen, indices).reshape(len(indices[0]), 3, -1)
            actions = choices[:, 1].copy()
            for row in self._ticks.get(self.number(), ()):
                for k in np.flatnonzero((indices[0] == row[1]) & (indices[1] == row[2])):
                    matches.check_within(name, row[PLACE:], choices[k], *map(int, row[:PLACE]))
                    actions[k], self.left = row[PLACE:], self.left - 1
            self.differing += int((actions != choices[:, 1]).any(1).sum())
            self.drawn += len(actions)
            return actions

        return act

    def end(self) -> None:
        """Check that every kept action was taken. Raises RecordingError."""
        if self.left:
            raise RecordingError(f"{self.path}: {self.left} of its actions are of agents that do not act there")


@contextlib.contextmanager
def _compared(path: Path, digests: Array, again: Path, env: SurvivalVectorEnv) -> Iterator[None]:
    """Record what happens inside, and compare its ticks, those before an action that is wrong, too.

    Raises RecordingError: a tick is not as it was.
    """
    try:
        with record(env, again):
            yield
    except RecordingError:
        here = _digests(again)
        _compare(path, digests[: len(here)], here)
        raise
    _compare(path, digests, _digests(again))


def _compare(path: Path, there: Array, here: Array) -> None:
    """Raise RecordingError at the first tick that differs."""
    shorter = min(len(there), len(here))
    differ = np.flatnonzero(there[:shorter] != here[:shorter])
    if len(differ) or len(there) != len(here):
        raise RecordingError(matches.OTHER_TICK.format(path, differ[0] if len(differ) else shorter))


def _digests(path: Path) -> Array:
    """The digests of the ticks of a recording, uint32 (ticks,)."""
    with contextlib.closing(Recording.open(path).tick_records()) as ticks:
        return np.array([_digest(tick) for tick in ticks], np.uint32)


def _digest(tick: TickRecord) -> int:
    """Four bytes of BLAKE2b of all that a tick record says: modes, joint actions, keys and the digest of the state."""
    parts: list[tuple[Any, str]] = [(tick.mode, "i1"), (tick.codes, "<u4"), (tick.keys, "<u8"), (tick.digest, "<u2")]
    whole = b"".join(np.ascontiguousarray(values, kind).tobytes() for values, kind in parts)
    return int.from_bytes(hashlib.blake2b(whole, digest_size=4).digest(), "little")
