"""outlast benchmark: agents by one protocol; verifiable results, scores and tables."""

import argparse
import contextlib
import functools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from outlast.ecs.kernels.available import available_cores
from outlast.envs.cli.grammar import add_command
from outlast.envs.cli.options import STOPPED, add_options, output, positive, seed
from outlast.envs.errors import needed
from outlast.envs.progress import Progress, duration
from outlast.envs.storage.outputs import check_file
from outlast.envs.text_table import terminal_width, text_table

from ..base.config import TrainingConfig
from ..base.errors import TrainingError
from ..base.files import check_out
from ..base.quantities import LiveView
from ..benchmark.tasks import BUDGETS, GAMES, RESPONSES, task_of, tasks
from ..runs.child_runs import MAIN, ChildRun, side_by_side

RESULTS = Path("benchmark")
AGAIN = "stopped: run the same command again to continue"
EFFECT = 0.05  # of scores, by default


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(commands, "benchmark", run)
    command.set_defaults(run=functools.partial(run, command=command))
    command.add_argument("action", choices=NAMES, metavar="ACTION", help=f"what to do: {', '.join(NAMES)}")
    text = "plan: tasks, or all; run, score, pack: a folder of results; verify, table: folders, or archives of them "
    text += f"(default {RESULTS}); check: archives; situations, anchors: a task; people: recordings"
    command.add_argument("names", nargs="*", metavar="NAME", help=text)
    plan, protocol, files, machine = map(command.group, ("the plan", "the protocol", "output", "machine"))
    text = "plan: an agent, which is a preset of `outlast train`, trained first; or NAME=SOURCE, where SOURCE is a "
    text += "preset, the folder of a run, FILE.zip, FILE.safetensors or FILE.py:FUNCTION, and {task}, {game} and "
    text += "{seed} in it stand for those of the entry (can be repeated); people: the name of the person"
    plan.add_argument("--agent", action="append", default=[], metavar="AGENT", help=text)
    text = "plan: seeds of training; each is an entry of its own (default 0 1 2 3 4, as ratings need five)"
    plan.add_argument("--seed", type=seed, nargs="+", default=[0, 1, 2, 3, 4], help=text)
    budgets = ", ".join(f"{steps:,}" for steps in BUDGETS.values())
    text = f"plan: agent-steps of training; the tracks have {budgets} (default 10e6)"
    protocol.add_argument("--budget", type=positive, default=BUDGETS["10M"], metavar="N", help=text)
    text = f"plan, anchors: games of each test (default {GAMES}, as in all tracks)"
    protocol.add_argument("--games", type=positive, default=GAMES, metavar="N", help=text)
    text = "plan: agent-steps of best responses to the first seed, or none (default 5e6 20e6 80e6)"
    protocol.add_argument("--responses", type=_responses, nargs="+", default=[*RESPONSES], metavar="N", help=text)
    text = "plan: two agents to compare, as in fast,mine (can be repeated)"
    plan.add_argument("--pair", action="append", default=[], metavar="ONE,OTHER", help=text)
    text = f"plan: the smallest difference of scores that matters (default {EFFECT})"
    plan.add_argument("--effect", type=float, default=EFFECT, metavar="X", help=text)
    trained = ("settings", "memory", "opponents")
    add_options(command, TrainingConfig, trained, "plan, of a preset: ", opponents={"default": None})
    text = "anchors: checkpoints; situations: names of policies, saved policies, or folders of runs, of which the "
    text += "newest are taken"
    protocol.add_argument("--policies", type=Path, nargs="+", default=[], metavar="PATH", help=text)
    text = f"plan, people: folder of results (default {RESULTS}); table, anchors: folder; pack: file"
    files.add_argument("--out", type=output(_check_out), metavar="PATH", help=text)
    text = "run, verify: only entries whose names begin with these words, as in 'fast ffa_2-v2 0'"
    files.add_argument("--only", default="", metavar="ENTRY", help=text)
    text = "pack: leave out what is too large to publish: candidates, best responses, and policies of other seeds"
    files.add_argument("--small", action="store_true", help=text)
    text = "run: entries that run at the same time; verify, check: matches (default: cores)"
    machine.add_argument("--jobs", type=positive, metavar="N", help=text)
    text = "run: threads of the training of each entry (default: cores, at most 4; of several entries 1)"
    machine.add_argument("--threads", type=positive, metavar="N", help=text)
    text = "verify: take matches for verified whose files or policies are not here, as in what --small made"
    files.add_argument("--allow-missing", action="store_true", help=text)
    text = "run, verify, check, situations, anchors: show no progress"
    files.add_argument("--quiet", action="store_true", help=text)


def run(options: argparse.Namespace, command: Any = None) -> int:
    """Compare agents by one protocol, with verifiable results.

    Compare agents by the protocol of docs/benchmark.md: tasks that never change, a plan before the first result, and
    games in worlds that no training uses. ACTION is one of: tasks, to list the tasks; plan, to write the manifest; run,
    to do what it says; score, to compute scores; verify, to play all matches again; pack, to put results into an
    archive; check, to verify an archive that is handed in; table, to write tables; situations, to try policies in small
    scenes with a known solution; people, to add games of people; anchors, to make the rated opponents of a task. The
    help of an option begins with the actions that take it.

    Examples:
        benchmark tasks  # list the tasks
        benchmark plan ffa_2-v2 teams_2-v2 --agent fast --seed 0 1 2 3 4 --out mine  # say what will be run
        benchmark run mine  # train, choose checkpoints, and play all matches of the plan
        benchmark score mine  # write the scores
        benchmark verify mine  # play every match again, action by action
        benchmark pack mine --out mine.zip  # put an entry into one file, to hand it in
        benchmark check mine.zip  # do all that a maintainer does before accepting it
        benchmark table mine other.zip --out tables  # write the tables, as Markdown and CSV, and figures
        benchmark situations teams_3-v2 --policies scripted runs/teams_3-fast-0  # what agents can do
        benchmark people games.rec --agent you --out mine  # where a person stands, by games of `outlast play`
    """
    for option in command._actions:  # their help begins with the actions that take them
        actions = [word for text in (option.help or "").split("; ") for word in text.partition(":")[0].split(", ")]
        given = option.option_strings and getattr(options, option.dest, option.default) != option.default
        if given and options.action not in actions:
            raise TrainingError(f"--{option.dest} has no effect on benchmark {options.action}: leave it out")
    options.out, options.jobs = options.out and Path(options.out), options.jobs or available_cores()
    if options.action != "tasks":
        with needed("train", f"benchmark {options.action} needs {{}}", TrainingError):
            import torch  # noqa: F401  # all else plays policies
    return ACTIONS[options.action](options) or 0


def _check_out(place: str) -> Path:
    """Check a folder for results, or the file of an archive. Raises TrainingError."""
    return check_file(place, "archives", TrainingError) if place.endswith(".zip") else check_out(place)


def _responses(text: str) -> int:
    return 0 if text == "none" else int(positive(text))


def _tasks(options: argparse.Namespace) -> None:
    """List the tasks."""
    if options.names:
        raise TrainingError(f"benchmark tasks lists all: leave out {options.names[0]}")
    tested = {task: ", ".join(game.name for game in task.tests[1:]) for task in tasks().values()}
    rows = [(task.name, task.about + (f" ({games})" if games else "")) for task, games in tested.items()]
    print(text_table(rows, width=terminal_width()))


def _plan(options: argparse.Namespace) -> None:
    """Write the manifest."""
    from ..benchmark import manifest
    from ..benchmark.entry import entries_of

    if not options.names or not options.agent:
        raise TrainingError("benchmark plan needs tasks and agents, as in: benchmark plan ffa_2-v2 --agent fast")
    given = {"opponents": options.opponents, "memory": options.memory, "settings": options.ppo}
    agents = [manifest.Agent.of(text, {name: own for name, own in given.items() if own}) for text in options.agent]
    chosen = [task_of(name) for name in (tasks() if options.names == ["all"] else options.names)]
    numbers = {"budget": options.budget, "games": options.games, "effect": options.effect}
    numbers["responses"] = sorted(steps for steps in options.responses if steps)
    pairs = [tuple(text.split(",")) for text in options.pair]
    made = manifest.write(options.out or RESULTS, chosen, agents, options.seed, pairs, **numbers)
    print(f"{made.folder / manifest.NAME}: {_about(entries_of(made), options.jobs)}")


def _about(entries: Sequence[Any], at_once: int) -> str:
    """Return a summary of the work and its expected time."""
    matches, seconds = sum(len(entry.planned) for entry in entries), sum(entry.work()[2] for entry in entries)
    several, at_once = "entries" if len(entries) > 1 else "entry", min(at_once, len(entries))
    work = f"{matches:,} matches, about {duration(seconds / at_once)} on idle cores like those of docs/performance.md"
    return f"{len(entries)} {several}, {at_once} at a time: {work}"


def _child(entry: Any, threads: int) -> ChildRun:
    """Return the run of an entry in its own process. threads: Of its training."""
    words = ["run", str(entry.manifest.folder), f"--only={entry}", f"--threads={threads}", "--quiet"]
    child = ChildRun(entry.folder, [], resume=False)
    child.name, child.words = str(entry), [sys.executable, "-m", MAIN, "benchmark", *words]
    return child


def _run(options: argparse.Namespace) -> int:
    """Run the entries: one in this process, several side by side; then the matches between agents."""
    from ..benchmark import manifest
    from ..benchmark.entry import EntryRun, entries_of

    made = manifest.read(_place(options))
    entries = entries_of(made, options.only, options.threads or 0)
    at_once, total = min(options.jobs, len(entries)), sum(entry.work()[1] for entry in entries)

    def done() -> int:
        return sum(entry.work()[0] for entry in entries)

    def progress(done: int, text: str) -> None:
        view.update(done, total, {})
        view.now(text)

    compared = [entry for entry in entries if entry.name in dict(made.content["pairs"])]
    for chosen in filter(None, (entries, compared) if len(entries) > 1 else ()):
        children = [_child(entry, options.threads or 1) for entry in chosen]
        view = LiveView(done(), total, quiet=options.quiet, about=_about(entries, at_once))
        if status := side_by_side(children, at_once, view, done, AGAIN):
            return status
    if len(entries) > 1:
        return 0
    view = LiveView(done(), total, quiet=options.quiet, about=_about(entries, at_once))
    try:
        found = EntryRun(entries[0], progress).run()
    except KeyboardInterrupt:
        print(AGAIN, file=sys.stderr)
        return STOPPED
    finally:
        view.close()
    print(f"{len(found.matches)} of {len(found.planned)} matches in {found.folder}")
    return 0


def _place(options: argparse.Namespace) -> Path:
    """Return the folder of results in the arguments."""
    if len(options.names) > 1:
        raise TrainingError(f"benchmark {options.action} takes one folder of results: leave out {options.names[1]}")
    return Path(options.names[0]) if options.names else RESULTS


def _score(options: argparse.Namespace) -> int:
    """Write the scores. Return 2 if planned values are missing, otherwise 0."""
    from ..benchmark import manifest, result, scores

    place = _place(options)
    found = scores.scores([manifest.read(place)])
    result.write_json(place / scores.NAME, found)
    print(*scores.lines(found), place / scores.NAME, sep="\n")
    if gone := scores.absent(found):
        print(f"{gone} planned values are missing: run `outlast benchmark run {place}`", file=sys.stderr)
    return 2 if gone else 0


def _verify(options: argparse.Namespace) -> int:
    """Verify. Return exit status 1 if anything is wrong, 2 if anything could not be verified, otherwise 0."""
    from ..benchmark import manifest, scores
    from ..benchmark.verify import opened, verify

    if options.action == "check" and not options.names:
        raise TrainingError("benchmark check needs archives that `outlast benchmark pack` made, as in: check mine.zip")
    fine, wrong, missing = "as recorded", "wrong", "not verified"
    counts = {fine: 0, wrong: 0, missing: 0}
    for name in options.names or [RESULTS]:
        with opened(Path(name)) as place:
            if options.action == "check":
                made = manifest.read(place)
                print(f"{name}: {Path(name).stat().st_size / 1e6:.1f} MB, track {made.track or 'none'}")
                with contextlib.suppress(TrainingError):  # which verification reports
                    print(*scores.lines(scores.scores([made])), sep="\n")
            for found in verify(place, options.jobs, options.only):
                kind = wrong if found.wrong else missing if found.missing else fine
                counts[kind] += 1
                if not options.quiet or kind == wrong or (kind == missing and not options.allow_missing):
                    print(found, flush=True)
    print(f"{sum(counts.values())} checks:", ", ".join(f"{number} {name}" for name, number in counts.items()))
    if counts[missing] and not options.allow_missing:
        print("not all is verified: put the missing files back, or take --allow-missing", file=sys.stderr)
    return 1 if counts[wrong] else 2 if counts[missing] and not options.allow_missing else 0


def _pack(options: argparse.Namespace) -> None:
    """Write an archive."""
    from ..benchmark.verify import pack

    place = _place(options)
    out = options.out or place.resolve().with_suffix(".zip")
    print(f"{out}: {pack(place, out, options.small) / 1e6:.2f} MB")


def _table(options: argparse.Namespace) -> None:
    """Write the tables, and print their paths."""
    from ..benchmark import manifest, people, scores, table
    from ..benchmark.verify import opened

    names = [Path(name) for name in options.names] or [RESULTS]
    with contextlib.ExitStack() as stack:
        places = [stack.enter_context(opened(name)) for name in names]
        found = scores.scores([manifest.read(place) for place in places])
        games = [own for place in places for own in people.read(place)]
        print(*table.write(found, games, options.out or (names[0] if names[0].is_dir() else Path())), sep="\n")


def _people(options: argparse.Namespace) -> None:
    """Add the games of a person."""
    from ..benchmark import people, table

    if not options.names or len(options.agent) != 1:
        raise TrainingError("benchmark people needs recordings and a name, as in: benchmark people a.rec --agent you")
    games = people.add(options.out or RESULTS, options.agent[0], [Path(name) for name in options.names])
    print(text_table(people.rows(games), table.PEOPLE_HEADS, width=terminal_width()))


def _anchors(options: argparse.Namespace) -> None:
    """Rate checkpoints, for maintainers of the benchmark."""
    from ..benchmark.suite import make

    if len(options.names) != 1 or not options.policies or options.out is None:
        raise TrainingError("benchmark anchors needs a task, --policies and --out")
    with Progress(0, "matches", quiet=options.quiet) as progress:
        print(make(task_of(options.names[0]), options.policies, options.out, options.games, progress.show))


def _situations(options: argparse.Namespace) -> None:
    """Print which situations policies pass."""
    from ..arena.players import contenders
    from ..benchmark import situations

    if len(options.names) != 1:
        raise TrainingError("benchmark situations needs a task, as in: situations teams_3-v2 --policies scripted")
    task, policies = task_of(options.names[0]), [str(path) for path in options.policies]
    chosen = [None, *(contenders(policies) if policies else [])]
    with Progress(len(chosen) * len(situations.SITUATIONS), "scenes", quiet=options.quiet) as progress:
        columns = [situations.shares(task.scenario, each, progress.add) for each in chosen]
    heads = ("situation", *("solution" if each is None else each.label for each in chosen))
    print(text_table(situations.table(columns), heads, width=terminal_width()))


NAMES = ("tasks", "plan", "run", "score", "verify", "pack", "check", "table", "situations", "people", "anchors")
WHAT = (_tasks, _plan, _run, _score, _verify, _pack, _verify, _table, _situations, _people, _anchors)
ACTIONS: dict[str, Callable[[argparse.Namespace], int | None]] = dict(zip(NAMES, WHAT, strict=True))
