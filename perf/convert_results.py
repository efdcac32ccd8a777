"""Convert policies and the anchors for the one folder results/, and compare what it holds with them.

    python -m perf.convert_results OUT [--compare WORLDS]

Sizes are printed. --compare lets all policies act on the same observations with float32 and with float16 weights,
drawing the same random numbers. To be deleted once results/ is there.
"""

import argparse
import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.scenarios.scenario import Scenario
from outlast.training import checkpoint, policy_file
from outlast.training.benchmark.suite import FOLDER as ANCHORS
from outlast.training.benchmark.tasks import task_of, tasks
from outlast.training.policy_file import CRITIC
from outlast.training.reproduction.experiments import PARTS, experiments
from outlast.training.run_header import Header
from perf.half_weights import equal_actions

ROOT = Path(__file__).parents[1]
RESULTS, BENCHMARK = ROOT / "docs" / "results", ROOT / "results" / "benchmark"
STUDIES = ("original", "text", "mended")
POOL = "pool"  # how runs of "mended" are called, whose preset is that of the benchmark's "fast"
FIRST_ONLY = ("text", "mended")  # studies of which the policies of the first seed are kept
ENOUGH = 0.999  # share of choices that must be equal
Weights = dict[str, np.ndarray[Any, Any]]


@dataclass(frozen=True)
class Model:
    """A policy that is kept: its name, where it was, and what it plays."""

    name: str
    source: Path
    game: Scenario
    whole: bool

    @property
    def file(self) -> str:
        """The path of its file in results/."""
        return f"policies/{self.name}{policy_file.SUFFIX}"


def main() -> int:
    """Convert and compare; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for the results, which must not exist")
    parser.add_argument("--compare", type=int, default=0, metavar="WORLDS", help="worlds in which each policy acts")
    given = parser.parse_args()
    given.out.mkdir(parents=True)
    chosen = list(models())
    kept_policies(chosen, given.out)
    kept_anchors(given.out)
    print(*sizes(given.out), sep="\n")
    return int(bool(given.compare and compare(chosen, given.out, given.compare)))


# ---- policies


def models() -> Iterator[Model]:
    """Yield the policies that are kept under results/policies, by name."""
    games = {f"{each.name}-{each.preset}": (each.name, each.scenario) for each in experiments(PARTS)}
    for study in STUDIES:
        for source in sorted((RESULTS / study).glob("*.zip")):
            stem, _, seed = source.stem.rpartition("-")
            name, game = games[stem]
            kind, first = POOL if study == "mended" else stem.rpartition("-")[2], seed == "0"
            if first or study not in FIRST_ONLY:
                yield Model(f"{name}/{kind}-{seed}", source, game, study == "original" and first)
    for source in sorted(BENCHMARK.rglob("fast/*/policy.zip")):
        task = task_of(source.parts[-4])
        yield Model(f"{task.name.rpartition('-')[0]}/fast-{source.parts[-2]}", source, task.games[0].scenario, True)


def weights_of(source: Path) -> tuple[Header, list[Weights]]:
    """The header and the weights of a checkpoint, float32."""
    files = checkpoint.read_checkpoint(source, ("policy.pt",))
    every = checkpoint.policies_in(files)
    return checkpoint.header_of(files), [{name: values.numpy() for name, values in own.items()} for own in every]


def acting(header: Header, policies: list[Weights]) -> list[Weights]:
    """The weights without those of the critic, and of the second extractor, which only the critic reads."""
    return [{name: values for name, values in own.items() if not name.startswith(CRITIC)} for own in policies]


def kept_policies(chosen: Iterable[Model], out: Path) -> None:
    """Write a file for each policy."""
    for model in chosen:
        header, policies = weights_of(model.source)
        policy_file.write(out / model.file, header, policies if model.whole else acting(header, policies))


def kept_anchors(out: Path) -> None:
    """Write a file for each task: the weights of all anchors, stacked, with their ratings and a common header."""
    for name in tasks():
        content = json.loads((ANCHORS / f"{name}.json").read_text())
        every, members, shared = list[Weights](), list[dict[str, Any]](), dict[str, Any]()
        for member in content["members"]:
            members.append({key: member[key] for key in ("name", "elo", "error")})
            if member["file"]:
                header, policies = weights_of(ANCHORS / member["file"])
                members[-1] |= {key: header.pop(key) for key in ("steps", "plan")}
                assert shared in ({}, header), member["name"]
                shared = header
                every += acting(header, policies)
        stacked = {weight: np.stack([own[weight] for own in every]) for weight in every[0]}
        rated = {"games": content["games"], "made": content["made"], "members": members}
        header = shared | {"steps": 0, "suite": rated}
        policy_file.write(out / "anchors" / f"{name}{policy_file.SUFFIX}", header, [stacked])


def sizes(out: Path) -> Iterator[str]:
    """Lines of bytes, files and folder, and their sum."""
    files = [path for path in out.rglob("*") if path.is_file()]
    folders = sorted({path.relative_to(out).parts[0] for path in files})
    for folder in [*folders, "."]:
        own = [path for path in files if path.is_relative_to(out / folder)]
        yield f"{sum(path.stat().st_size for path in own):>12,} {len(own):>4} {folder}"


# ---- comparison


def compare(chosen: Iterable[Model], out: Path, worlds: int, steps: int = 300) -> list[str]:
    """Print how many actions are equal with float16; returns the policies of which fewer than 99.9 % of choices are."""
    found = dict[str, tuple[float, float]]()
    for name, source, game, policies in _rounded(chosen, out):
        found[name] = equal_actions(source, policies, game, worlds, steps)
        choices, actions = found[name]
        print(f"{choices:.5f} of choices and {actions:.5f} of whole actions are equal: {name}", flush=True)
    (choices, actions), (fewest, least) = np.mean(list(found.values()), 0), np.min(list(found.values()), 0)
    print(f"of choices {choices:.5f} on average, {fewest:.5f} at least; of whole actions {actions:.5f}, {least:.5f}")
    return [name for name, (share, _) in found.items() if share < ENOUGH]


def _rounded(chosen: Iterable[Model], out: Path) -> Iterator[tuple[str, Path, Scenario, list[Weights]]]:
    """Yield name, checkpoint, game and rounded weights of all policies."""
    for model in chosen:
        yield model.name, model.source, model.game, policy_file.read(out / model.file)[1]
    for name in tasks():
        header, (stacked,) = policy_file.read(out / "anchors" / f"{name}{policy_file.SUFFIX}")
        for k, anchor in enumerate(each["name"] for each in header["suite"]["members"] if "steps" in each):
            own, source = {weight: values[k] for weight, values in stacked.items()}, ANCHORS / f"{name}-{anchor}.zip"
            yield f"{name} {anchor}", source, task_of(name).games[0].scenario, [own]


if __name__ == "__main__":
    sys.exit(main())
