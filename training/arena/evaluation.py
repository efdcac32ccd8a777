"""Cross-play: every policy against every other and itself, with standard errors, as tables; outlast.evaluate."""

import contextlib
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from outlast.envs.api.film import Looks, write_film_of
from outlast.envs.api.make import make_vec
from outlast.envs.api.options import check_options
from outlast.envs.core.spaces import fewest_sides
from outlast.envs.progress import Progress
from outlast.envs.recording import Recording, Replay, record
from outlast.envs.rendering.words import fits
from outlast.envs.rollout.lineup import ROLES, role_of
from outlast.envs.rollout.saved import common_scenario
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.scenarios.known_numbers import Numbers
from outlast.envs.scenarios.parse import checks_keywords, options_of, resolve
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.storage import inputs
from outlast.envs.text_table import text_table

from ..base.config import EvaluationOptions
from ..base.errors import TrainingError
from ..base.files import check_out, check_results, read_text, write_files
from ..base.metrics import check_statistics
from ..base.quantities import csv_text, with_error
from .match import Estimates, Match, Pairing
from .players import Contender, Given, contenders
from .ratings import Groups, elo, group_policies, linked, rate_groups

Array = np.ndarray[Any, Any]
RESULTS = ("wins", "wins_first", "wins_second", "length", "life", "return", "kills")  # and deaths by damage type
FILES = TABLES, FIGURES, RATINGS, GROUPS = "evaluation.json", "figures.csv", "ratings.csv", "groups.csv"
FIRST = ("policy", "against")
RATED, GROUPED = ("policy", "elo", "error"), ("group", "runs", "against", "figure", "value", "low", "high")
CERTAIN = 3.0  # a difference between the sides is reported from this many standard errors on
OVER_GAMES = "std. errors (±) are over games of these policies, and do not cover other training seeds"
OVER_SEEDS = "95 % intervals over training seeds and games, by bootstrap"
UNBOUNDED = "; inf: no game bounds the rating on that side"
LEAST = 8  # minimum characters of a name in the title of a film
SIZE, FPS = 512, 30  # pixels; frames a second: real time in the paper's variants


class Evaluation:
    """Cross-play in `worlds` worlds at once.

    Each pairing plays at least `episodes`, rounded up so that all worlds play the same number and each policy plays
    each side equally often. The numbers of a pairing are a function of the seed and of the positions of its policies
    in the list, and do not depend on threads. `str(evaluation)` has all tables.

    scenario: The game, with observations that fit all policies. chosen: The policies. pairs: All pairings, in the order
    in which they are played, including each policy with itself. pairings: The pairings that are complete. each:
    Episodes of a pairing that each world plays. episodes: Those of all worlds.

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
        self.episodes = self.each * worlds
        self.pairs = [(i, j) for j in range(len(self.chosen)) for i in range(j + 1)]
        options: dict[str, Any] = {"autoreset_mode": "Disabled", "copy": False, "check_actions": False}
        self.env = make_vec(self.scenario, worlds, seed=seed, threads=threads, **options)
        self.pairings: list[Pairing] = []
        self._groups: Groups | None = None
        try:
            self.env.reset()
            check_statistics(self.env, "length", "return")
            if fewest_sides(self.env.worlds) < ROLES:
                raise TrainingError(f"{self.scenario.name} has one side only: take a game with two or more")
            for contender in self.chosen:
                contender.check(self.env)
        except BaseException:
            self.close()
            raise

    @property
    def complete(self) -> bool:
        """Return whether all pairings have been played."""
        return len(self.pairings) == len(self.pairs)

    def play_pair(self, pair: tuple[int, int], progress: Callable[[int], None] = lambda episodes: None) -> Pairing:
        """Play a pairing, and store it in `pairings` once it is complete. progress: see Match.play."""
        words = np.random.SeedSequence([self.seed, *pair]).generate_state(1 + ROLES, np.uint64) >> np.uint64(1)
        world, *seeds = map(int, words)
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
        if self.complete and self._groups is None and len(self.chosen) > len(found := group_policies(self.chosen)) > 1:
            self._groups = rate_groups(found, *self._games(), self.seed)
        return self._groups

    def estimates(self, policy: str, against: str, side: int | None = None) -> Estimates:
        """Return mean and standard error of each column, for a policy against another one or itself, by their labels.

        side: Only from episodes in which `policy` plays that side; None: from all episodes.

        Raises TrainingError if the pairing is unknown or not complete.
        """
        names = [contender.label for contender in self.chosen]
        for pairing in self.pairings:
            pair = tuple(names[k] for k in pairing.pair)
            if {policy, against} == {*pair}:
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
            list(films(evaluation, hidden, folder))
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
            with record(evaluation.env, _recording(hidden, pair)) if hidden else contextlib.nullcontext():
                evaluation.play_pair(pair, progress.add)
            if folder is not None:
                write_tables(evaluation, folder)


def films(evaluation: Evaluation, hidden: Path, folder: Path) -> Iterator[Path]:
    """Write a film and a page of a typical episode of each pairing, and yield the path of each.

    hidden: The folder in which pairings are recorded. Raises RecordingError, FilmError, PageError.
    """
    from outlast.envs.web.pages import write_page

    game = evaluation.scenario
    for pairing in evaluation.pairings:
        names, (world, episode) = [evaluation.chosen[k].label for k in pairing.pair], pairing.results.typical()
        first, last = (int(record) for record in pairing.results.spans[world, episode])
        for ending in ("webm", "html"):
            path = folder / f"{'-'.join(names)}.{ending}"
            with contextlib.closing(Replay(Recording.open(_recording(hidden, pairing.pair), game))) as replay:
                ticks, sides = replay.ticks(first=first, last=last, worlds=[world]), replay.worlds.dims["sides"]
                own = [[k for k in range(sides) if role_of(k, world, episode) == role] for role in range(ROLES)]
                played = [f"side{'s' * (len(each) > 1)} {' '.join(map(str, each))}" for each in own]
                if ending == "webm":
                    title = f"{film_players(names, played)}, {game.name}"
                    write_film_of(path, replay.worlds, ticks, [world], Looks(size=SIZE, fps=FPS), title)
                else:
                    write_page(path, replay.worlds, ticks, [world], title=f"{game.name}: {_players(names, played)}")
            yield path


def _recording(folder: Path, pair: tuple[int, int]) -> Path:
    """Return the file in which a pairing is recorded."""
    return folder / f"{pair[0]}-{pair[1]}.rec"


def film_players(names: Sequence[str], sides: Sequence[str]) -> str:
    """Return the players with their sides, names shortened in the middle until both fit into a film's title."""
    for most in range(max(LEAST, *map(len, names)), LEAST - 1, -1):
        cut = (f"{name[: most // 2 - 1]}..{name[most // 2 - most + 1 :]}" for name in names)
        words = _players([name if len(name) <= most else short for name, short in zip(names, cut)], sides)
        if fits(words, SIZE):
            break
    return words


def _players(names: Sequence[str], sides: Sequence[str]) -> str:
    return " against ".join(f"{name} ({own})" for name, own in zip(names, sides, strict=True))


def text(evaluation: Evaluation, width: int | None = None, most: int | None = None) -> str:
    """Return all tables. width: Characters of a line, see text_table. most: Policies up to which columns are shown."""
    parts = _parts(evaluation, width, most is None or len(evaluation.chosen) <= most)
    return "\n\n".join(parts) if evaluation.pairings else "none of the pairings is complete"


def _parts(evaluation: Evaluation, width: int | None, columns: bool) -> Iterator[str]:
    """Yield the heading, with the files of policies whose labels do not name them, and the tables."""
    name, each, worlds = evaluation.scenario.name, evaluation.each, evaluation.worlds
    played = f"{len(evaluation.pairings)} pairings of {evaluation.episodes:,} episodes"
    lines = [f"{name}, seed {evaluation.seed}: {played}, {each} in each of {worlds} worlds"]
    lines += [f"{chosen.label}: {chosen.text}" for chosen in evaluation.chosen if chosen.text != chosen.label]
    yield "\n".join([*lines, OVER_GAMES])
    if rated := sorted(_rated(evaluation), key=lambda row: -row[1]):
        cells = [(label, f"{rating:.0f}", f"{error:.0f}") for label, rating, error in rated]
        yield text_table(cells, ("Elo (mean 1000)", "rating", "std. error"), left=1)
    labels, found = [contender.label for contender in evaluation.chosen], dict(_rows(evaluation))
    shares = {pair: with_error(*figures["wins"]) for pair, figures in found.items()}  # a draw counts half
    rows = [(one, *(shares.get((one, other), "-") for other in labels)) for one in labels]
    yield text_table(rows, ("wins of, against", *labels), left=1, width=width)
    yield from _sides(evaluation)
    yield from _groups(evaluation, width)
    names = list(evaluation.pairings[0].results.figures)
    results = [name for name in RESULTS if name in names] + [name for name in names if name.startswith("deaths_")]
    others = [name for name in names if name not in results]
    for some in (results, others) if columns else ():
        rows = [(*pair, *(with_error(*figures[name]) for name in some)) for pair, figures in found.items()]
        yield text_table(rows, (*FIRST, *some), left=len(FIRST), width=width)


def write_tables(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write evaluation.json with everything, and figures.csv, ratings.csv and groups.csv. Raises TrainingError."""
    figures = [(*names, name, *row) for names, rows in _rows(evaluation) for name, row in rows.items()]
    rated, grouped, pairings = _rated(evaluation), _group_rows(evaluation), []
    for each in evaluation.pairings:
        own = [{name: {"mean": m, "error": e} for name, (m, e) in each.estimates(role).items()} for role in (0, 1)]
        names = [evaluation.chosen[k].label for k in each.pair]
        pairings.append({"policies": names, "won, drawn, lost": each.won_drawn_lost(), "figures": own})
    everything = {
        **_played(evaluation),
        **{name: getattr(evaluation, name) for name in ("seed", "worlds", "episodes", "complete")},
        "ratings": [dict(zip(RATED, row, strict=True)) for row in rated],
        "groups": [dict(zip(GROUPED, row, strict=True)) for row in grouped],
        "pairings": pairings,
    }
    contents = {
        TABLES: json.dumps(_json(everything), indent=1, allow_nan=False) + "\n",
        FIGURES: csv_text((*FIRST, "figure", "mean", "error"), figures),
        RATINGS: csv_text(RATED, rated),
        GROUPS: csv_text(GROUPED, grouped),
    }
    return write_files({folder / name: content.encode() for name, content in contents.items()})


def check_folder(evaluation: Evaluation, folder: Path) -> None:
    """Raise TrainingError if tables cannot be written, or would replace those of another game or of other policies."""
    check_results(folder / name for name in FILES)
    path, now = folder / TABLES, _json(_played(evaluation))
    cure = "choose another folder with --out, or remove its content"
    if not path.exists():
        return
    try:
        found = json.loads(read_text(path))
        there = {key: found[key] for key in now}
        who = ", ".join(policy["policy"] for policy in there["policies"])
        about = f"{there['scenario']['name']} with {who}"
    except (*inputs.BROKEN_JSON, LookupError):
        raise TrainingError(f"{path} is not an evaluation, and would be replaced: {cure}") from None
    if there != now:
        raise TrainingError(f"{folder} holds another evaluation, of {about}: {cure}")


def _sides(evaluation: Evaluation) -> Iterator[str]:
    """Describe the pairing whose share of wins depends most on the side played, if one does."""
    found = {}
    for pair, figures in _rows(evaluation):
        (first, one), (second, other) = figures["wins_first"], figures["wins_second"]
        error = np.hypot(one, other) + 2 / evaluation.episodes  # not 0 where all of a few games were won
        if abs(first - second) > CERTAIN * error:
            wins = f"wins {with_error(first, one)} on the first side, {with_error(second, other)} on the second"
            found[pair] = abs(first - second), f"{pair[0]} against {pair[1]} {wins}"
    if found:
        many, most = len({frozenset(pair) for pair in found}), max(found.values(), key=lambda entry: entry[0])[1]
        every = f"{many} of {len(evaluation.pairings)} pairings"
        yield f"the side matters in {every}, see wins_first and wins_second: {most}"


def _groups(evaluation: Evaluation, width: int | None) -> Iterator[str]:
    """Yield tables of groups of runs, and a line on the policies whose errors do not cover other seeds."""
    try:
        groups, found = group_policies(evaluation.chosen), evaluation.groups()
    except TrainingError as error:
        yield f"no groups of training seeds: {error}"
        return
    if found is not None:
        ends = {(name, against): (runs, *three) for name, runs, against, _, *three in _group_rows(evaluation)}
        names = [group.label for group in found.groups]
        rated = [(name, *ends[name, ""]) for name in names]
        rows = [
            (name, str(runs or "-"), f"{elo:.0f}", f"[{low:.0f}, {high:.0f}]") for name, runs, elo, low, high in rated
        ]
        several = [group for group in found.groups if len(group.members) > 1]
        who = [f"{group.label}: {', '.join(evaluation.chosen[k].label for k in group.members)}" for group in several]
        table = text_table(rows, ("Elo of groups (mean 1000)", "runs", "rating", "95 % interval"), left=1)
        yield "\n".join([table, *who, OVER_SEEDS + ("" if np.isfinite(found.ratings).all() else UNBOUNDED)])
        wins = {pair: "{1:.3f} [{2:.3f}, {3:.3f}]".format(*own) for pair, own in ends.items()}
        shares = [(one, *(wins.get((one, other), "-") for other in names)) for one in names]
        yield text_table(shares, ("wins of group, against", *names), left=1, width=width)
    if alone := [group.label for group in groups if group.trained and len(group.members) == 1]:
        one, each = "one run: its error is over games, and does", "one run each: errors are over games, and do"
        yield f"{', '.join(alone)}: {one if len(alone) == 1 else each} not cover other seeds"


def _group_rows(evaluation: Evaluation) -> list[tuple[Any, ...]]:
    """Return the rows of groups.csv; none without a table of groups."""
    try:
        if (found := evaluation.groups()) is None:
            return []
    except TrainingError:  # the report gives the reason
        return []
    rows = list[tuple[Any, ...]]()
    for g, group in enumerate(found.groups):
        first = (group.label, len(group.members) if group.trained else 0)
        rows.append((*first, "", "elo", *(float(ends[g]) for ends in found.ratings)))
        others = [(h, other.label) for h, other in enumerate(found.groups) if g != h]
        rows += [(*first, label, "wins", *(float(ends[g, h]) for ends in found.wins)) for h, label in others]
    return rows


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


def _json(value: Any) -> Any:
    """Return the value for JSON, with None in place of NaN and infinity."""
    return json.loads(json.dumps(value), parse_constant=lambda name: None)
