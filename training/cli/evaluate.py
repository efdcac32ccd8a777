"""outlast evaluate: policies play against each other; win rates, ratings, behaviour."""

import argparse
import logging
import time
from typing import Any

from outlast.envs.cli.grammar import add_command
from outlast.envs.cli.options import STOPPED, add_options, add_scenario, given_options, output, scenario
from outlast.envs.errors import needed
from outlast.envs.rollout.lineup import OWN_AS
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.rollout.saved import SAVED_AS
from outlast.envs.text_table import terminal_width

from ..base.config import PLAYED, EvaluationOptions
from ..base.errors import TrainingError
from ..base.files import check_out
from ..base.quantities import explained

FEW = 4  # policies, whose columns are 16 lines
logger = logging.getLogger("outlast")


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(commands, "evaluate", run)
    columns = "\n".join(explained())
    about = "columns ('it' is the policy of the row), each with its standard error over games:"
    command.epilog = f"{command.epilog}\n\n{about}\n{columns}"
    add_scenario(command)
    text = f"who plays: {', '.join(POLICIES)}, a saved policy ({SAVED_AS}), {OWN_AS} of your own, or a folder of "
    text += "several runs, whose newest checkpoints play"
    command.group(PLAYED).add_argument("policies", nargs="+", metavar="POLICY", help=text)
    add_options(command, EvaluationOptions, out={"type": output(check_out)})


def run(options: argparse.Namespace) -> int:
    """Let policies play against each other, and rate them.

    Let every policy play against every other one and against itself, and print win rates, ratings and behaviour. Runs
    that differ only in their seeds are also rated as one group, with intervals over seeds.

    Examples:
        evaluate ffa_2 runs/ffa_2-fast-0 scripted random  # the newest policy of a run, against two others
        evaluate ffa_2 runs --episodes 200 --out evaluation
            # the newest policies of all runs in a folder; write tables
        evaluate teams_2 runs/teams_2-fast-0/steps_0010000000.zip scripted --out duel --film
            # one checkpoint; write films, too
    """
    with needed("train", "evaluating needs {}", TrainingError):
        from ..arena import evaluation as arena
    given, status = given_options(options, EvaluationOptions), 0
    numbers = {name: given[name] for name in ("episodes", "worlds", "seed", "threads")}
    game = scenario(options)
    with arena.opened(game, options.policies, options.out, options.film, **numbers) as (evaluation, folder, hidden):
        start = time.perf_counter()
        try:
            arena.play(evaluation, folder, hidden, quiet=options.quiet)
        except KeyboardInterrupt:
            status, complete = STOPPED, len(evaluation.pairings)
            logger.warning("stopped; %d of %d pairings are complete", complete, len(evaluation.pairs))
        finally:
            most = None if folder is None else FEW  # columns of many policies would take a hundred lines
            print(arena.text(evaluation, terminal_width(), most))
            print(f"\n{time.perf_counter() - start:,.0f} s", flush=True)
            if folder is not None and evaluation.pairings:
                print("", *arena.write_tables(evaluation, folder), sep="\n", flush=True)
        try:
            for path in arena.films(evaluation, hidden, folder) if hidden and folder and not status else ():
                print(path, flush=True)
        except KeyboardInterrupt:
            logger.warning("stopped; the tables are written, not all films are")
            return STOPPED
    return status
