"""The paper's own learning curves, runs of its variants in groups, and kept results. Does not need PyTorch."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from outlast.envs.errors import ScenarioError
from outlast.envs.rollout.saved import checkpoints
from outlast.envs.scenarios.variants import base, variant

from ..base import policy_file
from ..base.curves import FILE, Curves, Quantity, format_curves, is_known, read_curves, rounded
from ..base.errors import TrainingError
from ..base.presets import ROLLOUT, Hyperparameters
from ..plots.runs import ABSENT, PRESET, SCENARIO, Run, RunGroup, differing, kept_runs, load, read_kept, usual_numbers
from ..plots.runs import group_runs as groups_of

DIGITS = 4  # of values from logs of runs: kept results are small and look the same
PAPER_STEPS = 10_000_000  # agent-steps that the authors trained each variant for, rounded up to a full rollout
DEFAULTS = {"worlds": 1, "rollout": ROLLOUT, "dead": "keep", **asdict(Hyperparameters())}  # as in the paper


def behaviour(name: str) -> Quantity:
    """Return a quantity of agents' behaviour, as our runs log it."""
    return Quantity(name, f"behaviour/{name}")


SEEN = (
    *map(behaviour, ("attack_near", "attack_far", "near", "heals_given", "heals_held", "zone_distance")),
    *(Quantity(name, f"rollout/{name}") for name in ("first_death", "deaths_melee", "deaths_zone")),
    *(Quantity(name, f"rollout/{name}", sided=True) for name in ("damage_dealt", "strikes_landed", "heals_given")),
    Quantity("wins against scripted", "wins/scripted"),
)  # the paper has no curves of these; they measure claims about behaviour, and corrected games


def published_curves(variant: str) -> Curves:
    """Return the paper's curves of a variant, by its name: "ffa_2"."""
    with as_file(files(__package__).joinpath(FILE)) as path:
        return read_curves(path)[variant][1]


@dataclass(frozen=True)
class PaperRun(Run):
    """A run of one of the paper's variants, with curves of the paper's quantities and of behaviour.

    It is unfinished unless it is as long as the paper's.
    """

    @cached_property
    def changed(self) -> dict[str, Any]:
        """The numbers of the scenario that differ from the paper's."""
        usual = usual_numbers(self.scenario, self.plan[PRESET])
        names = sorted(self.numbers.keys() | usual.keys())
        return {key: its for key in names if (its := self.numbers.get(key, ABSENT)) != usual.get(key, ABSENT)}

    @property
    def unlike(self) -> dict[str, Any]:
        """The settings that differ from the paper's."""
        unlike = {key: value for key, value in self.settings.items() if key in DEFAULTS and value != DEFAULTS[key]}
        return unlike | self.changed

    @property
    def about(self) -> dict[str, Any]:
        """Return the description that is kept with its curves."""
        return {"variant": self.scenario, "plan": self.plan, "changed": self.changed}

    @property
    def name(self) -> str:
        """The name of the kept run."""
        return f"{self.scenario}-{self.plan['preset']}-{self.seed}"


@dataclass(frozen=True)
class PaperGroup(RunGroup):
    """Runs of a variant with a preset, in order of seeds."""

    runs: tuple[PaperRun, ...]

    @property
    def variant(self) -> str:
        """The name of the variant, with ablations."""
        return self.values[SCENARIO]

    @property
    def preset(self) -> str:
        """The name of the preset."""
        return self.values[PRESET]

    @property
    def name(self) -> str:
        """The name of its figure."""
        return f"{self.variant}-{self.preset}"

    @property
    def side(self) -> str:
        """Return the word for a side: "team" or "agent"."""
        return "team" if self.variant.startswith("teams") else "agent"

    @cached_property
    def paper(self) -> Curves:
        """The paper's own curves, those of the variant without ablations."""
        return published_curves(base(self.variant))

    @property
    def ablated(self) -> bool:
        """Return whether the variant has ablations, and so is not the paper's game."""
        return base(self.variant) != self.variant

    def notes(self) -> list[str]:
        """Return sentences on how these runs differ from the paper's: in length, in settings."""
        short = [f"seed {run.seed} ({run.steps / 1e6:.1f} million agent-steps)" for run in self.unfinished]
        other = [f"{key} = {value}" for key, value in self.runs[0].unlike.items()]
        notes = ["Unfinished: " + ", ".join(short)] if short else []
        if len(self.ended) < len(self.runs):
            notes[0] += "; not counted in end values"
        return notes + (["Unlike the paper: " + ", ".join(other)] if other else [])


def load_runs(places: Iterable[Path]) -> list[PaperRun]:
    """Return the runs of the paper's variants in these places; see plots.runs.load. Raises TrainingError."""
    return [_of_the_paper(run) for run in load(places)]


def _of_the_paper(run: Run) -> PaperRun:
    """Return the run, with its differences from the paper's game. Raises TrainingError for other games."""
    wrong = f"{run.origin} is not a run of the paper's games"
    if run.beyond:
        raise TrainingError(f"{wrong}: its game has {', '.join(run.beyond)}; `outlast plot` compares it")
    try:
        name = variant(run.scenario).name
    except ScenarioError as error:
        raise TrainingError(f"{wrong}: {error}; `outlast plot` compares it") from error
    kept = {tag for tag in run.curves.values if is_known(tag) or any(quantity.has(tag) for quantity in SEEN)}
    curves = Curves(run.curves.steps, {tag: values for tag, values in run.curves.values.items() if tag in kept})
    if run.origin.is_dir():
        curves = rounded(curves, DIGITS)
    return PaperRun(run.origin, name, run.numbers, run.plan, curves, asked=PAPER_STEPS)


def group_runs(runs: Sequence[PaperRun]) -> list[PaperGroup]:
    """Return groups in order of names.

    Raises TrainingError if runs of one variant and preset differ in more than seeds.
    """
    found = groups_of(runs, (SCENARIO, PRESET)) if runs else []
    for group in found:
        if group.mixed:
            mixed = ", ".join(group.mixed)
            raise TrainingError(f"runs of {group.label} differ in {mixed}; `outlast plot` compares them")
    return [PaperGroup(**vars(group)) for group in found]


def files_to_keep(runs: Sequence[PaperRun], folder: Path) -> dict[Path, bytes]:
    """Return curves and newest policies to keep, by path. Raises TrainingError as `curves_to_keep`."""
    contents = {}
    for run in runs:  # the last checkpoint of a run's folder, or the kept policy
        kept = run.origin.with_name(f"{run.origin.name}{policy_file.SUFFIX}")
        found = checkpoints(run.origin) if run.origin.is_dir() else [kept]
        if found and found[-1].exists():
            path = folder / f"{run.name}{policy_file.SUFFIX}"
            contents[path] = policy_file.content(*policy_file.read(found[-1]), exact="")
    return curves_to_keep(runs, folder) | contents


def curves_to_keep(runs: Sequence[PaperRun], folder: Path) -> dict[Path, bytes]:
    """Return the curves to keep, by path, including those of other runs that the folder keeps already.

    Raises TrainingError: a run would take the place of another one.
    """
    kept = kept_runs(folder)
    for run in runs:
        if run.name in kept and (differ := differing([_of_the_paper(read_kept(folder / run.name)), run])):
            names = ", ".join(differ)
            raise TrainingError(f"{folder} keeps a {run.name} with another {names}: choose another folder with --keep")
    kept |= {run.name: (run.about, run.curves) for run in runs}
    return {folder / FILE: format_curves(dict(sorted(kept.items())))}
