"""The command line: outlast rollout | variants | schedule."""

import argparse
import contextlib
import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence

from tqdm import tqdm

from outlast.ecs import EngineError, Worlds

from .errors import ClusterError
from .make import make_vec
from .policies import POLICIES
from .rollout import Summary, Task, rollout
from .scenario import Scenario, ScenarioError
from .variants import ALIASES, VARIANTS, variant

Work = Callable[[Callable[[int], None]], Summary]  # rolls out, and tells how many world-steps are done


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status. Errors of use are one line on stderr and status 2."""
    options = parser().parse_args(arguments)
    try:
        return int(options.run(options))
    except (ScenarioError, EngineError, ClusterError) as error:
        print(f"outlast: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # as in `outlast schedule ffa_1 | head`
        return 0


def parser() -> argparse.ArgumentParser:
    """The command line's grammar."""
    top = argparse.ArgumentParser(prog="outlast", description="Multi-agent survival worlds, thousands at a time.")
    commands = top.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser("rollout", help="run a policy in many worlds and print the episodes' statistics")
    run.add_argument("variant", help="see `outlast variants`")
    run.add_argument("--worlds", type=_positive, default=1024, help="how many worlds (default 1024)")
    run.add_argument("--steps", type=_positive, default=2000, help="steps of each world (default 2000)")
    run.add_argument("--policy", choices=sorted(POLICIES), default="random")
    run.add_argument("--seed", type=int, default=0, help="same seed, same episodes (default 0)")
    run.add_argument("--threads", type=_positive, default=1)
    run.add_argument("--set", action="append", default=[], metavar="NUMBER=VALUE", help="change a number: n_agents=10")
    run.add_argument("--log-deaths", action="store_true", help="print a line for every death")
    run.add_argument("--quiet", action="store_true", help="no progress bar")
    run.add_argument(
        "--ray", nargs="?", const="", metavar="ADDRESS", help="on the Ray cluster at ADDRESS, or one on this machine"
    )
    run.set_defaults(run=_rollout)

    commands.add_parser("variants", help="list the paper's variants").set_defaults(run=_variants)

    table = commands.add_parser("schedule", help="print the tick of a variant as a table")
    table.add_argument("variant")
    table.set_defaults(run=_schedule)
    return top


def _rollout(options: argparse.Namespace) -> int:
    if options.log_deaths:
        logging.basicConfig(level=logging.INFO, format="%(message)s")
    scenario = variant(options.variant).replace(**dict(_assignment(text) for text in options.set))
    with (_here if options.ray is None else _on_ray)(options, scenario) as (agents, work):
        return _watched(options, agents, work)


@contextlib.contextmanager
def _here(options: argparse.Namespace, scenario: Scenario) -> Iterator[tuple[int, Work]]:
    """The number of agents in a world, and what rolls out on this machine."""
    env = make_vec(scenario, options.worlds, seed=options.seed, threads=options.threads, check_actions=False)
    policy = POLICIES[options.policy](env, options.seed)
    with contextlib.closing(env):
        yield env.num_agents, lambda progress: rollout(env, policy, options.steps, progress)


@contextlib.contextmanager
def _on_ray(options: argparse.Namespace, scenario: Scenario) -> Iterator[tuple[int, Work]]:
    """The same on a Ray cluster."""
    if options.threads > 1 or options.log_deaths:
        raise ClusterError("--threads and --log-deaths are for one machine: leave them out with --ray")
    try:
        from . import cluster  # here, as Ray takes seconds to load
    except ModuleNotFoundError as error:
        raise ClusterError(str(error)) from error
    with contextlib.closing(make_vec(scenario, 1, seed=options.seed)) as env:  # compiles the tick once, for all workers
        agents = env.num_agents
    task = Task(scenario, POLICIES[options.policy], options.steps, options.seed)
    with cluster.connected(options.ray):
        yield agents, lambda progress: cluster.rollout(task, options.worlds, progress)


def _watched(options: argparse.Namespace, agents: int, work: Work) -> int:
    """Do the work behind a progress bar and report; the exit status."""
    start = time.perf_counter()
    bar = tqdm(total=options.worlds * options.steps, unit="world-step", unit_scale=True, disable=options.quiet)

    done = 0  # world-steps; a bar that is not shown does not count

    def progress(world_steps: int) -> None:
        nonlocal done
        new, done = world_steps - done, world_steps
        if bar.update(new):  # it redrew itself
            rate = done * agents / (time.perf_counter() - start)
            bar.set_postfix_str(f"{rate:,.0f} agent-steps/s", refresh=False)

    status = 0
    try:
        summary = work(progress)
    except KeyboardInterrupt as stop:
        summary, status = stop.args[0], 130
    seconds = time.perf_counter() - start
    bar.close()
    _report(options, summary, done, seconds, agents)
    return status


def _report(options: argparse.Namespace, summary: Summary, done: int, seconds: float, agents: int) -> None:
    print(f"{options.variant}: {options.policy} policy, seed {options.seed}, ", end="")
    print(f"{options.worlds} worlds x {options.steps} steps")
    print(f"{done:,} world-steps in {seconds:.1f} s: {done / seconds:,.0f} world-steps/s, ", end="")
    print(f"{done * agents / seconds:,.0f} agent-steps/s (policy included)")
    print(f"{summary.episodes:,} episodes ended; those still running are not counted\n\n{summary}")


def _variants(options: argparse.Namespace) -> int:
    for alias, name in ALIASES.items():
        print(f"{name:<9} {alias:<14} {VARIANTS[name].about}")
    return 0


def _schedule(options: argparse.Namespace) -> int:
    print(Worlds(variant(options.variant).modules, 1).schedule)
    return 0


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: a number of at least 1 is needed")
    return value


def _assignment(text: str) -> tuple[str, object]:
    name, _, value = text.partition("=")
    for kind in (int, float):
        try:
            return name, kind(value)
        except ValueError:
            continue
    return name, {"true": True, "false": False}.get(value.lower(), value)


if __name__ == "__main__":
    sys.exit(main())
