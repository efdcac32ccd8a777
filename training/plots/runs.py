"""Runs to be compared, of any scenario: what was trained, with which settings, and all curves."""

from collections.abc import Iterable
from dataclasses import MISSING, asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from outlast.envs.errors import ScenarioError
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.scenarios.variants import base, variant

from ..base import log_file, run_header
from ..base.config import HOW, SELF, TrainingConfig
from ..base.curves import Curves, Logged, curves_of_log
from ..base.errors import TrainingError
from ..base.presets import preset
from ..paper import results
from ..paper.curves import is_known

HOW_ONLY = ("seed", "device", "threads", "every", "settings", *HOW)  # keys of a plan that are no settings
USUAL = {
    each.name: each.default for each in fields(TrainingConfig) if each.default is not MISSING
}  # for what the plans of earlier versions do not say
SCENARIO, PRESET = "scenario", "preset"


@dataclass(frozen=True)
class Run(Logged):
    """A run.

    Attributes:
        origin: Its folder; of a run that is kept, its name in the folder of the others.
        scenario: The name of what is played.
        numbers: The numbers of the scenario, by name.
        plan: The plan of run.json.
        curves: Everything that was logged, by tag; of kept runs, the paper's quantities.
        label: The scenario's name with what was changed: "ffa_2-melee_damage=50"; "" if that is the name alone.
        asked: Agent-steps that were asked for; None if that is not recorded.
    """

    origin: Path
    scenario: str
    numbers: dict[str, Any]
    plan: dict[str, Any]
    curves: Curves
    label: str = ""
    asked: int | None = None

    @cached_property
    def settings(self) -> dict[str, Any]:
        """What decides the outcome, except the seed, by name: the scenario and its numbers, the plan, PPO's numbers."""
        usual = {name: value for name, value in USUAL.items() if name not in (*HOW_ONLY, "steps")}
        usual |= {"opponents": f"{SELF}:1", "anneal": ""}
        plan = {name: value for name, value in self.plan.items() if name not in HOW_ONLY}
        own = asdict(preset(self.plan[PRESET]).numbers) | self.plan.get("settings", {})
        return {SCENARIO: self.scenario, **usual, **plan, **self.numbers, **own}


def shown(value: Any) -> str:
    """Return a value as it is typed: true, 0.5, 8,4."""
    if isinstance(value, (list, tuple)):
        return ",".join(map(shown, value))
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and float(short := f"{value:g}") == value:
        return short
    return str(value)


def load(places: Iterable[Path]) -> list[Run]:
    """Return the runs in these places; see `results.read_runs`. Raises TrainingError."""
    return results.read_runs(places, lambda path: _of_folder(path) if path.is_dir() else _of_kept(path))


def run_of(origin: Path, header: run_header.Header, curves: Curves) -> Run:
    """Return the run that a header describes, with its curves. Raises TrainingError if its plan is not valid."""
    scenario, plan = header["scenario"], header["plan"]
    if type(plan.get("seed")) is not int or not run_header.is_plan(plan):
        raise TrainingError(f"{origin} does not hold a run: its plan is none")
    try:
        preset(plan.get(PRESET))
    except ScenarioError as error:
        raise TrainingError(f"{origin} does not hold a run: {error}") from error
    asked = plan.get("steps", header.get(run_header.ASKED))
    return Run(origin, scenario["name"], _played(scenario), plan, curves, scenario.get("label", ""), asked)


def _played(scenario: dict[str, Any]) -> dict[str, Any]:
    """Everything in a fingerprint except names.

    These are numbers, or what they are drawn from; roles, what is observed, the order of systems, and the code of
    mechanics of one's own, by the first digits of its hash.
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


def _of_folder(folder: Path) -> Run:
    header = run_header.read_run_folder(folder)
    return run_of(folder, header, curves_of_log(folder / log_file.NAME, is_known))


def _of_kept(path: Path) -> Run:
    kept = results.read_kept(path)
    usual = fingerprint(preset(kept.plan[PRESET]).scenario(variant(base(kept.variant))))["numbers"]
    numbers = {name: value for name, value in (usual | kept.changed).items() if value != results.MISSING}
    return Run(path, kept.variant, numbers, kept.plan, kept.curves, asked=kept.plan.get("steps"))
