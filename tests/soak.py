"""Soak test: play, reset and make environments for long, and look for leaks.

    python -m tests.soak [--world-steps 10e6] [--resets 100000]
        [--environments 1000]

There are three parts, each in a process of its own: random play of all
scenarios, with the invariants of tests.helpers.invariants checked after every
tick; resets of all kinds; and environments that are created, and closed or
dropped. The number of file descriptors and threads must not grow, and after the
warm-up resident memory must grow by less than a megabyte (/proc/self/statm,
after garbage collection; only Linux has it). The exit status is 0 if all held.
"""

import gc
import os
import statistics
import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import outlast
from outlast import VARIANTS
from tests.conftest import draw_actions, scaled
from tests.helpers.invariants import SCENARIOS, CheckedPlay, scenario

PROC = Path("/proc/self")
MEGABYTE = 2**20
LIMIT = 1.0  # megabytes of allowed growth
WARM_UP, PROBES = 0.2, 40  # a share of the work; measurements in the rest of it
WORLDS = scaled(512, least=20)  # of an environment that is stepped by two threads


@dataclass
class Usage:
    """What the process uses, measured in intervals."""

    megabytes: list[float] = field(default_factory=list)
    files: list[int] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)

    def probe(self) -> None:
        gc.collect()
        if PROC.exists():
            pages = int((PROC / "statm").read_text().split()[1])
            self.megabytes.append(pages * os.sysconf("SC_PAGE_SIZE") / MEGABYTE)
            self.files.append(len(list((PROC / "fd").iterdir())))
        self.threads.append(len(sys._current_frames()))

    @property
    def growth(self) -> float:
        """Megabytes from the first quarter of the probes to the last: medians, as a single probe may be a peak."""
        quarter = max(1, len(self.megabytes) // 4)
        if not self.megabytes:
            return 0.0
        return statistics.median(self.megabytes[-quarter:]) - statistics.median(self.megabytes[:quarter])

    def faults(self) -> list[str]:
        found = [f"memory grew by {self.growth:.2f} MB: less than {LIMIT} is allowed"] if self.growth >= LIMIT else []
        for name, counts in (("file descriptors", self.files), ("threads", self.threads)):
            if counts and counts[-1] > counts[0]:
                found.append(f"{name} grew from {counts[0]} to {counts[-1]}")
        return found

    def __str__(self) -> str:
        if not self.megabytes:
            return f"threads {self.threads[-1]}; memory is not measured here"
        return (
            f"resident {self.megabytes[0]:.1f} .. {max(self.megabytes):.1f} .. {self.megabytes[-1]:.1f} MB, growth "
            f"{self.growth:+.2f} MB in {len(self.megabytes)} probes, {self.files[-1]} files, {self.threads[-1]} threads"
        )


def soak(name: str, work: Iterator[int], amount: int, quiet: bool = False) -> Usage:
    """Do `amount` of work, the sum of what the iterator yields, and measure after the warm-up."""
    usage, done = Usage(), 0
    gc.collect()
    gc.freeze()  # existing objects, mostly the compiler's, make collecting slow
    probes = list(np.linspace(WARM_UP * amount, amount, PROBES, endpoint=False))
    with tqdm(total=amount, desc=name, unit_scale=True, disable=quiet) as bar:
        while done < amount:
            part = next(work)
            done += part
            bar.update(part)
            if probes and done >= probes[0]:
                probes = [probe for probe in probes if probe > done]
                usage.probe()
    usage.probe()
    gc.unfreeze()
    return usage


def steps() -> Iterator[int]:
    """Step worlds of all scenarios in turn, checking all invariants. Yields world-steps."""
    envs = [outlast.make_vec(scenario(name), WORLDS, seed=0, threads=2) for name in SCENARIOS]
    walks = [CheckedPlay(env, seed=k) for k, env in enumerate(envs)]
    while True:
        for walk in walks:
            walk.step()
            yield WORLDS


def resets() -> Iterator[int]:
    """Reset all or some worlds with every kind of seed, and step once after each reset. Yields resets."""
    rng, modes = np.random.default_rng(0), ("NextStep", "SameStep", "Disabled")
    envs = [outlast.make_vec(name, 3, seed=0, autoreset_mode=modes[k % 3]) for k, name in enumerate(VARIANTS)]
    for env in envs:
        env.reset()
    while True:
        for env in envs:
            mask = rng.random(3) < 0.5
            mask[rng.integers(3)] = True
            seed: Any = [None, int(rng.integers(2**63)), rng.integers(0, 2**63, 3)][rng.integers(3)]
            env.reset(seed=seed, options={"reset_mask": mask} if rng.random() < 0.5 else None)
            env.step(draw_actions(env, rng))
            yield 1


def environments() -> Iterator[int]:
    """Make environments with threads, and drop them, closed once, twice or not. Yields environments."""
    rng = np.random.default_rng(0)
    while True:
        for name in VARIANTS:
            env = outlast.make_vec(name, 40, seed=0, threads=3)
            env.reset()
            env.step(draw_actions(env, rng))
            env.send(draw_actions(env, rng))
            env.recv()
            for _ in range(rng.integers(3)):
                env.close()
            del env
            yield 1


PARTS: dict[str, Callable[[], Iterator[int]]] = {
    "world-steps": steps,
    "resets": resets,
    "environments": environments,
}


def parse_options(arguments: list[str] | None) -> Namespace:
    parser = ArgumentParser("python -m tests.soak", description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    for name, default in zip(PARTS, ("10e6", "100000", "1000"), strict=True):
        text = f"number of {name}, 0 to leave this part out (default %(default)s)"
        parser.add_argument(f"--{name}", type=_count, metavar="N", default=default, help=text)
    parser.add_argument("--quiet", action="store_true", help="show no progress bar")
    return parser.parse_args(arguments)


def _count(text: str) -> int:
    return int(float(text))


def run(name: str, amount: int, quiet: bool) -> None:
    """Run one part and exit: in a process of its own, as memory freed by other parts would hide growth."""
    usage = soak(name, PARTS[name](), amount, quiet)
    print(f"{amount:,} {name}: {usage}", flush=True)
    for fault in (faults := usage.faults()):
        print(f"{name}: {fault}", flush=True)
    sys.exit(1 if faults else 0)


def main(arguments: list[str] | None = None) -> int:
    options = parse_options(arguments)
    os.environ["MALLOC_ARENA_MAX"] = "1"  # else the C library keeps an arena for each thread
    codes = []
    for name in PARTS:
        amount = getattr(options, name.replace("-", "_"))
        process = get_context("spawn").Process(target=run, args=(name, amount, options.quiet))
        if amount:
            process.start()
            process.join()
            codes.append(process.exitcode)
    print("all held" if not any(codes) else "not all held", flush=True)
    return 1 if any(codes) else 0


if __name__ == "__main__":
    sys.exit(main())
