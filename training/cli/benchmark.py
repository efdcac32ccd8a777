"""outlast benchmark: agents by one protocol; verifiable results, scores and tables."""

import argparse
import functools
import itertools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from outlast.ecs.kernels.available import available_cores
from outlast.envs.cli.grammar import Parser
from outlast.envs.cli.options import STOPPED, add_options, count, output, positive, seed
from outlast.envs.progress import Progress, duration
from outlast.envs.text_table import terminal_width, text_table

from ..base.config import TrainingConfig
from ..base.errors import TrainingError, needed
from ..base.files import check_out
from ..base.hyperparameters import parse_hyperparameters
from ..benchmark.tasks import BUDGETS, GAMES, task_of, tasks
from ..runs.child_runs import MAIN, ChildRun, side_by_side
from ..runs.live_view import LiveView

OWN = ("agent", "seed", "jobs", "quiet")  # options that differ between several entries
RESULTS = Path("benchmark")
AGAIN = "stopped: run the same command again to continue"


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("benchmark tasks", "list the tasks"),
        (
            "benchmark run ffa_2-v1 teams_2-v1 --agent fast --seed 0 1 2 3 4",
            "train preset fast with five seeds, and play the games of the protocol",
        ),
        ("benchmark run ffa_2-v1 --agent mine=agents.py:make --seed 0 1", "enter agents of your own"),
        ("benchmark score benchmark", "play the matches between all agents, and write the scores"),
        ("benchmark verify benchmark", "play every recorded game again, and compare"),
        ("benchmark table benchmark --out tables", "write the tables, as Markdown and CSV, and a figure"),
        (
            "benchmark situations teams_3-v1 --policies scripted runs/teams_3-fast-0",
            "what agents can do, scene by scene",
        ),
    ]
    description = (
        "Compare agents by the protocol of docs/evaluating.md: tasks that never change, fixed budgets of training, and "
        "games in worlds that are not used in training. All games are recorded, so that the results can be verified. "
        "ACTION is one of: tasks, to list the tasks; run, to train agents and play their games; score, to play all "
        "agents against each other and compute scores; verify, to play all recorded games again; table, to write "
        "tables; situations, to try policies in small scenes with a known solution; anchors, to make the rated "
        "opponents of a task. The help of an option begins with the actions that take it."
    )
    text = "compare agents by one protocol, with verifiable results"
    command = commands.add_parser("benchmark", help=text, description=description, examples=examples)
    command.add_argument("action", choices=ACTIONS, metavar="ACTION", help=f"what to do: {', '.join(ACTIONS)}")
    text = f"run: tasks, or all; score, verify, table: folders of results (default {RESULTS}); verify: also "
    text += "folders in them, such as that of an agent; situations, anchors: a task"
    command.add_argument("names", nargs="*", metavar="NAME", help=text)
    text = "run: an agent, which is a preset of `outlast train`, trained first; or NAME=SOURCE, where SOURCE is a "
    text += "preset, the folder of a run, FILE.zip, FILE.safetensors or FILE.py:FUNCTION, and {task} and {seed} in it "
    text += "stand for those of the entry (can be repeated)"
    command.add_argument("--agent", action="append", default=[], metavar="AGENT", help=text)
    text = "run: seeds of training; each is an entry of its own (default 0)"
    command.add_argument("--seed", type=seed, nargs="+", default=[0], help=text)
    steps = " and ".join(f"{steps:,}" for steps in BUDGETS.values())
    text = f"run: agent-steps of training; the two tracks have {steps} (default 10e6)"
    command.add_argument("--budget", type=positive, default=BUDGETS["10M"], metavar="N", help=text)
    text = f"run, anchors: games of each match (default {GAMES}, as in both tracks)"
    command.add_argument("--games", type=_games, default=GAMES, metavar="N", help=text)
    trained = ("settings", "memory", "opponents")
    add_options(command, TrainingConfig, trained, "run, of a preset: ", opponents={"default": None})
    text = "anchors: checkpoints, or folders of runs, of which those at 10, 30 and 100 %% of the run are taken; "
    text += "situations: names of policies, saved policies, or folders of runs, of which the newest are taken"
    command.add_argument("--policies", type=Path, nargs="+", default=[], metavar="PATH", help=text)
    text = (
        f"run: folder for results (default {RESULTS}); table: for tables (default: that of the results); anchors: for "
    )
    command.add_argument("--out", type=output(check_out), metavar="FOLDER", help=f"{text}the anchors")
    text = "table: also keep what is small enough to publish in this folder: the numbers of all results, and of each "
    text += "agent's first seed the policy and its games against itself"
    command.add_argument("--keep", type=output(check_out), metavar="FOLDER", help=text)
    text = "run: entries that run at the same time; score, verify: matches (default: cores)"
    command.add_argument("--jobs", type=positive, metavar="N", help=text)
    text = "run: threads of the training of each entry (default: cores, at most 4; of several entries 1)"
    command.add_argument("--threads", type=positive, metavar="N", help=text)
    text = "verify: take matches for verified whose files or policies are not here, as in a copy that --keep made"
    command.add_argument("--allow-missing", action="store_true", help=text)
    text = "run, score, verify, situations, anchors: show no progress"
    command.add_argument("--quiet", action="store_true", help=text)
    command.arrange(
        {
            "entries": ("--agent", "--seed", "--opponents", "--ppo", "--memory", "--policies"),
            "the protocol": ("--budget", "--games"),
            "output": ("--out", "--keep", "--allow-missing", "--quiet"),
            "machine": ("--jobs", "--threads"),
        }
    )
    command.set_defaults(run=functools.partial(run, command))


def run(command: Parser, options: argparse.Namespace) -> int:
    """Run the action. Return the exit status."""
    action, allowed = ACTIONS[options.action]
    given = [name for name, value in vars(options).items() if value != command.get_default(name)]
    if unused := [name for name in given if name not in ("action", "names", "run", *allowed)]:
        raise TrainingError(f"--{unused[0]} has no effect on benchmark {options.action}: leave it out")
    options.out, options.keep = (each and Path(each) for each in (options.out, options.keep))
    if options.action != "tasks":
        with needed("train", f"benchmark {options.action} needs"):
            import torch  # noqa: F401  # all else plays policies
    return action(options, command)


def _games(text: str) -> int:
    number = count(text, 2)
    if number % 2:
        raise argparse.ArgumentTypeError(f"{text}: must be even, so that both play each side equally often")
    return number


def _tasks(options: argparse.Namespace, command: Parser) -> int:
    """List the tasks."""
    if options.names:
        raise TrainingError(f"benchmark tasks lists all: leave out {options.names[0]}")
    rows = []
    for task in tasks().values():
        tested = ", ".join(game.name for game in task.games[1:])
        rows.append((task.name, task.about + (f" ({tested})" if tested else "")))
    print(text_table(rows, width=terminal_width()))
    return 0


def _run(options: argparse.Namespace, command: Parser) -> int:
    """Run the entries: one in this process, several side by side."""
    from ..benchmark.agents import Agent
    from ..benchmark.entry import Entry

    if not options.names or not options.agent:
        raise TrainingError("benchmark run needs tasks and agents, as in: benchmark run ffa_2-v1 --agent fast")
    settings = {
        "opponents": options.opponents,
        "memory": options.memory,
        "settings": parse_hyperparameters(options.ppo),
    }
    given = {name: value for name, value in settings.items() if value}
    agents = [Agent.of(text, given) for text in options.agent]
    for agent in agents:
        agent.check_seeds(options.seed)
    chosen = [task_of(name) for name in (tasks() if options.names == ["all"] else options.names)]
    out, threads = options.out or RESULTS, options.threads or 0
    entries = [
        Entry(task, agent, number, options.budget, options.games, out, threads)
        for task, agent, number in itertools.product(chosen, agents, options.seed)
    ]
    if len({entry.folder for entry in entries}) < len(entries):
        raise TrainingError("name each task, each agent and each seed once")
    return _run_one(entries[0], options) if len(entries) == 1 else _run_several(entries, options, command)


def _about(entries: list[Any], at_once: int) -> str:
    """Return a summary of the work and its expected time."""
    from ..benchmark.entry import estimate

    matches = sum(len(entry.wanted) + entry.responds for entry in entries)
    several = "entries" if len(entries) > 1 else "entry"
    return (
        f"{len(entries)} {several}, {at_once} at a time: {matches:,} matches of {entries[0].games} games, about "
        f"{duration(estimate(entries) / at_once)} on idle cores like those of docs/performance.md"
    )


def _run_one(entry: Any, options: argparse.Namespace) -> int:
    from ..benchmark.entry import EntryRun

    if options.jobs is not None:
        raise TrainingError("--jobs has no effect on one entry: leave it out, or name several tasks, agents or seeds")
    view = LiveView(entry.done(), entry.work, quiet=options.quiet, about=_about([entry], 1))

    def progress(done: int, text: str) -> None:
        view.update(done, entry.work, {})
        view.now(text)

    try:
        found = EntryRun(entry, progress).run()
    except KeyboardInterrupt:
        print(AGAIN, file=sys.stderr)
        return STOPPED
    finally:
        view.close()
    print(f"{len(found.matches)} matches in {found.folder}")
    return 0


class ChildEntry(ChildRun):
    """An entry that runs in its own process."""

    def __init__(self, entry: Any, common: Sequence[str]) -> None:
        """Take the options that all entries have in common."""
        super().__init__(entry.folder, [], resume=False)
        self.entry, agent = entry, entry.agent
        source = agent.name if agent.name == agent.source else f"{agent.name}={agent.source}"
        words = ["run", entry.task.name, f"--agent={source}", f"--seed={entry.seed}", *common, "--quiet"]
        self.words = [sys.executable, "-m", MAIN, "benchmark", *words]

    @property
    def name(self) -> str:
        """Return its name in messages."""
        return str(self.entry.name)

    def steps(self) -> int:
        """Return the work done, judging by the files in its folder."""
        return int(self.entry.done())


def _run_several(entries: list[Any], options: argparse.Namespace, command: Parser) -> int:
    """Run the entries. Return the exit status: 0 for success, 130 if they were stopped."""
    at_once = min(_jobs(options), len(entries))
    common = command.words(options, leave_out=OWN) + (["--threads=1"] if options.threads is None else [])
    children, total = [ChildEntry(entry, common) for entry in entries], sum(entry.work for entry in entries)

    def done() -> int:
        return sum(child.steps() for child in children)

    view = LiveView(done(), total, quiet=options.quiet, about=_about(entries, at_once))
    return side_by_side(children, at_once, view, done, AGAIN)


def _jobs(options: argparse.Namespace) -> int:
    """Return the number of entries, or matches, that run at a time."""
    return int(options.jobs or available_cores())


def _places(options: argparse.Namespace) -> list[Path]:
    """Return the folders of results in the arguments."""
    from ..benchmark import kept

    places = [Path(name) for name in options.names] or [RESULTS]
    if gone := [place for place in places if not place.is_dir() and not kept.above(place)]:
        raise TrainingError(f"folder {gone[0]} does not exist: name a folder of results that `benchmark run` made")
    return places


def _score(options: argparse.Namespace, command: Parser) -> int:
    """Play the cross-play that is missing, and write the scores."""
    from ..benchmark import crossplay, scores
    from ..benchmark.result import write_json

    for place in _places(options):
        scores.scores(place)  # raises for incomplete results before hours of cross-play
        folders = [pair for own in scores.by_budget(place).values() for pair in scores.task_folders(own).items()]
        total = sum(len(crossplay.pairs(entries)) * entries[0].content["games"] for _, entries in folders)
        with Progress(total, "games", quiet=options.quiet) as progress:
            for folder, entries in folders:
                crossplay.play_all(folder, entries, progress.add, _jobs(options))
        found = scores.scores(place)
        write_json(place / scores.NAME, found)
        print(*scores.lines(found), place / scores.NAME, sep="\n")
    return 0


def _verify(options: argparse.Namespace, command: Parser) -> int:
    """Verify. Return exit status 1 if anything is wrong, 2 if anything could not be verified, otherwise 0."""
    from ..benchmark.verify import verify

    fine, wrong, missing = "as recorded", "wrong", "not verified"
    counts = {fine: 0, wrong: 0, missing: 0}
    for place in _places(options):
        for found in verify(place, _jobs(options)):
            kind = wrong if found.wrong else missing if found.missing else fine
            counts[kind] += 1
            if not options.quiet or kind == wrong or (kind == missing and not options.allow_missing):
                print(found, flush=True)
    print(f"{sum(counts.values())} checks:", ", ".join(f"{number} {name}" for name, number in counts.items()))
    if counts[missing] and not options.allow_missing:
        print("not all is verified: put the missing files back, or take --allow-missing", file=sys.stderr)
    return 1 if counts[wrong] else 2 if counts[missing] and not options.allow_missing else 0


def _table(options: argparse.Namespace, command: Parser) -> int:
    """Write the tables, and print their paths."""
    from ..benchmark import keeping, table

    places = _places(options)
    if len(places) > 1:
        raise TrainingError("benchmark table takes one folder of results: move the results to compare into one folder")
    if options.keep is not None:
        print(*keeping.keep(places[0], options.keep), sep="\n")
    print(*table.write(places[0], options.out or places[0]), sep="\n")
    return 0


def _anchors(options: argparse.Namespace, command: Parser) -> int:
    """Rate checkpoints, for maintainers of the benchmark."""
    from ..benchmark.anchors import make

    if len(options.names) != 1 or not options.policies or options.out is None:
        raise TrainingError("benchmark anchors needs a task, --policies and --out")
    with Progress(0, "matches", quiet=options.quiet) as progress:
        print(make(task_of(options.names[0]), options.policies, options.out, options.games, progress.show))
    return 0


def _situations(options: argparse.Namespace, command: Parser) -> int:
    """Print which situations policies pass."""
    from ..arena.players import contenders
    from ..benchmark import situations

    if len(options.names) != 1:
        raise TrainingError(
            "benchmark situations needs a task, as in: benchmark situations teams_3-v1 --policies scripted"
        )
    task, policies = task_of(options.names[0]), [str(path) for path in options.policies]
    chosen = contenders(policies) if policies else []
    with Progress((1 + len(chosen)) * len(situations.SITUATIONS), "scenes", quiet=options.quiet) as progress:
        rows = situations.table(task.scenario, chosen, progress.add)
    print(text_table(rows, ("situation", "solution", *(each.label for each in chosen)), width=terminal_width()))
    return 0


ACTIONS: dict[str, tuple[Callable[[argparse.Namespace, Parser], int], tuple[str, ...]]] = {
    "tasks": (_tasks, ()),
    "run": (
        _run,
        ("agent", "seed", "budget", "games", "opponents", "ppo", "memory", "out", "jobs", "threads", "quiet"),
    ),
    "score": (_score, ("jobs", "quiet")),
    "verify": (_verify, ("jobs", "quiet", "allow_missing")),
    "table": (_table, ("out", "keep")),
    "situations": (_situations, ("policies", "quiet")),
    "anchors": (_anchors, ("policies", "games", "out", "quiet")),
}  # by action, the options that have an effect
