"""Time BenchMARL's MAPPO in outlast's worlds and in VMAS's tasks.

    python -m perf.benchmarl [--save MACHINE]

Numbers are frames per second, a frame being a tick of one world. All tasks have
64 worlds, four agents and discrete actions, run on the CPU, and are measured in
turn. The times are BenchMARL's own, from the best iteration of several rounds:
of collecting alone, and with the updates. Each group of agents has networks of
its own, as have both sides of teams_2, and hunters and prey of simple_tag. It
needs `pip install -e '.[benchmarl]' vmas`.
"""

import csv
import logging
import runpy
import tempfile
from pathlib import Path
from typing import Any

try:
    import torch
    from benchmarl.environments import VmasTask
except ModuleNotFoundError as error:
    raise SystemExit(f"perf.benchmarl needs {error.name}: pip install -e '.[benchmarl]' vmas") from None

from outlast.envs.adapters.benchmarl import task
from perf.table import Table, options

EXAMPLE = Path(__file__).parent.parent / "docs" / "examples" / "benchmarl_mappo.py"
AGENTS, ROUNDS, ITERATIONS = 4, 3, 4


def tasks() -> dict[str, Any]:
    """The tasks by name; VMAS's are one with lidars, and one of hunters and prey."""
    navigation, tag = VmasTask.NAVIGATION.get_from_yaml(), VmasTask.SIMPLE_TAG.get_from_yaml()
    navigation.config["n_agents"] = AGENTS
    tag.config |= {"num_good_agents": 1, "num_adversaries": AGENTS - 1}
    return {
        "outlast/teams_2": task("teams_2"),
        "outlast/teams_2, one group": task("teams_2", groups="all"),
        "vmas/navigation": navigation,
        "vmas/simple_tag": tag,
    }


def seconds(folder: Path, timer: str) -> float:
    """Seconds of the fastest iteration, by BenchMARL's own timer."""
    (file,) = folder.rglob(f"timers_{timer}.csv")
    with file.open() as rows:
        return min(float(row[1]) for row in csv.reader(rows))


def main() -> None:
    """Run all tasks in turn."""
    given = options(__doc__).parse_args()
    logging.disable(logging.WARNING)
    torch.set_num_threads(1)
    example = runpy.run_path(str(EXAMPLE))
    batch, found = example["BATCH"], dict[str, list[tuple[float, ...]]]()
    for _ in range(ROUNDS):
        for name, own in tasks().items():
            with tempfile.TemporaryDirectory() as folder:
                run = example["experiment"](own, "mappo", ITERATIONS * batch, Path(folder), evaluation=False)
                run.run()
                times = tuple(seconds(Path(folder), timer) for timer in ("collection_time", "iteration_time"))
            found.setdefault(name, []).append(times)
    table = Table("benchmarl", "task", "collecting, frames a second", "training, frames a second")
    for name, rounds in found.items():
        table.add(name, *(f"{batch / min(times):,.0f}" for times in zip(*rounds, strict=True)))
    table.finish(given.save)


if __name__ == "__main__":
    main()
