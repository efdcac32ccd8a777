"""Measure every table of docs/performance.md on this machine.

    python -m perf.all --save MACHINE [--only step floor]
        [--original PYTHON:CHECKOUT]

The scripts run one after the other, each in a process of its own, and their
numbers are kept in perf/results/MACHINE. A script is left out, with a message,
if a library that it needs is not installed. First, a checkout is compared with
itself: that table, "noise", says how far apart two measurements of the same
code can be. Let nothing else run on the machine meanwhile.
"""

import subprocess
import sys
import time
from importlib.util import find_spec

from tqdm import tqdm

from perf.compare import compared, summary
from perf.report import ROOT
from perf.table import Table, options

SCRIPTS = {  # by name: arguments of python -m
    "step": ("perf.step",),
    "floor": ("perf.floor",),
    "worlds": ("perf.scale", "worlds"),
    "agents": ("perf.scale", "agents"),
    "threads": ("perf.scale", "threads"),
    "reset": ("perf.cost", "reset"),
    "memory": ("perf.cost", "memory", "--steps", "10000000"),
    "make": ("perf.cost", "make"),
    "edit": ("perf.edit",),
    "profile": ("perf.profile", "teams_3"),
    "frames": ("perf.frames",),
    "interfaces": ("perf.interfaces",),
    "vector_step": ("perf.vector_step",),
    "benchmarl": ("perf.benchmarl",),
    "training": (
        *("perf.training.rates", "--preset", "fast", "--worlds", "256"),
        *("--rollout", "32768", "--threads", "1"),
    ),
}
NEEDS = {  # libraries beside those of the core
    "interfaces": ("stable_baselines3", "torchrl", "pettingzoo"),
    "benchmarl": ("benchmarl", "vmas"),
    "training": ("torch",),
}


def main() -> None:
    """Run all scripts."""
    parser = options(__doc__)
    text = f"run only these scripts: {', '.join(SCRIPTS)} (default: all)"
    parser.add_argument("--only", nargs="+", choices=SCRIPTS, default=list(SCRIPTS), metavar="SCRIPT", help=text)
    parser.add_argument(
        "--original", metavar="PYTHON:CHECKOUT", help="for the script step: see python -m perf.step --help"
    )
    given = parser.parse_args()
    if given.save is None:
        parser.error("say where the numbers are kept: --save MACHINE")
    noise().finish(given.save)
    failed = []
    for name in (bar := tqdm(given.only, unit="table")):
        bar.set_description(name)
        if missing := [each for each in NEEDS.get(name, ()) if find_spec(each) is None]:
            tqdm.write(f"{name} is left out: {', '.join(missing)} is not installed")
            continue
        more = ["--original", given.original] if name == "step" and given.original else []
        start = time.perf_counter()
        status = subprocess.run(
            [sys.executable, "-m", *SCRIPTS[name], "--save", given.save, *more], cwd=ROOT, stdout=subprocess.DEVNULL
        ).returncode
        tqdm.write(f"{name}: {'done' if status == 0 else 'failed'} in {time.perf_counter() - start:.0f} s")
        failed += [name] if status else []
    if failed:
        sys.exit(f"{', '.join(failed)} failed: what they printed is above; run them again with --only")
    print(f"python -m perf.report {given.save} writes the tables into the pages")


def noise() -> Table:
    """The table of how much two equal checkouts differ."""
    table = Table("noise", "variant", "one", "the other", "ratio", "round by round")
    for variant in ("ffa_1", "teams_3"):
        table.add(variant, *summary(compared(ROOT, ROOT, variant, 1024, 1, specialize=True)))
    return table


if __name__ == "__main__":
    main()
