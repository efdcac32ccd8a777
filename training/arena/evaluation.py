"""Cross-play: every policy against every other and itself, with standard errors; outlast.evaluate."""

import contextlib
import functools
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.core.agents import fewest_sides
from outlast.envs.core.make import make_vec
from outlast.envs.core.validation import check_count
from outlast.envs.films import Looks, write_film_of
from outlast.envs.progress import Progress
from outlast.envs.recording import Recording, Replay, record
from outlast.envs.rendering.layers.title import fits
from outlast.envs.rollout.lineup import ROLES, role_of
from outlast.envs.rollout.saved import common_scenario
from outlast.envs.scenarios.naming import checks_keywords, options_of, resolve
from outlast.envs.scenarios.scenario import Number, Scenario

from ..base.errors import TrainingError
from ..base.files import check_out
from ..base.metrics import check_statistics
from . import report
from .groups import Groups, group_policies, rate_groups
from .match import Estimates, Match, MatchResults, Pairing
from .players import Contender, Given, contenders
from .ratings import elo, linked

Array = np.ndarray[Any, Any]
LEAST = 8  # characters of a name that the title of a film keeps, at least
SIZE, FPS = 512, 30  # pixels; frames a second, which is real time in the paper's variants


class Evaluation:
    """Cross-play in `worlds` worlds at once.

    Each pairing plays `episodes`, or a few more: every world plays equally many, and each policy plays each side
    equally often. A pairing's numbers are a function of the seed and of the places of its two policies in the list;
    threads make no difference. `str(evaluation)` has all tables.

    Attributes:
        scenario: What is played, with observations that all policies can play with.
        chosen: The policies.
        pairings: The pairings that are complete.
        each: Episodes of a pairing that each world plays.
        worlds: How many worlds there are.
        seed: The seed of the evaluation.

    Raises:
        ScenarioError: The scenario cannot be played.
        TrainingError: A policy cannot play there, or there is no side to play against.
    """

    def __init__(
        self,
        scenario: Scenario,
        chosen: Sequence[Contender],
        *,
        episodes: int = 1000,
        worlds: int = 64,
        seed: int = 0,
        threads: int = 1,
    ) -> None:
        check_count("episodes", episodes, 1)
        check_count("worlds", worlds, 1)
        players = [contender.player for contender in chosen if contender.player is not None]
        self.scenario, self.chosen, self.seed = common_scenario(scenario, players), list(chosen), seed
        self.worlds, self.each = worlds, -(-episodes // worlds)
        self.each += self.each * worlds % ROLES  # else one assignment of sides would be played more often
        options: dict[str, Any] = {"autoreset_mode": "Disabled", "copy": False, "check_actions": False}
        self.env = make_vec(self.scenario, worlds, seed=seed, threads=threads, **options)
        try:
            self._check()
        except BaseException:
            self.close()
            raise
        self.pairings: list[Pairing] = []

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """All pairings, in the order in which they are played, including each policy with itself."""
        return [(i, j) for j in range(len(self.chosen)) for i in range(j + 1)]

    @property
    def episodes(self) -> int:
        """How many episodes each pairing plays."""
        return self.each * self.worlds

    @property
    def complete(self) -> bool:
        """Whether all pairings have been played."""
        return len(self.pairings) == len(self.pairs)

    def play_pair(self, pair: tuple[int, int], progress: Callable[[int], None] = lambda episodes: None) -> Pairing:
        """Play a pairing, and store it in `pairings` once it is complete. progress: see Match.play."""
        words = np.random.SeedSequence([self.seed, *pair]).generate_state(1 + ROLES, np.uint64) >> np.uint64(1)
        world, *seeds = (int(word) for word in words)
        players = dict.fromkeys(pair)  # one, if it meets itself
        acts = [self.chosen[k].act(self.env, own) for k, own in zip(players, seeds, strict=False)]
        self.pairings.append(Pairing(pair, Match(self.env, acts, self.each, world).play(progress)))
        return self.pairings[-1]

    def play(self, progress: Callable[[int], None] = lambda episodes: None) -> list[Pairing]:
        """Play all pairings, one after the other."""
        return [self.play_pair(pair, progress) for pair in self.pairs]

    def ratings(self) -> tuple[Array, Array] | None:
        """Return Elo ratings and standard errors, see ratings.elo; None until a chain of games links all policies."""
        wins, draws = self._games()
        return elo(wins, draws) if len(self.chosen) > 1 and linked(wins + wins.T + draws) else None

    def groups(self) -> Groups | None:
        """Ratings and wins of groups of runs that differ by their seeds only, with intervals over seeds and games.

        None if no such group has several runs or there is only one group, and until all pairings are complete.

        Raises:
            TrainingError: Two of the policies are the same run, or runs of one seed.
        """
        return self._groups if self.complete else None

    @functools.cached_property
    def _groups(self) -> Groups | None:
        grouped = group_policies(self.chosen)
        several = len(self.chosen) > len(grouped) > 1
        return rate_groups(grouped, *self._games(), self.seed) if several else None

    def estimates(self, policy: str, against: str) -> Estimates:
        """Mean and standard error of each column, for a policy against another one: see training.columns.

        Args:
            policy: The label of the policy.
            against: The label of the other one, or the same label.

        Raises:
            TrainingError: There is no such pairing, or it is not complete.
        """
        names = [contender.label for contender in self.chosen]
        for pairing in self.pairings:
            pair = tuple(names[k] for k in pairing.pair)
            if policy in pair and against in pair and {policy, against} == set(pair):
                return pairing.estimates(pair.index(policy))
        raise TrainingError(f"{policy} against {against} is not complete; the policies are {', '.join(names)}")

    def __str__(self) -> str:
        return report.text(self)

    def close(self) -> None:
        """Close the worlds."""
        self.env.close()

    def _games(self) -> tuple[Array, Array]:
        """Games that each policy won against each other, and draws, (policies, policies) both; 0 against itself."""
        wins, draws = np.zeros((2, len(self.chosen), len(self.chosen)))
        for pairing in self.pairings:
            i, j = pairing.pair
            if i != j:
                wins[i, j], draws[i, j], wins[j, i] = pairing.won_drawn_lost()
                draws[j, i] = draws[i, j]
        return wins, draws

    def _check(self) -> None:
        self.env.reset()
        check_statistics(self.env, "length", "return", "kills")
        if fewest_sides(self.env.worlds) < ROLES:
            raise TrainingError(f"{self.scenario.name} has worlds of one side: there is no opponent to play against")
        for contender in self.chosen:
            contender.check(self.env)


@checks_keywords
def evaluate(
    scenario: str | Scenario,
    policies: Given | Sequence[Given] | Mapping[str, Given],
    *,
    episodes: int = 1000,
    worlds: int = 64,
    seed: int = 0,
    threads: int = 1,
    out: str | Path | None = None,
    film: bool = False,
    quiet: bool = False,
    **numbers: Number,
) -> Evaluation:
    """Let policies play against each other, and themselves; `outlast evaluate` does the same.

    >>> print(outlast.evaluate("ffa_2", ["runs/duel", "scripted"], episodes=200))

    Args:
        scenario: A Scenario or the name of one: "ffa_2", "mygame.py:arena".
        policies: Names, such as "scripted"; paths of checkpoints; folders with one or more runs, for the newest
            checkpoint of each run; functions (observations) -> actions for all agents of all worlds. Optionally a dict
            of these by label.
        episodes: How many episodes each pairing plays, at least.
        worlds: Worlds at once; all play the same number of episodes.
        seed: The same seed gives the same numbers.
        threads: How many threads share the worlds; the numbers stay the same.
        out: Folder for the tables as CSV and JSON, which are updated after each pairing.
        film: Whether to make a film and a page of a typical episode of each pairing in `out`.
        quiet: Whether to show no progress bar.
        **numbers: Numbers of the scenario to change, as in melee_damage=20.

    Returns:
        The evaluation. `print` shows its tables; `estimates(policy, against)` returns means and standard errors of each
        column, and `ratings()` the Elo ratings; these errors are over games. `groups()` returns ratings of groups of
        runs that differ only by seeds, with intervals over seeds and games. Its worlds are closed.

    Raises:
        ScenarioError: There is no such scenario.
        NumberError: The scenario has no such number (perhaps one of the arguments was meant).
        TrainingError: There is no such policy, it cannot play there, or `out` cannot be written or holds another
            evaluation.
        ValueError: `episodes` or `worlds` is not an integer of at least 1.
        ActionError: A function returned actions that are not valid.
    """
    game = resolve(scenario, numbers, options_of(evaluate))
    folder = checked_folder(out, film)
    evaluation = Evaluation(game, contenders(policies), episodes=episodes, worlds=worlds, seed=seed, threads=threads)
    with contextlib.closing(evaluation), recordings(film) as hidden:
        if folder is not None:
            report.check_folder(evaluation, folder)
        play(evaluation, folder, hidden, quiet=quiet)
        if hidden is not None and folder is not None:
            list(films(evaluation, hidden, folder))
    return evaluation


def checked_folder(out: str | Path | None, film: bool) -> Path | None:
    """Return the folder, if tables can be written into it, so that no evaluation is lost for want of it."""
    if out is None:
        if film:
            raise TrainingError("films need a folder: name one as out (--out FOLDER)")
        return None
    return check_out(out)


@contextlib.contextmanager
def recordings(film: bool) -> Iterator[Path | None]:
    """Open a temporary folder for the recordings that films are made from; None if there are to be no films."""
    if not film:
        yield None
        return
    with tempfile.TemporaryDirectory() as hidden:
        yield Path(hidden)


def play(evaluation: Evaluation, folder: Path | None, hidden: Path | None, *, quiet: bool) -> None:
    """Play every pairing. If there is a folder for tables, those of what is complete are always in it."""
    pairs, each = len(evaluation.pairs), evaluation.episodes
    about = f"{pairs} pairings of {each:,} episodes; fewer (--episodes) take less time" if pairs > 1 else ""
    with Progress(pairs * each, "episodes", quiet=quiet, about=about) as progress:
        for pair in evaluation.pairs:
            with record(evaluation.env, _recording(hidden, pair)) if hidden else contextlib.nullcontext():
                evaluation.play_pair(pair, progress.add)
            if folder is not None:
                report.write_tables(evaluation, folder)


def films(evaluation: Evaluation, hidden: Path, folder: Path) -> Iterator[Path]:
    """Make a film and a page of a typical episode of each pairing, and yield the path of each once it is written."""
    for pairing in evaluation.pairings:
        yield from show_pairing(evaluation, pairing, _recording(hidden, pairing.pair), folder)


def _recording(folder: Path, pair: tuple[int, int]) -> Path:
    return folder / f"{pair[0]}-{pair[1]}.rec"


def show_pairing(evaluation: Evaluation, pairing: Pairing, recording: Path, folder: Path) -> list[Path]:
    """Write the typical episode of a pairing into the folder: A-B.webm and A-B.html, each whole or not at all.

    recording: The file in which all its episodes are recorded. Raises RecordingError, FilmError, PageError.
    """
    names, results = [evaluation.chosen[k].label for k in pairing.pair], pairing.results
    sides, game = _sides(evaluation.env.worlds.dims["sides"], results), evaluation.scenario.name
    shown, target = f"{film_players(names, sides)}, {game}", folder / "-".join(names)
    from outlast.envs.web.replay import write_page

    world, episode = results.typical()
    first, last = (int(record) for record in results.spans[world, episode])
    made = [target.with_name(target.name + ending) for ending in (".webm", ".html")]
    ticks = functools.partial(Replay.ticks, first=first, last=last, worlds=[world])
    with contextlib.closing(Replay(Recording.open(recording, evaluation.scenario))) as replay:
        write_film_of(made[0], replay.worlds, ticks(replay), [world], Looks(size=SIZE, fps=FPS), shown)
    with contextlib.closing(Replay(Recording.open(recording, evaluation.scenario))) as replay:
        write_page(made[1], replay.worlds, ticks(replay), [world], title=f"{game}: {_players(names, sides)}")
    return made


def film_players(names: Sequence[str], sides: Sequence[str]) -> str:
    """Return who plays which sides, with names shortened in the middle until a film's title has room for both."""
    for most in range(max(LEAST, *map(len, names)), LEAST - 1, -1):
        words = _players([_shortened(name, most) for name in names], sides)
        if fits(words, SIZE):
            break
    return words


def _players(names: Sequence[str], sides: Sequence[str]) -> str:
    return " against ".join(f"{name} ({own})" for name, own in zip(names, sides, strict=True))


def _shortened(name: str, most: int) -> str:
    return name if len(name) <= most else f"{name[: most // 2 - 1]}..{name[most // 2 - most + 1 :]}"


def _sides(count: int, results: MatchResults) -> list[str]:
    """The sides that each role plays in the typical episode: "side 0", "sides 0 2"."""
    own = [[side for side in range(count) if role_of(side, *results.typical()) == role] for role in range(ROLES)]
    return [f"side{'s' * (len(each) > 1)} {' '.join(map(str, each))}" for each in own]
