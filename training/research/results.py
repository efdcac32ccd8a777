"""Runs of the paper's variants, in groups that differ by seeds only, and what is kept of them. Needs no PyTorch."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from outlast.envs.errors import ScenarioError
from outlast.envs.rollout.saved import checkpoints
from outlast.envs.scenarios.variants import base, variant

from ..base import policy_file
from ..base.curves import FILE, Curves, format_curves
from ..base.errors import TrainingError
from ..base.hyperparameters import Hyperparameters
from ..base.presets import ROLLOUT, preset
from ..plots.runs import ABSENT, Run, kept_runs, load, read_kept, usual_numbers
from .published import PAPER_STEPS, is_kept, published_curves

FREE = ("seed", "device", "threads")  # what may differ between runs of a group
DEFAULTS = {"worlds": 1, "rollout": ROLLOUT, "dead": "keep", **asdict(Hyperparameters())}  # as in the paper
USUAL = "as usual"


@dataclass(frozen=True)
class PaperRun(Run):
    """A run of one of the paper's variants, with curves of the paper's quantities and of what agents did.

    changed: Numbers of the scenario that differ from the paper's.
    """

    changed: dict[str, Any] = field(default_factory=dict)

    @property
    def variant(self) -> str:
        """The name of the variant, with ablations."""
        return self.scenario

    @property
    def done(self) -> bool:
        """Whether it is as long as the paper's."""
        return self.steps >= PAPER_STEPS

    @cached_property
    def settings(self) -> dict[str, Any]:
        """Everything that runs of a group have in common."""
        common = {key: value for key, value in self.plan.items() if key not in (*FREE, "settings")}
        numbers = asdict(preset(self.plan["preset"]).numbers)
        return {"variant": self.variant, **common, **numbers, **self.plan.get("settings", {}), **self.changed}

    @property
    def unlike(self) -> dict[str, Any]:
        """The settings that differ from the paper's."""
        unlike = {key: value for key, value in self.settings.items() if key in DEFAULTS and value != DEFAULTS[key]}
        return unlike | self.changed

    @property
    def about(self) -> dict[str, Any]:
        """What is kept with its curves."""
        return {"variant": self.variant, "plan": self.plan, "changed": self.changed}

    @property
    def name(self) -> str:
        """The name by which it is kept."""
        return f"{self.variant}-{self.plan['preset']}-{self.seed}"


@dataclass(frozen=True)
class PaperGroup:
    """Runs of a variant with a preset, in order of seeds."""

    runs: tuple[PaperRun, ...]

    @property
    def variant(self) -> str:
        """The name of the variant."""
        return self.runs[0].variant

    @property
    def preset(self) -> str:
        """The name of the preset."""
        return str(self.runs[0].plan["preset"])

    @property
    def name(self) -> str:
        """The name of its figure."""
        return f"{self.variant}-{self.preset}"

    @property
    def ended(self) -> tuple[PaperRun, ...]:
        """The runs whose end values count: those that are as long as the paper's; all, if none is."""
        return tuple(run for run in self.runs if run.done) or self.runs

    @cached_property
    def paper(self) -> Curves:
        """The paper's own curves, those of the variant without ablations."""
        return published_curves(base(self.variant))

    @property
    def ablated(self) -> bool:
        """Whether the variant has ablations, so that it is another game than the paper's."""
        return base(self.variant) != self.variant

    def notes(self) -> list[str]:
        """Sentences on how these runs differ from the paper's: in length, in settings."""
        short = [f"seed {run.seed} ({run.steps / 1e6:.1f} million agent-steps)" for run in self.runs if not run.done]
        other = [f"{key} = {value}" for key, value in self.runs[0].unlike.items()]
        notes = ["Unfinished: " + ", ".join(short)] if short else []
        if len(self.ended) < len(self.runs):
            notes[0] += "; not counted in end values"
        return notes + (["Unlike the paper: " + ", ".join(other)] if other else [])


def load_runs(places: Iterable[Path]) -> list[PaperRun]:
    """Return the runs of the paper's variants in these places; see plots.runs.load. Raises TrainingError."""
    return [_of_the_paper(run) for run in load(places)]


def _of_the_paper(run: Run) -> PaperRun:
    """The run, with what differs from the paper's game. Raises TrainingError if it is of another one."""
    wrong = f"{run.origin} is no run of the paper's"
    if run.beyond:
        raise TrainingError(f"{wrong}: its game has {', '.join(run.beyond)}; leave out --paper")
    try:
        name = variant(run.scenario).name
    except ScenarioError as error:
        raise TrainingError(f"{wrong}: {error}; leave out --paper") from error
    own, usual = run.numbers, usual_numbers(name, run.plan["preset"])
    pairs = {key: (own.get(key, ABSENT), usual.get(key, ABSENT)) for key in sorted(own.keys() | usual.keys())}
    changed = {key: its for key, (its, other) in pairs.items() if its != other}
    curves = Curves(run.curves.steps, {tag: values for tag, values in run.curves.values.items() if is_kept(tag)})
    return PaperRun(run.origin, name, own, run.plan, curves, asked=run.asked, changed=changed)


def group_runs(results: Iterable[PaperRun]) -> list[PaperGroup]:
    """Groups in order of names. Raises TrainingError if runs of one variant and preset differ in more than seeds."""
    groups: dict[str, list[PaperRun]] = {}
    for result in results:
        together = groups.setdefault(f"{result.variant}-{result.plan['preset']}", [])
        for other in together:
            _check(other, result)
        together.append(result)
    return [PaperGroup(tuple(sorted(runs, key=lambda run: run.seed))) for _, runs in sorted(groups.items())]


def _check(one: PaperRun, other: PaperRun) -> None:
    """Refuse two runs that cannot be averaged."""
    if difference := _difference(one, other):
        raise TrainingError(f"{difference}: leave out --paper to compare them, or plot them one by one")
    if one.seed == other.seed:
        raise TrainingError(f"{one.origin} and {other.origin} are the same run, or both of seed {one.seed}: give one")


def _difference(one: PaperRun, other: PaperRun) -> str:
    """Say which setting is the first that differs; empty if none does."""
    mine, its = one.settings, other.settings
    for key in sorted(mine.keys() | its.keys()):
        pair = mine.get(key, USUAL), its.get(key, USUAL)
        if pair[0] != pair[1]:
            return f"{key} is {pair[0]} in {one.origin} and {pair[1]} in {other.origin}"
    return ""


def files_to_keep(runs: Sequence[PaperRun], folder: Path) -> dict[Path, bytes]:
    """Curves and policies to keep, by path. Raises TrainingError where a run would take the place of another one."""
    policies = {folder / f"{run.name}{policy_file.SUFFIX}": _newest_policy(run.origin) for run in runs}
    contents = {
        path: policy_file.content(*policy_file.read(source), exact="") for path, source in policies.items() if source
    }
    return curves_to_keep(runs, folder) | contents


def curves_to_keep(runs: Sequence[PaperRun], folder: Path) -> dict[Path, bytes]:
    """Curves to keep, by path, with those of other runs that the folder keeps already.

    Raises TrainingError: a run would take the place of another one.
    """
    kept = kept_runs(folder)
    for run in runs:
        if run.name in kept and (difference := _difference(_of_the_paper(read_kept(folder / run.name)), run)):
            raise TrainingError(f"{folder} keeps another {run.name}: {difference}: choose another folder with --keep")
    kept |= {run.name: (run.about, run.curves) for run in runs}
    return {folder / FILE: format_curves(dict(sorted(kept.items())))}


def _newest_policy(origin: Path) -> Path | None:
    """The last checkpoint of a run's folder, or the policy that is kept."""
    found = checkpoints(origin) if origin.is_dir() else [origin.with_name(f"{origin.name}{policy_file.SUFFIX}")]
    return found[-1] if found and found[-1].exists() else None
