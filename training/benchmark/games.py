"""Matches: played, and played again to verify them, tick by tick and action by action.

A match is a function of its game and its policies. Its file (.npz, a few kB) holds what these cannot tell again:

- digests: four bytes of a hash of every tick, over all actions and the digest of the state;
- doubtful: those actions whose random number is so close to another choice that another machine may take that;
- foreign: all actions of functions of the user's, which are not executed again.
"""

import contextlib
import hashlib
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import RecordingError
from outlast.envs.recording.digests import Digests
from outlast.envs.recording.tick_records import JointActions
from outlast.envs.rollout.lineup import ROLES
from outlast.envs.storage import safe_npz

from ..arena.evaluation import Evaluation
from ..arena.match import Act, AgentIndices, Match, MatchResults, Pairing
from ..arena.players import Contender
from ..base.errors import TrainingError
from ..base.files import write_files
from .tasks import TaskGame

Array = np.ndarray[Any, Any]
SUFFIX = ".npz"
LARGEST = 2**24  # maximum bytes of a file
PLACE = 3  # numbers that locate an action: tick, world, agent
FORM = {"digests": ("<u4",), "doubtful": ("<u4",), "foreign": ("|u1", "<u2", "<u4")}  # types of the arrays in a file
DIGITS = 6  # significant digits of figures
# Possible difference of cumulative probabilities between machines. Ten policies were computed in float32 and in
# float64, and with inputs that differ by a unit in the last place: at most 7.5e-7, in 240,000 rows.
ROUNDING = 2**-18


@dataclass(frozen=True)
class Moves:
    """The content of the file of a match; see the module.

    digests: uint32 (ticks,). doubtful: uint32 (n, 3 + actions): tick, world, agent, and what it did. foreign: unsigned
    integers (actions of functions,), the number of each joint action, in the order in which they were taken.
    """

    digests: Array
    doubtful: Array
    foreign: Array

    @classmethod
    def read(cls, path: Path) -> "Moves":
        """Read a file. Raises RecordingError."""
        try:
            with path.open("rb") as file:
                found = safe_npz.entries(file, {f"{name}.npy" for name in FORM}, LARGEST)
            arrays = {name: safe_npz.array(found[f"{name}.npy"]) for name in FORM}
        except safe_npz.BROKEN as error:
            raise RecordingError(f"{path} is not a file of games: {error}") from error
        axes = {name: array.ndim for name, array in arrays.items()}
        if axes != dict.fromkeys(FORM, 1) | {"doubtful": 2} or any(
            arrays[name].dtype.str not in types for name, types in FORM.items()
        ):
            raise RecordingError(f"{path} is not a file of games: its arrays have other types or shapes")
        return cls(**arrays)

    def write(self, path: Path) -> str:
        """Write a file, completely or not at all; equal moves give equal bytes. Return its SHA-256.

        Raises TrainingError.
        """
        file = io.BytesIO()
        np.savez(file, **{name: getattr(self, name) for name in FORM})
        write_files({path: file.getvalue()})
        return hashlib.sha256(file.getvalue()).hexdigest()


@dataclass(frozen=True)
class Played:
    """A match that was played, or played again.

    Attributes:
        outcome: Its numbers, see `outcome`.
        moves: The content of its file.
        differing: Number of actions that differ from a saved policy's choice, but within rounding of it.
        drawn: Number of actions that saved policies chose.
    """

    outcome: dict[str, Any]
    moves: Moves
    differing: int
    drawn: int


def digest(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def play(
    game: TaskGame,
    policies: Sequence[Contender | None],
    games: int,
    given: Moves | None = None,
) -> Played:
    """Play a match, or play it again by its file.

    Args:
        game: The game, in the worlds of its seed.
        policies: One that meets itself; two; or three, of which the last plays the team-mates of the first, see Match.
            None: a function of the user's, of a match that is played again.
        games: Number of games, each in its own world: must be even, so that both play each side equally often.
        given: The file of the match. Policies are asked what they would do, and take the kept actions where these may
            be rounded otherwise.

    Raises:
        RecordingError: A tick differs from the file, or a policy did not choose an action that is kept.
        TrainingError: A policy cannot play the game.
    """
    with worlds(game, policies, games) as env:
        seats = _Seats(env, given)
        ticks = env.add_observer(lambda: _Ticks(env, given))
        acts = [seats.act(game, role, policy) for role, policy in enumerate(policies)]
        match = Match(env, acts, 1, game.seed)
        seats.tick = lambda: match.records + 1
        found = match.play()
        made = Moves(np.array(ticks.found, np.uint32), *seats.kept())
    if given is not None and (len(given.digests) != len(made.digests) or seats.left):
        raise RecordingError("its file holds ticks or actions that the games do not have")
    return Played(outcome(found), made, seats.differing, seats.drawn)


def outcome(found: MatchResults) -> dict[str, Any]:
    """Turn a match into numbers for JSON.

    Returns "won", "drawn" and "lost": games of the first policy; "figures": its columns, see base.quantities, as [mean,
    standard error]; None for what could not be measured. The error of a figure that was measured in one game only is 0.
    """
    pairing = Pairing((0, 1), found)
    figures = dict[str, list[float] | None]()
    for name, (mean, error) in pairing.estimates(0).items():
        known = not np.isnan(mean)
        figures[name] = [float(f"{each:.{DIGITS}g}") for each in (mean, np.nan_to_num(error))] if known else None
    return dict(zip(("won", "drawn", "lost"), pairing.won_drawn_lost(), strict=True)) | {"figures": figures}


@contextlib.contextmanager
def worlds(game: TaskGame, policies: Sequence[Contender | None], games: int) -> Iterator[SurvivalVectorEnv]:
    """Yield the worlds of a match, with observations that fit all policies."""
    if games % ROLES:
        raise TrainingError(f"games = {games}: must be even, so that each policy plays each side equally often")
    known = [policy for policy in policies if policy is not None]
    evaluation = Evaluation(game.scenario, known, episodes=games, worlds=games, seed=game.seed)
    try:
        if game.given:
            evaluation.env.set_numbers(game.numbers(games))
        yield evaluation.env
    finally:
        evaluation.close()


@dataclass
class _Ticks:
    """An observer that hashes every tick, and compares it with the file of the match. Raises RecordingError."""

    env: SurvivalVectorEnv
    given: Moves | None
    found: list[int] = field(default_factory=list)
    recording: bool = True

    def __post_init__(self) -> None:
        self._digests, self._joint = Digests(self.env.worlds), JointActions(self.env.worlds)

    def check(self, mode: Array) -> None:
        """Allow every tick."""

    def before(self, mode: Array) -> None:
        """Note the actions."""
        self._codes = self._joint.encode(self.env.worlds.actions)

    def after(self, mode: Array) -> None:
        """Hash the tick."""
        number, state = len(self.found), self._digests.compute(len(self.found))
        parts = (mode, "i1"), (self._codes, "<u4"), (state, "<u2")
        joined = b"".join(np.ascontiguousarray(values, kind).tobytes() for values, kind in parts)
        self.found.append(int.from_bytes(hashlib.blake2b(joined, digest_size=4).digest(), "little"))
        if self.given is not None and self.given.digests[number : number + 1].tolist() != self.found[-1:]:
            raise RecordingError(f"tick {number} is the first that differs when the match is played again")

    def close(self) -> None:
        """End the observation."""
        self.recording = False


class _Seats:
    """The policies of a match: what they choose, and what is kept of it; see Moves.

    left: Number of actions in the file that nobody has taken yet.
    """

    def __init__(self, env: SurvivalVectorEnv, given: Moves | None) -> None:
        self.env, self.sizes = env, tuple(int(size) for size in env.action_sizes)
        self.differing = self.drawn = self.left = 0
        self.tick: Callable[[], int] = lambda: 1  # the number of the next step
        self._doubtful = [np.zeros((0, PLACE + len(self.sizes)), np.int64)]
        self._foreign = list[Array]()
        self._given: dict[int, list[Array]] | None = None
        if given is not None:
            if given.doubtful.shape[1] != PLACE + len(self.sizes):
                raise RecordingError("its file holds games with a different number of actions")
            self._given, self._codes, self.left = {}, given.foreign, len(given.doubtful) + len(given.foreign)
            for row in given.doubtful.astype(np.int64):
                self._given.setdefault(int(row[0]), []).append(row)

    def kept(self) -> tuple[Array, Array]:
        """Return doubtful and foreign actions."""
        codes = np.concatenate([np.zeros(0, np.int64), *self._foreign])
        kind = np.min_scalar_type(np.prod(self.sizes, dtype=object) - 1)
        return np.concatenate(self._doubtful).astype("<u4"), codes.astype(kind.newbyteorder("<"))

    def act(self, game: TaskGame, role: int, policy: Contender | None) -> Act:
        """Return the function that plays a policy in a role. Its random numbers depend on the game and the role."""
        if policy is None:
            return self._repeat
        (seed,) = np.random.SeedSequence([game.seed, role]).generate_state(1, np.uint64) >> np.uint64(1)
        foreign = policy.foreign
        choose = policy.act(self.env, int(seed), keyed=True, slack=0.0 if foreign else ROUNDING)
        return partial(self._note if foreign else self._choose, policy.text, choose)

    def _note(self, name: str, choose: Act, seen: dict[str, Array], indices: AgentIndices) -> Array:
        """Let a function of the user's play, and keep what it does."""
        actions = choose(seen, indices)
        self._foreign.append(np.ravel_multi_index(tuple(actions.T), self.sizes))
        return actions

    def _repeat(self, seen: dict[str, Array], indices: AgentIndices) -> Array:
        """Return the kept actions of a function."""
        codes, self._codes = np.split(self._codes, [len(indices[0])])
        if len(codes) < len(indices[0]) or codes.max(initial=0) >= np.prod(self.sizes, dtype=object):
            raise RecordingError(f"tick {self.tick()}: its file lacks actions of a function")
        self._foreign.append(codes.astype(np.int64))
        self.left -= len(codes)
        return np.stack(np.unravel_index(codes, self.sizes), 1)

    def _choose(self, name: str, choose: Act, seen: dict[str, Array], indices: AgentIndices) -> Array:
        """Return the choices of a policy, or the kept actions, which must be within rounding of them.

        A saved policy has three choices, see Player.doubted; scripted styles do not round, and have a single one.
        """
        choices = choose(seen, indices).reshape(len(indices[0]), -1, len(self.sizes))
        first, choice, last = (choices[:, k] for k in (0, choices.shape[1] // 2, -1))
        actions, number = choice.copy(), self.tick()
        for row in (self._given or {}).get(number, ()):
            for k in np.flatnonzero((indices[0] == row[1]) & (indices[1] == row[2])):
                actions[k], self.left = row[PLACE:], self.left - 1
        for k in np.flatnonzero(((actions < first) | (actions > last)).any(1)):
            where = f"in world {indices[0][k]}, tick {number}, agent {indices[1][k]}"
            raise RecordingError(f"{name} did not play this match: {where} it chooses {choice[k]}, not {actions[k]}")
        self.differing += int((actions != choice).any(1).sum())
        self.drawn += len(actions) * (choices.shape[1] > 1)
        doubted = np.flatnonzero((first != last).any(1))
        place = np.full(len(doubted), number), indices[0][doubted], indices[1][doubted]
        self._doubtful.append(np.column_stack([*place, actions[doubted]]))
        return actions
