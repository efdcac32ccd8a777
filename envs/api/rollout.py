"""outlast.rollout: a rollout in one call. The command `outlast rollout` is a front end to it."""

import contextlib
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np
from gymnasium.vector import AutoresetMode

from ..core.validation import Array, check_count
from ..core.vector_env import SurvivalVectorEnv
from ..errors import UsageError
from ..recording import record as record_env
from ..rollout import lineup, local
from ..rollout.lineup import Against, Entries, Other, Others, entries_of
from ..rollout.memory import check_memories
from ..rollout.policies import Policy, plain
from ..rollout.summary import Summary
from ..rollout.table_file import Ended, episode_file, event_file, numbered, with_episodes
from ..scenarios.known_numbers import Numbers
from ..scenarios.parse import checks_keywords, options_of, resolve
from ..scenarios.scenario import Scenario
from ..storage.interrupts import left_whole
from .make import make_vec
from .options import MACHINE, OUTPUT, PLAY, option

WORLDS = 1024  # how many worlds play by default

File = str | os.PathLike[str]
Progress = Callable[[Summary], None]
Watch = Callable[[Array], None]
Play = Callable[[Progress], Summary]


@checks_keywords
def rollout(
    game: str | Scenario | SurvivalVectorEnv,
    policy: Other = "random",
    steps: int = 0,
    progress: Progress = lambda summary: None,
    *,
    worlds: int | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    threads: int | None = None,
    others: Others | None = None,
    record: File | None = None,
    record_policy: bool = False,
    events: File | None = None,
    csv: File | None = None,
    keep: bool = False,
    specialize: bool = False,
    interpret: Collection[str] = (),
    watch: Watch | None = None,
    **numbers: Unpack[Numbers],
) -> Summary:
    """Play complete episodes, the same number in every world, and summarise them.

    >>> print(outlast.rollout("ffa_2", "scripted", worlds=256, melee_damage=20))
    >>> print(outlast.rollout("mygame.py:arena", "runs/arena-fast-0/steps_0010000000.zip", others="scripted"))

    Worlds that have finished their episodes go on until all worlds have; their further episodes are not counted. Saved
    policies run on one thread of PyTorch, as their networks are too small for more; after each of their calls, PyTorch
    has its former number of threads again.

    Args:
        game: A scenario or its name: that of a variant ("ffa_2+steering"), FILE.py:NAME, package.module:NAME. Or an
            environment from make_vec: all of its worlds are reset, and it stays open. As it determines them, `worlds`,
            `seed`, `threads`, `specialize`, `interpret` and numbers are then refused.
        policy: Who plays: random, noop, scripted, camper, hunter, hoarder, healer, a saved policy (a model's name,
            FILE.zip, FILE.safetensors or the folder of a run, whose newest checkpoint is taken), or FILE.py:FUNCTION of
            your own. In Python also a function from the observations to the actions of all worlds; if it has a method
            `reset`, that is called with the worlds in which an episode begins, bool (worlds,), before it acts there.
        steps: Steps to play in each world, instead of episodes (default: none). Episodes that end in them count, so
            that means lean towards short ones.
        progress: Called after every step with the summary so far, the object that is returned in the end.
        worlds: Number of worlds (default 1024).
        episodes: Episodes to play in each world (default: 1).
        seed: Seed of all random numbers: the same seed gives the same episodes (default 0).
        threads: Threads that share the worlds, with the same results (default 1).
        others: Opponents of the policy, which plays one side, another one in each episode, while they play all others:
            a policy, or several with weights, as in scripted:0.5,FILE.zip:0.5, of which one is drawn for each episode
            of each world (default: the policy plays all sides). Also as a dict: {policy: weight}. `outcomes` of the
            summary counts who wins against each.
        record: Record every tick in a new file, for `outlast replay FILE`.
        record_policy: Whether to record, with the ticks, the action probabilities, values and attention of a saved
            policy, which pages of `outlast replay --html` show.
        events: Write a table of events (who hit, killed, used, gave or broke what) to a new file, NAME.csv or
            NAME.parquet.
        csv: Write a table with a row for each episode and all its statistics to a new file, NAME.csv or NAME.parquet.
        keep: Whether to keep the statistics of each episode, for `arrays` of the summary.
        specialize: Whether to compile for this game alone: steps are faster, but compiling takes some ten seconds the
            first time.
        interpret: Run this system, such as melee.aim, as Python, so that breakpoints and print work in it. In Python a
            list of them.
        watch: Called after the reset and after every step with the worlds that still count, bool (worlds,).
        **numbers: Numbers of the scenario to change, as for `Scenario.replace`.

    Returns:
        Means and standard errors of all statistics; `str` turns them into a table.

    Raises:
        ScenarioError: The scenario is unknown.
        NumberError: A number is out of its range, or does not exist (then it is a KeywordError).
        ValueError: A count is out of its range.
        UsageError: A policy does not exist or cannot play there, options exclude each other, or a file cannot be
            written.
        RecordingError: The recording cannot be written. The last call of `progress` got the summary so far.
        EndlessError: A world without a limit was in one episode for 100,000 steps. Not with `steps`.
        KeyboardInterrupt: After Ctrl-C, with the summary so far as its argument; files of events and episodes contain
            everything up to then.
    """
    asked = {"steps": steps, "worlds": worlds, "episodes": episodes, "threads": threads, "seed": seed}
    for name, count in asked.items():
        if count is not None:
            check_count(name, count, 0 if name in ("steps", "seed") else 1)
    if steps and episodes is not None:
        raise UsageError("rollout: steps and episodes exclude each other; give one of them")
    check_files(record, record_policy, events, csv)
    stopped = None
    with contextlib.ExitStack() as stack:
        if isinstance(game, SurvivalVectorEnv):
            decided = {"specialize": specialize or None, "interpret": interpret or None, **numbers}
            if game.autoreset_mode is AutoresetMode.DISABLED:
                raise UsageError(
                    "rollout: the environment has autoreset_mode='Disabled', and worlds must go on by themselves: make "
                    "it with 'NextStep' or 'SameStep'"
                )
            check_decided("the environment", UsageError, worlds=worlds, seed=seed, threads=threads, **decided)
            entries = _entries(policy, others)
            made = game, *_playing(game, lineup.loaded([each for each, _ in entries], 0), entries, 0)
        else:
            settings: dict[str, Any] = {"seed": seed or 0, "threads": threads or 1}
            settings |= {"specialize": specialize, "interpret": interpret}
            made = worlds_of(resolve(game, numbers, options_of(rollout)), policy, others, worlds or WORLDS, **settings)
            stack.enter_context(contextlib.closing(made[0]))
        files: dict[str, Any] = {"record": record, "record_policy": record_policy, "events": events, "csv": csv}
        files |= {"steps": steps, "episodes": episodes or 1}
        play = stack.enter_context(prepared(*made, keep=keep, watch=watch, **files))
        try:
            return play(progress)
        except KeyboardInterrupt as stop:
            stopped = stop  # raised after the files are closed, so that they are complete
    raise stopped


@dataclass(frozen=True)
class RolloutOptions:
    """The options of `outlast.rollout` that are flags."""

    described = rollout
    worlds: int = option(WORLDS, PLAY, metavar="N", least=1)
    episodes: int | None = option(None, PLAY, metavar="N", least=1)
    steps: int = option(0, PLAY, metavar="N", least=1)
    policy: str = option("random", PLAY, metavar="NAME")
    others: str | None = option(None, PLAY, metavar="NAMES")
    seed: int = option(0, PLAY, metavar="N", least=0, most=2**64 - 1)
    csv: str | None = option(None, OUTPUT, metavar="FILE")
    events: str | None = option(None, OUTPUT, metavar="FILE")
    record: str | None = option(None, OUTPUT, metavar="FILE")
    record_policy: bool = option(False, OUTPUT)
    threads: int = option(1, MACHINE, metavar="N", least=1)
    specialize: bool = option(False, MACHINE)
    interpret: Collection[str] = option((), MACHINE, metavar="SYSTEM", many=True)


def worlds_of(
    asked: Scenario, policy: Other, others: Others | None, worlds: int, **settings: Any
) -> tuple[SurvivalVectorEnv, Policy, Against | None]:
    """Make worlds in which all policies can play; also return what `_playing` does. settings: of make_vec."""
    entries = _entries(policy, others)
    names = [each for each, _ in entries]
    fitting, players = lineup.load_policies(names, asked, settings["seed"])
    foreign = any(map(lineup.is_foreign, names))
    env = make_vec(fitting, worlds, copy=foreign, check_actions=foreign, **settings)
    try:
        return env, *_playing(env, players, entries, settings["seed"])
    except BaseException:
        env.close()
        raise


def _entries(policy: Other, others: Others | None) -> Entries:
    """Return the policy and the others, with weights. Raises UsageError if any is not valid."""
    entries = [*lineup.checked_entries([(policy, 1)]), *([] if others is None else entries_of(others))]
    check_memories([each for each, _ in entries])
    return entries


def _playing(
    env: SurvivalVectorEnv, players: Sequence[str | Policy], entries: Entries, seed: int
) -> tuple[Policy, Against | None]:
    """Return the policy of all agents of these worlds, and the same, if there are others, as it counts who wins."""
    for player in players:
        if callable(check := getattr(player, "check", None)):
            check(plain(env))
    policy = lineup.maker(players[0])(env, seed)
    if len(players) == 1:
        return policy, None
    if env.autoreset_mode is not AutoresetMode.NEXT_STEP:
        raise UsageError(
            f"rollout: with others, worlds must begin their next episode in the step after the end, and those of the "
            f"environment have autoreset_mode={env.autoreset_mode.value!r}: who won could not be seen"
        )
    plain(env)
    weighted = [(player, weight) for player, (_, weight) in zip(players[1:], entries[1:], strict=True)]
    against = Against(env, policy, lineup.Lineup(weighted, env, names=_titles([each for each, _ in entries[1:]])))
    return against, against


@contextlib.contextmanager
def prepared(
    env: SurvivalVectorEnv,
    policy: Policy,
    against: Against | None,
    *,
    record: File | None,
    record_policy: bool,
    events: File | None,
    csv: File | None,
    keep: bool = False,
    watch: Watch | None = None,
    steps: int,
    episodes: int,
) -> Iterator[Play]:
    """Open the files of a rollout, and yield a function that plays the steps, or else episodes, of these worlds.

    Raises UsageError for a file that cannot be written; after Ctrl-C, when all files are complete, KeyboardInterrupt,
    with the summary as its argument if it came behind the last step.
    """
    thinks, plays = (against.policy, against.plays) if against else (policy, None)
    watchers = [each for each in (watch, against and against.watch) if each]
    numbers = np.ones(env.num_worlds, np.int64)  # number of the episode that each world is in
    parts = list[Summary]()
    try:
        with left_whole() as stack:
            if record is not None:
                thought: dict[str, Any] = {"policy": thinks, "plays": plays} if record_policy else {}
                stack.enter_context(record_env(env, record, episodes=0 if steps else episodes, **thought))
            if events is not None:
                add_events = stack.enter_context(event_file(os.fspath(events), env.worlds.layout, env.first_world))
                watchers.append(lambda where: add_events(with_episodes(env.events(), numbers), where))
            ended: list[Ended[None]] = []
            if csv is not None:
                ended.append(stack.enter_context(episode_file(os.fspath(csv), env, numbers, against)))
            kept: list[dict[str, Array]] | None = [] if keep else None
            if kept is not None:
                rows, add = numbered(env, numbers, against), kept.append
                ended.append(lambda info, where: add(rows(info, where)) if where.any() else None)

            def look(where: Array) -> None:
                for watcher in watchers:
                    watcher(where)

            def note(info: Mapping[str, Any], where: Array) -> None:
                for each in ended:
                    each(info, where)
                numbers[where] += 1

            def play(progress: Progress) -> Summary:
                def progressed(summary: Summary) -> None:
                    summary.outcomes, summary.kept = against.outcomes if against else {}, kept
                    progress(summary)

                watched = look if watchers else None
                parts.append(
                    local.rollout(env, policy, steps, progressed, episodes=episodes, watch=watched, ended=note)
                )
                return parts[-1]

            yield play
    except KeyboardInterrupt as stop:
        if stop.args or not parts:
            raise
        raise KeyboardInterrupt(parts[-1]) from None


def _titles(policies: Sequence[str | Policy]) -> list[str]:
    """Return a name for each policy, no two the same."""
    titles: list[str] = []
    for each in policies:
        title = each if isinstance(each, str) else getattr(each, "__name__", type(each).__name__)
        titles.append(title if title not in titles else f"{title} {len(titles) + 1}")
    return titles


def check_files(record: File | None, record_policy: bool, events: File | None, csv: File | None) -> None:
    """Raise UsageError, before worlds are made, for `record_policy` alone or one file for two things."""
    if record_policy and record is None:
        raise UsageError("record_policy (--record-policy) is about recordings: name a file to record into, too")
    found: dict[str, str] = {}
    for name, path in {"record": record, "events": events, "csv": csv}.items():
        if path is not None and (other := found.setdefault(os.path.realpath(path), name)) != name:
            raise UsageError(f"{other} and {name} are both {os.fspath(path)}: give another name for one")


def check_decided(what: str, error: type[Exception], **given: Any) -> None:
    """Raise the error if options are given that a recording or an environment, `what`, has decided."""
    if decided := [name for name, value in given.items() if value is not None]:
        raise error(f"{', '.join(decided)}: {what} has that already; leave it out, or give a scenario")
