"""What came out of runs: found in their folders or in kept files, and sorted into groups that differ by seeds only."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from outlast.envs.errors import ScenarioError, TrainingError
from outlast.envs.scenarios.fingerprint import fingerprint, is_fingerprint
from outlast.envs.scenarios.renamed import NUMBERS, current
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.variants import base, variant

from . import header, paper
from .curves import NEEDED, Curves, is_known, kept, of_log, read_kept
from .presets import preset
from .settings import PAPER, ROLLOUT

LOG = "log.csv"
FREE = ("seed", "device", "threads")  # what may differ between runs of a group
USUAL = {"worlds": 1, "rollout": ROLLOUT, "dead": "keep", **PAPER}  # as in the paper
LACKING, USUALLY = "not there", "as usual"


@dataclass(frozen=True)
class Result:
    """A run: where it was found, what was trained and how, its curves.

    variant: a name, with fixes. plan: Plan.about() of train.py. changed: numbers other than those of the paper.
    """

    origin: Path
    variant: str
    plan: dict[str, Any]
    changed: dict[str, Any]
    curves: Curves

    @property
    def seed(self) -> int:
        """The seed of the run."""
        return int(self.plan["seed"])

    @property
    def steps(self) -> int:
        """Agent-steps done."""
        return int(self.curves.steps[-1])

    @property
    def done(self) -> bool:
        """Whether it went on as long as the paper's."""
        return self.steps >= paper.STEPS

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that runs of a group have in common."""
        common = {key: value for key, value in self.plan.items() if key not in (*FREE, "settings")}
        return {"variant": self.variant, **common, **PAPER, **self.plan.get("settings", {}), **self.changed}

    @property
    def unlike(self) -> dict[str, Any]:
        """What was set to something else than in the paper."""
        told = {key: value for key, value in self.settings.items() if key in USUAL and value != USUAL[key]}
        return told | self.changed

    @property
    def about(self) -> dict[str, Any]:
        """What a kept file says of itself."""
        return {"variant": self.variant, "plan": self.plan, "changed": self.changed}

    @property
    def name(self) -> str:
        """Of a kept file."""
        return f"{self.variant}-{self.plan['preset']}-{self.seed}.csv"

    def text(self) -> str:
        """The content of a kept file."""
        return kept(self.about, self.curves)


@dataclass(frozen=True)
class Group:
    """Runs of a variant with a preset, in order of seeds."""

    runs: tuple[Result, ...]

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
        """Of its figure."""
        return f"{self.variant}-{self.preset}"

    @property
    def ended(self) -> tuple[Result, ...]:
        """The runs whose ends count: those that went as long as the paper's; all, if none did."""
        return tuple(run for run in self.runs if run.done) or self.runs

    @cached_property
    def paper(self) -> Curves:
        """The paper's own, of the variant without fixes."""
        return paper.curves(base(self.variant))

    @property
    def mended(self) -> bool:
        """Whether flaws of the variant are mended, so that it is another game than the paper's."""
        return base(self.variant) != self.variant

    def notes(self) -> list[str]:
        """Sentences on what sets these runs apart from the paper's: shorter ones, other settings."""
        short = [f"seed {run.seed} ({run.steps / 1e6:.1f} million agent-steps)" for run in self.runs if not run.done]
        other = [f"{key} = {value}" for key, value in self.runs[0].unlike.items()]
        told = ["Unfinished: " + ", ".join(short)] if short else []
        if len(self.ended) < len(self.runs):
            told[0] += "; not counted in end values"
        return told + (["Unlike the paper: " + ", ".join(other)] if other else [])


def load(places: Iterable[Path]) -> list[Result]:
    """The results in these places: folders of runs, kept files, or folders of either. Raises TrainingError."""
    return [_of_folder(path) if path.is_dir() else _of_kept(path) for place in places for path in _found(place)]


def _found(place: Path) -> list[Path]:
    """Folders of runs and kept files in a place, which may be one."""
    if not place.exists():
        raise TrainingError(f"there is no {place}")
    if place.is_file():
        return [place]
    if (place / LOG).exists():
        return [place]
    found = sorted([*place.glob("*.csv"), *(log.parent for log in place.glob(f"*/{LOG}"))])
    if not found:
        raise TrainingError(f"there are no runs in {place}: neither {LOG} nor folders or files with results of outlast")
    return found


def _of_folder(folder: Path) -> Result:
    """The run in a folder."""
    told = header.of_run(folder)
    scenario = told["scenario"]
    try:
        name = variant(scenario["name"]).name
        changed = _changed(name, told["plan"].get("preset"), scenario["numbers"])
        return _checked(Result(folder, name, told["plan"], changed, of_log(folder / LOG)))
    except ScenarioError as error:
        raise TrainingError(f"{folder} is no run of the paper's: {error}") from error


def _changed(name: str, of: str, numbers: dict[str, Any]) -> dict[str, Any]:
    """Numbers other than those of the paper's variant as agents of the preset see it."""
    scenario: Scenario = preset(of).scenario(variant(base(name)))
    own = fingerprint(scenario)["numbers"]
    numbers = current(numbers, NUMBERS, own)
    keys = sorted(own.keys() | numbers.keys())
    pairs = {key: (numbers.get(key, LACKING), own.get(key, LACKING)) for key in keys}
    return {key: its for key, (its, usual) in pairs.items() if its != usual}


def _of_kept(path: Path) -> Result:
    """The run of a kept file."""
    about, curves = read_kept(path)
    try:
        result = Result(path, variant(about["variant"]).name, about["plan"], current(about["changed"], NUMBERS), curves)
        preset(result.plan["preset"])
    except (AttributeError, KeyError, TypeError, ScenarioError) as error:
        raise TrainingError(f"{path} does not hold the curves of a run: {error}") from error
    return _checked(result)


def _checked(result: Result) -> Result:
    """The same, if it can be named, compared and drawn. Raises TrainingError."""
    tags, missing = result.curves.values.keys(), [tag for tag in NEEDED if tag not in result.curves.values]
    told = f"{result.origin} does not hold the curves of a run"
    if missing or not all(map(is_known, tags)):
        raise TrainingError(f"{told}: it has " + (f"no {missing[0]}" if missing else "others than the paper's"))
    if not header.is_plan(result.plan) or type(result.plan.get("seed")) is not int:
        raise TrainingError(f"{told}: its plan is none")
    if not is_fingerprint({"name": result.variant, "numbers": result.changed}) or "$" in str(result.changed):
        raise TrainingError(f"{told}: what was changed in it is not numbers")
    return result


def grouped(results: Iterable[Result]) -> list[Group]:
    """Groups in order of names. Raises TrainingError if runs of one variant and preset differ in more than seeds."""
    groups: dict[str, list[Result]] = {}
    for result in results:
        together = groups.setdefault(f"{result.variant}-{result.plan['preset']}", [])
        for other in together:
            _check(other, result)
        together.append(result)
    return [Group(tuple(sorted(runs, key=lambda run: run.seed))) for _, runs in sorted(groups.items())]


def _check(one: Result, other: Result) -> None:
    """Two runs may be averaged."""
    if told := _difference(one, other):
        raise TrainingError(f"{told}: plot them one by one, each with an --out of its own")
    if one.seed == other.seed:
        raise TrainingError(f"{one.origin} and {other.origin} are the same run, or both of seed {one.seed}: give one")


def _difference(one: Result, other: Result) -> str:
    """The first setting that is not the same; empty if all are."""
    mine, its = one.settings, other.settings
    for key in sorted(mine.keys() | its.keys()):
        pair = mine.get(key, USUALLY), its.get(key, USUALLY)
        if pair[0] != pair[1]:
            return f"{key} is {pair[0]} in {one.origin} and {pair[1]} in {other.origin}"
    return ""


def keepable(results: Sequence[Result], folder: Path) -> dict[Path, str]:
    """Files to keep results in, by path. Raises TrainingError where another run would be lost."""
    files = {folder / result.name: result for result in results}
    for path, result in files.items():
        if path.exists() and (told := _difference(_of_kept(path), result)):
            raise TrainingError(f"{path} keeps another run: {told}: choose another folder with --keep")
    return {path: result.text() for path, result in files.items()}
