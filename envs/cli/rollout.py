"""outlast rollout: run a policy in many worlds and print the episodes' statistics."""

import argparse
import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

from tqdm import tqdm

from ..core.make import make_vec
from ..errors import ClusterError
from ..recording import record
from ..rollout.against import Against
from ..rollout.event_file import event_file
from ..rollout.local import Task, rollout
from ..rollout.mixture import Mixture
from ..rollout.policies import POLICIES, Policy
from ..rollout.summary import Summary
from ..scenarios.scenario import Scenario
from .options import (
    add_common,
    add_number,
    add_others,
    add_policy,
    add_scenario,
    add_seed,
    load_policies,
    maker,
    messages_shown,
    scenario,
)

Work = Callable[[Callable[[Summary], None]], Summary]  # rolls out, and calls what it is given after every step
Chosen = list[str | Policy]  # names or loaded policies: --policy, then those of --others


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("rollout", help="run a policy in many worlds and print the episodes' statistics")
    add_scenario(command)
    add_number(command, "--worlds", 1024, "number of worlds")
    length = command.add_mutually_exclusive_group()
    add_number(length, "--episodes", 1, "whole episodes of each world")
    add_number(length, "--steps", "none", "steps of each world instead; means then lean towards short episodes")
    add_policy(command, "random")
    add_others(command, None, "who plays all sides but one, which changes from world to world and episode to episode")
    add_seed(command)
    text = "write what happened, who hit, killed, used, gave or broke what, into a new file, NAME.csv or NAME.parquet"
    command.add_argument("--events", metavar="FILE", help=text)
    text = "run this system, such as melee.aim, as Python, for breakpoints and print; may be repeated"
    command.add_argument("--interpret", metavar="SYSTEM", action="append", default=[], help=text)
    command.add_argument("--log-deaths", action="store_true", help="print a line on stderr for every death")
    add_common(command, "--threads", "--record", "--quiet")
    text = "use the Ray cluster at ADDRESS, or the one on this machine (default: no cluster)"
    command.add_argument("--ray", nargs="?", const="", metavar="ADDRESS", help=text)
    command.set_defaults(run=run, steps=0)


def run(options: argparse.Namespace) -> int:
    """Roll out and report; the exit status."""
    deaths = messages_shown("outlast.deaths", "%(message)s") if options.log_deaths else contextlib.nullcontext()
    place = _here if options.ray is None else _on_ray
    chosen = load_policies([options.policy, *(options.others or ())], scenario(options), options.seed)
    with deaths, place(options, *chosen) as (agents, work, results):
        return _run_with_bar(options, chosen[0].name, agents, work, results)


@contextlib.contextmanager
def _here(options: argparse.Namespace, asked: Scenario, chosen: Chosen) -> Iterator[tuple[int, Work, Against | None]]:
    """The number of agents in a world, what rolls out on this machine, and what counts wins, with --others."""
    env = make_vec(
        asked,
        options.worlds,
        seed=options.seed,
        threads=options.threads,
        copy=False,
        check_actions=False,
        interpret=options.interpret,
    )
    with contextlib.closing(env):
        policy, against = maker(chosen[0])(env, options.seed), None
        if options.others:
            entries = list(zip(chosen[1:], options.others.values(), strict=True))
            against = policy = Against(env, policy, Mixture(entries, env, range(env.num_agents), list(options.others)))
        if options.record is not None:
            record(env, options.record)
        with event_file(options.events, env.worlds.layout) if options.events else contextlib.nullcontext() as file:

            def watch(where: Any) -> None:
                if file:
                    file.add(env.events(), where)
                if against:
                    against.watch(where)

            settings = {"episodes": options.episodes, "watch": watch if file or against else None}
            yield env.num_agents, lambda progress: rollout(env, policy, options.steps, progress, **settings), against


@contextlib.contextmanager
def _on_ray(options: argparse.Namespace, asked: Scenario, chosen: Chosen) -> Iterator[tuple[int, Work, None]]:
    """The same on a Ray cluster."""
    if options.threads > 1 or any((options.log_deaths, options.record, options.events, options.interpret)):
        given = "--threads, --log-deaths, --record, --events and --interpret"
        raise ClusterError(f"{given} are for one machine: leave them out with --ray")
    if options.others:
        raise ClusterError("--others plays on one machine: leave it out with --ray")
    if options.policy not in POLICIES:
        raise ClusterError(f"--policy {options.policy}: a saved policy plays on one machine: leave out --ray")
    try:
        from ..rollout import ray as cluster  # here, as Ray takes seconds to load
    except ModuleNotFoundError as error:
        raise ClusterError(str(error)) from error
    with contextlib.closing(make_vec(asked, 1, seed=options.seed)) as env:  # compiles the tick once, for all workers
        agents = env.num_agents
    task = Task(asked, POLICIES[options.policy], options.steps, options.seed, options.episodes)
    with cluster.connected(options.ray):
        yield agents, lambda progress: cluster.rollout_on_cluster(task, options.worlds, progress), None


def _run_with_bar(options: argparse.Namespace, name: str, agents: int, work: Work, results: Against | None) -> int:
    """Do the work behind a progress bar and report; the exit status."""
    start = time.perf_counter()
    unit, each = ("world-step", options.steps) if options.steps else ("episode", options.episodes)
    total, scale = options.worlds * each, bool(options.steps)
    bar = tqdm(total=total, unit=unit, unit_scale=scale, miniters=0, disable=options.quiet)  # 0: also between ends

    def progress(summary: Summary) -> None:
        done = summary.world_steps if options.steps else summary.episodes
        if bar.update(done - bar.n):  # it redrew itself
            rate = summary.world_steps * agents / (time.perf_counter() - start)
            bar.set_postfix_str(f"{rate:,.0f} agent-steps/s", refresh=False)

    status = 0
    try:
        summary = work(progress)
    except KeyboardInterrupt as stop:
        summary, status = stop.args[0] if stop.args else Summary(), 130
    seconds = time.perf_counter() - start
    bar.close()
    _report(options, name, summary, seconds, agents)
    if results:
        print(f"\n{results}")
    return status


def _report(options: argparse.Namespace, name: str, summary: Summary, seconds: float, agents: int) -> None:
    each, done = options.steps or options.episodes, summary.world_steps
    against = " against " + ", ".join(options.others) if options.others else ""
    print(f"{name}: {options.policy} policy{against}, seed {options.seed}, {options.worlds} worlds x ", end="")
    print(f"{each} {'step' if options.steps else 'episode'}{'s' if each > 1 else ''}")
    print(f"{done:,} world-steps in {seconds:.1f} s: {done / seconds:,.0f} world-steps/s, ", end="")
    print(f"{done * agents / seconds:,.0f} agent-steps/s (policy included)")
    print(summary)
