"""reproduce: the paper's eight experiments, its method as the text has it, and corrected games, in one command."""

import argparse
import ast
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import outlast
from outlast.ecs.kernels.available import available_cores
from outlast.envs.api.options import MACHINE, OUTPUT
from outlast.envs.cli.grammar import add_command
from outlast.envs.cli.options import STOPPED, add_quiet, nonnegative, output, positive
from outlast.envs.errors import FilmError, install
from outlast.envs.progress import Progress, above_bars
from outlast.envs.rendering.films import compress, find_ffmpeg
from outlast.envs.rollout.saved import checkpoints, newest
from outlast.envs.scenarios.parse import resolve
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.variants import VARIANTS

from ..base import policy_file
from ..base.curves import FILE, LOG, format_curves, last_step, rounded, thinned
from ..base.errors import TrainingError
from ..base.files import check_out, write_files
from ..base.quantities import LiveView
from ..plots.plot import plot
from ..plots.runs import kept_runs
from ..policies.player import weights_of
from ..runs.child_runs import ChildRun, side_by_side
from . import corrected_games
from .compare import figures_and_tables
from .results import PAPER_STEPS, curves_to_keep, group_runs, load_runs

ORIGINAL, CORRECTED = "original", "mended"  # parts: the one that others are compared with; corrected games
PARTS = {
    ORIGINAL: "the eight variants, with the authors' networks and numbers",
    "text": "the same by the method of the paper's text (presets paper and scaled)",
    CORRECTED: "games without the paper's flaws, against a pool of opponents",
}
FEW_WORLDS = ("--worlds", "4")  # with many, the paper's observations do not recur (docs/paper.md)
MANY_WORLDS = ("ffa_2", "ffa_3")  # exceptions: with 64, these end as in the paper; ffa_1 and ffa_4 do not
MENDED_STEPS = 50_000_000
KEPT_AS = "pool"  # name of the policies of corrected games, which differ from those of the preset alone
POOL = ("--opponents", "self:0.5,past:0.3,scripted:0.2", "--with", "Behaviour", "--every", "5000000")
SINGLE = {
    "ffa_2": ("health_cap", "bounty", "rivalry", "steering"),
    "teams_2": ("health_cap", "team_share", "bounty", "rivalry", "steering"),
}  # games in which each flaw is corrected alone
TOGETHER = {
    "ffa_2": ("health_cap+bounty+steering", "health_cap+rivalry+steering"),
    "ffa_3": ("health_cap+bounty+steering", "health_cap+rivalry+steering"),
    "teams_2": ("health_cap+team_share+bounty+steering", "health_cap+team_share+rivalry+steering"),
    "teams_3": ("health_cap+team_share+bounty+steering", "health_cap+team_share+rivalry+steering"),
}
TO_HEAL_MATES = (
    ("teams_2", ("melee_damage=2",)),  # with the paper's 5, agents die before a mate arrives
    ("teams_2", ("give_last_reach=10",)),  # mates are seldom within the paper's 2 metres
    ("teams_2", ("give_last_reach=10", "melee_damage=2")),
    ("teams_3", ("give_last_reach=10",)),
)  # games, with their first combination of TOGETHER, which make it easier to heal each other
Counter = Callable[[int], object]  # of tasks that are done
FILM: dict[str, Any] = {"size": 256, "every": 6, "fps": 15, "views": "+vision"}
CURVES = ("length", "kills", "wins/scripted", "damage_dealt", "strikes_landed", "heals_given")  # of corrected games
POINTS, DIGITS = 64, 3  # of kept curves of corrected games, which are only drawn, as averages


@dataclass(frozen=True)
class Experiment:
    """A run for each of several seeds."""

    part: str
    game: str  # the name of a variant, with ablations
    preset: str
    options: tuple[str, ...] = ()  # further options of `outlast train`, without the seed
    numbers: tuple[str, ...] = ()  # numbers of the game with other values: "melee_damage=2"

    @property
    def name(self) -> str:
        """The game with its changed numbers, which distinguish it."""
        return "+".join((self.game, *self.numbers))

    @property
    def scenario(self) -> Scenario:
        """Return the game."""
        pairs = (pair.partition("=") for pair in self.numbers)
        return resolve(self.game, {number: ast.literal_eval(value) for number, _, value in pairs})

    @property
    def steps(self) -> int:
        """Agent-steps of a run."""
        return MENDED_STEPS if self.part == CORRECTED else PAPER_STEPS

    @property
    def seeds(self) -> int:
        """Return the default number of runs."""
        return 2 if self.part == CORRECTED else 3

    def words(self, seed: int) -> list[str]:
        """Return arguments and options of `outlast train` for a run."""
        own = ("--steps", str(self.steps), "--seed", str(seed), "--threads", "1")
        changed = (word for pair in self.numbers for word in ("--set", pair))
        return [self.game, "--preset", self.preset, *changed, *self.options, *own]

    def folder(self, out: Path, seed: int) -> Path:
        """Return the folder of a run."""
        return out / "runs" / self.part / f"{self.name}-{self.preset}-{seed}"

    def kept_policy(self, out: Path, run: Path) -> Path:
        """Return the file in which the policy of a run is kept."""
        kind, seed = KEPT_AS if self.part == CORRECTED else self.preset, run.name.rpartition("-")[2]
        return out / "policies" / self.name / f"{kind}-{seed}{policy_file.SUFFIX}"

    def results(self, out: Path) -> list[Path]:
        """Return its complete runs by seed: their folders, or kept results in the folder of the part.

        A kept run with its policy does not need its folder any more. If both exist, the folder counts.
        """
        name = f"{self.name}-{self.preset}-"
        steps = {out / self.part / run: done for run, done in self._kept(out).items()}
        folders = [path for path in self.folder(out, 0).parent.glob("*") if path.name.startswith(name)]
        steps |= {path: last_step(path / LOG) for path in folders if checkpoints(path)}
        by_seed = {path.name.removeprefix(name): path for path, done in steps.items() if done >= self.steps}
        return [by_seed[seed] for seed in sorted(filter(str.isdecimal, by_seed), key=int)]

    def steps_done(self, out: Path, seed: int) -> int:
        """Return agent-steps of a run, by its log or by kept results."""
        folder = self.folder(out, seed)
        return max(last_step(folder / LOG), self._kept(out).get(folder.name, 0))

    def _kept(self, out: Path) -> dict[str, int]:
        """Return agent-steps of all runs of its part that are kept, by name."""
        return {name: int(curves.steps[-1]) for name, (_, curves) in kept_runs(out / self.part).items()}


Plan = list[tuple[Experiment, int]]  # with a seed


def experiments(parts: Iterable[str]) -> list[Experiment]:
    """Return the experiments of some parts."""
    every = [
        Experiment(part, name, preset, () if name in MANY_WORLDS else FEW_WORLDS)
        for part, preset in ((ORIGINAL, "original"), ("text", "paper"), ("text", "scaled"))
        for name in VARIANTS
    ]
    for game, together in TOGETHER.items():
        corrected = (f"{game}+{names}" for names in (*SINGLE.get(game, ()), *together))
        every += [Experiment(CORRECTED, name, "fast", POOL) for name in (game, *corrected)]
    for game, numbers in TO_HEAL_MATES:
        every.append(Experiment(CORRECTED, f"{game}+{TOGETHER[game][0]}", "fast", POOL, numbers))
    wanted = set(parts)
    return [each for each in every if each.part in wanted]


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(commands, "reproduce", run)
    parts = "\n".join(f"  {name:10}{about}" for name, about in PARTS.items())
    command.epilog = f"{command.epilog}\n\nparts:\n{parts}"
    done = command.group("what is done")
    text = f"parts to train: {', '.join(PARTS)}, see below (default: all)"
    done.add_argument("parts", nargs="*", metavar="PART", help=text)
    text = "only these games of the parts, such as ffa_2 (default: all)"
    done.add_argument("--only", nargs="+", default=[], metavar="GAME", help=text)
    text = "runs of each experiment, with one seed after the other (default: 3, of corrected games 2)"
    done.add_argument("--seeds", type=positive, metavar="N", help=text)
    text = "seed of the first run of each experiment (default 0)"
    done.add_argument("--first", type=nonnegative, default=0, metavar="SEED", help=text)
    text = "folder for runs, figures, tables and films (default paper)"
    command.group(OUTPUT).add_argument("--out", type=output(check_out), default="paper", help=text)
    text = "only print the runs to train, with the agent-steps that are left"
    done.add_argument("--plan", action="store_true", help=text)
    add_quiet(command)
    text = "runs that train at the same time (default: cores)"
    command.group(MACHINE).add_argument("--jobs", type=positive, help=text)


def run(options: argparse.Namespace) -> int:
    """Train, measure and draw the paper's experiments and more.

    Train the runs of docs/paper.md, and write its figures, tables and films. The same command continues after it was
    stopped.

    Examples:
        reproduce --plan  # the runs to train, with their agent-steps
        reproduce original --out reproduction  # the eight experiments; the same command continues after Ctrl-C
        reproduce original --only ffa_2 teams_2 --seeds 1  # two of them, one seed each
    """
    options.out = Path(options.out)
    chosen = _chosen(options)
    plan = _plan(chosen, options)
    jobs = options.jobs or available_cores()
    done = [min(each.steps, each.steps_done(options.out, seed)) for each, seed in plan]
    about, lines = _summary(plan, done, jobs)
    if options.plan:
        print("\n".join([about, *lines]))
        return 0
    try:  # ahead of hours of training
        find_ffmpeg(".webm")
    except FilmError as error:
        raise TrainingError(f"the films need FFmpeg: {install('train,plot,view')}") from error
    status = _train(plan, done, options, about, jobs)
    if status == STOPPED:
        return status
    for part in PARTS:  # also after a failed run, for the runs that did not fail
        if own := [each for each in chosen if each.part == part and each.results(options.out)]:
            about = f"figures and tables of {part}"
            with Progress(0, "steps", quiet=options.quiet, about=about) as progress:
                for made in write_part(part, own, options.out, progress.add):
                    with above_bars(sys.stdout):
                        print(made)
    return status


def _chosen(options: argparse.Namespace) -> list[Experiment]:
    """Return the requested experiments. Raises TrainingError."""
    for part in options.parts:
        if part not in PARTS:
            raise TrainingError(f"unknown part '{part}'; known: {', '.join(PARTS)}")
    chosen = experiments(options.parts or PARTS)
    games = list(dict.fromkeys(each.name for each in chosen))
    if unknown := [game for game in options.only if game not in games]:
        raise TrainingError(f"--only {unknown[0]}: unknown game; known: {', '.join(games)}")
    return [each for each in chosen if each.name in (options.only or games)]


def _plan(chosen: Sequence[Experiment], options: argparse.Namespace) -> Plan:
    """Return all runs, the first seed of every experiment ahead of the second."""
    counts = [options.seeds or each.seeds for each in chosen]
    rounds = range(options.first, options.first + max(counts))
    return [(each, seed) for seed in rounds for each, count in zip(chosen, counts) if seed - options.first < count]


def _summary(plan: Plan, done: Sequence[int], jobs: int) -> tuple[str, list[str]]:
    """Return a summary of the runs still to train, and the command of each."""
    left = [(each, seed, rest) for (each, seed), steps in zip(plan, done, strict=True) if (rest := each.steps - steps)]
    finished = f"{len(plan) - len(left)} of {len(plan)} runs are finished"
    if not left:
        return f"{finished}: figures and tables are written again", []
    about = f"{len(left)} runs, {jobs} at a time: {sum(rest for *_, rest in left):,} agent-steps"
    lines = [f"outlast train {' '.join(each.words(seed))}  # {rest:,} agent-steps" for each, seed, rest in left]
    return about + (f"; {finished}" if len(left) < len(plan) else ""), lines


def _train(plan: Plan, done: Sequence[int], options: argparse.Namespace, about: str, jobs: int) -> int:
    """Train the remaining runs. Return the exit status."""
    runs = [
        (ChildRun(each.folder(options.out, seed), each.words(seed), resume=True), each.steps, before)
        for (each, seed), before in zip(plan, done, strict=True)
    ]
    waiting = [run for run, steps, before in runs if before < steps]
    view = LiveView(sum(done), sum(steps for _, steps, _ in runs), quiet=options.quiet, about=about)
    return side_by_side(waiting, jobs, view, lambda: sum(min(s, max(run.steps(), before)) for run, s, before in runs))


def write_part(part: str, chosen: Sequence[Experiment], out: Path, progress: Counter) -> Iterator[Path]:
    """Write all output of a part, and yield the path of each file once it is written. Raises TrainingError.

    Figures and tables show all experiments of the part whose runs are in the folder; otherwise one game's would replace
    those of another. Corrected games that are not chosen are shown if they were measured before.

    chosen: The experiments to film. progress: Called with 1 after each long task.
    """
    there = [each for each in experiments([part]) if each.results(out)]
    if part == CORRECTED:
        known = corrected_games.read_measured(out / part / corrected_games.FILE)
        runs = {run for each in there for run in each.results(out)}
        old = {run for run in runs if ((run / corrected_games.FILE).exists() if run.is_dir() else run.name in known)}
        shown = [each for each in there if each in chosen or old.issuperset(each.results(out))]
        yield from _mended(part, shown, out, progress)
    else:
        yield from _beside_the_paper(part, there, out, progress)
    for each in chosen:
        run = each.results(out)[0]
        name = each.name if part == CORRECTED else f"{each.name}-{each.preset}"  # corrected games have one preset
        policy = newest(run) if run.is_dir() else each.kept_policy(out, run)
        yield _film(each.scenario, policy, out / part / f"{name}.webm")
        progress(1)


def _beside_the_paper(part: str, there: Sequence[Experiment], out: Path, progress: Counter) -> Iterator[Path]:
    """Yield kept results, figures and tables."""
    runs = load_runs(place for each in there for place in each.results(out))
    yield from write_files(curves_to_keep(runs, out / part) | _policies(there, out))
    games = {each.game for each in there}
    others = [each for each in experiments([ORIGINAL]) if part != ORIGINAL and each.game in games]
    beside = load_runs(place for each in others for place in each.results(out))
    files = figures_and_tables(group_runs(runs), "png", group_runs(beside))
    yield from write_files({out / part / name: content for name, content in files.items()})
    progress(1)


def _mended(part: str, there: Sequence[Experiment], out: Path, progress: Counter) -> Iterator[Path]:
    """Yield kept policies, curves and measurements; a table, and a figure for each variant."""
    study = out / part
    curves, measured = kept_runs(study), corrected_games.read_measured(study / corrected_games.FILE)
    for each in there:
        for run in each.results(out):
            if run.is_dir():
                measured[run.name] = corrected_games.measured(each.scenario, run)
                (result,) = load_runs([run])
                curves[run.name] = result.about, rounded(thinned(result.curves, POINTS), DIGITS)
            elif run.name not in measured:
                raise TrainingError(
                    f"{study / corrected_games.FILE} does not have {run.name}, and its folder is missing"
                )
            progress(1)
    kept = {FILE: format_curves(dict(sorted(curves.items())))}
    kept |= {corrected_games.FILE: corrected_games.format_measured(measured.values())}
    shown = {each.name: [measured[run.name] for run in each.results(out)] for each in there}
    kept |= {"measured.md": (corrected_games.table(shown) + "\n").encode()}
    yield from write_files({study / name: content for name, content in kept.items()} | _policies(there, out))
    changed = sorted({pair.partition("=")[0] for each in there for pair in each.numbers})
    runs = dict[str, list[Path]]()
    for each in there:
        runs.setdefault(each.game.partition("+")[0], []).extend(study / run.name for run in each.results(out))
    for name, own in runs.items():
        yield from plot(own, study / name, by=("scenario", *changed), curves=CURVES).files
        progress(1)


def _policies(there: Sequence[Experiment], out: Path) -> dict[Path, bytes]:
    """Return the policies to keep of the runs whose folders exist, by path."""
    runs = ((each, run) for each in there for run in each.results(out) if run.is_dir())
    return {each.kept_policy(out, run): policy_file.content(*weights_of(newest(run))) for each, run in runs}


def _film(game: Scenario, policy: Path, path: Path) -> Path:
    """Film an episode of a policy."""
    first = outlast.rollout(game, policy, worlds=1, seed=0)
    length = int(next(mean for name, mean, _ in first.rows() if name == "length"))
    with tempfile.TemporaryDirectory() as folder:
        film, small = Path(folder, "film.mp4"), Path(folder, path.name)
        compress(outlast.film(game, film, policy=policy, worlds=1, seed=0, steps=length, **FILM), small)
        (written,) = write_files({path: small.read_bytes()})
    return written
