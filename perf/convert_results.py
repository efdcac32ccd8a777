"""Convert docs/results and the anchors to the one folder results/, and compare what it holds with them.

    python -m perf.convert_results OUT [--compare WORLDS]

What is written, with its size, and every check are printed; the status is 1 if one fails. --compare lets all policies
act on the same observations with float32 and with float16 weights, drawing the same random numbers. To be deleted once
results/ is there.
"""

import argparse
import csv
import gzip
import io
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.scenarios.scenario import Scenario
from outlast.training import checkpoint, policy_file
from outlast.training.benchmark.suite import FOLDER as ANCHORS
from outlast.training.benchmark.tasks import task_of, tasks
from outlast.training.curves import Curves, Logged
from outlast.training.paper.report import report
from outlast.training.paper.results import RunResult, group_runs, load_runs
from outlast.training.policy_file import CRITIC
from outlast.training.reproduction import mended
from outlast.training.reproduction.experiments import PARTS, experiments
from outlast.training.run_header import Header
from perf.half_weights import equal_actions

ROOT = Path(__file__).parents[1]
RESULTS, BENCHMARK = ROOT / "docs" / "results", ROOT / "results" / "benchmark"
STUDIES = ("original", "text", "mended", "worlds-64")
POOL = "pool"  # how runs of "mended" are called, whose preset is that of the benchmark's "fast"
FIRST_ONLY = ("text", "mended")  # studies of which the policies of the first seed are kept
SHOWN = ("original", "worlds-64", "benchmarl")  # studies whose figures are on a page
BUDGET = 10_000_000
DIGITS = {"mended": 3}  # of curves that only figures are made of; others are kept to the bit
NOTHING = "0" * 64  # the digest of a recording that is not kept
ENOUGH = 0.999  # share of choices that must be equal
FIGURES = ("wins", *mended.SELF_PLAY)  # those that are used of "measured"
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
    chosen, failed = list(models()), list[str]()
    kept_policies(chosen, given.out)
    kept_anchors(given.out)
    for study in STUDIES:
        kept_curves(study, given.out)
    kept_measured(given.out)
    kept_pictures(given.out)
    for what, equal in checks(given.out):
        print(f"{'equal' if equal else 'DIFFERENT'}: {what}", flush=True)
        failed += [] if equal else [what]
    print(*sizes(given.out), sep="\n")
    if given.compare:
        failed += compare(chosen, given.out, given.compare)
    return int(bool(failed))


# ---- policies


def models() -> Iterator[Model]:
    """Yield the policies that are kept under results/policies, by name."""
    games = {f"{each.name}-{each.preset}": (each.name, each.scenario) for each in experiments(PARTS)}
    for study in STUDIES[:3]:
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


# ---- tables


def packed(text: str) -> bytes:
    """A text as gzip; equal texts give equal bytes."""
    return gzip.compress(text.encode(), 9, mtime=0)


def kept_curves(study: str, out: Path) -> None:
    """Write the curves of all runs of a study as one table, whose first line describes the runs."""
    runs, text = load_runs([RESULTS / study]), io.StringIO()
    names = {run.origin.stem: run for run in runs}
    about = {name: run.about for name, run in names.items()}
    tags = sorted({tag for run in runs for tag in run.curves.values})
    text.write(f"# {json.dumps(about, separators=(',', ':'))}\n")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["run", "step", *tags])
    for name, run in names.items():
        columns = [
            [short(value, DIGITS.get(study, 0)) for value in run.curves.values.get(tag, ())]
            or [""] * len(run.curves.steps)
            for tag in tags
        ]
        rows.writerows([name, step, *cells] for step, *cells in zip(run.curves.steps.tolist(), *columns, strict=True))
    place = out / study / "curves.csv.gz"
    place.parent.mkdir(exist_ok=True)
    place.write_bytes(packed(text.getvalue()))


def short(value: Any, digits: int) -> str:
    """A number with so many significant digits; 0: the fewest that give the same float32."""
    if np.isnan(value):
        return ""
    return f"{value:.{digits}g}" if digits else np.format_float_positional(value, trim="-")


def read_curves(place: Path) -> list[RunResult]:
    """Read what `kept_curves` wrote."""
    first, _, rest = gzip.decompress(place.read_bytes()).decode().partition("\n")
    (_, _, *tags), *rows = csv.reader(io.StringIO(rest))
    found = []
    for name, about in json.loads(first[2:]).items():
        own = [row for row in rows if row[0] == name]
        values = {
            tag: np.array([row[k] or "nan" for row in own], np.float64).astype(np.float32)
            for k, tag in enumerate(tags, 2)
        }
        curves = Curves(
            np.array([row[1] for row in own], np.int64),
            {tag: each for tag, each in values.items() if np.isfinite(each).any()},
        )
        found.append(RunResult(Path(f"{name}.csv"), about["variant"], about["plan"], about["changed"], curves))
    return found


def kept_measured(out: Path) -> None:
    """Write one table of what was measured of all mended games: a row for each pair of policies and role."""
    text = io.StringIO()
    heads = [f"{name} {of}" for name in FIGURES for of in ("mean", "error")]
    rows = csv.DictWriter(text, ["run", "agents", "policy", "against", "role", *heads], "", lineterminator="\n")
    rows.writeheader()
    for place in sorted((RESULTS / "mended" / "measured").iterdir()):
        content = json.loads((place / "evaluation.json").read_text())
        row = {"run": place.name, "agents": content["scenario"]["numbers"]["agents_count"]}
        for pairing in content["pairings"]:
            for role, figures in enumerate(pairing["figures"]):
                policy, against = pairing["policies"][:: 1 - 2 * role]
                there = {name: figures[name] for name in FIGURES if name in figures}
                means = {f"{name} mean": each["mean"] for name, each in there.items()}
                errors = {f"{name} error": f"{each['error']:.4g}" for name, each in there.items()}
                rows.writerow(row | {"policy": policy, "against": against, "role": role} | means | errors)
    (out / "mended" / "measured.csv.gz").write_bytes(packed(text.getvalue()))


# ---- pictures, and what stays as it is


def kept_pictures(out: Path) -> None:
    """Copy tables, and the figures that pages show; make films of the animations."""
    from imageio_ffmpeg import get_ffmpeg_exe

    for source in sorted(RESULTS.rglob("*")):
        target = out / source.relative_to(RESULTS)
        (out / target.relative_to(out).parts[0]).mkdir(exist_ok=True)
        if source.suffix == ".gif":
            words = [
                "-i",
                source,
                "-c:v",
                "libvpx-vp9",
                "-pix_fmt",
                "yuv420p",
                "-b:v",
                "0",
                "-crf",
                "40",
                target.with_suffix(".webm"),
            ]
            subprocess.run([get_ffmpeg_exe(), "-nostdin", "-loglevel", "error", *map(str, words)], check=True)
        elif (
            source.suffix == ".md"
            or source.name == "ends.csv"
            or (source.suffix == ".png" and target.parent.name in SHOWN)
        ):
            shutil.copy(source, target)
        elif source.suffix == ".json" and target.parent.name == "benchmarl":
            target.write_text(json.dumps(json.loads(source.read_text()), separators=(",", ":")) + "\n")


def sizes(out: Path) -> Iterator[str]:
    """Lines of bytes, files and folder, and their sum."""
    files = [path for path in out.rglob("*") if path.is_file()]
    folders = sorted({path.relative_to(out).parts[0] for path in files})
    for folder in [*folders, "."]:
        own = [path for path in files if path.is_relative_to(out / folder)]
        yield f"{sum(path.stat().st_size for path in own):>12,} {len(own):>4} {folder}"


# ---- comparison


def checks(out: Path) -> Iterator[tuple[str, bool]]:
    """Yield what was compared with what was there before, and whether it is equal."""
    for study in STUDIES:
        before, after = load_runs([RESULTS / study]), read_curves(out / study / "curves.csv.gz")
        within = 10.0 ** (1 - DIGITS[study]) if study in DIGITS else 0
        pairs = zip(sorted(before, key=key), sorted(after, key=key), strict=True)
        yield f"curves of {study}, up to {within:g}", all(same_run(*pair, within) for pair in pairs)
        if study not in DIGITS:
            beside = load_runs([RESULTS / "original"]) if study == "text" else []
            tables = [report(group_runs(runs), group_runs(beside)) for runs in (before, after)]
            yield f"end values and claims of {study}", tables[0] == tables[1]
    with tempfile.TemporaryDirectory() as folder:
        expand_measured(out / "mended" / "measured.csv.gz", Path(folder))
        names = {each.name: each for each in experiments(["mended"])}
        places = {name: sorted(Path(folder).glob(f"{name}-fast-[0-9]")) for name in names}
        yield (
            "measurements of mended games",
            mended.table(places) + "\n" == (RESULTS / "mended" / "measured.md").read_text(),
        )


def key(run: Logged) -> str:
    """What runs are sorted by."""
    return f"{run.plan['preset']} {run.seed} {run.variant} {run.changed}"  # type: ignore[attr-defined]


def same_run(one: RunResult, other: RunResult, within: float) -> bool:
    """Whether two runs have the same description, and the same curves up to a relative error."""
    mine, its = one.curves, other.curves
    same = (
        one.about == other.about and np.array_equal(mine.steps, its.steps) and mine.values.keys() == its.values.keys()
    )
    return same and all(
        np.allclose(mine.values[tag], its.values[tag], within, 0, equal_nan=True) for tag in mine.values
    )


def expand_measured(place: Path, out: Path) -> None:
    """Write the evaluations that `kept_measured` read, as far as they are used."""
    found: dict[str, Any] = {}
    for row in csv.DictReader(io.StringIO(gzip.decompress(place.read_bytes()).decode())):
        own = found.setdefault(
            row["run"], {"scenario": {"numbers": {"agents_count": int(row["agents"])}}, "pairings": []}
        )
        figures = {name: {"mean": float(row[f"{name} mean"])} for name in FIGURES if row[f"{name} mean"]}
        if row["role"] == "0":
            own["pairings"].append({"policies": [row["policy"], row["against"]], "figures": []})
        own["pairings"][-1]["figures"].append(figures)
    for name, content in found.items():
        (out / name).mkdir()
        (out / name / "evaluation.json").write_text(json.dumps(content))


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
