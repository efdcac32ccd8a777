"""The original implementation, timed in a process of its own: by its own Python, from a checkout that stays as it is.

The other interpreter runs this file as a script, so only the standard library is imported at the top. Each line of JSON
that it reads asks for steps of one environment, and each line that it writes answers with the seconds a step. It times
env.step alone, in CPU time of its process: random actions in fresh episodes, cut after `limit` steps. The same episodes
and actions are played whenever a line is repeated.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PARTS = (Path("masurvival", "envs", "masurvival_env.py"), Path("experiments"))  # all that is used of a checkout


class NotTheOriginal(ValueError):
    """What was given as the original does not play it."""


class Original:
    """The original's environments, played in a process of their own until `with` ends.

    Args:
        given: PYTHON:CHECKOUT, an interpreter that has what the original imports, and the folder of the original.

    Raises:
        NotTheOriginal: one of the two is not that; also while it plays.
    """

    def __init__(self, given: str) -> None:
        self.python, _, folder = given.rpartition(":")
        if not (self.python and folder):
            raise NotTheOriginal(f"expected PYTHON:CHECKOUT, an interpreter and the original's folder, not {given!r}")
        for part in PARTS:
            if not (Path(folder) / part).exists():
                missing = Path(folder) / part
                raise NotTheOriginal(f"expected the original's folder behind the colon, but there is no {missing}")
        # the other process must not import from where this one does
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        command = [self.python, __file__, str(Path(folder).resolve())]
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
            )
        except OSError as problem:
            found = f"{self.python} does not start ({problem.strerror})"
            raise NotTheOriginal(f"expected a Python interpreter before the colon, but {found}") from None
        self.about: str = self._answer()["about"]  # its versions

    def __enter__(self) -> Original:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()  # closes its input, which ends it

    def timer(self, experiment: str, counts: Mapping[str, int], steps: int, limit: int) -> Callable[[], float]:
        """Calls that answer with the CPU seconds of a step of the original's env.step.

        Args:
            experiment: a folder of the checkout's experiments/, whose env.json is the configuration.
            counts: agents, heals and boxes where they differ from the configuration's.
            steps: how many are played in a call, rounded up to whole episodes.
            limit: how many steps of an episode are played.
        """
        request = {"experiment": experiment, "counts": dict(counts), "steps": steps, "limit": limit}
        return lambda: float(self._ask(request)["seconds"])

    def _ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None
        print(json.dumps(request), file=self._process.stdin, flush=True)
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        try:
            answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        except ValueError:  # there is no line, or none of the script below
            answer = {"error": "no answer of the script perf/original.py"}
        if "error" not in answer:
            return answer
        self._process.kill()
        self._process.communicate()
        found = f"{self.python} says: {answer['error']}"
        raise NotTheOriginal(f"expected an interpreter before the colon that plays the original, but {found}")


def serve(checkout: Path) -> None:
    """Answer every line of the input; what the original prints is dropped."""
    answers, sys.stdout = sys.stdout, open(os.devnull, "w")  # noqa: SIM115 (until the process ends)
    sys.path[0] = str(checkout)  # in place of this file's folder, whose modules the original must not import

    def send(**answer: object) -> None:
        print(json.dumps(answer), file=answers, flush=True)

    try:
        from masurvival.envs.masurvival_env import MaSurvival  # type: ignore[import-not-found]  # of the checkout

        send(about=versions())
        for line in sys.stdin:
            asked = json.loads(line)
            made = MaSurvival(config=configuration(checkout, asked["experiment"], asked["counts"]))
            send(seconds=play(made, asked["steps"], asked["limit"]))
    except Exception as problem:
        send(error=f"{type(problem).__name__}: {problem}")


def versions() -> str:
    """The versions of this interpreter, and of the packages that matter to the original's speed."""
    found = [f"Python {platform.python_version()}"]
    for name in ("numpy", "gym", "Box2D"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"no {name}")
    return ", ".join(found)


def configuration(checkout: Path, experiment: str, counts: Mapping[str, int]) -> dict[str, Any]:
    """The configuration of an experiment of the original, with other counts."""
    config: dict[str, Any] = json.loads((checkout / "experiments" / experiment / "env.json").read_text())
    places = {
        "agents": (config["agents"], "n_agents"),
        "heals": (config["heals"]["reset_spawns"], "n_items"),
        "boxes": (config["boxes"]["reset_spawns"], "n_boxes"),
    }
    for name, count in counts.items():
        part, key = places[name]
        part[key] = count
    return config


def play(env: Any, steps: int, limit: int) -> float:
    """CPU seconds a step of env.step, over the first `limit` steps of fresh episodes."""
    import numpy as np

    env.np_random = np.random.default_rng(0)  # the original's reset ignores seeds
    env.action_space.seed(0)
    taken, spent = 0, 0.0
    while taken < steps:
        env.reset()
        actions = [env.action_space.sample() for _ in range(limit)]
        start = time.process_time()
        for action in actions:
            taken += 1
            if env.step(action)[2]:
                break
        spent += time.process_time() - start
    return spent / taken


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
