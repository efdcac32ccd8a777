"""Time simulators side by side: ours and others, on one core, in one run.

    python -m perf.peers [--folder FOLDER] [--only vmas jaxmarl ...] [--save MACHINE]

Each library is installed by uv into an environment of its own in FOLDER (default:
~/.cache/outlast-peers) and runs in a process of its own, in one thread on one
processor. A library that cannot be installed has no rows. All rows are measured
in turn, ROUNDS times; a rate is the best of these, in CPU time. Games differ in
rules, physics and observations.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from perf.table import Table, options

STEPS = Path(__file__).with_name("peer_steps.py")
ROUNDS = 3
ENVIRONMENT = {"OMP_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu", "SDL_VIDEODRIVER": "dummy"}
ENVIRONMENT |= {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}
LIBRARIES = {  # what uv installs, and the Python that it takes; nothing for our own
    "outlast": (),
    "vmas": ("3.11", "vmas==1.5.2"),
    "jaxmarl": ("3.11", "jaxmarl==0.2.0"),
    "battlegrounds": ("3.12", "marl-battlegrounds==1.0.3"),
    "pettingzoo": ("3.11", "pettingzoo[sisl]==1.27.0", "mpe2==1.1.1"),
    "magent2": ("3.11", "magent2==0.3.4"),
    "pogema": ("3.11", "pogema==1.4.0"),
    "lbforaging": ("3.11", "lbforaging==2.0.0"),
}


class Row(NamedTuple):
    """A row of the table: a library, a game in words, and what perf.peer_steps is asked for."""

    library: str
    words: str
    maker: str
    game: str
    worlds: int = 1
    options: dict[str, Any] = {}  # noqa: RUF012  not changed


OURS, BATCH, JAX = 256, 8192, 256
ROWS = [
    Row("outlast", "teams_3, 2 against 2", "outlast", "teams_3", OURS),
    Row("outlast", "teams_3, 5 against 5", "outlast", "teams_3", OURS, {"agents_count": 10}),
    Row("outlast", "docs/examples/football.py, 2 against 2", "outlast", "football:FOOTBALL", OURS),
    Row("vmas", "simple_tag", "vmas", "simple_tag", BATCH),
    Row("vmas", "balance", "vmas", "balance", BATCH),
    Row(
        "vmas", "football, 2 against 2", "vmas", "football", BATCH,
        {"n_blue_agents": 2, "n_red_agents": 2, "ai_red_agents": False},
    ),
    Row("jaxmarl", "MPE simple_tag", "jaxmarl", "MPE_simple_tag_v3", JAX),
    Row("jaxmarl", "SMAX 5m_vs_6m", "jaxmarl", "SMAX", JAX, {"level": "5m_vs_6m"}),
    Row("jaxmarl", "Overcooked", "jaxmarl", "overcooked", JAX),
    Row("battlegrounds", "tdm, 5 against 5", "battlegrounds", "tdm", 64),
    Row("pettingzoo", "MPE2 simple_tag", "parallel", "mpe2.simple_tag_v3"),
    Row("pettingzoo", "SISL pursuit", "parallel", "pettingzoo.sisl.pursuit_v5"),
    Row("magent2", "battle", "parallel", "magent2.environments.battle_v4"),
    Row("pogema", "16 x 16, 4 agents", "pogema", "", 1, {"num_agents": 4, "size": 16}),
    Row("lbforaging", "8 x 8, 4 agents, 3 foods", "foraging", "Foraging-8x8-4p-3f-v3"),
]  # fmt: skip


def interpreter(folder: Path, library: str) -> str:
    """Return the Python that has a library; install it if it is not there. Raises CalledProcessError."""
    if not LIBRARIES[library]:
        return sys.executable
    version, *wanted = LIBRARIES[library]
    place = folder / library
    python, done = place / "bin" / "python", place / "installed"
    if not done.exists():
        subprocess.run(["uv", "venv", "-q", "--clear", "--python", version, place], check=True)
        subprocess.run(["uv", "pip", "install", "-q", "--python", python, *wanted], check=True)
        done.touch()
    return str(python)


class Timed:
    """A row, in a process that waits to be asked."""

    def __init__(self, python: str, row: Row) -> None:
        self.row, self.seconds = row, list[float]()
        command = [python, str(STEPS), row.maker, row.game, str(row.worlds), json.dumps(row.options)]
        kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH" or row.library == "outlast"}
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=kept | ENVIRONMENT
        )
        self.agents: int = self.answer()["agents"]

    def answer(self) -> Any:
        """The next line of JSON; libraries may print other lines."""
        assert self.process.stdout
        for line in self.process.stdout:
            if line[0] in "{0123456789" and line.rstrip()[-1] in "}0123456789":
                return json.loads(line)
        raise RuntimeError(f"{self.row.library}: {self.row.words} stopped; what it printed is above")

    def measure(self) -> None:
        """Time it once."""
        assert self.process.stdin
        print(file=self.process.stdin, flush=True)
        self.seconds.append(self.answer())


def main() -> None:
    """Install, start, measure in turn."""
    parser = options(__doc__)
    parser.add_argument("--folder", type=Path, default=Path.home() / ".cache" / "outlast-peers", help="environments")
    parser.add_argument("--only", nargs="+", choices=LIBRARIES, default=list(LIBRARIES), help="only these libraries")
    given = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    timed = list[Timed]()
    for library in given.only:
        try:
            python = interpreter(given.folder, library)
        except (OSError, subprocess.CalledProcessError) as problem:
            print(f"{library} is left out: {problem}", file=sys.stderr)
            continue
        timed += [Timed(python, row) for row in ROWS if row.library == library]
    for _ in range(ROUNDS):
        for each in timed:
            each.measure()
    table = Table("peers", "simulator", "game", "agents", "worlds", "world-steps a second", "agent-steps a second")
    for each in timed:
        row, rate = each.row, each.row.worlds / min(each.seconds)
        name = re.sub(r"\[\w+\]|==", " ", (LIBRARIES[row.library] or ("", "outlast"))[1]).replace("  ", " ")
        table.add(name, row.words, each.agents, row.worlds, f"{rate:,.0f}", f"{rate * each.agents:,.0f}")
    table.finish(given.save)


if __name__ == "__main__":
    main()
