"""Tables in Markdown that are made from the code: variants, numbers, spaces, components, the tick."""

import dataclasses
import inspect
import math
from typing import Any

from sources import code, comments, grid, summary

import outlast
from outlast import components, systems
from outlast.components import Phase
from outlast.ecs import Action, Component, Event, Module, Observation, Statistic, Worlds
from outlast.envs.adapters.registry import IDS
from outlast.envs.cli.games import uses
from outlast.envs.core.spaces import published
from outlast.envs.rendering.layers import FILM_LAYERS_BY_NAME, FILM_OPTIONAL, LAYERS
from outlast.envs.scenarios.number_table import allowed, in_words, number_rows
from outlast.training.base.presets import PRESETS, Hyperparameters
from outlast.training.base.quantities import COLUMNS
from outlast.training.benchmark.suite import suite
from outlast.training.benchmark.tasks import tasks

FULL = "teams_4"  # the variant with every mechanic of the paper; {value} knows its numbers


def worlds(name: str) -> Worlds:
    """Make one world of a variant, without compiling anything."""
    return Worlds(outlast.variant(name).modules, 1)


def variants() -> str:
    """The numbers that differ between the variants, and the counts of mechanics that not all of them have."""
    numbers = {name: scenario.numbers() for name, scenario in outlast.VARIANTS.items()}
    everywhere = set.intersection(*(set(own) for own in numbers.values()))
    differing = [key for key in sorted(everywhere) if len({repr(own[key]) for own in numbers.values()}) > 1]
    counts = sorted({key for own in numbers.values() for key in own if key.endswith("_count")} - everywhere)
    keys = differing + counts
    original = {name: alias for alias, name in outlast.envs.scenarios.variants.ALIASES.items()}
    rows = [
        [code(name), code(original[name]), *(shown(own.get(key, "–")) for key in keys)] for name, own in numbers.items()
    ]
    return grid(["variant", "original name", *map(code, keys)], rows)


def cards() -> str:
    """A table of each variant: its names, agents, spaces and rewards."""
    return "\n\n".join(f"### {name}\n\n{_card(name)}" for name in outlast.VARIANTS)


def _card(name: str) -> str:
    original = next(alias for alias, own in outlast.envs.scenarios.variants.ALIASES.items() if own == name)
    env = outlast.make_vec(name, 1)
    numbers, seen = env.scenario.numbers(), env.single_observation_space
    pays = {"a tick alive": "alive", "a tick dead": "dead", "a kill": "kill", "a death": "death"}
    paid = [f"{numbers[f'rewards_{key}']:g} for {what}" for what, key in pays.items() if numbers[f"rewards_{key}"]]
    *_, registered = (own for own, scenario in IDS.items() if scenario == name)
    shapes = ", ".join(f"{code(key)} {seen[key].shape[1:]}" for key in seen)
    sizes, joint = env.action_sizes.tolist(), math.prod(env.action_sizes)
    limit = f", or after {numbers['ending_limit']} ticks" if numbers["ending_limit"] else ""
    rows = [
        ["in words", env.scenario.about],
        ["names", f"{code(name)}; the original's {code(original)}; in Gymnasium {code(registered)}"],
        ["agents", f"{env.num_agents}, {code('agent_0')} to {code(f'agent_{env.num_agents - 1}')}"],
        ["actions of an agent", f"{code(f'MultiDiscrete({sizes})')}; joint: {code(f'Discrete({joint})')}"],
        ["observation of an agent", f"float32: {shapes}; flat: {code(f'Box({env.flat_size})')}"],
        ["state of a world", f"float32 ({env.state_space.shape[0]})"],
        ["rewards", "; ".join(paid)],
        ["ends", f"{numbers['ending_rule']}{limit}"],
    ]
    env.close()
    return grid(["", ""], rows)


def ablations() -> str:
    """What each ablation changes in teams_4, which has every mechanic that any of them changes."""
    plain, rows = outlast.VARIANTS["teams_4"].numbers(), []
    for name, ablation in outlast.ABLATIONS.items():
        ablated = outlast.variant(f"teams_4+{name}").numbers()
        changed = ", ".join(code(f"{key} = {value}") for key, value in ablated.items() if plain.get(key) != value)
        rows.append([code(name), str(ablation.flaw), ablation.about, changed])
    return grid(["ablation", "flaw", "in words", "changes in teams_4"], rows)


def numbers(*names: str) -> str:
    """The numbers of the mechanics `names` (all if there are none): defaults, values in variants, allowed values."""
    kinds = [getattr(systems, name) for name in names or systems.__all__]
    return "\n\n".join(_numbers(kind) for kind in kinds)


def _numbers(kind: type[Module]) -> str:
    played = [s.numbers() for s in outlast.VARIANTS.values() if kind in s]
    rows = []
    for row in number_rows(kind()):
        runs = "; ".join(dict.fromkeys(in_words(own[row.name]) for own in played)) or "–"
        values = (text.replace(",", ", ") for text in (row.default, runs))
        rows.append([code(row.name), *values, row.allowed, row.unit, row.about])
    table = grid(["number", "default", "in the variants", "allowed", "unit", "meaning"], rows) if rows else ""
    return f"### {kind.__name__}\n\n{summary(kind)}\n\n{table}"


def ppo() -> str:
    """The numbers of PPO: values in the paper's runs and in preset fast, allowed values, and their meaning."""
    paper, fast, rows = Hyperparameters(), PRESETS["fast"].numbers, []
    for item in dataclasses.fields(Hyperparameters):
        text = item.metadata["about"]
        values = [shown(getattr(own, item.name)) for own in (paper, fast)]
        rows.append([code(item.name), *values, allowed(item.default, item.metadata), f"{text[:1].upper()}{text[1:]}."])
    return grid(["number", "original, paper, scaled", "fast", "allowed", "is"], rows)


def views() -> str:
    """The layers by their names in --views."""
    rows = []
    for name, layer in FILM_LAYERS_BY_NAME.items():
        headline = inspect.getdoc(type(layer)) or ""
        filmed = "on request" if name in FILM_OPTIONAL else "yes"
        drawn = "yes" if layer in LAYERS else "on request"
        rows.append([code(name), filmed, drawn, code(_call(layer)), headline.splitlines()[0]])
    return grid(["name", "in films", "in pictures", "in Python", "what it shows"], rows)


def _call(layer: Any) -> str:
    """Return the call, as text, that makes an equal layer."""
    fields = [field for field in dataclasses.fields(layer) if getattr(layer, field.name) != field.default]
    return f"{type(layer).__name__}({', '.join(f'{field.name}={getattr(layer, field.name)!r}' for field in fields)})"


def shown(value: Any) -> str:
    """Return a number, or a tuple of numbers, as text for readers."""
    if isinstance(value, tuple):
        return ", ".join(map(shown, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def owners(base: type[Component]) -> dict[type[Component], type[Module]]:
    """Return the mechanic that adds each component of a kind."""
    kinds = [getattr(systems, name) for name in systems.__all__]
    return {type(s): kind for kind in kinds for s in kind().singletons() if isinstance(s, base)}


def columns() -> str:
    """What the columns of `outlast evaluate` are."""
    return grid(["column", "unit", "is"], [[code(name), *column] for name, column in COLUMNS.items()])


def benchmark_tasks() -> str:
    """The tasks of the benchmark, and the games in which they are tested besides that of training."""
    rows = [[code(task.name), task.about, ", ".join(game.name for game in task.tests[1:])] for task in tasks().values()]
    return grid(["task", "is", "also tested in"], rows)


def suite_ratings() -> str:
    """The fixed Elo ratings of the suite in each task: the best style, and the anchors."""
    rows = []
    for task in tasks().values():
        members = sorted(suite(task).members.values(), key=lambda member: member.rating or 0.0)
        anchors = [f"{member.rating:.0f}" for member in members if member.anchor is not None]
        best = [member for member in members if member.anchor is None][-1]
        rows.append([code(task.name), f"{best.name} {best.rating:.0f}", ", ".join(anchors)])
    return grid(["task", "best style", "anchors"], rows)


def actions() -> str:
    """The components of an action, in order. Components of the same order are alternatives, with the same positions."""
    kinds = [getattr(systems, name) for name in systems.__all__]
    found = sorted(owners(Action), key=lambda kind: (kind.order, max(column.high for column in kind.columns.values())))
    rows, begins, free = [], dict[float, int](), 0
    for component in found:
        begin = begins.setdefault(component.order, free)
        free = begin + len(component.columns)
        makers = [kind for kind in kinds if any(type(made) is component for made in kind().singletons())]
        for k, (name, column) in enumerate(component.columns.items()):
            low, high = int(column.low), int(column.high)
            values = [f"{value - low} → {value}" if low else str(value) for value in range(low, high + 1)]
            says = ", ".join(values if len(values) < 10 else [*values[:2], "...", values[-1]])
            about = ["", ""] if k else [summary(component), ", ".join(code(kind.__name__) for kind in makers)]
            rows.append([begin + k, code(name), says, *about])
    return grid(["position", "action", "values", "meaning", "mechanic"], rows)


def observations(name: str) -> str:
    """The keys of an observation, their shapes in general and in the variant `name`."""
    return _published(Observation, worlds(name), name)


def fields(name: str) -> str:
    """The fields of observations of the variant `name`, and which mechanic adds a field to another one's rows."""
    there, rows = worlds(name), []
    adding = {(key, field.name): m for m in there.layout.modules for key, own in m.fields().items() for field in own}
    for key, _, _, column in published(there, Observation):
        if isinstance(column.fields, str):
            rows.append([code(key), f"as `{column.fields}`", "", "", "", ""])
            continue
        for k, field in enumerate(there.layout.fields.get(key, {}).values()):
            last = field.columns.stop - 1
            where = str(field.start) if field.size == 1 else f"{field.start} to {last}"
            owner = adding.get((key, field.name))
            who = code(type(owner).__name__) if owner else ""
            rows.append([code(key) if k == 0 else "", code(field.name), where, field.unit, f"{field.scale:.4g}", who])
    return grid(["key", "field", "columns", "unit", "scale", "added by"], rows)


def statistics(name: str) -> str:
    """The statistics of an episode of the variant `name`."""
    return _published(Statistic, worlds(name), name)


def _published(base: type[Component], there: Worlds, name: str) -> str:
    owned, rows, before = owners(base), [], None
    found = {entry[1:3]: entry for entry in published(there, base)}
    columns = [pair for component in owned for pair in ((component, own) for own in component.columns)]
    for key, component, own, column in (found[pair] for pair in columns if pair in found):
        if column.dims == ("damage_types",):  # reported under a key for each damage type
            key = ", ".join(f"{key}_{damage}" for damage in there.layout.labels["damage_type"])
        shape = "" if column.dims == ("damage_types",) else " × ".join(map(str, column.dims))
        sizes = " × ".join(map(str, column.shape(there.dims))) if shape else ""
        bounds = "" if math.isinf(column.low) or math.isinf(column.high) else f"{column.low:g} to {column.high:g}"
        note = "; ".join(part for part in (bounds, comments(component).get(own, "")) if part)
        first = component is not before
        says = [summary(component), code(owned[component].__name__)] if first else ["", ""]
        rows.append([code(key), shape, sizes, note, *says])
        before = component
    return grid(["key", "shape", f"in {name}", "note", "meaning", "mechanic"], rows)


def _is(target: Any, base: type) -> bool:
    """Return whether an object is a subclass; components also have annotations, which are no classes."""
    return isinstance(target, type) and issubclass(target, base)


def all_components(*names: str) -> str:
    """The components `names` (all if there are none) with their columns."""
    kinds = [getattr(components, name) for name in names or components.__all__]
    return "\n\n".join(_component(kind) for kind in kinds if _is(kind, Component))


def _component(kind: type[Component]) -> str:
    notes = comments(kind)
    rows = [
        [code(name), column.dtype.name, " × ".join(map(str, column.dims)), f"{column.fill:g}", notes.get(name, "")]
        for name, column in kind.columns.items()
    ]
    heading = f"### {kind.__name__}\n\n*{kind.__bases__[0].__name__}.* {summary(kind)}"
    return f"{heading}\n\n{grid(['column', 'type', 'dimensions', 'at first', 'note'], rows)}"


def component_uses(name: str) -> str:
    """Which systems write and read each component in a variant, as `outlast schedule --components` prints it."""
    made = worlds(name)
    rows = [
        [code(each.__name__), each.__bases__[0].__name__, *(", ".join(map(code, own)) for own in uses(made, each))]
        for each in made.components
    ]
    return grid(["component", "kind", "archetypes", "written by", "read by"], rows)


def events() -> str:
    """The events: their columns, and the mechanics that emit them, which bring and write them."""
    kinds = [kind for name in components.__all__ if _is(kind := getattr(components, name), Event)]
    mechanics = [getattr(systems, name) for name in systems.__all__]
    rows = []
    for kind in sorted(kinds, key=lambda kind: kind.name):
        emits = [
            mechanic.__name__
            for mechanic in mechanics
            if any(isinstance(singleton, kind) for singleton in mechanic().singletons())
            and any(p.kind == "write" and kind in p.components for s in mechanic().systems() for p in s.parameters)
        ]
        columns = ", ".join(f"{code(name)} ({column.unit})" for name, column in kind.columns.items() if column.unit)
        rows.append([code(kind.name), columns, summary(kind), ", ".join(map(code, emits))])
    return grid(["event", "columns", "meaning", "emitted by"], rows)


def phases() -> str:
    """The phases of a tick."""
    rows = [[code(phase.name), phase.when.value, phase.postcondition] for phase in Phase]
    return grid(["phase", "runs on", "what is true when it ends"], rows)


def schedule(name: str) -> str:
    """The tick of a variant, as `outlast schedule` prints it."""
    return f"```text\n{worlds(name).schedule}\n```"
