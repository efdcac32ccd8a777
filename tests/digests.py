"""Golden digests of 2000 ticks of each variant, by platform and version.

    python -m tests.digests [VARIANT ...] [--ticks N] [--threads N]
    python -m tests.digests --write

The first form prints digests, the second adds those of this platform to
tests/golden/digests.json, where what is there stays. A digest covers all
observations, rewards, ends and statistics up to a tick, but not the layout of
the state. Another digest is another behaviour, which needs a new version of the
environment.
"""

import argparse
import hashlib
import json
import platform
import re
import sys
from pathlib import Path
from typing import Any

import llvmlite.binding
import numpy as np

from outlast import VARIANTS, make_vec
from outlast.envs.adapters.registry import IDS
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.storage.outputs import atomic_write
from outlast.systems import box2d

FILE = Path(__file__).parent / "golden" / "digests.json"
MARKS = (0, 1, 10, 50, 200, 500, 1000, 2000)  # the ticks after which digests are taken
WORLDS, SEED = 32, 3
HELD_TICKS = 20  # how long agents hold a direction, so that they get somewhere
NEW_VERSION = (
    "behaviour changed: raise the version of {name} in envs/adapters/registry.py, "
    "say what changed in changes/, and write new digests: python -m tests.digests --write"
)
Golden = dict[str, dict[str, dict[str, str]]]  # platform: {environment: {tick: digest}}


def numbered_actions(env: SurvivalVectorEnv, tick: int) -> np.ndarray[Any, Any]:
    """Random actions that depend on the tick and the world's number only: not on the batch, nor on a library."""
    sizes, agents = env.action_sizes, env.num_agents
    last = env.first_world + env.num_worlds
    motion, rest = (_bytes(stream, last * agents * len(sizes)) for stream in (f"{tick // HELD_TICKS} held", f"{tick}"))
    drawn = np.concatenate([part.reshape(last, agents, -1) for part in (motion, rest)], -1)
    columns = [*range(3), *range(len(sizes) + 3, 2 * len(sizes))]
    return (drawn[env.first_world :, :, columns] % sizes).astype(np.int64)


def _bytes(stream: str, count: int) -> np.ndarray[Any, Any]:
    """Random uint8 (count,), always the same for the same stream."""
    return np.frombuffer(hashlib.shake_128(stream.encode()).digest(count), np.uint8)


def behaviour_digests(name: str, ticks: int, worlds: int = WORLDS, **options: Any) -> dict[str, str]:
    """Digests of a variant, by the ticks of MARKS up to `ticks`."""
    env = make_vec(name, worlds, seed=SEED, copy=False, **options)
    total, found = hashlib.blake2b(digest_size=12), {}
    for tick in range(ticks + 1):
        outcome = env.step(numbered_actions(env, tick)) if tick else env.reset(seed=SEED)
        for array in _arrays(outcome):
            total.update(np.ascontiguousarray(array))
        if tick in MARKS:
            found[str(tick)] = total.hexdigest()
    env.close()
    return found


def _arrays(outcome: Any) -> list[np.ndarray[Any, Any]]:
    """All arrays in what reset or step returned, those of dicts in order of their names.

    Which agents are alive is left out, as earlier versions did not report it.
    """
    if isinstance(outcome, dict):
        return [array for key, value in sorted(outcome.items()) if key != "alive" for array in _arrays(value)]
    return [array for value in outcome for array in _arrays(value)] if isinstance(outcome, tuple) else [outcome]


def platform_name() -> str:
    """What the last bits of floats may depend on: machine, fused multiply-add, system, C library, Box2D."""
    fused = " fma" if llvmlite.binding.get_host_cpu_features()["fma"] else ""
    library = " ".join(platform.libc_ver()) or platform.release()
    engine = ".".join(box2d.VERSION.split(".")[:3])  # whichever package it is from
    return f"{platform.machine()}{fused}, {platform.system()} {library}, Box2D {engine}"


def environment(name: str) -> str:
    """A variant with the version of its environment, as in "ffa_1-v1"."""
    versions = {match[1] for key, kind in IDS.items() if kind == name and (match := re.search(r"-v(\d+)$", key))}
    assert len(versions) == 1, f"{name} has several versions at once: {sorted(versions)}"
    return f"{name}-v{versions.pop()}"


def golden() -> Golden:
    """The content of the file."""
    return json.loads(FILE.read_text()) if FILE.exists() else {}


def first_difference(written: dict[str, str], found: dict[str, str]) -> str:
    """Where two runs first differ, as text; "" if they agree at every tick that both have."""
    agreed = "the start"
    for mark in (str(tick) for tick in MARKS if str(tick) in written and str(tick) in found):
        if written[mark] != found[mark]:
            return f"between {agreed} and tick {mark}"
        agreed = f"tick {mark}"
    return ""


def changed(name: str, found: dict[str, str]) -> str:
    """Why these digests of a variant are not what this platform has for its version, or ""."""
    where = first_difference(golden().get(platform_name(), {}).get(environment(name), {}), found)
    return f"{environment(name)} differs {where}; {NEW_VERSION.format(name=name)}" if where else ""


def write(found: dict[str, dict[str, str]]) -> None:
    """Add digests to the file; what is there stays."""
    whole = golden()
    mine = whole.setdefault(platform_name(), {})
    for name, digests in found.items():
        mine[environment(name)] = digests | mine.get(environment(name), {})
    with atomic_write(FILE) as place:
        place.write_text(json.dumps(whole, indent=1) + "\n")


def main(arguments: list[str]) -> int:
    form: Any = {"description": __doc__, "formatter_class": argparse.RawDescriptionHelpFormatter}
    parser = argparse.ArgumentParser("python -m tests.digests", **form)
    parser.add_argument("variants", nargs="*", metavar="VARIANT", help="variants to play (default: all)")
    parser.add_argument("--ticks", type=int, default=MARKS[-1], help="ticks to play (default %(default)s)")
    parser.add_argument("--threads", type=int, default=1, help="threads that share the worlds (default %(default)s)")
    text = "add the digests to the file; none that is there is changed"
    parser.add_argument("--write", action="store_true", help=text)
    options = parser.parse_args(arguments)
    names = options.variants or VARIANTS
    found = {name: behaviour_digests(name, options.ticks, threads=options.threads) for name in names}
    if not options.write:
        print(json.dumps(found, indent=1))
        return 0
    write(found)
    print(f"{FILE.name}: {len(found)} environments on {platform_name()}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
