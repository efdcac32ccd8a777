"""Random scenarios, which must run the same compiled and as plain Python, or be refused by both: test_fuzz.py.

    python -m tests.fuzz.scenarios SEED COUNT TICKS

prints what becomes of scenarios 0 to COUNT of a seed, which are always the same: a
line of JSON each, with digests of the whole state after each tick. In each
scenario, mechanics have been taken out and put in, and numbers, subclasses and
orders between systems are random. There are also mechanics of a user's, whose
code is generated, with components, statistics, events and fields in the agents'
rows of their own.
"""

import dataclasses
import faulthandler
import gc
import importlib.util
import json
import math
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import outlast
from outlast import ABLATIONS, VARIANTS, Scenario, components, systems
from outlast.distributions import choice, integers, uniform
from outlast.ecs import Archetype, Component, Module, Singleton
from outlast.errors import OutlastError
from tests.conftest import COMPILED, digest
from tests.fuzz import generated
from tests.helpers.sines import sines_of_c

TIMEOUT = 600.0  # seconds for a scenario
COUNTED = {"agents": (components.Side,), "boxes": (components.Box, components.BoxItem), "heals": (components.Heal,)}
EXCLUSIVE = ("Steering", "Teams", "FreeForAll")  # added in the place of another mechanic
CAPS = {"count": 9, "cells": 12, "substeps": 4, "slots": 6, "iterations": 12, "rays": 20}  # by the end of the name
SCALES = (0.1, 0.5, 1.5, 2.0, 10.0)
ALONE = ("heals", "boxes", "safe_zone", "melee", "give_last", "death_drop")  # mechanics that can be left out
GROUPS = (*((name,) for name in ALONE), ("inventory", "pickup", "give_last", "death_drop", "heals", "boxes"))


# ---- a scenario


def make_scenario(rng: Random, name: str, folder: Path) -> Scenario:
    """A random scenario. folder: for the source of generated mechanics. Raises OutlastError if it is refused."""
    scenario = outlast.variant(rng.choice([*VARIANTS]))
    if rng.random() < 0.3:
        fit = [ablation for ablation, what in ABLATIONS.items() if what.needs in scenario]
        scenario = outlast.variant("+".join((scenario.name, *rng.sample(fit, rng.choice((1, 1, 2))))))
    for group in rng.sample(GROUPS, rng.choice((0, 0, 1, 1, 2))):
        scenario = scenario.without(*(name for name in group if name in scenario))
    if rng.random() < 0.1:
        scenario = scenario.without(type(rng.choice(scenario.modules)))
    added = [getattr(systems, name)() for name in systems.__all__ if rng.random() < 0.05]
    scenario = scenario.with_(*(module for module in added if type(module).__name__ not in EXCLUSIVE))
    own = rng.random()  # generated mechanics refuse each other often, so few scenarios have both
    if own < 0.6:
        scenario = scenario.with_(*_generated(rng, name, folder, scenario))
    if own > 0.5:
        scenario = scenario.with_(_kinds(rng, scenario))
    numbers = {key: value for key, value in _numbers(rng, scenario) if rng.random() < 0.08}
    scenario = _ordered(rng, scenario.replace(**numbers))
    return _differing(rng, scenario) if rng.random() < 0.4 else scenario


def _differing(rng: Random, scenario: Scenario) -> Scenario:
    """With numbers that differ from world to world, and perhaps roles; some cannot."""
    numbers = [each for each in scenario.numbers().items() if not isinstance(each[1], (tuple, str))]
    varied = {name: _drawn(rng, value) for name, value in rng.sample(numbers, min(len(numbers), rng.randrange(4)))}
    if "agents" in scenario and rng.random() < 0.5:
        varied["agents_count"] = integers(2, rng.randrange(3, 6))
    scenario = scenario.vary(**varied)
    if rng.random() < 0.5:
        items = [(module.name, item) for module in scenario.modules for item in dataclasses.fields(module)]
        able = [f"{name}_{item.name}" for name, item in items if item.metadata.get("per_agent")]
        some = rng.sample(able, min(len(able), rng.randrange(4)))
        own = {name: _drawn(rng, scenario.numbers()[name]) for name in some}
        roles = {"one": outlast.role(1, **own), "others": outlast.role()}
        scenario = scenario.roles(**roles, drawn=rng.choice(("never", "anyone", "side")))
    return scenario


def _drawn(rng: Random, value: Any) -> Any:
    """What a number could be drawn from."""
    if isinstance(value, bool):
        return choice(True, False)
    if isinstance(value, int):
        return rng.choice((integers(value, value + rng.randrange(1, 4)), choice(value, value + 2)))
    low, high = value * rng.uniform(0.5, 1), value * rng.uniform(1, 1.5) + 0.1
    return rng.choice((uniform(low, high), choice(low, high)))


def _ordered(rng: Random, scenario: Scenario) -> Scenario:
    """Perhaps with an order between some systems or mechanics that share a phase."""
    systems = [system for module in scenario.modules for system in module.systems()]
    while rng.random() < 0.15:
        phase = rng.choice(systems).phase
        labels = [*{rng.choice((each.label, each.module)): 0 for each in systems if each.phase is phase}]
        if len(labels) > 1:
            scenario = scenario.ordered(*rng.sample(labels, min(len(labels), rng.choice((2, 2, 3)))))
    return scenario


def _generated(rng: Random, name: str, folder: Path, scenario: Scenario) -> Iterator[Module]:
    """Mechanics of a generated file, whose name is that of the scenario."""
    names = [type(module).__name__ for module in scenario.modules if type(module).__module__.startswith("outlast.")]
    path = folder / f"{name}.py"
    path.write_text(generated.source(rng, name, names))
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    yield from (made() for made in module.MECHANICS)


def _kinds(rng: Random, scenario: Scenario) -> Module:
    """A mechanic with kinds of entities that have some of outlast's components, and with more entities of its kinds."""
    able = [each for each in vars(components).values() if isinstance(each, type) and issubclass(each, Component)]
    able = [each for each in able if not issubclass(each, Singleton)]
    there = [kind for module in scenario.modules for kind in module.archetypes()]
    found, dims = [], dict[str, int | str]()
    names = ("thing", "beast", *dict.fromkeys(kind.name for kind in there if kind.count))
    for name in rng.sample(names, rng.choice((1, 1, 2))):
        has = {type(part) for kind in there if kind.name == name for part in kind.parts}
        counted = [part for parts in COUNTED.values() for part in parts]  # mostly refused in other kinds
        lacks = [part for part in able if part not in has and (part not in counted or rng.random() < 0.1)]
        count = rng.choice((0, 1, 2) if name in ("agent", "heal") else (0,)) if has else rng.choice((1, 2, 17))
        here = {"x": rng.uniform(-9, 9), "y": rng.uniform(-9, 9), "dynamic": rng.randrange(2)}
        here |= {"radius": 0.3, "bound": 0.3, "angle": rng.uniform(-4, 4)}
        parts = rng.sample(lacks, rng.randrange(1, len(lacks) if not has else 3))
        if components.Shape in parts and components.Polygon in parts:
            parts.remove(components.Polygon)
        made = [_part(part, here, rng) for part in parts]
        order = None if has else rng.choice((0, 10, 60))
        found.append(Archetype(name, tuple(made), count, alive=bool(has) or rng.random() < 0.8, order=order))
        for dim, kinds in COUNTED.items() if rng.random() < 0.9 else ():
            if {*has, *parts} & {*kinds}:
                dims[dim] = int(dims.get(dim, 0)) + count

    class Kinds(Module):
        def archetypes(self) -> Any:
            return found

        def dims(self) -> Any:
            return dims

    return Kinds()


def _part(part: type[Component], here: dict[str, Any], rng: Random) -> Component:
    """A component with those of the values that it has; a polygon has corners on a circle."""
    if part is components.Polygon:
        count = rng.randrange(3, 9)
        turns = [2 * math.pi * (k + rng.uniform(0, 0.5)) / count for k in range(count)]
        return components.Polygon([(0.5 * math.cos(turn), 0.5 * math.sin(turn)) for turn in turns])
    return part(**{key: value for key, value in here.items() if key in part.columns})


def _numbers(rng: Random, scenario: Scenario) -> Iterator[tuple[str, Any]]:
    """A random value for each number; most are possible."""
    for module in scenario.modules:
        for item in dataclasses.fields(module):
            value, choices = getattr(module, item.name), item.metadata.get("choices")
            cap = next((cap for end, cap in CAPS.items() if item.name.endswith(end)), None)
            if item.name == "backend":
                continue  # compiled and plain Python differ in it anyway
            if choices:
                value = rng.choice(choices)
            elif isinstance(value, bool):
                value = rng.random() < 0.5
            elif isinstance(value, tuple):
                value = tuple(sorted((rng.uniform(0.5, 12) for _ in range(rng.randrange(1, 6))), reverse=True))
            elif isinstance(value, int):
                value = rng.randrange(0, (cap or 2 * value + 3) + 1)
                value += 150 * (item.name == "limit")  # less than the health of agents, or no limit, is mostly refused
            else:
                value *= rng.choice(SCALES)
            if isinstance(value, (int, float)) and not choices and rng.random() < 0.97:  # else perhaps out of range
                value = min(max(value, item.metadata["low"]), item.metadata["high"])
            yield f"{module.name}_{item.name}", value


# ---- what becomes of it


def run_scenario(seed: int, k: int, ticks: int, folder: Path) -> dict[str, Any]:
    """Digests of each tick, or why there are none: {"digests": [...]}, {"refused": "..."} or {"error": "..."}."""
    digests: list[str] = []
    worlds = 1 if k % 8 else 3  # plain Python is slow
    try:
        env = outlast.make_vec(make_scenario(Random(f"{seed} {k}"), f"generated_{k}", folder), worlds, seed=k)
        rng = np.random.default_rng([seed, k])
        with nullcontext() if COMPILED else sines_of_c():
            env.reset()
            digests.append(digest(env.worlds))
            for _ in range(ticks):
                env.step(rng.integers(0, env.action_sizes, (worlds, env.num_agents, len(env.action_sizes))))
                digests.append(digest(env.worlds))
        env.close()
    except OutlastError as error:
        return {"digests": digests, "refused": f"{type(error).__name__}: {error}"}
    except IndexError as error:  # of a generated system
        if COMPILED and f"generated{k}_" not in str(error):
            return {"digests": digests, "error": f"IndexError without the name of the system: {error}"}
        return {"digests": digests, "refused": "IndexError of a generated system"}
    except Exception:
        return {"digests": digests, "error": traceback.format_exc()}
    return {"digests": digests}


def main(seed: int, count: int, ticks: int) -> None:
    """Print a line of JSON for each scenario; where one takes TIMEOUT, say on which line, and exit."""
    with tempfile.TemporaryDirectory() as folder:
        for k in range(count):
            faulthandler.dump_traceback_later(TIMEOUT, exit=True)
            print(json.dumps(run_scenario(seed, k, ticks, Path(folder))), flush=True)
            faulthandler.cancel_dump_traceback_later()
            sys.modules.pop(f"generated_{k}", None)
            gc.collect()  # its mechanics, which errors of later scenarios would name


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
