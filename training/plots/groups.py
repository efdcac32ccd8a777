"""Groups of runs that differ only by seeds, named by the settings in which the groups differ."""

import itertools
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import asdict, dataclass

from outlast.ecs.kernels.errors import did_you_mean

from ..base.errors import TrainingError
from ..base.presets import Hyperparameters
from .runs import ABSENT, PRESET, SCENARIO, Run, shown

SEED = "seed"
OF_PRESET = {*asdict(Hyperparameters()), "rollout", "steps", "cameras_mode"}  # settings that come with a preset


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


def group_runs(runs: Sequence[Run], by: Sequence[str] = ()) -> list[RunGroup]:
    """Put runs into groups, in order of their values.

    by: Names of settings that distinguish groups; if empty, runs of a group differ by seeds only. Raises TrainingError:
    a setting is unknown, or two runs are the same one.
    """
    if by:
        _check_names(runs, by)
    names = list(by) or telling(runs)
    grouped: dict[tuple[str, ...], list[Run]] = {}
    for run in runs:
        grouped.setdefault(tuple(value_of(run, name) for name in names), []).append(run)
    keys = sorted(grouped, key=lambda key: [_order(text) for text in key])
    return [_group(grouped[key], dict(zip(names, key, strict=True))) for key in keys]


def _group(runs: Sequence[Run], values: dict[str, str]) -> RunGroup:
    ordered = sorted(runs, key=lambda run: run.seed)
    mixed = unnamed(ordered)
    for one, other in itertools.pairwise(ordered if not mixed else ()):
        if one.seed == other.seed:
            both = f"{one.origin} and {other.origin}"
            raise TrainingError(f"{both} are the same run, or both of seed {one.seed}: give one")
    return RunGroup(tuple(ordered), values, tuple(mixed))


def differing(runs: Sequence[Run]) -> list[str]:
    """Return the settings in which runs differ, in order of first mention."""
    names = dict.fromkeys(name for run in runs for name in run.settings)
    return [name for name in names if len({value_of(run, name) for run in runs}) > 1]


def telling(runs: Sequence[Run]) -> list[str]:
    """Return settings that distinguish all runs that differ in any setting.

    The game's name and the preset are included whenever they differ; of the game's numbers, and then of all other
    settings, there are as few as a greedy choice finds.
    """
    names = differing(runs)
    numbers = [name for name in names if name not in OF_PRESET and any(name in run.numbers for run in runs)]
    chosen = list[str]()
    for name in dict.fromkeys([SCENARIO, *numbers, PRESET, *names]):
        always = name in (SCENARIO, PRESET)
        if name in names and (always or _kinds(runs, [*chosen, name]) > _kinds(runs, chosen)):
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


def _kinds(runs: Sequence[Run], names: Sequence[str]) -> int:
    return len({tuple(value_of(run, name) for name in names) for run in runs})


def value_of(run: Run, name: str) -> str:
    """Return a setting of a run as a text."""
    return str(run.seed) if name == SEED else shown(run.settings.get(name, ABSENT))


def _order(text: str) -> tuple[float, str]:
    """Return a key that sorts numbers by size, before words."""
    try:
        return float(text), ""
    except ValueError:
        return float("inf"), text


def _check_names(runs: Sequence[Run], by: Iterable[str]) -> None:
    known = [*dict.fromkeys(name for run in runs for name in run.settings), SEED]
    for name in by:
        if name not in known:
            hint = did_you_mean(name, known, after=" ")
            differ = ", ".join([*differing(runs), SEED])
            raise TrainingError(f"--by {name}: unknown setting of these runs; {hint}they differ in {differ}")


def common(runs: Sequence[Run], get: Callable[[Run], str]) -> str:
    """Return the value that all runs share; "" if they differ."""
    found = {get(run) for run in runs}
    return found.pop() if len(found) == 1 else ""
