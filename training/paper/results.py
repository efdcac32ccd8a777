"""Results of runs, from their folders or as they are kept, in groups that differ by seeds only. Needs no PyTorch."""

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from outlast.envs.errors import ScenarioError
from outlast.envs.rollout.saved import checkpoints
from outlast.envs.scenarios.fingerprint import fingerprint, is_fingerprint
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.variants import base, variant

from ..base import log_file, policy_file, run_header
from ..base.curves import FILE, NEEDED, Curves, Described, Logged, curves_of_log, format_curves, read_curves
from ..base.errors import EmptyRunError, TrainingError
from ..base.hyperparameters import Hyperparameters
from ..base.presets import ROLLOUT, preset
from .curves import PAPER_STEPS, is_kept, is_known, published_curves

FREE = ("seed", "device", "threads")  # what may differ between runs of a group
DEFAULTS = {"worlds": 1, "rollout": ROLLOUT, "dead": "keep", **asdict(Hyperparameters())}  # as in the paper
MISSING, USUAL = "not there", "as usual"
RUN_FILES = (log_file.NAME, run_header.NAME)  # by which the folder of a run is recognised
Kind = TypeVar("Kind")
logger = logging.getLogger("outlast")


@dataclass(frozen=True)
class RunResult(Logged):
    """A run: where it is, and curves of the paper's quantities and of what agents did.

    origin: Its folder; of a run that is kept, its name in the folder of the others. variant: With ablations. plan: That
    of run.json. changed: Numbers of the scenario that differ from the paper's.
    """

    origin: Path
    variant: str
    plan: dict[str, Any]
    changed: dict[str, Any]
    curves: Curves

    @property
    def done(self) -> bool:
        """Whether it is as long as the paper's."""
        return self.steps >= PAPER_STEPS

    @property
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
class RunGroup:
    """Runs of a variant with a preset, in order of seeds."""

    runs: tuple[RunResult, ...]

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
    def ended(self) -> tuple[RunResult, ...]:
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


def load_runs(places: Iterable[Path]) -> list[RunResult]:
    """The results of the paper's variants in these places, see `read_runs`."""
    return read_runs(places, lambda path: _of_folder(path) if path.is_dir() else read_kept(path))


def read_runs(places: Iterable[Path], read: Callable[[Path], Kind]) -> list[Kind]:
    """Read all runs. Those in which no episode has ended yet are left out, and named in a warning.

    Args:
        places: Folders of runs, folders around them, studies (folders with runs that are kept), or single runs of a
            study, as if they were folders in it.
        read: Reads one folder or kept run; raises EmptyRunError for a run without a curve.

    Raises:
        TrainingError: A place holds no runs, or none with a curve.
    """
    found, reasons = list[Kind](), list[str]()
    for path in dict.fromkeys(path for place in places for path in _found(place)):
        try:
            found.append(read(path))
        except EmptyRunError as error:
            reasons.append(str(error))
    if reasons and not found:
        raise TrainingError(f"there is nothing to draw: {reasons[0]}")
    for reason in reasons:
        logger.warning("left out: %s", reason)
    return found


NOT_THE_PAPERS = {
    "varied": "numbers that vary",
    "observed": "numbers that agents observe",
    "roles": "roles",
    "order": "systems in another order",
    "code": "mechanics of one's own",
}  # keys of fingerprints, in words


def _found(place: Path) -> list[Path]:
    """Folders of runs and kept runs in a place, which may itself be one."""
    if any((place / name).exists() for name in RUN_FILES):
        return [place]
    if not place.exists():
        return [_kept_run(place)]
    if place.is_file():
        raise TrainingError(f"{place} is a file: give the folder of a run, or one with runs in it or in its {FILE}")
    runs = {path.parent for name in RUN_FILES for path in place.glob(f"*/{name}")}
    found = sorted([*(place / name for name in kept_runs(place)), *runs])
    if not found:
        wanted = f"neither {log_file.NAME} nor {FILE} nor folders of runs"
        raise TrainingError(f"there are no runs in {place}: {wanted}")
    return found


def kept_runs(study: Path) -> dict[str, Described]:
    """What is kept of the runs of a study, by name; nothing if there is none. Raises TrainingError."""
    return read_curves(study / FILE) if (study / FILE).exists() else {}


def _kept_run(place: Path) -> Path:
    """The place, if it is that of a kept run. Raises TrainingError."""
    known = kept_runs(place.parent)
    if not known:
        raise TrainingError(f"there is no folder {place}")
    if place.name not in known:
        raise TrainingError(f"{place.parent / FILE} has no run {place.name}, but {', '.join(known)}")
    return place


def _of_folder(folder: Path) -> RunResult:
    """The run in a folder."""
    header = run_header.read_run_folder(folder)
    scenario, plan = header["scenario"], header["plan"]
    if more := [what for key, what in NOT_THE_PAPERS.items() if scenario.get(key)]:
        raise TrainingError(f"{folder} is no run of the paper's: its game has {', '.join(more)}; leave out --paper")
    try:
        name = variant(scenario["name"]).name
        changed = _changed(name, plan.get("preset"), scenario["numbers"])
        curves = curves_of_log(folder / log_file.NAME, is_known)
        kept = Curves(curves.steps, {tag: values for tag, values in curves.values.items() if is_kept(tag)})
        return _checked(RunResult(folder, name, plan, changed, kept))
    except ScenarioError as error:
        raise TrainingError(f"{folder} is no run of the paper's: {error}; leave out --paper") from error


def _changed(name: str, of: str, numbers: dict[str, Any]) -> dict[str, Any]:
    """Numbers that differ from those of the paper's variant with the observations of the preset."""
    scenario: Scenario = preset(of).scenario(variant(base(name)))
    own = fingerprint(scenario)["numbers"]
    keys = sorted(own.keys() | numbers.keys())
    pairs = {key: (numbers.get(key, MISSING), own.get(key, MISSING)) for key in keys}
    return {key: its for key, (its, usual) in pairs.items() if its != usual}


def read_kept(path: Path) -> RunResult:
    """The run of a study, as if it were a folder in it."""
    about, curves = read_curves(path.parent / FILE)[path.name]
    try:
        result = RunResult(path, variant(about["variant"]).name, about["plan"], about["changed"], curves)
        preset(result.plan["preset"])
    except (KeyError, TypeError, ScenarioError) as error:
        raise TrainingError(f"{path} does not hold the curves of a run: {error}") from error
    return _checked(result)


def _checked(result: RunResult) -> RunResult:
    """The result, if it can be named, compared and drawn. Raises TrainingError."""
    tags, missing = result.curves.values.keys(), [tag for tag in NEEDED if tag not in result.curves.values]
    wrong = f"{result.origin} does not hold the curves of a run"
    if missing or not all(map(is_kept, tags)):
        raise TrainingError(f"{wrong}: it has " + (f"no {missing[0]}" if missing else "others than the paper's"))
    if not run_header.is_plan(result.plan) or type(result.plan.get("seed")) is not int:
        raise TrainingError(f"{wrong}: its plan is none")
    if not is_fingerprint({"name": result.variant, "numbers": result.changed}) or "$" in str(result.changed):
        raise TrainingError(f"{wrong}: what was changed in it is not numbers")
    return result


def group_runs(results: Iterable[RunResult]) -> list[RunGroup]:
    """Groups in order of names. Raises TrainingError if runs of one variant and preset differ in more than seeds."""
    groups: dict[str, list[RunResult]] = {}
    for result in results:
        together = groups.setdefault(f"{result.variant}-{result.plan['preset']}", [])
        for other in together:
            _check(other, result)
        together.append(result)
    return [RunGroup(tuple(sorted(runs, key=lambda run: run.seed))) for _, runs in sorted(groups.items())]


def _check(one: RunResult, other: RunResult) -> None:
    """Refuse two runs that cannot be averaged."""
    if difference := _difference(one, other):
        raise TrainingError(f"{difference}: leave out --paper to compare them, or plot them one by one")
    if one.seed == other.seed:
        raise TrainingError(f"{one.origin} and {other.origin} are the same run, or both of seed {one.seed}: give one")


def _difference(one: RunResult, other: RunResult) -> str:
    """Say which setting is the first that differs; empty if none does."""
    mine, its = one.settings, other.settings
    for key in sorted(mine.keys() | its.keys()):
        pair = mine.get(key, USUAL), its.get(key, USUAL)
        if pair[0] != pair[1]:
            return f"{key} is {pair[0]} in {one.origin} and {pair[1]} in {other.origin}"
    return ""


def files_to_keep(runs: Sequence[RunResult], folder: Path) -> dict[Path, bytes]:
    """Curves and policies to keep, by path. Raises TrainingError where a run would take the place of another one."""
    policies = {folder / f"{run.name}{policy_file.SUFFIX}": _newest_policy(run.origin) for run in runs}
    contents = {
        path: policy_file.content(*policy_file.read(source), exact="") for path, source in policies.items() if source
    }
    return curves_to_keep(runs, folder) | contents


def curves_to_keep(runs: Sequence[RunResult], folder: Path) -> dict[Path, bytes]:
    """Curves to keep, by path, with those of other runs that the folder keeps already.

    Raises:
        TrainingError: A run would take the place of another one.
    """
    kept = kept_runs(folder)
    for run in runs:
        if run.name in kept and (difference := _difference(read_kept(folder / run.name), run)):
            raise TrainingError(f"{folder} keeps another {run.name}: {difference}: choose another folder with --keep")
    kept |= {run.name: (run.about, run.curves) for run in runs}
    return {folder / FILE: format_curves(dict(sorted(kept.items())))}


def _newest_policy(origin: Path) -> Path | None:
    """The last checkpoint of a run's folder, or the policy that is kept."""
    found = checkpoints(origin) if origin.is_dir() else [origin.with_name(f"{origin.name}{policy_file.SUFFIX}")]
    return found[-1] if found and found[-1].exists() else None
