"""outlast rollout: run a policy in many worlds and print the episodes' statistics."""

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from outlast.ecs.kernels.errors import OutlastError

from ..api.make import make_vec
from ..api.options import RolloutOptions
from ..api.rollout import check_files, prepared, worlds_of
from ..core.options import MACHINE, OUTPUT
from ..errors import ClusterError, UsageError, needed
from ..progress import Progress
from ..rollout.local import RolloutTask
from ..rollout.policies import POLICIES
from ..rollout.summary import Summary
from ..rollout.table_file import check_table
from ..scenarios.scenario import Scenario
from ..scenarios.scenario_json import plain, same_for_all
from ..storage.atomic_write import atomic_write
from ..storage.outputs import check_file, written_to
from .options import CLUSTER, STDOUT, STOPPED, add_options, add_quiet, add_scenario, messages_shown, printable, scenario
from .options import output as written

Work = Callable[[Callable[[Summary], None]], Summary]  # rolls out, and calls what it is given after every step


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("rollout ffa_2 --policy scripted", "one episode in each of 1024 worlds"),
        (
            "rollout teams_3 --worlds 64 --record fights.rec --csv fights.csv",
            "a recording to replay, and a table with a row for each episode",
        ),
        (
            "rollout ffa_2 --policy scripted --others random,FILE.zip --json -",
            "how often it wins against each of the others, as JSON",
        ),
    ]
    description = (
        "Play complete episodes in many worlds, the same number in each, and print means and standard errors of their "
        "statistics. With --steps, every world plays a fixed number of steps instead. Episodes that have not ended by "
        "then do not count, so the means lean towards short episodes."
    )
    text = "run a policy in many worlds and print the episodes' statistics"
    command = commands.add_parser("rollout", help=text, description=description, examples=examples, run=run)
    add_scenario(command)
    csv, events = (partial(check_table, what=what) for what in ("episodes", "events"))
    add_options(command, RolloutOptions, csv={"type": written(csv)}, events={"type": written(events)})
    output = command.group(OUTPUT)
    text = "write the statistics and the options of the rollout to a new file, NAME.json; with -, print them instead "
    text += "of the table"
    output.add_argument("--json", type=_summary, metavar="FILE", help=text)
    output.add_argument("--log-deaths", action="store_true", help="print a line for every death, on standard error")
    add_quiet(command)
    text = f"play on the Ray cluster at ADDRESS; {CLUSTER} (default: no cluster)"
    command.group(MACHINE).add_argument("--ray", nargs="?", const="", metavar="ADDRESS", help=text)


def _summary(text: str) -> str:
    """Return the file of a summary, or STDOUT."""
    check = partial(check_file, what="summaries", error=UsageError, endings=(".json",), new=True)
    return text if text == STDOUT else written(check)(text)


def run(options: argparse.Namespace) -> int:
    """Roll out and report; the exit status."""
    if options.steps and options.episodes:
        raise UsageError("--steps and --episodes exclude each other: give one of them")
    options.episodes = options.episodes or 1
    deaths = messages_shown("outlast.deaths", "%(message)s") if options.log_deaths else contextlib.nullcontext()
    asked, place, out = scenario(options), _here if options.ray is None else _on_ray, sys.stdout
    with deaths:
        played: Played | None = None
        try:
            with place(options, asked) as (agents, work):
                played = _play_with_bar(options, agents, work)
                if played.failure is not None:
                    raise played.failure
        finally:  # its files are complete, even if printing fails
            if played is not None and (played.failure is None or played.summary.world_steps):
                _report(options, asked, played, out)
        return played.status


@contextlib.contextmanager
def _here(options: argparse.Namespace, asked: Scenario) -> Iterator[tuple[int, Work]]:
    """Yield the number of agents in a world, and what rolls out on this machine."""
    settings = {name: getattr(options, name) for name in ("seed", "threads", "specialize", "interpret")}
    files = {name: getattr(options, name) for name in ("record", "record_policy", "events", "csv")}
    check_files(**files)
    made = worlds_of(asked, options.policy, options.others, options.worlds, **settings)
    with contextlib.closing(made[0]), prepared(*made, steps=options.steps, episodes=options.episodes, **files) as play:
        yield made[0].num_agents, play


@contextlib.contextmanager
def _on_ray(options: argparse.Namespace, asked: Scenario) -> Iterator[tuple[int, Work]]:
    """Yield the same on a Ray cluster."""
    here = ("log_deaths", "record", "record_policy", "events", "csv", "specialize", "interpret")
    if options.threads > 1 or any(getattr(options, name) for name in here):
        given = "--threads, --log-deaths, --record, --record-policy, --events, --csv, --specialize and --interpret"
        raise ClusterError(f"{given} are for one machine: leave them out with --ray")
    if options.others:
        raise ClusterError("--others plays on one machine: leave it out with --ray")
    if options.policy not in POLICIES:
        raise ClusterError(f"--policy {options.policy} plays on one machine: leave out --ray")
    with needed("ray", "--ray needs Ray", ClusterError):
        from ..rollout import ray as cluster  # here, as Ray takes seconds to load
    with contextlib.closing(make_vec(asked, 1, seed=options.seed)) as env:  # compiles the tick once, for all workers
        agents = env.num_agents
    task = RolloutTask(asked, POLICIES[options.policy], options.steps, options.seed, options.episodes)
    with contextlib.redirect_stdout(sys.stderr), cluster.connected(options.ray):  # Ray writes of lost workers there
        yield agents, lambda progress: cluster.rollout_on_cluster(task, options.worlds, progress)


@dataclass(frozen=True)
class Played:
    """A rollout that was played, and how it ended."""

    summary: Summary
    agents: int  # in a world
    seconds: float
    status: int  # of the command
    failure: Exception | None  # what stopped it, such as a full disk


def _play_with_bar(options: argparse.Namespace, agents: int, work: Work) -> Played:
    """Do the work behind a progress bar, as far as it gets."""
    start = time.perf_counter()
    unit, each = ("world-steps", options.steps) if options.steps else ("episodes", options.episodes)
    latest = Summary()

    def show(summary: Summary) -> None:
        nonlocal latest
        latest = summary
        rate = summary.world_steps * agents / (time.perf_counter() - start)
        note = f"{rate:,.0f} agent-steps/s"
        progress.show(summary.world_steps if options.steps else summary.episodes, note=note)

    status, failure = 0, None
    try:
        with Progress(options.worlds * each, unit, quiet=options.quiet) as progress:
            latest = work(show)
    except KeyboardInterrupt as stop:
        latest, status = stop.args[0] if stop.args else Summary(), STOPPED
    except (OutlastError, OSError) as error:  # as where the disk is full
        failure = error
    return Played(latest, agents, time.perf_counter() - start, status, failure)


def _report(options: argparse.Namespace, asked: Scenario, played: Played, out: TextIO) -> None:
    """Write the JSON file that is asked for, and print the table or the JSON to `out`. Raises UsageError."""
    found = played.summary, played.seconds, played.agents
    if options.json == STDOUT:
        print(_as_json(options, asked, *found), end="", file=out)
        return
    try:
        if options.json is not None:
            with (
                written_to(options.json, UsageError, "; the summary is not written"),
                atomic_write(Path(options.json), new=True) as place,
            ):
                place.write_text(_as_json(options, asked, *found), encoding="utf-8")
    finally:  # a full disk costs no table
        print(_heading(options, asked, *found), played.summary, sep="\n", file=out)


def _heading(options: argparse.Namespace, asked: Scenario, summary: Summary, seconds: float, agents: int) -> str:
    each, done = options.steps or options.episodes, summary.world_steps
    against = " against " + ", ".join(map(printable, options.others)) if options.others else ""
    unit = f"{'step' if options.steps else 'episode'}{'s' if each > 1 else ''}"
    return (
        f"{asked.name}: {printable(options.policy)} policy{against}, seed {options.seed}, "
        f"{options.worlds} worlds x {each} {unit}\n"
        f"{done:,} world-steps in {seconds:.1f} s: {done / seconds:,.0f} world-steps/s, "
        f"{done * agents / seconds:,.0f} agent-steps/s{_shares(summary, seconds) if options.ray is None else ''}"
    )


def _shares(summary: Summary, seconds: float) -> str:
    """Describe the shares of time: the policy, the worlds, and the rest, which is statistics and files."""
    parts = {**summary.seconds, "rest": seconds - sum(summary.seconds.values())}
    return " (" + ", ".join(f"{name} {part / seconds:.0%}" for name, part in parts.items()) + ")"


def _as_json(options: argparse.Namespace, asked: Scenario, summary: Summary, seconds: float, agents: int) -> str:
    """Return what was asked for, by the options' names, then the summary's numbers."""
    import outlast  # here, as the package imports the environments

    names = ("policy", "others", "seed", "worlds", "episodes", "steps")
    given = {name: getattr(options, name) for name in names}
    given["episodes" if options.steps else "steps"] = None
    about = {"outlast": outlast.__version__, "scenario": asked.name, "numbers": same_for_all(asked), **plain(asked)}
    about |= {"agents": agents, "asked": given, "seconds": seconds, "seconds_of": summary.seconds}
    return json.dumps(about | summary.as_dict(), indent=2) + "\n"
