"""Evaluations in one call: `outlast evaluate`, and outlast.evaluate."""

import contextlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from outlast.envs.progress import Progress
from outlast.envs.recording import record
from outlast.envs.scenarios.naming import checks_keywords, options_of, resolve
from outlast.envs.scenarios.scenario import Number, Scenario

from ..base.errors import TrainingError
from ..base.files import check_out
from . import report
from .contenders import Given, contenders
from .evaluation import Evaluation
from .showcase import show_pairing


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
