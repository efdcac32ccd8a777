"""Runs of `reproduce`: the paper's eight experiments, its method as the text describes it, and corrected games."""

import ast
import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from statistics import mean

from outlast.envs.rollout.saved import checkpoints, newest
from outlast.envs.scenarios.parse import resolve
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.variants import VARIANTS

from ..base.errors import TrainingError
from ..base.log_file import NAME as LOG
from ..base.log_file import last_step
from ..base.policy_file import SUFFIX
from ..base.tables import csv_text
from ..plots.panels import hours
from ..plots.runs import kept_runs, load
from .results import PAPER_STEPS

PARTS = {
    "original": "the eight variants, with the authors' networks and numbers",
    "text": "the same by the method of the paper's text (presets paper and scaled)",
    "mended": "games without the paper's flaws, against a pool of opponents",
}
SECONDS = "seconds.csv"  # times of runs; one such file is beside this module
GUESS = 20_000  # agent-steps a second of runs whose preset was never timed
SAME_NETWORKS = {"paper": "original", "scaled": "original"}  # presets with about the same time as another one
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


@dataclass(frozen=True)
class Experiment:
    """A run for each of several seeds.

    Attributes:
        game: The name of a variant, with ablations.
        preset: The preset of networks and numbers.
        options: Further options of `outlast train`, without the seed.
        numbers: Numbers of the game with other values: "melee_damage=2".
    """

    part: str
    game: str
    preset: str
    options: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()

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
        return MENDED_STEPS if self.part == "mended" else PAPER_STEPS

    @property
    def seeds(self) -> int:
        """Return the default number of runs."""
        return 2 if self.part == "mended" else 3

    def words(self, seed: int) -> list[str]:
        """Return arguments and options of `outlast train` for a run."""
        own = ("--steps", str(self.steps), "--seed", str(seed), "--threads", "1")
        changed = (word for pair in self.numbers for word in ("--set", pair))
        return [self.game, "--preset", self.preset, *changed, *self.options, *own]

    def folder(self, out: Path, seed: int) -> Path:
        """Return the folder of a run."""
        return out / "runs" / self.part / f"{self.name}-{self.preset}-{seed}"

    def policy(self, out: Path, run: Path) -> Path:
        """Return the policy of a run in `results`: its newest checkpoint, or its kept policy."""
        return newest(run) if run.is_dir() else self.kept_policy(out, run)

    def kept_policy(self, out: Path, run: Path) -> Path:
        """Return the file in which the policy of a run is kept."""
        kind = KEPT_AS if self.part == "mended" else self.preset
        seed = run.name.rpartition("-")[2]
        return out / "policies" / self.name / f"{kind}-{seed}{SUFFIX}"

    @property
    def film(self) -> str:
        """The file of its film; corrected games have one preset."""
        return f"{self.name}.webm" if self.part == "mended" else f"{self.name}-{self.preset}.webm"

    def results(self, out: Path) -> list[Path]:
        """Return its complete runs by seed: their folders, or kept results in the folder of the part.

        A kept run with its policy does not need its folder any more. If both exist, the folder counts.
        """
        name = f"{self.name}-{self.preset}-"
        steps = {out / self.part / run: done for run, done in self._kept(out).items()}
        folders = self.folder(out, 0).parent.glob("*")
        steps |= {path: last_step(path / LOG) for path in folders if path.name.startswith(name) and checkpoints(path)}
        by_seed = {path.name.removeprefix(name): path for path, done in steps.items() if done >= self.steps}
        return [by_seed[seed] for seed in sorted(filter(str.isdecimal, by_seed), key=int)]

    def steps_done(self, out: Path, seed: int) -> int:
        """Return agent-steps of a run, by its log or by kept results."""
        folder = self.folder(out, seed)
        return max(last_step(folder / LOG), self._kept(out).get(folder.name, 0))

    def _kept(self, out: Path) -> dict[str, int]:
        """Return agent-steps of all runs of its part that are kept, by name."""
        return {name: int(curves.steps[-1]) for name, (_, curves) in kept_runs(out / self.part).items()}

    @property
    def key(self) -> tuple[str, str, str]:
        """The key of its time in SECONDS."""
        return self.part, self.name, self.preset


def experiments(parts: Iterable[str]) -> list[Experiment]:
    """Return the experiments of some parts."""
    every = [
        *_trained_as("original", "original"),
        *_trained_as("text", "paper"),
        *_trained_as("text", "scaled"),
        *_mended(),
    ]
    wanted = set(parts)
    return [each for each in every if each.part in wanted]


def _trained_as(part: str, preset: str) -> Iterator[Experiment]:
    for name in VARIANTS:
        yield Experiment(part, name, preset, () if name in MANY_WORLDS else FEW_WORLDS)


def _mended() -> Iterator[Experiment]:
    for game, together in TOGETHER.items():
        for mended in ("", *SINGLE.get(game, ()), *together):
            yield Experiment("mended", "+".join(filter(None, (game, mended))), "fast", POOL)
    for game, numbers in TO_HEAL_MATES:
        yield Experiment("mended", f"{game}+{TOGETHER[game][0]}", "fast", POOL, numbers)


def expected_seconds(chosen: Sequence[Experiment]) -> tuple[list[float], list[bool]]:
    """Return the seconds of a run of each on one core of the machine of SECONDS, and whether it was timed.

    If it was not, the time is estimated by the mean over its preset, or over one with the same networks.
    """
    known = _read_seconds(files(__package__).joinpath(SECONDS).read_text(encoding="utf-8"))
    alike = {preset: mean(s for key, s in known.items() if key[2] == preset) for *_, preset in known}
    alike = {preset: alike[same] for preset, same in SAME_NETWORKS.items() if same in alike} | alike
    seconds = [known.get(each.key, alike.get(each.preset, each.steps / GUESS)) for each in chosen]
    return seconds, [each.key in known for each in chosen]


def seconds_table(chosen: Iterable[Experiment], out: Path, before: str = "") -> str:
    """Return the content of SECONDS: for each experiment, the mean over its complete runs whose folders exist.

    out: The output folder of the command. before: The previous table: its rows of experiments without such a folder
    are kept.
    """
    rows, known = list[tuple[object, ...]](), _read_seconds(before)
    for each in chosen:
        every = [seconds for run in each.results(out) if run.is_dir() and (seconds := _seconds(run))]
        if every or each.key in known:
            rows.append((*each.key, round(mean(every) if every else known[each.key])))
    return csv_text(("part", "game", "preset", "seconds"), rows)


def _read_seconds(text: str) -> dict[tuple[str, str, str], float]:
    rows = csv.DictReader(io.StringIO(text))
    return {(row["part"], row["game"], row["preset"]): float(row["seconds"]) for row in rows}


def _seconds(folder: Path) -> float:
    """Return the seconds of a run by its log; 0 without a log."""
    try:
        (run,) = load([folder])
    except TrainingError:
        return 0.0
    elapsed = hours(run)
    return 0.0 if elapsed is None else 3600 * float(elapsed[-1])
