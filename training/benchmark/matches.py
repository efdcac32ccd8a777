"""Matches of the benchmark: played and recorded, or played again from a recording and compared with it."""

import contextlib
import hashlib
import itertools
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outlast.ecs import STEP
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import RecordingError
from outlast.envs.recording import Recording, record
from outlast.envs.recording.tick_records import JointActions, TickRecord
from outlast.envs.rollout.lineup import ROLES
from outlast.envs.rollout.saved import common_scenario, forms
from outlast.envs.scenarios.fingerprint import difference, fingerprint
from outlast.envs.storage.atomic_write import atomic_write

from ..arena.evaluation import Evaluation
from ..arena.match import Act, AgentIndices, Match, MatchResults, Pairing
from ..arena.players import Contender
from ..base.errors import TrainingError
from .tasks import TaskGame

Array = np.ndarray[Any, Any]
Asked = tuple[str, Act]  # a policy that is asked what it would choose, and its name in messages
DIGITS = 6  # significant digits of figures
# By how much cumulative probabilities may differ on another machine. Ten policies of this benchmark were computed in
# float32 and in float64, and with inputs that differ by a unit in the last place: by 7.5e-7 at most, in 240,000 rows.
ROUNDING = 2**-18
OTHER_TICK = "{}: tick {} is the first that is not as it is when the match is played again"


def digest(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def play(
    game: TaskGame,
    pair: Sequence[Contender],
    games: int,
    path: Path,
    progress: Callable[[int], None] = lambda ended: None,
) -> dict[str, Any]:
    """Play a match and record it.

    Args:
        game: What is played.
        pair: Two policies, or one that meets itself.
        games: How many games, each in a world of its own: an even number, so that both play each side equally often.
        path: The file of the recording, written whole or not at all.
        progress: Called with how many more games have ended.

    Returns:
        The outcome, see `outcome`, with "recording", the digest of the file.
    """
    with worlds(game, pair, games) as env, atomic_write(path) as place:
        with record(env, place):
            acts = [_act(game, role, policy, env) for role, policy in enumerate(pair)]
            found = Match(env, acts, 1, game.seed).play(progress)
        made = digest(place)
    return outcome(found) | {"recording": made}


def outcome(found: MatchResults) -> dict[str, Any]:
    """Turn a match into numbers for JSON.

    Returns:
        "games", "won", "drawn" and "lost" by the first policy; "figures": for each of the two its columns, see
        training.columns, as [mean, standard error], without those that could not be measured; the error of what was
        measured in one game only is 0.
    """
    pairing = Pairing((0, 1), found)
    won, drawn, lost = pairing.won_drawn_lost()
    every = [
        {
            name: [float(f"{each:.{DIGITS}g}") for each in (mean, np.nan_to_num(error))]
            for name, (mean, error) in own.items()
        }
        for own in map(pairing.estimates, range(ROLES))
    ]
    figures = [{name: pair for name, pair in each.items() if not np.isnan(pair).any()} for each in every]
    return {"games": won + drawn + lost, "won": won, "drawn": drawn, "lost": lost, "figures": figures}


@dataclass
class Repeated:
    """A match that was played again from its recording.

    Attributes:
        outcome: As `play` returned it, without the digest of the recording.
        differing: How many recorded actions are not what a saved policy chooses, but within rounding of it.
        drawn: How many actions saved policies chose.
        doubtful: Where the choices of saved policies may be rounded otherwise, int (n, 3 + actions): tick, world,
            agent, and the actions that this agent took.
    """

    outcome: dict[str, Any]
    differing: int
    drawn: int
    doubtful: Array


def repeat(game: TaskGame, pair: Sequence[Contender | None], games: int, path: Path) -> Repeated:
    """Play the recorded actions of a match in worlds that are made anew, and ask the policies what they would do.

    Args:
        game: What was played.
        pair: Two policies, or one that met itself; None: one that is not known here.
        games: How many games were played.
        path: The file of the recording.

    Returns:
        What the match comes to this time.

    Raises:
        RecordingError: It is no recording, or of another game, a tick is not what was recorded, or a policy did not
            choose an action in it.
    """
    recording = Recording.open(path)
    if recording.cut:
        raise RecordingError(recording.cut)
    if recording.num_worlds != games:
        raise RecordingError(f"{path} is of {recording.num_worlds} worlds: {games} games were to be played")
    known = [policy for policy in pair if policy is not None]
    own = common_scenario(game.scenario, [policy.player for policy in known if policy.player is not None])
    others = [difference(fingerprint(recording.scenario), fingerprint(each)) for each in [own, *forms(game.scenario)]]
    if all(others[: 1 if len(known) == len(pair) else None]):
        raise RecordingError(f"{path} is of another game {others[0]}")
    with (
        worlds(game, known, games, recording) as env,
        tempfile.TemporaryDirectory() as folder,
        contextlib.closing(recording.tick_records()) as ticks,
    ):
        again = Path(folder, "again.rec")
        every = [None if each is None else asked(game, k, each, env) for k, each in enumerate(pair)]
        script = _Script(path, ticks, env, every)
        with record(env, again):
            match = Match(env, script.acts(), 1, game.seed)
            script.number = lambda: match.records + 1
            found = match.play()
        _compare(path, recording, Recording.open(again))
    return Repeated(outcome(found), script.differing, script.drawn, script.doubtful())


class _Script:
    """Policies that choose recorded actions; those that are said to have played are asked what they would choose."""

    def __init__(
        self, path: Path, ticks: Iterable[TickRecord], env: SurvivalVectorEnv, asked: Sequence[Asked | None]
    ) -> None:
        self.path, self.asked = path, asked
        self.differing = self.drawn = 0  # see Repeated
        self.number: Callable[[], int] = lambda: 1  # which tick record the next step has
        self._joint, self._records = JointActions(env.worlds), enumerate(ticks)
        self._lows = np.array([low for _, low, _ in self._joint.columns])[:, None, None]  # environments count from 0
        self._at, self._actions = 0, np.zeros(0)
        self._doubtful = [np.zeros((0, 3 + len(self._lows)), np.int64)]

    def doubtful(self) -> Array:
        """See Repeated."""
        return np.concatenate(self._doubtful)

    def acts(self) -> list[Act]:
        """One function for each policy."""
        return [self._act(role) for role in range(len(self.asked))]

    def _act(self, role: int) -> Act:
        def act(seen: dict[str, Array], indices: AgentIndices) -> Array:
            actions: Array = self._now()[indices]
            if (asked := self.asked[role]) is not None:
                name, choose = asked
                choices = choose(seen, indices).reshape(len(actions), -1, actions.shape[1])
                self._check(name, actions, choices, indices)
            return actions

        return act

    def _check(self, name: str, actions: Array, choices: Array, indices: AgentIndices) -> None:
        """Count the actions that differ from the choices of a policy, (agents, 3, actions), see Player.doubted.

        Scripted styles do not round, and have a single choice, (agents, 1, actions).

        Raises RecordingError: an action is not within rounding of the choice.
        """
        first, choice, last = (choices[:, k] for k in (0, choices.shape[1] // 2, -1))
        self.differing += int((actions != choice).any(1).sum())
        self.drawn += len(actions) * (choices.shape[1] > 1)
        for k in np.flatnonzero(((actions < first) | (actions > last)).any(1))[:1]:
            check_within(name, actions[k], choices[k], self.number(), *(int(index[k]) for index in indices))
        doubted = np.flatnonzero((first != last).any(1))
        place = np.full(len(doubted), self.number()), indices[0][doubted], indices[1][doubted]
        self._doubtful.append(np.column_stack([*place, actions[doubted]]))

    def _now(self) -> Array:
        """The recorded actions of the next step, (worlds, agents, actions)."""
        wanted = self.number()
        while self._at < wanted:
            self._at, tick = next(self._records, (wanted, None))
            if tick is None or (self._at == wanted and (tick.mode != STEP).any()):
                raise RecordingError(f"{self.path}: tick {wanted} is no step of all worlds, as the match goes on then")
            if self._at == wanted:
                self._actions = np.moveaxis(self._joint.decode(tick.codes) - self._lows, 0, -1)
        return self._actions


def check_within(name: str, action: Array, choices: Array, tick: int, world: int, agent: int) -> None:
    """Check that an action is within rounding of a policy's choice: between the first and the last of `choices`.

    Args:
        name: The policy in messages.
        action: Integers (actions,).
        choices: Integers (3, actions), see Player.doubted; or (1, actions).
        tick: The number of the tick record; it is in messages, as are `world` and `agent`.
        world: The row of the world.
        agent: The number of the agent.

    Raises:
        RecordingError: It is not.
    """
    if (action < choices[0]).any() or (action > choices[-1]).any():
        place, choice = f"in world {world}, tick {tick}, agent {agent}", choices[len(choices) // 2]
        raise RecordingError(f"{name} did not play it: {place} it chooses {choice}, not {action}")


def _compare(path: Path, there: Recording, here: Recording) -> None:
    """Raise RecordingError where two recordings differ in a tick."""
    for number, (one, two) in enumerate(itertools.zip_longest(there.tick_records(), here.tick_records())):
        if one is None or two is None or not _same(one, two):
            raise RecordingError(OTHER_TICK.format(path, number))


def _same(one: TickRecord, two: TickRecord) -> bool:
    return all(np.array_equal(getattr(one, key), getattr(two, key)) for key in ("mode", "codes", "keys", "digest"))


@contextlib.contextmanager
def worlds(
    game: TaskGame, pair: Sequence[Contender], games: int, recording: Recording | None = None
) -> Iterator[SurvivalVectorEnv]:
    """The worlds of a match, which all policies can play in. recording: Of such worlds; it tells their cameras_mode."""
    if games % ROLES:
        raise TrainingError(f"games = {games}: an even number is needed, so that each policy plays each side as often")
    scenario = game.scenario if recording is None else recording.scenario
    evaluation = Evaluation(scenario, pair, episodes=games, worlds=games, seed=game.seed)
    try:
        if game.given:
            evaluation.env.set_numbers(game.numbers(games))
        yield evaluation.env
    finally:
        evaluation.close()


def asked(game: TaskGame, role: int, policy: Contender, env: SurvivalVectorEnv) -> Asked:
    """Return a policy that is asked what it would choose in a role, as `repeat` asks it."""
    return policy.text, _act(game, role, policy, env, ROUNDING)


def _act(game: TaskGame, role: int, policy: Contender, env: SurvivalVectorEnv, slack: float = 0.0) -> Act:
    """The function that plays a policy in a role; its random numbers depend on the game and the role only."""
    (seed,) = np.random.SeedSequence([game.seed, role]).generate_state(1, np.uint64) >> np.uint64(1)
    return policy.act(env, int(seed), keyed=True, slack=slack)
