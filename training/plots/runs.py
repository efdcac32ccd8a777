"""Runs to be compared, of any scenario, and groups of those that differ only by seeds. Does not need PyTorch.

Runs are in folders of their own, or kept: the curves of several in one file.
"""

import itertools
import logging
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from outlast.ecs.kernels.errors import did_you_mean
from outlast.envs.errors import ScenarioError
from outlast.envs.scenarios.fingerprint import fingerprint, is_fingerprint
from outlast.envs.scenarios.variants import base, variant

from ..base import policy_file
from ..base.config import HOW, SELF, TrainingConfig
from ..base.curves import FILE, LOG, NEEDED, Curves, Described, curves_of_log, is_known, read_curves
from ..base.errors import EmptyRunError, TrainingError
from ..base.presets import Hyperparameters, preset

HOW_ONLY = ("seed", "device", "threads", "every", "settings", *HOW)  # keys of a plan that are not settings
USUAL = {
    each.name: each.default for each in fields(TrainingConfig) if each.default is not MISSING
}  # values for plans of earlier versions, which lack them
SCENARIO, PRESET, SEED = "scenario", "preset", "seed"
OF_PRESET = {*asdict(Hyperparameters()), "rollout", "steps", "cameras_mode"}  # settings that come with a preset
RUN_FILES = (LOG, policy_file.RUN_JSON)  # files that identify the folder of a run
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

    def text(self, name: str) -> str:
        """Return a setting, or the seed, as a text."""
        return shown(self.seed if name == SEED else self.settings.get(name, ABSENT))


@dataclass(frozen=True)
class RunGroup:
    """Runs of one setting, in order of seeds."""

    runs: tuple[Run, ...]
    values: dict[str, str]  # the settings that distinguish it, as texts by name; empty if it is the only group
    mixed: tuple[str, ...]  # settings in which its own runs differ, possible if groups are formed by other settings

    @property
    def label(self) -> str:
        """Its name in legends and tables: "melee_damage=20"; for a scenario and a preset, only their names."""
        plain = (SCENARIO, PRESET)
        texts = (value if name in plain else f"{name}={value}" for name, value in self.values.items())
        return ", ".join(texts) or common(self.runs, lambda run: run.label) or self.runs[0].scenario

    @property
    def ended(self) -> tuple[Run, ...]:
        """The runs whose end values count: the finished ones (see `unfinished`), or all if none is finished."""
        return tuple(run for run in self.runs if run not in self.unfinished) or self.runs

    @property
    def unfinished(self) -> tuple[Run, ...]:
        """Runs shorter than requested; if that is not recorded, shorter than 9/10 of the longest run."""
        longest = max(run.steps for run in self.runs)
        return tuple(run for run in self.runs if run.steps < (0.9 * longest if run.asked is None else run.asked))


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
                found.append(run_of(path, header, curves_of_log(path / LOG, is_known)))
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
        if place.name in (known := kept_runs(place.parent)):
            return [place]
        file = f"{place.parent / FILE} has no run {place.name}; known: {', '.join(known)}"
        raise TrainingError(file if known else f"folder {place} does not exist")
    if place.is_file():
        raise TrainingError(f"{place} is a file: give the folder of a run, or one with runs in it or in its {FILE}")
    runs = {path.parent for name in RUN_FILES for path in place.glob(f"*/{name}")}
    found = sorted([*(place / name for name in kept_runs(place)), *runs])
    if not found:
        wanted = f"neither {LOG} nor {FILE} nor folders of runs"
        raise TrainingError(f"{place} does not hold runs: {wanted}")
    return found


def kept_runs(study: Path) -> dict[str, Described]:
    """Return the kept runs of a study, by name; empty if it has none. Raises TrainingError."""
    return read_curves(study / FILE) if (study / FILE).exists() else {}


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
    """Return everything in a fingerprint except names; the code of the user's mechanics by digits of its hash."""
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


def group_runs(runs: Sequence[Run], by: Sequence[str] = ()) -> list[RunGroup]:
    """Put runs into groups, in order of their values.

    by: Names of settings that distinguish groups; if empty, runs of a group differ by seeds only. Raises TrainingError:
    a setting is unknown, or two runs are the same one.
    """
    known = [*dict.fromkeys(name for run in runs for name in run.settings), SEED]
    if unknown := [name for name in by if name not in known]:
        hint, differ = did_you_mean(unknown[0], known, after=" "), ", ".join([*differing(runs), SEED])
        raise TrainingError(f"--by {unknown[0]}: unknown setting of these runs; {hint}they differ in {differ}")
    names, found = list(by) or telling(runs), list[RunGroup]()
    for key, own in _grouped(runs, names).items():
        ordered = sorted(own, key=lambda run: run.seed)
        mixed = unnamed(ordered)
        for one, other in itertools.pairwise(ordered if not mixed else ()):
            if one.seed == other.seed:
                both = f"{one.origin} and {other.origin}"
                raise TrainingError(f"{both} are the same run, or both of seed {one.seed}: give one")
        found.append(RunGroup(tuple(ordered), dict(zip(names, key, strict=True)), tuple(mixed)))
    return sorted(found, key=lambda group: [_order(text) for text in group.values.values()])


def _grouped(runs: Iterable[Run], names: Sequence[str]) -> dict[tuple[str, ...], list[Run]]:
    """Return runs by the texts of some of their settings."""
    found: dict[tuple[str, ...], list[Run]] = {}
    for run in runs:
        found.setdefault(tuple(map(run.text, names)), []).append(run)
    return found


def differing(runs: Sequence[Run]) -> list[str]:
    """Return the settings in which runs differ, in order of first mention."""
    names = dict.fromkeys(name for run in runs for name in run.settings)
    return [name for name in names if len(_grouped(runs, [name])) > 1]


def telling(runs: Sequence[Run]) -> list[str]:
    """Return settings that distinguish all runs that differ in any setting.

    The game's name and the preset are included whenever they differ; of the game's numbers, and then of all other
    settings, there are as few as a greedy choice finds.
    """
    names, chosen = differing(runs), list[str]()
    numbers = [name for name in names if name not in OF_PRESET and any(name in run.numbers for run in runs)]
    for name in dict.fromkeys([SCENARIO, *numbers, PRESET, *names]):
        always = name in (SCENARIO, PRESET)
        if name in names and (always or len(_grouped(runs, [*chosen, name])) > len(_grouped(runs, chosen))):
            chosen.append(name)
    return chosen


def unnamed(runs: Sequence[Run], named: Collection[str] = ()) -> list[str]:
    """Return settings in which runs differ, without those of `named` and those implied by them.

    With a game's name come its numbers, or the other way round; with a preset comes OF_PRESET.
    """
    names = [name for name in differing(runs) if name not in named]
    numbers = {name for name in names if any(name in run.numbers for run in runs)}
    follow = set[str]()
    if SCENARIO in (*named, *names):
        follow |= numbers or {SCENARIO}
    if PRESET in (*named, *names):
        follow |= OF_PRESET
    if {SCENARIO, PRESET, "agents_count"} & {*named, *names}:
        follow |= {"worlds"}  # a preset has fewer worlds for more agents
    return [name for name in names if name not in follow]


def _order(text: str) -> tuple[float, str]:
    """Return a key that sorts numbers by size, before words."""
    try:
        return float(text), ""
    except ValueError:
        return float("inf"), text


def common(runs: Sequence[Run], get: Callable[[Run], str]) -> str:
    """Return the value that all runs share; "" if they differ."""
    found = {get(run) for run in runs}
    return found.pop() if len(found) == 1 else ""
