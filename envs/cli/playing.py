"""Commands that play and look: rollout, frames, play and replay, and models, which can play."""

import argparse
import contextlib
import dataclasses
import json
import logging
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from outlast.ecs import SKIP
from outlast.ecs.kernels.errors import OutlastError

from ..api.film import PICTURES, REPLAYED, Count, FilmOptions, Looks, film, write_film_of
from ..api.make import make_vec
from ..api.options import MACHINE, OUTPUT
from ..api.play import FASTEST, PageOptions, PlayOptions, play
from ..api.rollout import RolloutOptions, check_files, prepared, worlds_of
from ..datasets.export import check_new, export_dataset
from ..datasets.samples import Selection
from ..errors import ClusterError, RecordingError, ReplayError, UsageError, needed
from ..progress import Progress
from ..recording import Recording, Replay
from ..recording.replay import last_tick, rows_of
from ..rendering.films import check_film
from ..rollout.local import RolloutTask
from ..rollout.policies import POLICIES
from ..rollout.saved import models
from ..rollout.summary import Summary
from ..rollout.table_file import check_table, event_file
from ..scenarios.scenario import Scenario
from ..scenarios.scenario_json import plain, same_for_all
from ..storage.outputs import atomic_write, check_file, written_to
from ..text_table import text_table
from ..web.pages import checked, replay_page
from .grammar import Parser, add_command
from .options import (
    STDOUT,
    STOPPED,
    add_import,
    add_options,
    add_quiet,
    add_scenario,
    given_options,
    import_files,
    messages_shown,
    nonnegative,
    output,
    path,
    positive,
    printable,
    scenario,
)

LOGGER = logging.getLogger(__name__)

Work = Callable[[Callable[[Summary], None]], Summary]  # rolls out, and calls what it is given after every step


def add(commands: Any) -> None:
    """Add these commands to a parser's commands."""
    command = add_command(commands, "rollout", roll_out)
    add_scenario(command)
    csv, events = ({"type": output(partial(check_table, what=what))} for what in ("episodes", "events"))
    add_options(command, RolloutOptions, csv=csv, events=events)
    files = command.group(OUTPUT)
    text = "write the statistics and the options of the rollout to a new file, NAME.json; with -, print them instead "
    text += "of the table"
    files.add_argument("--json", type=_summary_file, metavar="FILE", help=text)
    files.add_argument("--log-deaths", action="store_true", help="print a line for every death, on standard error")
    add_quiet(command)
    text = "play on the Ray cluster at ADDRESS; without ADDRESS, on that of $RAY_ADDRESS, the one on this machine, or "
    text += "a new one here (default: no cluster)"
    command.group(MACHINE).add_argument("--ray", nargs="?", const="", metavar="ADDRESS", help=text)

    command = add_command(commands, "frames", draw_frames)
    add_scenario(command)
    add_options(command, FilmOptions)
    _add_pictures(command, required=True)
    add_quiet(command)

    command = add_command(commands, "play", steer)
    add_scenario(command)
    add_options(command, PlayOptions, fps={"type": _rate})
    add_options(command, PageOptions)

    _add_replay(add_command(commands, "replay", replay))
    add_command(commands, "models", list_models)


def _add_pictures(command: Parser, required: bool) -> None:
    """Add --out and, for it, --size, --mosaic, --views, --every and --fps."""
    text = "what to write: a film, NAME.mp4, NAME.webm, NAME.gif or NAME.apng; or, by any name without an ending, a "
    text += "folder of numbered PNG pictures"
    pictures = command.group(PICTURES)
    pictures.add_argument("--out", type=output(check_film), required=required, metavar="PATH", help=text)
    add_options(command, Looks, mosaic={"type": _grid})


def _add_replay(command: Parser) -> None:
    command.add_argument("file", type=path, help="the recording, made by `outlast rollout VARIANT --record FILE`")
    add_import(command, "the recording uses")
    text = "let the recorded worlds take as much memory as they need; otherwise 1 GiB is the limit, and more for a "
    text += "long file"
    command.add_argument("--trust", action="store_true", help=text)
    _add_pictures(command, required=False)
    files, part = command.group(OUTPUT), command.group("which part")
    text = "write a web page that plays the recording"
    files.add_argument("--html", type=output(checked), metavar="PATH", help=text)
    text = "with --html: another recording, which the page plays side by side with this one"
    files.add_argument("--beside", type=path, metavar="FILE", help=text)
    text = "write samples to learn from: to a folder of .npz files, to NAME.parquet, or to the Minari dataset "
    text += "minari:NAME-v0"
    files.add_argument("--data", type=output(check_new), metavar="PATH", help=text)
    text = "with --data NAME.parquet: a column for each number that agents observe, own_health, others_0_x ..., in "
    text += "place of a list for each kind"
    files.add_argument("--flat", action="store_true", help=text)
    text = "write a table of what happened to a new file, NAME.csv or NAME.parquet"
    files.add_argument("--events", type=output(partial(check_table, what="events")), metavar="FILE", help=text)
    text = "numbers of the worlds to write, such as 0,3 (default: for --out the first 16, or as many as --mosaic has "
    text += "room for; for --html the first; otherwise all)"
    part.add_argument("--worlds", type=_numbers, metavar="W,W", help=text)
    text = "first tick to write (default: 0)"
    part.add_argument("--from", type=nonnegative, default=0, metavar="N", dest="first", help=text)
    text = "last tick to write (default: the last of the recording)"
    part.add_argument("--to", type=nonnegative, metavar="N", dest="last", help=text)
    text = "do not compare the ticks with the recorded digests"
    part.add_argument("--no-verify", action="store_false", dest="verify", help=text)
    text = "threads that share the worlds, with the same results (default: 1)"
    command.group(MACHINE).add_argument("--threads", type=positive, default=1, metavar="N", help=text)
    add_quiet(command)


def _summary_file(text: str) -> str:
    """Return the file of a summary, or STDOUT."""
    check = partial(check_file, what="summaries", error=UsageError, endings=(".json",), new=True)
    return text if text == STDOUT else output(check)(text)


def _grid(text: str) -> tuple[int, int]:
    """Return rows and columns, as in 4x4."""
    rows, _, columns = text.lower().partition("x")
    if not (rows.isdecimal() and columns.isdecimal() and int(rows) * int(columns)):
        raise argparse.ArgumentTypeError(f"{text}: rows x columns are needed, as in 4x4")
    return int(rows), int(columns)


def _rate(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0 < (value := float(text)) <= FASTEST:
            return value
    raise argparse.ArgumentTypeError(f"{text}: a number above 0, up to {FASTEST}, is needed")


def _numbers(text: str) -> list[int]:
    """Return numbers with commas between them."""
    return [nonnegative(part) for part in text.split(",")]


def roll_out(options: argparse.Namespace) -> int:
    """Run a policy in many worlds and print the episodes' statistics.

    Play complete episodes in many worlds, the same number in each, and print means and standard errors of their
    statistics. With --steps, every world plays a fixed number of steps instead. Episodes that have not ended by then do
    not count, so the means lean towards short episodes.

    Examples:
        rollout ffa_2 --policy scripted  # one episode in each of 1024 worlds
        rollout teams_3 --worlds 64 --record fights.rec --csv fights.csv
            # a recording to replay, and a table with a row for each episode
        rollout ffa_2 --policy scripted --others random,FILE.zip --json -
            # how often it wins against each of the others, as JSON
    """
    if options.steps and options.episodes:
        raise UsageError("--steps and --episodes exclude each other: give one of them")
    options.episodes = options.episodes or 1
    place = _here if options.ray is None else _on_ray
    played = _Rollout(options, scenario(options))
    with messages_shown("outlast.deaths", "%(message)s") if options.log_deaths else contextlib.nullcontext():
        try:
            with place(options, played.game) as (played.agents, work):
                played.play(work)
        finally:  # its files are complete, even if printing fails
            if played.seconds:
                played.report()
    return played.status


@contextlib.contextmanager
def _here(options: argparse.Namespace, game: Scenario) -> Iterator[tuple[int, Work]]:
    """Yield the number of agents in a world, and what rolls out on this machine."""
    settings = {name: getattr(options, name) for name in ("seed", "threads", "specialize", "interpret")}
    files = {name: getattr(options, name) for name in ("record", "record_policy", "events", "csv")}
    check_files(**files)
    made = worlds_of(game, options.policy, options.others, options.worlds, **settings)
    with contextlib.closing(made[0]), prepared(*made, steps=options.steps, episodes=options.episodes, **files) as play:
        yield made[0].num_agents, play


@contextlib.contextmanager
def _on_ray(options: argparse.Namespace, game: Scenario) -> Iterator[tuple[int, Work]]:
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
    with contextlib.closing(make_vec(game, 1, seed=options.seed)) as env:  # compiles the tick once, for all workers
        agents = env.num_agents
    task = RolloutTask(game, POLICIES[options.policy], options.steps, options.seed, options.episodes)
    with contextlib.redirect_stdout(sys.stderr), cluster.connected(options.ray):  # Ray writes of lost workers there
        yield agents, lambda progress: cluster.rollout_on_cluster(task, options.worlds, progress)


@dataclasses.dataclass
class _Rollout:
    """A rollout, and what came of it."""

    options: argparse.Namespace
    game: Scenario
    agents: int = 0  # in a world
    summary: Summary = dataclasses.field(default_factory=Summary)
    seconds: float = 0.0  # that it took; 0: it has nothing to report
    status: int = 0  # of the command

    def play(self, work: Work) -> None:
        """Do the work behind a progress bar, as far as it gets."""
        options, start = self.options, time.perf_counter()
        unit, each = ("world-steps", options.steps) if options.steps else ("episodes", options.episodes)

        def show(summary: Summary) -> None:
            self.summary = summary
            rate = summary.world_steps * self.agents / (time.perf_counter() - start)
            note = f"{rate:,.0f} agent-steps/s"
            progress.show(summary.world_steps if options.steps else summary.episodes, note=note)

        try:
            with Progress(options.worlds * each, unit, quiet=options.quiet) as progress:
                self.summary = work(show)
        except KeyboardInterrupt as stop:
            self.summary, self.status = stop.args[0] if stop.args else Summary(), STOPPED
        except (OutlastError, OSError):  # as where the disk is full: what was played until then is reported
            self.seconds = time.perf_counter() - start if self.summary.world_steps else 0.0
            raise
        self.seconds = time.perf_counter() - start

    def report(self) -> None:
        """Write the JSON file that is asked for, and print the table or the JSON. Raises UsageError."""
        if self.options.json == STDOUT:
            print(self._as_json(), end="")
            return
        try:
            if self.options.json is not None:
                with (
                    written_to(self.options.json, UsageError, "; the summary is not written"),
                    atomic_write(Path(self.options.json), new=True) as place,
                ):
                    place.write_text(self._as_json(), encoding="utf-8")
        finally:  # a full disk costs no table
            print(self._heading(), self.summary, sep="\n")

    def _heading(self) -> str:
        options, done, seconds = self.options, self.summary.world_steps, self.seconds
        each, shares = options.steps or options.episodes, ""
        against = " against " + ", ".join(map(printable, options.others)) if options.others else ""
        unit = f"{'step' if options.steps else 'episode'}{'s' if each > 1 else ''}"
        if options.ray is None:  # of time: the policy, the worlds, and the rest, which is statistics and files
            parts = {**self.summary.seconds, "rest": seconds - sum(self.summary.seconds.values())}
            shares = " (" + ", ".join(f"{name} {part / seconds:.0%}" for name, part in parts.items()) + ")"
        return (
            f"{self.game.name}: {printable(options.policy)} policy{against}, seed {options.seed}, "
            f"{options.worlds} worlds x {each} {unit}\n"
            f"{done:,} world-steps in {seconds:.1f} s: {done / seconds:,.0f} world-steps/s, "
            f"{done * self.agents / seconds:,.0f} agent-steps/s{shares}"
        )

    def _as_json(self) -> str:
        """Return what was asked for, by the options' names, then the summary's numbers."""
        import outlast  # here, as the package imports the environments

        names = ("policy", "others", "seed", "worlds", "episodes", "steps")
        asked = {name: getattr(self.options, name) for name in names}
        asked["episodes" if self.options.steps else "steps"] = None
        about: dict[str, Any] = {"outlast": outlast.__version__, "scenario": self.game.name}
        about |= {"numbers": same_for_all(self.game), **plain(self.game), "agents": self.agents, "asked": asked}
        about |= {"seconds": self.seconds, "seconds_of": self.summary.seconds}
        return json.dumps(about | self.summary.as_dict(), indent=2) + "\n"


def list_models(options: argparse.Namespace) -> None:
    """List the trained policies that are kept, by name.

    List the trained policies that are kept with outlast. Their names are GAME/KIND-SEED. All policy options take these
    names, and fetch the file if it is not there. wins: the share of 320 games that it wins against `scripted`; a draw
    counts as half.

    Examples:
        models  # every name, with how it was trained
        evaluate teams_3 teams_3/fast-0 scripted  # two policies, of which one is a model
    """
    rows = [("preset", "seed", "agent-steps", " wins", "  bytes", "SHA-256", "name")]
    for each in models().values():
        numbers = f"{each.steps:>11,}", f"{each.wins:.3f}", f"{each.size:>7,}"
        rows.append((each.preset, str(each.seed), *numbers, each.sha256[:12], each.name))
    print(text_table(rows))  # as wide as the names of games are


def steer(options: argparse.Namespace) -> None:
    """Steer an agent with the keyboard, in the browser, against policies.

    Steer an agent with the keyboard, on a web page that opens in your browser. Without --host, only this machine can
    open it. Ctrl-C ends the game.

    Examples:
        play ffa_2  # a duel against the scripted policy
        play teams_3 --agent 2 --others random --fps 10  # you are agent 2 of 0 to 3, at a third of the speed
    """
    play(scenario(options), **given_options(options, PlayOptions), **given_options(options, PageOptions))
    print(file=sys.stderr)  # behind the ^C


def draw_frames(options: argparse.Namespace) -> int:
    """Play worlds and draw every step, as pictures or as a film.

    Play worlds from the beginning, and draw every step, into a film or a folder of pictures.

    Examples:
        frames teams_3 --out fight.webm  # a film of one world, in which the scripted policy plays 150 steps
        frames ffa_2 --policy random --steps 100 --out pictures  # numbered pictures in a folder
        frames ffa_3 --mosaic 2x2 --views +vision,-ids --out four.gif  # four worlds at once, and what agents see
    """
    asked, given = scenario(options), given_options(options, FilmOptions) | given_options(options, Looks)
    return _filmed(options, options.steps, lambda progress: film(asked, options.out, progress=progress, **given))


def _filmed(options: argparse.Namespace, total: int, made: Callable[[Count], object]) -> int:
    """Make a film of `total` ticks after the first one with a progress bar, and describe it. Return the exit status."""
    bars, frames = list[Progress](), 0

    def show(count: int) -> None:
        nonlocal frames
        frames = count
        if not bars:  # before the first frame, something may be refused
            bars.append(begun.enter_context(Progress(total // options.every + 1, "frames", quiet=options.quiet)))
        bars[0].show(count, max(bars[0].total, count))  # the ends of episodes add some

    try:
        with contextlib.ExitStack() as begun:
            made(show)
    except KeyboardInterrupt:
        LOGGER.warning("stopped; %s was not written", options.out)
        return STOPPED
    out = Path(options.out)
    size = sum(file.stat().st_size for file in (out.glob("frame_*.png") if out.is_dir() else [out]))
    print(f"{printable(options.out)}: {frames:,} frames, {size / 1e6:.1f} MB")
    return 0


def replay(options: argparse.Namespace) -> int:
    """Replay a recording: verify it, or make a film, page or data of it.

    Play a recording again, bit for bit, and check that every tick is what was recorded. Print the statistics of its
    episodes, or make a film of it (--out), a web page (--html), samples for learners (--data) or a table of events
    (--events).

    Examples:
        replay fights.rec  # play it again, compare every tick, and print its statistics
        replay fights.rec --html fights.html  # a page that plays it
        replay fights.rec --worlds 3 --from 100 --to 400 --out fight.webm  # a film of world 3, ticks 100 to 400
    """
    products = [write for name, write in PRODUCTS.items() if getattr(options, name) is not None]
    _check_replay(options, bool(products))
    import_files(options)
    recording = _recording(options.file, options.trust)
    options.to, options.last = options.last, last_tick(recording, options.first, options.last)
    if options.worlds is not None:
        rows_of(recording, options.worlds)  # which refuses those that there are not
    with contextlib.closing(Replay(recording, options.threads)) as replayed:
        try:
            for write in products or [_verify]:
                if status := write(options, replayed):
                    return status  # stopped, or not what was recorded: the others would be no better
            return 0
        except ReplayError as error:
            LOGGER.error("%s", error)
            return 1


def _check_replay(options: argparse.Namespace, products: bool) -> None:
    """Refuse options that would have no effect."""
    looks = dataclasses.asdict(Looks()).items()
    if options.out is None and (unused := [f"--{name}" for name, usual in looks if getattr(options, name) != usual]):
        raise RecordingError(f"{', '.join(unused)}: for pictures and films only; give --out PATH")
    if options.beside is not None and options.html is None:
        raise RecordingError("--beside is for pages: give --html PATH, too")
    if options.flat and not (options.data or "").endswith(".parquet"):
        raise RecordingError("--flat is for tables of samples: give --data NAME.parquet, too")
    if not products and (options.first or options.last is not None or options.worlds is not None):
        files = "--out, --html, --data or --events"
        raise RecordingError(f"--from, --to and --worlds select what is written; give {files}, too")


def _recording(path: str, trust: bool) -> Recording:
    try:
        recording = Recording.open(path, trust=trust)
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror}") from None
    if recording.cut:
        LOGGER.warning("%s", recording.cut)
    return recording


def _verify(options: argparse.Namespace, replayed: Replay) -> int:
    """Replay everything, and print the statistics that the recorded rollout printed."""
    with Progress(len(replayed.recording), "ticks", quiet=options.quiet) as progress:
        for _ in progress.over(replayed.ticks(options.verify)):
            pass
    same = "every digest is the same" if options.verify else "not verified"
    print(f"{printable(options.file)}: {replayed.recording.contents}; {same}")
    print(replayed.summary)
    return 0


def _film(options: argparse.Namespace, replayed: Replay) -> int:
    shown, ticks = _selected(options, replayed, math.prod(options.mosaic) if options.mosaic else REPLAYED)
    looks, name = Looks(**given_options(options, Looks)), replayed.recording.scenario.name
    write = partial(write_film_of, options.out, replayed.worlds, ticks, shown, looks, name)
    return _filmed(options, options.last - options.first, write)


def _page(options: argparse.Namespace, replayed: Replay) -> int:
    beside = None if options.beside is None else _recording(options.beside, options.trust)
    chosen = {"worlds": options.worlds, "first": options.first, "last": options.to}
    how = {"verify": options.verify, "threads": options.threads, "quiet": options.quiet}
    replay_page(replayed.recording, options.html, beside=beside, **chosen, **how)
    print(printable(options.html))
    return 0


def _data(options: argparse.Namespace, replayed: Replay) -> int:
    worlds, _ = _selected(options, replayed, replayed.worlds.count)
    with Progress(options.last + 1, "ticks", quiet=options.quiet) as progress:
        selection = Selection(worlds, options.first, options.last, options.verify, lambda tick: progress.add())
        count = export_dataset(options.data, replayed, selection, options.flat)
    print(f"{printable(options.data)}: {count:,} agent-steps")
    return 0


def _events(options: argparse.Namespace, replayed: Replay) -> int:
    worlds, recording = replayed.worlds, replayed.recording
    shown, ticks = _selected(options, replayed, worlds.count)
    chosen = np.isin(np.arange(worlds.count), shown)
    progress = Progress(options.last - options.first + 1, "ticks", quiet=options.quiet)
    with event_file(options.events, worlds.layout, recording.first_world) as add, progress:
        for _ in progress.over(ticks):
            add(replayed.events(), chosen & (worlds.mode != SKIP))
    print(printable(options.events))
    return 0


PRODUCTS = {"out": _film, "html": _page, "data": _data, "events": _events}


def _selected(options: argparse.Namespace, replayed: Replay, most: int) -> tuple[Sequence[int], Iterator[int]]:
    """Return the worlds that are asked for, or the first `most`, and the ticks, if these are among them."""
    asked, count = options.worlds, min(most, replayed.worlds.count)
    worlds = list(range(count)) if asked is None else rows_of(replayed.recording, asked)
    return worlds, replayed.ticks(options.verify, first=options.first, last=options.last, worlds=worlds)
