"""Scenarios: a list of mechanics with their numbers, and the ways to derive one from another."""

import dataclasses
import json
import logging
import os
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from outlast.ecs import Distribution, Module, NumberError, Role, Roles, Worlds
from outlast.ecs.declarations.component import snake_case
from outlast.ecs.declarations.roles import NEVER
from outlast.ecs.kernels.errors import did_you_mean, meant
from outlast.ecs.memory.numbers import checked_roles, place
from outlast.systems import ObserveRoles
from outlast.systems.role_limits import limits

from ..errors import ScenarioError
from ..storage import inputs
from ..storage.inputs import read_text
from ..storage.outputs import atomic_write
from .derivation import all_replaced, as_filename, by_full_name, defaults, following, in_full, leaders, numbers, titles
from .scenario_json import added, arguments, as_form

Number = float | str | Sequence[float]  # integers and bools, too: type checkers take them for floats
LOGGER = logging.getLogger("outlast")
STYLES = ("scripted", "camper", "hunter", "hoarder", "healer")  # policies that a scenario may have its own of
ELSEWHERE = {  # names that users take for numbers, and what to use instead
    "max_episode_steps": "the time limit of a scenario is its number ending_limit",
    "seed": "environments are seeded by reset(seed=...), those of gymnasium.make by nothing else",
}
Policies = tuple[tuple[str, Callable[..., Any]], ...]


@dataclass(frozen=True, repr=False)
class Scenario:
    """A game: its mechanics with their numbers, as data.

    >>> duel = outlast.variant("ffa_3").without(Boxes).replace(n_agents=10, melee_damage=20)

    The name of a derived scenario lists the changes, "ffa_3-without_boxes-n_agents=10-melee_damage=20" above, and
    in `about`.

    Attributes:
        name: What errors and files call it.
        modules: The mechanics; they may be given in any order, and are sorted by name.
        about: One line for people.
        order: Chains of systems, each of which runs before the next one: what `ordered` added.
        varied: Names of the numbers that each world draws, and their distributions: what `vary` added.
        observed: The varied numbers that agents observe: what `observe_numbers` added.
        by_role: Which agents have numbers of their own: what `roles` added.
        policies: The game's own "scripted" and others of STYLES, by name: what `with_policies` added.
        origin: The scenario that this one was derived from in one or more steps, the last one with a name of its own;
            None if it was not derived.
        added: For numbers of mechanics added by `with_` that scale with another number: the values of both at the time.

    Raises:
        ScenarioError: Two mechanics are of the same kind or have the same name, or a policy is not possible.
    """

    name: str
    modules: tuple[Module, ...]
    about: str = ""
    order: tuple[tuple[str, ...], ...] = ()
    varied: tuple[tuple[str, Distribution], ...] = ()
    observed: tuple[str, ...] = ()
    by_role: Roles | None = None
    policies: Policies | Mapping[str, Callable[..., Any]] = ()
    origin: "Scenario | None" = dataclasses.field(default=None, init=False, compare=False)
    added: Mapping[str, tuple[Any, Any]] = dataclasses.field(default_factory=dict, init=False, compare=False)

    def __post_init__(self) -> None:
        modules = tuple(self.modules)
        _check_mechanics(self.name, modules)
        object.__setattr__(self, "modules", tuple(sorted(modules, key=lambda module: module.name)))
        _check_together(self.name, self.modules)
        object.__setattr__(self, "policies", tuple(sorted(dict(self.policies).items())))
        for name, policy in dict(self.policies).items():
            if name not in STYLES or not callable(policy):
                raise ScenarioError(
                    f"{self.name}: policies {name!r}: {policy!r:.60}: functions are needed, for {STYLES}"
                )
        if self.by_role:
            self.by_role.check_apart(dict(self.varied))
        for chain in self.order:
            if not all(isinstance(name, str) for name in chain) or not 1 < len({*chain}) == len(chain):
                raise ScenarioError(
                    f"{self.name}: {chain!r} is not an order: at least two labels or names are needed, each once"
                )

    def __repr__(self) -> str:
        chains = "".join(f", {' before '.join(chain)}" for chain in self.order)
        return f"Scenario({self.name!r}, {len(self.modules)} mechanics{chains})"

    def without(self, *kinds: type[Module] | str) -> "Scenario":
        """Return the scenario without some of its mechanics.

        Args:
            *kinds: Classes or names ("melee").

        Raises:
            ScenarioError: The scenario does not have one of them.
        """
        gone = [self[kind] for kind in kinds]
        return self._derived(modules=tuple(m for m in self.modules if not any(m is each for each in gone)))

    def with_(self, *modules: Module) -> "Scenario":
        """Return the scenario with more mechanics; each replaces the one of its kind, whose numbers no longer vary.

        Numbers of other mechanics that scale with one of the new numbers change as with `replace`.

        Args:
            *modules: Instances, such as Melee(damage=20).

        Raises:
            ScenarioError: An argument is not a mechanic.
            NumberError: A mechanic sets a number that every role sets.
        """
        _check_mechanics(self.name, modules)
        slots, given, before = {module.slot() for module in modules}, numbers(modules), self.numbers()
        varied = tuple(entry for entry in self.varied if entry[0] not in given)
        after = (*(m for m in self.modules if m.slot() not in slots), *modules)
        changed = {name: value for name, value in given.items() if before.get(name, value) != value}
        if self.by_role:
            self.by_role.check_others(changed.keys() - defaults(modules))
        gone = before.keys() - numbers(after).keys()
        made = self._derived(modules=all_replaced(after, self._led(changed, given.keys() | gone)), varied=varied)
        now = made.numbers()
        more = {name: (now[name], now[leader]) for name, leader in leaders(modules).items() if leader in now}
        return made._made(made.origin, {**made.added, **more})

    def ordered(self, *systems: str) -> "Scenario":
        """Return the scenario with an order between systems that do not declare one, such as those of two authors.

        Args:
            *systems: Labels of systems ("poison.sicken") or names of mechanics ("poison"), which stand for all their
                systems. Each runs before the next one, in every phase that they share.

        Raises:
            ScenarioError: Fewer than two are given, or one is given twice.
        """
        return self._derived(order=(*self.order, systems))

    def replace(self, /, **numbers: Number) -> "Scenario":
        """Return the scenario with other values for some numbers. Numbers that are set no longer vary.

        Numbers that scale with one of them, as safe_zone_radii does with room_size, change in proportion, and a message
        at level INFO reports it; those that were set explicitly, now or earlier, stay as they are.

        Args:
            **numbers: Values by name, module_number ("melee_damage"); n_agents stands for agents_count.

        Raises:
            NumberError: A number is unknown (the message has a hint), or a value is out of its range.
        """
        full = by_full_name(self.find_number, [*numbers.items()])
        if self.by_role:
            self.by_role.check_others(full)
        given = {self.find_number(name): value for name, value in full.items()}
        modules = all_replaced(self.modules, given)  # also checks the numbers
        checked = {f"{m.name}_{name}": getattr(m, name) for m in modules for own, name in given if own == m.name}
        varied = tuple(entry for entry in self.varied if entry[0] not in full)
        return self._derived(modules=all_replaced(self.modules, given | self._led(checked)), varied=varied)

    def _led(self, changed: Mapping[str, Any], beside: Container[str] = ()) -> dict[tuple[str, str], Any]:
        """Return, and log, the numbers that follow those that change, except those that vary or are in `beside`."""
        found, varied = {}, dict(self.varied)
        led = following(self.modules, self.root.numbers(), changed, self.added)
        for key, (leader, value) in led.items():
            if key not in varied and key not in beside:
                found[self.find_number(key)] = value
                about = ", ".join(f"{each:g}" for each in (value if isinstance(value, tuple) else (value,)))
                LOGGER.info("%s is scaled with %s, to %s; set it, too, for other values", key, leader, about)
        return found

    def vary(self, /, **numbers: Distribution) -> "Scenario":
        """Return the scenario with numbers that each world draws anew at the beginning of each episode.

        >>> scenario.vary(melee_damage=distributions.integers(5, 20), n_agents=distributions.integers(2, 8))

        Draws are functions of seed, world, episode and the number's name. Tables have room for the highest counts;
        agents beyond a world's count are absent from it: not alive, neither observed nor rewarded. Numbers that scale
        with a varied number stay as they are.

        Args:
            **numbers: Distributions by name, as for `replace`: uniform, log_uniform, integers, choice or free of
                outlast.distributions.

        Raises:
            NumberError: A number is unknown, or cannot have the values of its distribution.
        """
        varied = dict(self.varied)
        for name, distribution in by_full_name(self.find_number, [*numbers.items()]).items():
            if not isinstance(distribution, Distribution):
                raise NumberError(
                    f"{name} = {distribution!r}: a distribution is needed, as in outlast.distributions.uniform(1, 2); "
                    "replace() sets one value for all worlds"
                )
            varied[name] = distribution
        place(list(self.modules), varied)  # raises an error if a single number is wrong
        return self._derived(varied=tuple(sorted(varied.items())))

    def observe_numbers(self, *names: str) -> "Scenario":
        """Return the scenario with varied numbers as an observation, "numbers": float32 (agents, numbers).

        Every agent that is in the episode observes them.

        Args:
            *names: Numbers that vary; without any, all of them. The columns are in alphabetical order of full names.

        Raises:
            ScenarioError: One of them does not vary, or none does.
        """
        varied = dict(self.varied)
        full = ["_".join(self.find_number(name)) for name in names] or [*varied]
        if missing := [name for name in full or ["a number"] if name not in varied]:
            raise ScenarioError(f"{missing[0]} does not vary here, so it cannot be observed; vary() it first")
        return self._derived(observed=tuple(sorted({*full})))

    def roles(self, /, *, drawn: str = NEVER, observed: bool = True, **roles: Role) -> "Scenario":
        """Return the scenario with roles, which give agents numbers of their own; any earlier roles are replaced.

        >>> scenario.roles(hunter=outlast.role(1, melee_damage=20, agents_health=200), prey=outlast.role(3))

        Whether the roles fit the number of agents is checked when worlds are made.

        Args:
            drawn: "never": agents keep the roles that their ids give them. "anyone": each episode draws which agent has
                which role. "side": the same, but among the agents of each side.
            observed: Whether agents observe their own and the others' roles, as the field "role" of the rows: a one-hot
                vector. If not, the rows keep the fields that they had.
            **roles: Roles by name, as returned by outlast.role().

        Raises:
            NumberError: Roles are empty; a number is unknown, out of its range or cannot differ between agents; or
                `observed` is neither True nor False.
        """
        if not isinstance(observed, (bool, Role)):
            raise NumberError(f"observed = {observed!r}: allowed are True and False")
        named = []
        options: dict[str, Any] = {"drawn": drawn, "observed": observed}
        for name, each in (roles | {name: each for name, each in options.items() if isinstance(each, Role)}).items():
            if not isinstance(each, Role):
                raise NumberError(f"{name} = {each!r:.60}: a role is needed, as in {name}=outlast.role(1)")
            numbers = by_full_name(self.find_number, each.numbers)
            named.append(dataclasses.replace(each, name=name, numbers=tuple(sorted(numbers.items()))))
        by_role = checked_roles(self.modules, Roles(tuple(named), drawn))
        others = tuple(module for module in self.modules if not isinstance(module, ObserveRoles))
        shown = (ObserveRoles(count=len(named)),) if observed else ()
        return self._derived(modules=(*others, *shown), by_role=by_role)

    def with_policies(self, **policies: Callable[..., Any]) -> "Scenario":
        """Return the scenario with policies of its own, which play wherever their names are given for this game.

        >>> tag = outlast.Scenario("tag", mechanics).with_policies(scripted=chase)

        So `outlast play`, whose opponents are "scripted", and `outlast evaluate` and `outlast train --opponents` with
        that name, let `chase` play.

        Args:
            **policies: By the name that each replaces, "scripted", "camper", "hunter", "hoarder" or "healer": a
                function (observations) -> actions, or a function (env) or (env, seed) that returns one. It chooses for
                each agent by what that agent observes: observations are float32 (..., agents, ...) by key, and actions
                integers (..., agents, actions), with any leading axes, as there may be none.

        Raises:
            ScenarioError: The name or the function is unknown.
        """
        return self._made(self.origin, self.added, policies={**dict(self.policies), **policies})

    def worlds(self, count: int, threads: int = 1, **options: Any) -> Worlds:
        """Make worlds of this scenario, without an environment around them.

        Args:
            count: How many worlds.
            threads: How many threads advance them.
            **options: Other arguments of ecs.Worlds.

        Raises:
            DeclarationError, NumberError, ScheduleError: As for ecs.Worlds.
        """
        options |= {"ordered": self.order, "varied": dict(self.varied)}
        options |= {"observed": self.observed, "roles": self.by_role}
        return Worlds((*self.modules, *limits(self.modules, self.by_role)), count, threads, **options)

    def known_as(self, name: str) -> "Scenario":
        """Return the scenario, which gets this name unless it has one of its own; derived names then begin with it."""
        return self if self.is_named else self._made(self.origin, self.added, name=name)

    def titled_as(self, other: "Scenario") -> "Scenario":
        """Return it with the name and `about` of `other`, from which it was derived without becoming another game."""
        return self._made(other.origin or other, self.added, name=other.name, about=other.about)

    @property
    def is_named(self) -> bool:
        """Return whether it has a name of its own, rather than one that describes its difference from its origin."""
        return self.origin is None or self.name != titles(self.origin, self)[0]

    @property
    def root(self) -> "Scenario":
        """The first of the scenarios that this one was derived from; itself if it was not derived."""
        return self.origin.root if self.origin else self

    @property
    def file_name(self) -> str:
        """The scenario's name in a form that can be part of a file's name."""
        return as_filename(self.name).lstrip(".") or "scenario"

    def _derived(self, **fields: Any) -> "Scenario":
        """Return the scenario with other fields, and a name and sentence that describe its difference from its origin.

        Numbers of mechanics that it no longer has do not vary any more.
        """
        origin = self.origin if self.origin and not self.is_named else self
        made = dataclasses.replace(self, **fields)
        known = made.numbers()
        varied = tuple(entry for entry in made.varied if entry[0] in known)
        observed = tuple(name for name in made.observed if name in dict(varied))
        by_role = made.by_role and made.by_role.only(known)
        made = dataclasses.replace(made, varied=varied, observed=observed, by_role=by_role)
        led, (name, about) = leaders(made.modules), titles(origin, made)
        kept = {name: pair for name, pair in self.added.items() if name in led}
        return made._made(origin, kept, name=name, about=about)

    def _made(self, origin: "Scenario | None", added: Mapping[str, tuple[Any, Any]], **fields: Any) -> "Scenario":
        made = dataclasses.replace(self, **fields)
        object.__setattr__(made, "origin", origin)
        object.__setattr__(made, "added", added)
        return made

    def numbers(self) -> dict[str, Any]:
        """Return every number of every mechanic, by the name that `replace` takes."""
        return numbers(self.modules)

    def to_json(self) -> str:
        """Return the scenario as JSON, in which mechanics have the full names of their classes."""
        return json.dumps(as_form(self), indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str) -> "Scenario":
        """Return the scenario that `to_json` described. It imports nothing: import your own mechanics first.

        Raises:
            ScenarioError: The text is something else, or names a mechanic that is not imported.
            NumberError: A number is out of its range.
        """

        def restored(form: dict[str, Any]) -> Scenario:
            made, origin = cls(**arguments(form)), restored(form["origin"]) if "origin" in form else None
            return made._made(origin, added(form, made.modules))

        try:
            return restored(inputs.parse_json(text))
        except (ScenarioError, NumberError):
            raise
        except inputs.BROKEN_JSON as error:
            raise ScenarioError(f"it does not hold a scenario: {type(error).__name__}: {error}") from None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write `to_json` to a file, completely or not at all, replacing what was there before.

        Raises:
            OSError: The file cannot be written.
        """
        with atomic_write(Path(path)) as place:
            place.write_text(self.to_json(), encoding="utf-8")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Scenario":
        """Read what `save` wrote.

        Raises:
            ScenarioError: The file cannot be read, or its text is refused as by `from_json`.
            NumberError: A number is out of its range.
        """
        name = os.fspath(path)
        try:
            return cls.from_json(read_text(path))
        except OSError as error:
            raise ScenarioError(f"{name} cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ScenarioError(f"{name} is not a text, and so not a scenario") from error
        except (ScenarioError, NumberError) as error:
            raise type(error)(f"{name}: {error}") from error
        except ValueError as error:  # it is too large
            raise ScenarioError(f"{name} is not a scenario: {error}") from error

    def __getitem__(self, kind: type[Module] | str) -> Module:
        """Return the mechanic of this class or name."""
        if found := self._found(kind):
            return found
        known = [module.name for module in self.modules]
        name = kind if isinstance(kind, str) else getattr(kind, "__name__", repr(kind))
        hint = did_you_mean(snake_case(name), known, after=" ")
        raise ScenarioError(f"{self.name} has no module '{name}'; {hint}it has: {', '.join(known)}")

    def __contains__(self, kind: type[Module] | str) -> bool:
        return self._found(kind) is not None

    def _found(self, kind: Any) -> Module | None:
        is_class = isinstance(kind, type)
        return next((m for m in self.modules if m.name == kind or (is_class and isinstance(m, kind))), None)

    def find_number(self, asked: str, options: Iterable[str] = ()) -> tuple[str, str]:
        """Return the module and the number that `replace` changes under this name.

        NumberError if it is unknown; its hint also considers the `options` of a function.
        """
        key = in_full(asked)
        for module in self.modules:
            name = key.removeprefix(f"{module.name}_")
            if name != key and any(item.name == name for item in dataclasses.fields(module)):
                return module.name, name
        hint = ELSEWHERE.get(asked) or meant(asked, self.known_numbers(), options)
        raise NumberError(f"{self.name} has no number '{asked}'; {hint}")

    def known_numbers(self) -> list[str]:
        """Return every name that `replace` takes: "melee_damage", "n_agents"."""
        return [*self.numbers(), *(f"n_{m.name}" for m in self.modules if hasattr(m, "count"))]


def _check_mechanics(scenario: str, modules: Iterable[Any]) -> None:
    """Raise ScenarioError, which begins with the scenario's name, if one is not an instance of a mechanic."""
    for module in modules:
        if not isinstance(module, Module):
            raise ScenarioError(f"{scenario}: {module!r} is not a mechanic: pass an instance, as in Melee(damage=20)")


def _check_together(scenario: str, modules: Sequence[Module]) -> None:
    """Raise ScenarioError if two mechanics take one slot, two have a name in common, or a number scales with none."""
    taken: dict[type, Module] = {}
    owners: dict[str, Module] = {}
    for module in modules:
        other = taken.setdefault(module.slot(), module)
        if other is not module:
            names = " and ".join(sorted(type(each).__name__ for each in (other, module)))
            raise ScenarioError(f"{scenario}: {names} exclude each other; use with_() to replace one by the other")
    for module in modules:
        for name in (module.name, *(f"{module.name}_{item.name}" for item in dataclasses.fields(module))):
            if name in owners:
                one, two = (f"{type(m).__module__}.{type(m).__qualname__}" for m in (owners[name], module))
                raise ScenarioError(
                    f"{scenario}: '{name}' is a name of both {one} and {two}; give one of the mechanics another "
                    'name, a class attribute as in name = "swamp"'
                )
            owners[name] = module
    for name, leader in leaders(modules).items():
        known = (f"{kind.name}_{item.name}" for kind in Module.imported() for item in dataclasses.fields(kind))
        if leader not in owners and leader not in known:
            hint = did_you_mean(leader, owners, before="; ")
            raise ScenarioError(f"{scenario}: {name} scales with '{leader}', which no mechanic has{hint}")
