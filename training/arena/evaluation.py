"""Cross-play: every policy against every other and itself, with standard errors, as tables; outlast.evaluate."""

import contextlib
import functools
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from outlast.envs.api.make import make_vec
from outlast.envs.core.agents import fewest_sides
from outlast.envs.core.options import check_options
from outlast.envs.progress import Progress
from outlast.envs.recording import record
from outlast.envs.rollout.lineup import ROLES
from outlast.envs.rollout.saved import common_scenario
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.scenarios.known_numbers import Numbers
from outlast.envs.scenarios.parse import checks_keywords, options_of, resolve
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.storage import strict_json
from outlast.envs.text_table import text_table

from ..base.config import EvaluationOptions
from ..base.errors import TrainingError
from ..base.files import check_out, check_results, read_text, write_files
from ..base.metrics import check_statistics
from ..base.tables import csv_text, with_error
from .films import films, recording_of
from .groups import Groups, group_policies, rate_groups
from .match import Estimates, Match, Pairing
from .players import Contender, Given, contenders
from .ratings import elo, linked

Array = np.ndarray[Any, Any]
RESULTS = ("wins", "wins_first", "wins_second", "length", "life", "return", "kills")  # and deaths by damage type
FILES = TABLES, FIGURES, RATINGS, GROUPS = "evaluation.json", "figures.csv", "ratings.csv", "groups.csv"
FIRST = ("policy", "against")
RATED, GROUPED = ("policy", "elo", "error"), ("group", "runs", "against", "figure", "value", "low", "high")
CERTAIN = 3.0  # a difference between the sides is reported from this many standard errors on
OVER_GAMES = "std. errors (±) are over games of these policies, and do not cover other training seeds"
OVER_SEEDS = "95 % intervals over training seeds and games, by bootstrap"
UNBOUNDED = "; inf: no game bounds the rating on that side"


class Evaluation:
    """Cross-play in `worlds` worlds at once.

    Each pairing plays at least `episodes`, rounded up so that all worlds play the same number and each policy plays
    each side equally often. The numbers of a pairing are a function of the seed and of the positions of its policies
    in the list, and do not depend on threads. `str(evaluation)` has all tables.

    Attributes:
        scenario: The game, with observations that fit all policies.
        chosen: The policies.
        pairings: The pairings that are complete.
        each: Episodes of a pairing that each world plays.

    Raises ScenarioError if the scenario cannot be played, and TrainingError if a policy cannot play there or all
    agents are on one side.
    """

    def __init__(
        self,
        scenario: Scenario,
        chosen: Sequence[Contender],
        *,
        episodes: int = 200,
        worlds: int = 64,
        seed: int = 0,
        threads: int = 1,
    ) -> None:
        check_options(EvaluationOptions, locals())
        players = [contender.player for contender in chosen if contender.player is not None]
        self.scenario, self.chosen, self.seed = common_scenario(scenario, players), list(chosen), seed
        self.worlds, self.each = worlds, -(-episodes // worlds)
        self.each += self.each * worlds % ROLES  # otherwise one assignment of sides is played more often
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
        """Return the number of episodes of each pairing."""
        return self.each * self.worlds

    @property
    def complete(self) -> bool:
        """Return whether all pairings have been played."""
        return len(self.pairings) == len(self.pairs)

    def play_pair(self, pair: tuple[int, int], progress: Callable[[int], None] = lambda episodes: None) -> Pairing:
        """Play a pairing, and store it in `pairings` once it is complete. progress: see Match.play."""
        words = np.random.SeedSequence([self.seed, *pair]).generate_state(1 + ROLES, np.uint64) >> np.uint64(1)
        world, *seeds = (int(word) for word in words)
        players = dict.fromkeys(pair)  # a single one in a game against itself
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
        """Rate groups of runs that differ by their seeds only, with intervals over seeds and games.

        None if no such group has several runs, if there is only one group, or until all pairings are complete. Raises
        TrainingError if two of the policies are the same run, or runs of one seed.
        """
        return self._groups if self.complete else None

    @functools.cached_property
    def _groups(self) -> Groups | None:
        grouped = group_policies(self.chosen)
        several = len(self.chosen) > len(grouped) > 1
        return rate_groups(grouped, *self._games(), self.seed) if several else None

    def estimates(self, policy: str, against: str, side: int | None = None) -> Estimates:
        """Return mean and standard error of each column, for a policy against another one or itself, by their labels.

        side: Only from episodes in which `policy` plays that side; None: from all episodes.

        Raises TrainingError if the pairing is unknown or not complete.
        """
        names = [contender.label for contender in self.chosen]
        for pairing in self.pairings:
            pair = tuple(names[k] for k in pairing.pair)
            if policy in pair and against in pair and {policy, against} == set(pair):
                return pairing.estimates(pair.index(policy), side)
        raise TrainingError(f"{policy} against {against} is not complete; the policies are {', '.join(names)}")

    def __str__(self) -> str:
        return text(self)

    def close(self) -> None:
        """Close the worlds."""
        self.env.close()

    def _games(self) -> tuple[Array, Array]:
        """Count the games that each policy won against each other, and draws, both (policies, policies)."""
        wins, draws = np.zeros((2, len(self.chosen), len(self.chosen)))
        for pairing in self.pairings:
            i, j = pairing.pair
            if i != j:
                wins[i, j], draws[i, j], wins[j, i] = pairing.won_drawn_lost()
                draws[j, i] = draws[i, j]
        return wins, draws

    def _check(self) -> None:
        self.env.reset()
        check_statistics(self.env, "length", "return")
        if fewest_sides(self.env.worlds) < ROLES:
            raise TrainingError(f"{self.scenario.name} has one side only: take a game with two or more")
        for contender in self.chosen:
            contender.check(self.env)


@checks_keywords
def evaluate(
    scenario: str | Scenario,
    policies: Given | Sequence[Given] | Mapping[str, Given],
    *,
    episodes: int = 200,
    worlds: int = 64,
    seed: int = 0,
    threads: int = 1,
    out: str | Path | None = None,
    film: bool = False,
    quiet: bool = False,
    **numbers: Unpack[Numbers],
) -> Evaluation:
    """Let policies play against each other, and themselves; `outlast evaluate` does the same.

    >>> print(outlast.evaluate("ffa_2", ["runs/duel", "scripted"], episodes=200))

    Args:
        scenario: A Scenario or the name of one: "ffa_2", "mygame.py:arena".
        policies: Names, such as "scripted"; paths of checkpoints; folders with one or more runs, for the newest
            checkpoint of each run; functions (observations) -> actions for all agents of all worlds. Optionally a dict
            of these by label.
        episodes: Episodes of each pairing, rounded up so that all worlds play the same number.
        worlds: Worlds that play at once.
        seed: The same seed gives the same numbers.
        threads: Threads that share the worlds, with the same results.
        out: Write the tables to this folder, as CSV and JSON, after each pairing.
        film: Whether to write a film and a page of a typical episode of each pairing beside the tables, too.
        quiet: Whether to show no progress bar.
        **numbers: Numbers of the scenario to change, as in melee_damage=20.

    Returns:
        The evaluation. `print` shows its tables; `estimates(policy, against)` returns means and standard errors of each
        column, and `ratings()` the Elo ratings; these errors are over games. `groups()` returns ratings of groups of
        runs that differ only by seeds, with intervals over seeds and games. Its worlds are closed.

    Raises:
        ScenarioError: The scenario is unknown.
        NumberError: The scenario lacks a number (perhaps one of the arguments was meant).
        TrainingError: A policy does not exist or cannot play there, or `out` cannot be written or holds another
            evaluation.
        ValueError: `episodes`, `worlds`, `seed` or `threads` is not an integer in its range.
        ActionError: A function returned invalid actions.
    """
    game = resolve(scenario, numbers, options_of(evaluate))
    options = {"episodes": episodes, "worlds": worlds, "seed": seed, "threads": threads}
    with opened(game, policies, out, film, **options) as (evaluation, folder, hidden):
        play(evaluation, folder, hidden, quiet=quiet)
        if hidden is not None and folder is not None:
            list(films(evaluation.scenario, evaluation.chosen, evaluation.pairings, hidden, folder))
    return evaluation


@contextlib.contextmanager
def opened(
    game: Scenario, policies: Any, out: str | Path | None, film: bool, **options: int
) -> Iterator[tuple[Evaluation, Path | None, Path | None]]:
    """Open an evaluation, see `evaluate`. Checks first that its tables can be written.

    Yields it, the folder for its tables, and a temporary folder for the recordings from which films are made.
    """
    if film and out is None:
        raise TrainingError("films need a folder: name one as out (--out FOLDER)")
    folder = None if out is None else check_out(out)
    with contextlib.ExitStack() as stack:
        evaluation = stack.enter_context(contextlib.closing(Evaluation(game, contenders(policies), **options)))
        if folder is not None:
            check_folder(evaluation, folder)
        yield evaluation, folder, Path(stack.enter_context(tempfile.TemporaryDirectory())) if film else None


def play(evaluation: Evaluation, folder: Path | None, hidden: Path | None, *, quiet: bool) -> None:
    """Play every pairing. With a folder for tables, write those of the complete pairings after each one."""
    pairs, each = len(evaluation.pairs), evaluation.episodes
    about = f"{pairs} pairings of {each:,} episodes; fewer (--episodes) take less time" if pairs > 1 else ""
    with Progress(pairs * each, "episodes", quiet=quiet, about=about) as progress:
        for pair in evaluation.pairs:
            with record(evaluation.env, recording_of(hidden, pair)) if hidden else contextlib.nullcontext():
                evaluation.play_pair(pair, progress.add)
            if folder is not None:
                write_tables(evaluation, folder)


def text(evaluation: Evaluation, width: int | None = None, most: int | None = None) -> str:
    """Return all tables under a heading; the tables cover the complete pairings.

    width: characters in a line of a table, see envs.text_table. most: policies up to which columns are shown.
    """
    if not evaluation.pairings:
        return "none of the pairings is complete"
    parts = [_heading(evaluation), _ratings(evaluation), _wins(evaluation, width), _sides(evaluation)]
    parts += _groups(evaluation, width)
    if most is not None and len(evaluation.chosen) > most:
        return "\n\n".join(filter(None, parts))
    names = list(evaluation.pairings[0].results.figures)
    results = [name for name in RESULTS if name in names] + [name for name in names if name.startswith("deaths_")]
    others = [name for name in names if name not in results]
    parts += [_figures(evaluation, some, width) for some in (results, others)]
    return "\n\n".join(filter(None, parts))


def _heading(evaluation: Evaluation) -> str:
    """Return the heading: the games played, and the files of policies whose labels do not name them."""
    name, each, worlds = evaluation.scenario.name, evaluation.each, evaluation.worlds
    played = f"{len(evaluation.pairings)} pairings of {evaluation.episodes:,} episodes"
    lines = [f"{name}, seed {evaluation.seed}: {played}, {each} in each of {worlds} worlds"]
    lines += [f"{chosen.label}: {chosen.text}" for chosen in evaluation.chosen if chosen.text != chosen.label]
    lines += [OVER_GAMES]
    return "\n".join(lines)


def write_tables(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write evaluation.json with everything; figures.csv, ratings.csv and groups.csv with the numbers.

    Raises TrainingError.
    """
    figures = [(*names, name, *row) for names, rows in _rows(evaluation) for name, row in rows.items()]
    everything = {
        **_played(evaluation),
        **{name: getattr(evaluation, name) for name in ("seed", "worlds", "episodes", "complete")},
        "ratings": [dict(zip(RATED, row, strict=True)) for row in _rated(evaluation)],
        "groups": [dict(zip(GROUPED, row, strict=True)) for row in _group_rows(evaluation)],
        "pairings": [_pairing(evaluation, pairing) for pairing in evaluation.pairings],
    }
    contents = {
        TABLES: json.dumps(_json(everything), indent=1, allow_nan=False) + "\n",
        FIGURES: csv_text((*FIRST, "figure", "mean", "error"), figures),
        RATINGS: csv_text(RATED, _rated(evaluation)),
        GROUPS: csv_text(GROUPED, _group_rows(evaluation)),
    }
    write_files({folder / name: content.encode() for name, content in contents.items()})
    return [folder / name for name in contents]


def check_folder(evaluation: Evaluation, folder: Path) -> None:
    """Raise TrainingError if tables cannot be written, or would replace those of another evaluation.

    An evaluation of another game or of other policies is another one.
    """
    check_results(folder / name for name in FILES)
    path, now = folder / TABLES, _json(_played(evaluation))
    if not path.exists():
        return
    cure = "choose another folder with --out, or remove its content"
    try:
        found = json.loads(read_text(path))
        there = {key: found[key] for key in now}
        who = ", ".join(policy["policy"] for policy in there["policies"])
        about = f"{there['scenario']['name']} with {who}"
    except (*strict_json.BROKEN, LookupError):
        raise TrainingError(f"{path} is not an evaluation, and would be replaced: {cure}") from None
    if there != now:
        raise TrainingError(f"{folder} holds another evaluation, of {about}: {cure}")


def _ratings(evaluation: Evaluation) -> str:
    rows = sorted(_rated(evaluation), key=lambda row: -row[1])
    cells = [(label, f"{rating:.0f}", f"{error:.0f}") for label, rating, error in rows]
    return text_table(cells, ("Elo (mean 1000)", "rating", "std. error"), left=1) if cells else ""


def _wins(evaluation: Evaluation, width: int | None) -> str:
    """Return shares of episodes that each policy wins against each other; draws count half."""
    labels = [contender.label for contender in evaluation.chosen]
    rates = {names: figures["wins"] for names, figures in _rows(evaluation)}
    rows = [(one, *(with_error(*rates.get((one, other), (np.nan, 0))) for other in labels)) for one in labels]
    return text_table(rows, ("wins of, against", *labels), left=1, width=width)


def _sides(evaluation: Evaluation) -> str:
    """Describe the pairing whose share of wins depends most on the side played; "" if none does."""
    found = {}
    for pair, figures in _rows(evaluation):
        (first, one), (second, other) = figures["wins_first"], figures["wins_second"]
        error = np.hypot(one, other) + 2 / evaluation.episodes  # not 0 where all of a few games were won
        if abs(first - second) > CERTAIN * error:
            found[pair] = abs(first - second), with_error(first, one), with_error(second, other)
    if not found:
        return ""
    most = max(found, key=lambda pair: found[pair][0])
    wins = "{} against {} wins {} on the first side, {} on the second".format(*most, *found[most][1:])
    many = len({frozenset(pair) for pair in found})
    return f"the side matters in {many} of {len(evaluation.pairings)} pairings, see wins_first and wins_second: {wins}"


def _groups(evaluation: Evaluation, width: int | None) -> Iterator[str]:
    """Yield tables of groups of runs, and a line on the policies whose errors do not cover other seeds."""
    try:
        groups, found = group_policies(evaluation.chosen), evaluation.groups()
    except TrainingError as error:
        yield f"no groups of training seeds: {error}"
        return
    if found is not None:
        yield from _group_tables(evaluation, found, width)
    if alone := [group.label for group in groups if group.trained and len(group.members) == 1]:
        one, each = "one run: its error is over games, and does", "one run each: errors are over games, and do"
        yield f"{', '.join(alone)}: {one if len(alone) == 1 else each} not cover other seeds"


def _group_tables(evaluation: Evaluation, found: Groups, width: int | None) -> Iterator[str]:
    """Yield the ratings of groups, and their shares of games won."""
    names = [group.label for group in found.groups]
    ends = {(name, against): (runs, *three) for name, runs, against, _, *three in _group_rows(evaluation)}
    rows = [
        (name, str(runs or "-"), f"{elo:.0f}", f"[{low:.0f}, {high:.0f}]")
        for name, (runs, elo, low, high) in ((name, ends[name, ""]) for name in names)
    ]
    several = [group for group in found.groups if len(group.members) > 1]
    who = [f"{group.label}: {', '.join(evaluation.chosen[k].label for k in group.members)}" for group in several]
    table = text_table(rows, ("Elo of groups (mean 1000)", "runs", "rating", "95 % interval"), left=1)
    yield "\n".join([table, *who, OVER_SEEDS + ("" if np.isfinite(found.ratings).all() else UNBOUNDED)])
    wins = {names: "{1:.3f} [{2:.3f}, {3:.3f}]".format(*own) for names, own in ends.items()}
    shares = [(one, *("-" if one == other else wins[one, other] for other in names)) for one in names]
    yield text_table(shares, ("wins of group, against", *names), left=1, width=width)


def _group_rows(evaluation: Evaluation) -> list[tuple[Any, ...]]:
    """Return the rows of groups.csv; none without a table of groups."""
    try:
        found = evaluation.groups()
    except TrainingError:
        found = None  # the report gives the reason
    if found is None:
        return []
    rows: list[tuple[Any, ...]] = []
    for g, group in enumerate(found.groups):
        first = (group.label, len(group.members) if group.trained else 0)
        rows.append((*first, "", "elo", *(float(ends[g]) for ends in found.ratings)))
        rows += [
            (*first, other.label, "wins", *(float(ends[g, h]) for ends in found.wins))
            for h, other in enumerate(found.groups)
            if g != h
        ]
    return rows


def _figures(evaluation: Evaluation, names: Sequence[str], width: int | None) -> str:
    known = [name for name in names if name in evaluation.pairings[0].results.figures]
    rows = [(*pair, *(with_error(*figures[name]) for name in known)) for pair, figures in _rows(evaluation)]
    return text_table(rows, (*FIRST, *known), left=len(FIRST), width=width)


def _rated(evaluation: Evaluation) -> list[tuple[str, float, float]]:
    """Return label, rating and its error of each policy; empty until games join all policies."""
    found = evaluation.ratings()
    labels = [contender.label for contender in evaluation.chosen]
    return [] if found is None else [(label, float(r), float(e)) for label, r, e in zip(labels, *found, strict=True)]


def _rows(evaluation: Evaluation) -> list[tuple[tuple[str, str], Estimates]]:
    """Return the estimates by the labels of a policy and its opponent, in their order; against itself once."""
    labels, found = [contender.label for contender in evaluation.chosen], dict[tuple[int, ...], Estimates]()
    for pairing in evaluation.pairings:
        found |= {pairing.pair[:: 1 - 2 * role]: pairing.estimates(role) for role in (1, 0)}
    return [((labels[i], labels[j]), figures) for (i, j), figures in sorted(found.items(), key=lambda entry: entry[0])]


def _played(evaluation: Evaluation) -> dict[str, Any]:
    """Return the description that distinguishes evaluations."""
    policies = [{"label": chosen.label, "policy": chosen.text} for chosen in evaluation.chosen]
    return {"scenario": fingerprint(evaluation.scenario), "policies": policies}


def _pairing(evaluation: Evaluation, pairing: Pairing) -> dict[str, Any]:
    names = [evaluation.chosen[k].label for k in pairing.pair]
    figures = [{name: {"mean": m, "error": e} for name, (m, e) in pairing.estimates(role).items()} for role in (0, 1)]
    return {"policies": names, "won, drawn, lost": pairing.won_drawn_lost(), "figures": figures}


def _json(value: Any) -> Any:
    """Return the value for JSON, with None in place of NaN and infinity."""
    return json.loads(json.dumps(value), parse_constant=lambda name: None)
