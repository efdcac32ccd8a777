"""Time the edit loop: from the start of a process to the end of its first step.

    python -m perf.edit [--repeats 5] [--save MACHINE]

Times are seconds of wall time. Each row starts new processes. They share a
cache of compiled code of their own, which is empty ("cold"), or was filled by
the same game ("warm"), by the same game with other numbers, by the game before
an edit, or by games that combine its mechanics in other ways. The game is
teams_3 with a mechanic from a user's file; what is edited is a copy of outlast.
In the row with the typo, the process ends with the error.
"""

import functools
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import outlast
from perf.table import Table, options, positive

PACKAGE = Path(outlast.__file__).parent
WORLDS = 64
MECHANIC = """
from dataclasses import dataclass

from outlast.components import Body, Phase
from outlast.ecs import Entity, Module, Read, Rows, Write, number


@dataclass(frozen=True)
class Swamp(Module):
    drag: float = number(0.5, low=0, high=1)


@Swamp.system(Phase.DRIVE, after="motors")
def wade(body: Write[Body], entities: Read[Entity], agents: Rows[Body], drag: float) -> None:
    for e in agents:
        if entities.alive[e] and body.x[e] > 1:
            body.vx[e] *= drag
"""
SCRIPT = """
import outlast, swamp
env = outlast.make_vec({scenario}, {worlds}, seed=0)
env.reset()
env.step(env.action_space.sample() * 0)
"""
GAME = 'outlast.variant("teams_3").with_(swamp.Swamp())'
NUMBERS = f"{GAME}.replace(n_heals=9, n_boxes=5, melee_damage=7, safe_zone_radii=(9.0, 2.0))"
OTHERS = (
    f'{GAME}.without("heals").with_(outlast.systems.DropLast())',
    'outlast.variant("ffa_3").with_(swamp.Swamp())',
    'outlast.variant("ffa_1").with_(outlast.systems.DropLast())',
    f'{GAME}.without("safe_zone", "death_drop")',
    'outlast.variant("teams_2").without("melee")',
)


ZONE = "outlast/systems/safe_zone.py"
EDITS = {  # by row: a file, a text in it, the text instead (with a number), whether the process then ends with an error
    "a mechanic of the user's edited": ("swamp.py", "> 1:", "> {}:", False),
    "a mechanic of outlast's edited": (ZONE, "share *", "{} * share *", False),
    "a docstring edited": (ZONE, '"""Move the zone', '"""{} Move the zone', False),
    "a typo, reported": ("swamp.py", "body.x", "body.z{}", True),
}


class Game:
    """A folder with a user's mechanic, a copy of outlast and a cache."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.cache = folder, folder / "cache"
        (folder / "swamp.py").write_text(MECHANIC)
        hidden = shutil.ignore_patterns("__pycache__")
        shutil.copytree(PACKAGE, folder / "outlast", symlinks=False, ignore=hidden)

    def start(self, scenario: str = GAME, fails: bool = False) -> float:
        """Seconds of a process that makes and steps the scenario. fails: Whether it must end with an error."""
        environment = os.environ | {"PYTHONPATH": str(self.folder), "OUTLAST_CACHE_DIR": str(self.cache)}
        command = [sys.executable, "-c", SCRIPT.format(scenario=scenario, worlds=WORLDS)]
        start = time.perf_counter()
        done = subprocess.run(command, env=environment, cwd=self.folder, capture_output=True, text=True)
        seconds = time.perf_counter() - start
        if (done.returncode != 0) is not fails:
            raise RuntimeError(f"the process ended with {done.returncode}: {done.stderr[-2000:]}")
        return seconds

    def cold(self) -> float:
        """The same with an empty cache."""
        shutil.rmtree(self.cache, ignore_errors=True)
        return self.start()

    def after_edit(self, what: str, k: int) -> float:
        """The same after one of the EDITS, which is then undone. k: number of the repetition."""
        name, old, new, fails = EDITS[what]
        file = self.folder / name
        text = file.read_text()
        if old not in text:
            raise RuntimeError(f"{name} has no {old}")
        file.write_text(text.replace(old, new.format(k + 2), 1))
        try:
            return self.start(fails=fails)
        finally:
            file.write_text(text)


def main() -> None:
    """Print the seconds of each row: minimum and median."""
    parser = options(__doc__)
    parser.add_argument(
        "--repeats", type=positive, default=5, help="processes that are started for each row (default 5)"
    )
    given = parser.parse_args()
    table = Table("edit", "what", "least", "median")
    with tempfile.TemporaryDirectory() as name:
        game = Game(Path(name))
        rows: dict[str, Callable[[int], float]] = {
            "cold, empty cache": lambda k: game.cold(),
            "warm": lambda k: game.start(),
            "warm, other numbers": lambda k: game.start(NUMBERS),
            **{what: functools.partial(game.after_edit, what) for what in EDITS},
        }
        for what, timed in rows.items():
            seconds = [timed(k) for k in range(given.repeats)]
            table.add(what, min(seconds), statistics.median(seconds))
        for scenario in (f"{GAME}.with_(outlast.systems.DropLast())", 'outlast.variant("ffa_1")'):
            game.start(scenario)  # so that each mechanic of OTHERS has been compiled in some game
        seconds = [game.start(other) for other in OTHERS]
        table.add("another combination of known mechanics", min(seconds), statistics.median(seconds))
    table.finish(given.save)


if __name__ == "__main__":
    main()
