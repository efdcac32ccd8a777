"""Matches of the benchmark, played and recorded."""

import contextlib
import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.recording import Recording, record
from outlast.envs.rollout.lineup import ROLES
from outlast.envs.storage.atomic_write import atomic_write

from ..arena.evaluation import Evaluation
from ..arena.match import Act, Match, MatchResults, Pairing
from ..arena.players import Contender
from ..base.errors import TrainingError
from .tasks import TaskGame

Array = np.ndarray[Any, Any]
Asked = tuple[str, Act]  # the name of a policy in messages, and its function
DIGITS = 6  # significant digits of figures
# Possible difference of cumulative probabilities between machines. Ten policies of this benchmark were computed in
# float32 and in float64, and with inputs that differ by a unit in the last place: at most 7.5e-7, in 240,000 rows.
ROUNDING = 2**-18


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
    """Play a match and record it. Return the outcome, see `outcome`, with "recording", the digest of the file.

    pair: Two policies, or one that meets itself. games: Number of games, each in its own world: must be even, so that
    both play each side equally often. path: File of the recording, written completely or not at all.
    progress: Called with the number of further games that have ended.
    """
    with worlds(game, pair, games) as env, atomic_write(path) as place:
        with record(env, place):
            acts = [_act(game, role, policy, env) for role, policy in enumerate(pair)]
            found = Match(env, acts, 1, game.seed).play(progress)
        made = digest(place)
    return outcome(found) | {"recording": made}


def outcome(found: MatchResults) -> dict[str, Any]:
    """Turn a match into numbers for JSON.

    Returns "games", "won", "drawn" and "lost" by the first policy; "figures": for each of the two its columns, see
    base.quantities, as [mean, standard error], without those that could not be measured; the error of a
    figure that was measured in one game only is 0.
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


@contextlib.contextmanager
def worlds(
    game: TaskGame, pair: Sequence[Contender], games: int, recording: Recording | None = None
) -> Iterator[SurvivalVectorEnv]:
    """Yield the worlds of a match, with observations that fit all policies.

    recording: A recording of such worlds; gives their cameras_mode.
    """
    if games % ROLES:
        raise TrainingError(f"games = {games}: must be even, so that each policy plays each side equally often")
    scenario = game.scenario if recording is None else recording.scenario
    evaluation = Evaluation(scenario, pair, episodes=games, worlds=games, seed=game.seed)
    try:
        if game.given:
            evaluation.env.set_numbers(game.numbers(games))
        yield evaluation.env
    finally:
        evaluation.close()


def asked(game: TaskGame, role: int, policy: Contender, env: SurvivalVectorEnv) -> Asked:
    """Return the name of a policy and its function in a role, for `repeat`."""
    return policy.text, _act(game, role, policy, env, ROUNDING)


def _act(game: TaskGame, role: int, policy: Contender, env: SurvivalVectorEnv, slack: float = 0.0) -> Act:
    """Return the function that plays a policy in a role. Its random numbers depend on the game and the role only."""
    (seed,) = np.random.SeedSequence([game.seed, role]).generate_state(1, np.uint64) >> np.uint64(1)
    return policy.act(env, int(seed), keyed=True, slack=slack)
