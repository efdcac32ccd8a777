"""Runs of `reproduce`: the paper's eight experiments, its method as the text describes it, and corrected games."""

import ast
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from outlast.envs.rollout.saved import checkpoints, newest
from outlast.envs.scenarios.parse import resolve
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.variants import VARIANTS

from ..base.curves import LOG as LOG
from ..base.curves import last_step
from ..base.policy_file import SUFFIX
from ..plots.runs import kept_runs
from .results import PAPER_STEPS

PARTS = {
    "original": "the eight variants, with the authors' networks and numbers",
    "text": "the same by the method of the paper's text (presets paper and scaled)",
    "mended": "games without the paper's flaws, against a pool of opponents",
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


def experiments(parts: Iterable[str]) -> list[Experiment]:
    """Return the experiments of some parts."""
    every = [
        Experiment(part, name, preset, () if name in MANY_WORLDS else FEW_WORLDS)
        for part, preset in (("original", "original"), ("text", "paper"), ("text", "scaled"))
        for name in VARIANTS
    ]
    for game, together in TOGETHER.items():
        corrected = (f"{game}+{names}" for names in (*SINGLE.get(game, ()), *together))
        every += [Experiment("mended", name, "fast", POOL) for name in (game, *corrected)]
    for game, numbers in TO_HEAL_MATES:
        every.append(Experiment("mended", f"{game}+{TOGETHER[game][0]}", "fast", POOL, numbers))
    wanted = set(parts)
    return [each for each in every if each.part in wanted]
