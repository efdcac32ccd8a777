"""Matches: played, and played again to verify them, tick by tick and action by action.

A match is a function of its game and its policies. Its file (.npz, a few kB) holds what these cannot tell again:

- digests: four bytes of a hash of every tick, over all actions and the digest of the state;
- doubtful: those actions whose random number is so close to another choice that another machine may take that;
- foreign: all actions of functions of the user's, which are not executed again.
"""

import contextlib
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import RecordingError
from outlast.envs.recording.file_format import JointActions
from outlast.envs.recording.recorder import Digests
from outlast.envs.storage import inputs

from ..arena.evaluation import Evaluation
from ..arena.match import Act, AgentIndices, Match, Pairing
from ..arena.players import Contender
from ..base.files import write_files
from .result import NUMBERS
from .tasks import TaskGame

Array = np.ndarray[Any, Any]
SUFFIX = ".npz"
LARGEST = 2**24  # maximum bytes of a file
PLACE = 3  # numbers that locate an action: tick, world, agent
FORM = {"digests": (1, "<u4"), "doubtful": (2, "<u4"), "foreign": (1, "|u1", "<u2", "<u4")}  # arrays: axes and types
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
                found = inputs.zip_entries(file, {f"{name}.npy" for name in FORM}, LARGEST)
            arrays = {name: inputs.npy_array(found[f"{name}.npy"]) for name in FORM}
        except inputs.BROKEN_ZIP as error:
            raise RecordingError(f"{path} is not a file of games: {error}") from error
        for name, (axes, *types) in FORM.items():
            if arrays[name].ndim != axes or arrays[name].dtype.str not in types:
                raise RecordingError(f"{path} is not a file of games: its arrays have other types or shapes")
        return cls(**arrays)

    def write(self, path: Path) -> str:
        """Write a file, and return its SHA-256; equal moves give equal bytes. Raises TrainingError."""
        file = io.BytesIO()
        np.savez(file, **{name: getattr(self, name) for name in FORM})
        write_files({path: file.getvalue()})
        return digest(path)


@dataclass(frozen=True)
class Played:
    """A match that was played, or played again.

    outcome: "won", "drawn" and "lost": games of the first policy; "figures": its columns, see base.quantities, as
    [mean, standard error], with 0 if it was measured in one game only; None if in none. moves: The content of its file.
    differing: Number of actions that differ from a saved policy's choice, but within rounding of it. drawn: Number of
    actions that saved policies chose.
    """

    outcome: dict[str, Any]
    moves: Moves
    differing: int
    drawn: int


def digest(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def play(game: TaskGame, policies: Sequence[Contender | None], games: int, given: Moves | None = None) -> Played:
    """Play a match, or play it again by its file. Raises TrainingError: a policy cannot play the game.

    policies: One that meets itself; two; or three, of which the last plays the team-mates of the first, see Match.
    None: a function of the user's, of a match that is played again. games: How many, each in its own world: even, so
    that both play each side equally often. given: The file of the match: policies are asked what they would do, and
    take the kept actions where these may be rounded otherwise. Raises RecordingError: a tick or an action differs.
    """
    known = [policy for policy in policies if policy is not None]
    evaluation = Evaluation(game.scenario, known, episodes=games, worlds=games, seed=game.seed)
    with contextlib.closing(evaluation.env) as env:
        if game.given:
            env.set_numbers(game.numbers(games))
        seats = _Seats(env, given)
        env.add_observer(lambda: seats)
        acts = [seats.act(game, role, policy) for role, policy in enumerate(policies)]
        found = Match(env, acts, 1, game.seed).play()
        made = Moves(np.array(seats.found, np.uint32), *seats.kept())
    if given is not None and (len(given.digests) != len(made.digests) or seats.left):
        raise RecordingError("its file holds ticks or actions that the games do not have")
    pairing, figures = Pairing((0, 1), found), dict[str, list[float] | None]()
    for name, ends in pairing.estimates(0).items():
        rounded = [float(f"{each:.{DIGITS}g}") for each in np.nan_to_num(ends)]
        figures[name] = None if np.isnan(ends[0]) else rounded
    outcome = dict(zip(NUMBERS, pairing.won_drawn_lost(), strict=True)) | {"figures": figures}
    return Played(outcome, made, seats.differing, seats.drawn)


class _Seats:
    """The policies of a match, what they choose, and what is kept of it, see Moves; as an observer, it hashes ticks.

    found: The hash of every tick. left: Number of actions in the file that nobody has taken yet.
    """

    def __init__(self, env: SurvivalVectorEnv, given: Moves | None) -> None:
        self.env, self.given, self.recording = env, given, True
        self.sizes, self.found = tuple(int(size) for size in env.action_sizes), list[int]()
        self._digests, self._joint = Digests(env.worlds), JointActions(env.worlds)
        self._doubtful, self._foreign = [np.zeros((0, PLACE + len(self.sizes)), np.int64)], [np.zeros(0, np.int64)]
        rows, codes = (self._doubtful[0], self._foreign[0]) if given is None else (given.doubtful, given.foreign)
        if rows.shape[1] != PLACE + len(self.sizes):
            raise RecordingError("its file holds games with a different number of actions")
        self._rows, self._codes, self.left = rows.astype(np.int64), codes, len(rows) + len(codes)
        self.differing = self.drawn = 0

    def check(self, mode: Array) -> None:
        """Allow every tick."""

    def before(self, mode: Array) -> None:
        """Note the actions."""
        self._taken = self._joint.encode(self.env.worlds.actions)

    def after(self, mode: Array) -> None:
        """Hash the tick, and compare it with the file of the match. Raises RecordingError."""
        number, state = len(self.found), self._digests.compute(len(self.found))
        parts = (mode, "i1"), (self._taken, "<u4"), (state, "<u2")
        joined = b"".join(np.ascontiguousarray(values, kind).tobytes() for values, kind in parts)
        self.found.append(int.from_bytes(hashlib.blake2b(joined, digest_size=4).digest(), "little"))
        if self.given is not None and self.given.digests[number : number + 1].tolist() != self.found[-1:]:
            raise RecordingError(f"tick {number} is the first that differs when the match is played again")

    def close(self) -> None:
        """End the observation."""
        self.recording = False

    def kept(self) -> tuple[Array, Array]:
        """Return doubtful and foreign actions."""
        kind = np.min_scalar_type(np.prod(self.sizes, dtype=object) - 1).newbyteorder("<")
        return np.concatenate(self._doubtful).astype("<u4"), np.concatenate(self._foreign).astype(kind)

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
            raise RecordingError(f"tick {len(self.found)}: its file lacks actions of a function")
        self._foreign.append(codes.astype(np.int64))
        self.left -= len(codes)
        return np.stack(np.unravel_index(codes, self.sizes), 1)

    def _choose(self, name: str, choose: Act, seen: dict[str, Array], indices: AgentIndices) -> Array:
        """Return the choices of a policy, or the kept actions, which must be within rounding of them.

        A saved policy has three choices, see Player.doubted; scripted styles do not round, and have a single one.
        """
        choices = choose(seen, indices).reshape(len(indices[0]), -1, len(self.sizes))
        first, choice, last = (choices[:, k] for k in (0, choices.shape[1] // 2, -1))
        actions, number = choice.copy(), len(self.found)
        for row in self._rows[self._rows[:, 0] == number]:
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
