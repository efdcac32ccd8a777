"""Runs to be compared, of any scenario: their game, settings and all curves. Does not need PyTorch.

They are in folders of their own, or kept: the curves of several in one file.
"""

import logging
from collections.abc import Iterable
from dataclasses import MISSING, asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from outlast.envs.errors import ScenarioError
from outlast.envs.scenarios.fingerprint import fingerprint, is_fingerprint
from outlast.envs.scenarios.variants import base, variant

from ..base import curves, policy_file
from ..base.config import HOW, SELF, TrainingConfig
from ..base.curves import FILE, NEEDED, Curves, Described, curves_of_log, is_known, read_curves
from ..base.errors import EmptyRunError, TrainingError
from ..base.presets import preset

HOW_ONLY = ("seed", "device", "threads", "every", "settings", *HOW)  # keys of a plan that are not settings
USUAL = {
    each.name: each.default for each in fields(TrainingConfig) if each.default is not MISSING
}  # values for plans of earlier versions, which lack them
SCENARIO, PRESET = "scenario", "preset"
RUN_FILES = (curves.LOG, policy_file.RUN_JSON)  # files that identify the folder of a run
ABSENT = "not there"  # in place of a number that a game lacks
BEYOND = {
    "varied": "numbers that vary",
    "observed": "numbers that agents observe",
    "roles": "roles",
    "order": "systems in another order",
    "code": "mechanics of one's own",
}  # keys of fingerprints that describe more than a variant with other numbers, in words
logger = logging.getLogger("outlast")


@dataclass(frozen=True)
class Run:
    """A run."""

    origin: Path  # its folder; for a kept run, its name in the folder of the study
    scenario: str  # name of the game
    numbers: dict[str, Any]  # of the scenario, by name
    plan: dict[str, Any]
    curves: Curves  # all logged values, by tag; for kept runs, the paper's quantities
    label: str = ""  # name of the scenario with its changes: "ffa_2-melee_damage=50"; "" if that is the name alone
    asked: int | None = None  # requested agent-steps; None if that is not recorded
    beyond: tuple[str, ...] = ()  # parts of the game that no variant has, in words; see BEYOND

    @property
    def seed(self) -> int:
        """The seed of the run."""
        return int(self.plan["seed"])

    @property
    def steps(self) -> int:
        """The agent-steps done."""
        return int(self.curves.steps[-1])

    @cached_property
    def settings(self) -> dict[str, Any]:
        """Return everything but the seed that decides the outcome, by name: scenario, numbers, plan, PPO's numbers."""
        usual = {name: value for name, value in USUAL.items() if name not in (*HOW_ONLY, "steps")}
        usual |= {"opponents": f"{SELF}:1", "anneal": ""}
        plan = {name: value for name, value in self.plan.items() if name not in HOW_ONLY}
        own = asdict(preset(self.plan[PRESET]).numbers) | self.plan.get("settings", {})
        return {SCENARIO: self.scenario, **usual, **plan, **self.numbers, **own}


def shown(value: Any) -> str:
    """Return a value as a user types it: true, 0.5, 8,4."""
    if isinstance(value, (list, tuple)):
        return ",".join(map(shown, value))
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and float(short := f"{value:g}") == value:
        return short
    return str(value)


def load(places: Iterable[Path]) -> list[Run]:
    """Read all runs. Those in which no episode has ended yet are left out, with a warning.

    places: Folders of runs, folders around them, studies (folders with kept runs), or single runs of a study, named as
    if they were folders in it. Raises TrainingError: a place does not hold runs, or none with a curve.
    """
    found, reasons = list[Run](), list[str]()
    for path in dict.fromkeys(path for place in places for path in _found(place)):
        try:
            if path.is_dir():
                header = policy_file.read_run_folder(path)
                found.append(run_of(path, header, curves_of_log(path / curves.LOG, is_known)))
            else:
                found.append(read_kept(path))
        except EmptyRunError as error:
            reasons.append(str(error))
    if reasons and not found:
        raise TrainingError(f"nothing can be drawn: {reasons[0]}")
    for reason in reasons:
        logger.warning("left out: %s", reason)
    return found


def _found(place: Path) -> list[Path]:
    """Return the folders of runs and the kept runs in a place, which may be one itself."""
    if any((place / name).exists() for name in RUN_FILES):
        return [place]
    if not place.exists():
        return [_kept_run(place)]
    if place.is_file():
        raise TrainingError(f"{place} is a file: give the folder of a run, or one with runs in it or in its {FILE}")
    runs = {path.parent for name in RUN_FILES for path in place.glob(f"*/{name}")}
    found = sorted([*(place / name for name in kept_runs(place)), *runs])
    if not found:
        wanted = f"neither {curves.LOG} nor {FILE} nor folders of runs"
        raise TrainingError(f"{place} does not hold runs: {wanted}")
    return found


def kept_runs(study: Path) -> dict[str, Described]:
    """Return the kept runs of a study, by name; empty if it has none. Raises TrainingError."""
    return read_curves(study / FILE) if (study / FILE).exists() else {}


def _kept_run(place: Path) -> Path:
    """Return the place, if it is that of a kept run. Raises TrainingError."""
    known = kept_runs(place.parent)
    if not known:
        raise TrainingError(f"folder {place} does not exist")
    if place.name not in known:
        raise TrainingError(f"{place.parent / FILE} has no run {place.name}; known: {', '.join(known)}")
    return place


def run_of(origin: Path, header: policy_file.Header, curves: Curves) -> Run:
    """Return the run that a header describes, with its curves. Raises TrainingError if its plan is not valid."""
    scenario, plan = header["scenario"], header["plan"]
    _check_plan(origin, plan)
    asked = plan.get("steps", header.get(policy_file.ASKED))
    beyond = tuple(words for key, words in BEYOND.items() if scenario.get(key))
    return Run(origin, scenario["name"], _played(scenario), plan, curves, scenario.get("label", ""), asked, beyond)


def read_kept(path: Path) -> Run:
    """Return a run of a study, as if it were a folder in it. Raises TrainingError."""
    about, curves = read_curves(path.parent / FILE)[path.name]
    wrong = f"{path} does not hold the curves of a run"
    try:
        name, plan, changed = variant(about["variant"]).name, about["plan"], about["changed"]
        _check_plan(path, plan)
        usual = usual_numbers(name, plan[PRESET])
    except (KeyError, TypeError, ScenarioError) as error:
        raise TrainingError(f"{wrong}: {error}") from error
    if missing := [tag for tag in NEEDED if tag not in curves.values]:
        raise TrainingError(f"{wrong}: it has no {missing[0]}")
    if not is_fingerprint({"name": name, "numbers": changed}) or "$" in str(changed):
        raise TrainingError(f"{wrong}: its changed numbers are invalid")
    numbers = {key: value for key, value in (usual | changed).items() if value != ABSENT}
    return Run(path, name, numbers, plan, curves, asked=plan.get("steps"))


def usual_numbers(name: str, of: str) -> dict[str, Any]:
    """Return the numbers of a variant without ablations, with the observations of a preset. Raises ScenarioError."""
    return fingerprint(preset(of).scenario(variant(base(name))))["numbers"]


def _check_plan(origin: Path, plan: Any) -> None:
    """Raise TrainingError if it is not the plan of a run."""
    if not policy_file.is_plan(plan) or type(plan.get("seed")) is not int:
        raise TrainingError(f"{origin} does not hold a run: its plan is invalid")
    try:
        preset(plan.get(PRESET))
    except ScenarioError as error:
        raise TrainingError(f"{origin} does not hold a run: {error}") from error


def _played(scenario: dict[str, Any]) -> dict[str, Any]:
    """Return everything in a fingerprint except names.

    These are numbers, or their distributions; roles, observations, the order of systems, and the code of the user's
    mechanics, by the first digits of its hash.
    """
    drawn = {name: f"{kind}({', '.join(map(shown, of))})" for name, (kind, *of) in scenario.get("varied", {}).items()}
    roles, order, code = (scenario.get(key, {}) for key in ("roles", "order", "code"))
    more = {"roles drawn": roles["drawn"]} if roles else {}
    for role in roles["roles"] if roles else ():
        more[f"{role['name']} agents"] = "rest" if role["count"] is None else role["count"]
        more |= {f"{role['name']} {name}": value for name, value in role["numbers"].items()}
    more |= {"observed": scenario["observed"]} if scenario.get("observed") else {}
    more |= {"order": "; ".join(" < ".join(chain) for chain in order)} if order else {}
    more |= {f"code of {name}": digest[:8] for name, (_, _, digest) in code.items()}
    return {**scenario["numbers"], **drawn, **more}
