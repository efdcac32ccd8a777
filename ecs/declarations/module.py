"""Modules: a mechanic is a frozen dataclass whose fields are its numbers, and on which its systems are registered.

    @dataclass(frozen=True)
    class Poison(Module):
        dose: int = number(3, low=0)

    @Poison.system(Phase.ACT)
    def sicken(health: Write[Health], agents: Rows[Health, Venom], dose: int):
        ...

A scenario is a list of modules; a mechanic that is not in the list is off. A mechanic's name is the name of its class
in snake case ("poison"), or the class attribute `name`; its numbers are called "poison_dose" and its systems
"poison.sicken". The latter is also the stream of a system's random numbers. A subclass draws the same numbers as its
base; with the class attribute `stream`, a mechanic keeps its draws under another name.
"""

import builtins
import contextlib
import dataclasses
import functools
import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self, TypeVar

from ..kernels.errors import DeclarationError, NumberError, did_you_mean
from ..kernels.frozen_values import annotated, check_random, is_outside
from ..kernels.jit import kernel
from .access import Label, parameters
from .archetype import Archetype
from .component import Component, Singleton, snake_case
from .fields import Field
from .layout import Layout
from .numbers import checked, kind_of
from .phase import PhaseBase
from .system import Neighbour, System, check_twice, components, neighbours, redefines

Function = TypeVar("Function", bound=Callable[..., Any])
RECORDS = "_reads"  # the attribute of a copy that holds the numbers read, see declarations.declared
NEAR = 0.85  # a method whose name is this similar (1: equal) to that of a method of Module counts as a slip
Bounds = tuple[Any, Any] | Mapping[str, tuple[Any, Any]]  # (low, high); for a key with fields, by the fields' names


@dataclass(frozen=True)
class Module:
    """Base of all mechanics.

    A subclass of a mechanic inherits its numbers and systems, under its own name, and replaces it in a scenario.

    Attributes:
        name: Unique in a scenario. By default the class's name in snake case.
        stream: Prefix of its random streams. By default the stream of the mechanic that it extends, or its name.
        draws_level: Whether its draws at resets make every episode a level of its own, as for a maze. Worlds can
            then be given keys of random numbers (see Worlds.give_keys).
        registered: The systems of this class, without those of its bases.

    Raises:
        NumberError: A number is outside its range.
        DeclarationError: The declaration of a number is invalid.
    """

    name: ClassVar[str] = ""
    stream: ClassVar[str] = ""
    draws_level: ClassVar[bool] = False
    registered: ClassVar[list[System]] = []

    def __init_subclass__(cls) -> None:
        cls.registered = []
        if RECORDS in vars(cls):  # see declarations.declared
            return
        inherited = dataclasses.fields(cls)
        for item in inherited:
            given = vars(cls).get(item.name, dataclasses.MISSING)
            if given is not dataclasses.MISSING and not isinstance(given, dataclasses.Field):  # a new default
                cls.__annotations__ = {item.name: item.type} | inspect.get_annotations(cls)
                setattr(cls, item.name, field(default=given, metadata=item.metadata))
        cls._check_constants([item.name for item in inherited])
        cls._check_hooks()
        if "name" not in vars(cls) or isinstance(vars(cls)["name"], dataclasses.Field):
            cls.name = snake_case(cls.__name__)
        for attribute in ("name", "stream"):
            value = vars(cls).get(attribute, "default")
            if not isinstance(value, dataclasses.Field) and not re.fullmatch("[a-z][a-z0-9_]*", str(value)):
                raise DeclarationError(
                    f"{cls.__module__}.{cls.__qualname__} has the {attribute} {value!r}: it must be lower-case "
                    f'letters, digits and underscores, such as {attribute} = "swamp"'
                )

    @classmethod
    def _check_constants(cls, numbers: list[str]) -> None:
        """Raise DeclarationError for a plain value that looks like a number of the mechanic."""
        known = {*inspect.get_annotations(Module), *inspect.get_annotations(cls), *Label.kinds}
        for name, value in vars(cls).items():
            if isinstance(value, (int, float, str, tuple)) and not (name in known or name.startswith("_")):
                kind, hint = type(value).__name__, did_you_mean(name, numbers, after=" A") or "a"
                raise DeclarationError(
                    f"{cls.__name__}.{name} = {value!r:.60} is not a new default of an inherited number; {hint} new "
                    f"number is declared as {name}: {kind} = number(...), a constant as {name}: ClassVar[{kind}] = ..."
                )

    @classmethod
    def _check_hooks(cls) -> None:
        """Raise DeclarationError for a method whose name is similar to one of Module: it would never be called."""
        bases = {name for base in cls.__mro__[1:] for name in vars(base)}
        hooks = [name for name, value in vars(Module).items() if callable(value) and not name.startswith("_")]
        for name, value in vars(cls).items():
            own = callable(value) and not isinstance(value, type) and not name.startswith("_") and name not in bases
            if own and (hint := did_you_mean(name, hooks, after=" ", count=1, cutoff=NEAR)):
                raise DeclarationError(
                    f"{cls.__name__}.{name}() is never called; {hint}If it is a method of your own, give it a "
                    f"less similar name, or _{name}"
                )

    def __post_init__(self, *_: Any) -> None:  # takes InitVars, which _declared refuses
        for name, kind, rule in self._declared():
            object.__setattr__(self, name, checked(f"{self.name}.{name}", getattr(self, name), kind, rule))

    @classmethod
    @functools.cache
    def _declared(cls) -> tuple[tuple[str, type, Any], ...]:
        """Return the name, the type and the rule of every number. DeclarationError for an impossible declaration."""
        if (own := annotated(cls)) and "__dataclass_fields__" not in vars(cls):
            raise DeclarationError(
                f"{cls.__name__} declares numbers ({', '.join(own)}), which only a dataclass has: write "
                f"@dataclass(frozen=True) above class {cls.__name__}"
            )
        annotations = [each for base in cls.__mro__ for each in inspect.get_annotations(base).items()]
        if lost := next((name for name, kind in annotations if "InitVar" in str(kind)), ""):
            raise DeclarationError(
                f"{cls.__name__}.{lost} is an InitVar, which replace() would lose: declare {lost}: float = number(), "
                f"or a constant as {lost}: ClassVar[float] = ..."
            )
        for item in dataclasses.fields(cls):
            if hasattr(builtins, item.name):
                raise DeclarationError(
                    f"{cls.name} has a number '{item.name}', which would hide Python's own {item.name} in its systems; "
                    "rename it"
                )
            if hasattr(Module, item.name):
                raise DeclarationError(
                    f"{cls.name} has a number '{item.name}', which hides Module.{item.name}; rename it (a class "
                    "attribute, as the mechanic's own name, has no annotation, or one with ClassVar)"
                )
        items = dataclasses.fields(cls)
        return tuple((item.name, kind_of(f"{cls.name}.{item.name}", item), item.metadata) for item in items)

    @classmethod
    def slot(cls) -> type:
        """Return the slot of the module: a scenario has one module per slot.

        By default, a class and its subclasses share a slot. Mechanics that exclude each other without importing each
        other return the same class, such as a component.
        """
        base = cls._base()
        return base.slot() if base else cls

    @classmethod
    def _base(cls) -> type["Module"] | None:
        """Return the mechanic that this class extends; None if its base is not a mechanic, that is, has no systems."""
        bases = (base for base in cls.__mro__[1:] if issubclass(base, Module))  # a mixin may come first
        return next((base for base in bases if any(vars(each).get("registered") for each in base.__mro__)), None)

    @classmethod
    def _stream(cls) -> str:
        """Return the stream or its default, computed late: a base may register systems after this class."""
        base = None if cls.stream else cls._base()
        return base._stream() if base else cls.stream or cls.name

    @classmethod
    def system(
        cls,
        phase: PhaseBase,
        *,
        after: Neighbour | tuple[Neighbour, ...] = (),
        before: Neighbour | tuple[Neighbour, ...] = (),
        needs: type[Component] | tuple[type[Component], ...] = (),
        compiled: bool = True,
    ) -> Callable[[Function], Function]:
        """Register a function as a system of this module in `phase`; see declarations.access for its parameters.

        Defining a function again, for example by running a notebook's cell twice, replaces the earlier one.

        Args:
            phase: The phase of the tick that the system runs in.
            after: Systems that it runs after, within the phase: labels of systems ("zone.shrink"); names of mechanics
                ("zone"), which stand for all systems of that mechanic, or of the one in its slot; or components, which
                stand for all other systems that write or add to them. Labels and names override components.
            before: Systems that it runs before, in the same forms; a component stands for all other systems that read,
                write or add to it.
            needs: Components that a scenario may lack: if one is missing, the system is not scheduled.
            compiled: False for a system that remains Python, which splits the tick in two at that point.

        Returns:
            A decorator that returns the function as a kernel.

        Raises:
            DeclarationError: The module is outlast's own, but the function is not; `phase` is not a phase; `after`,
                `before` or `needs` is not one of the above; or a parameter has an annotation that access does not list.
        """
        if not isinstance(phase, PhaseBase):
            raise DeclarationError(
                f"{cls.__name__}.system got {phase!r:.60}: a phase comes first, as in "
                f"@{cls.__name__}.system(Phase.NAME)"
            )

        def register(function: Function) -> Function:
            label = f"{cls.name}.{function.__name__}"
            if is_outside(function) and not is_outside(cls):
                raise DeclarationError(
                    f"{label}: {cls.__name__} belongs to outlast, and every scenario in this process would get the "
                    f"system; give it to a mechanic of yours, such as class My{cls.__name__}({cls.__name__})"
                )
            earlier, later = neighbours(label, "after", after), neighbours(label, "before", before)
            needed = components(label, needs)
            declared = parameters(function)
            if is_outside(function):  # outlast's own are checked when compiled: importing is a seventh faster
                check_random(function, label)
            inner = kernel(function) if compiled else function
            system = System(
                module=cls.name,
                name=function.__name__,
                phase=phase,
                function=function,
                kernel=inner,
                parameters=declared,
                after=earlier,
                before=later,
                needs=needed,
                compiled=compiled,
                stream=f"{cls._stream()}.{function.__name__}",
                slot=cls,
            )
            for other in cls.registered:
                check_twice(label, function, other.function, phase is other.phase)
            cls.registered[:] = [other for other in cls.registered if not redefines(function, other.function)]
            cls.registered.append(system)
            return inner

        return register

    def systems(self) -> Iterable[System]:
        """Return the systems to schedule, inherited ones included; a module may select them by its numbers.

        A system of a subclass replaces an inherited one of the same name.
        """
        return type(self).all_systems()

    @classmethod
    def all_systems(cls) -> list[System]:
        """Return its systems and those that it inherits, for any values of its numbers."""
        found: list[System] = []
        for base in reversed(cls.__mro__):
            if issubclass(base, Module):
                own = {system.name for system in base.registered}
                before = {system.name: system for system in found if system.name in own}
                found = [system for system in found if system.name not in own]
                found += [system.instead_of(before.get(system.name)) for system in base.registered]
        found = [system if system.module == cls.name else system.inherited(cls.name) for system in found]
        stream, slot = cls._stream(), cls.slot()
        return [dataclasses.replace(system, stream=f"{stream}.{system.name}", slot=slot) for system in found]

    @classmethod
    def imported_systems(cls) -> list[System]:
        """Return the systems of all imported mechanics, whether in a scenario or not."""
        return [system for kind in cls.imported() for system in kind.all_systems()]

    @classmethod
    def imported(cls) -> list[type["Module"]]:
        """Return this class and all classes that extend it, in the order in which they were defined."""
        subclasses = (each for each in cls.__subclasses__() if RECORDS not in vars(each))
        return [cls, *(kind for subclass in subclasses for kind in subclass.imported())]

    @staticmethod
    def providers(provides: Callable[["Module"], bool]) -> str:
        """Name the imported mechanics that provide something with their default numbers; for hints in error messages.

        Args:
            provides: Whether an instance provides it.

        Returns:
            Their classes' names, see `named`.
        """
        return Module.named(Module.providing(provides))

    @staticmethod
    def providing(provides: Callable[["Module"], bool]) -> list[type["Module"]]:
        """Return the same mechanics as `providers`, as classes."""
        found = list[type[Module]]()
        for kind in Module.imported():
            with contextlib.suppress(Exception):  # a user's class may fail, or need numbers
                if provides(kind()):
                    found.append(kind)
        return found

    @staticmethod
    def named(found: Sequence[type["Module"]]) -> str:
        """Join the names of classes, without subclasses of others: "FreeForAll or Teams"; "" without names."""
        return " or ".join(sorted({kind.__name__ for kind in found if not {*kind.__mro__[1:]} & {*found}}))

    def archetypes(self) -> Iterable[Archetype]:
        """Return the kinds of entities that this module adds or extends."""
        return ()

    def singletons(self) -> Iterable[Singleton]:
        """Return the per-world components that this module adds."""
        return ()

    def dims(self) -> dict[str, int | str]:
        """Return sizes by dimension, which add up over modules: an int, a dimension's name or a sum, "a + b - 1"."""
        return {}

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        """Make memory for the Scratch parameter `name`, once per thread: an array (any object for a Python system).

        Numbers that determine its shape cannot vary. Its initial content must not depend on numbers.
        dims: Sizes by name of the dimension.
        """
        raise DeclarationError(f"{self.name} has the Scratch parameter '{name}' but no scratch()")

    def check(self, layout: Layout) -> None:
        """Raise NumberError for numbers that do not fit the other modules.

        Args:
            layout: The layout of all modules of the scenario.
        """

    def bounds(self, layout: Layout) -> Mapping[str, Bounds]:
        """Return the bounds of observations that follow from the scenario's numbers, for the environments' spaces.

        Args:
            layout: The layout of all modules of the scenario.

        Returns:
            By key of the observation, {field: (lowest, highest)} in the field's own unit: numbers, or arrays with an
            entry for each of the field's columns. For a key without fields, (lowest, highest): numbers, or arrays that
            broadcast to the column's shape. They must hold in every tick, for all actions, and include 0, the
            value of rows outside the world.

        The bounds of a field are the widest range that any module returns, so a mechanic that breaks another one's
        bounds (such as by moving agents out of the room) returns its own. Bounds for keys that the scenario lacks are
        ignored. Bounds of a key also hold for keys whose rows are copies of it: those of "own" for "others".
        """
        return {}

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        """Return fields to add to the rows of observations, by key; a system of this module writes them.

        {"own": (Field("stamina", "ticks", scale=100),)} adds one to rows of "own", and so to their copies in "others".
        Fields for a key that the scenario lacks, because its mechanic is left out, are left out, too.
        """
        return {}

    def groups(self, agents: int) -> tuple[int, ...]:
        """Return the sizes of the groups, such as teams, into which it splits the entities that can have roles.

        Roles that are drawn by group stay within these. An entity's group follows from its index among `agents`
        entities; () without groups.
        """
        return ()

    def replace(self, /, **numbers: Any) -> Self:
        """Return a copy with other numbers; for an unknown name, raise a NumberError that lists the known ones."""
        known = [name for name, *_ in self._declared()]
        for key in numbers:
            if key not in known:
                raise NumberError(f"{self.name} has no number '{key}'; it has: {', '.join(known) or 'none'}")
        return type(self)(**{name: numbers.get(name, getattr(self, name)) for name in known})

    def value(self, name: str) -> Any:
        """Return the number `name` for kernels: the index of a choice. DeclarationError if it does not exist."""
        known = {item.name: item.metadata.get("choices") for item in dataclasses.fields(self)}
        if name in known:
            value, choices = getattr(self, name), known[name]
            return choices.index(value) if choices else value
        asking = [system.label for system in self.systems() if any(name == p.name for p in system.access)]
        kinds = [kind for kind in Module.imported() if "__dataclass_fields__" in vars(kind)]
        others = {f"{kind.name}_{item.name}": kind.__name__ for kind in kinds for item in dataclasses.fields(kind)}
        cure = f"add {others[name]}, which has it" if name in others else did_you_mean(name, [*known, *others])
        raise DeclarationError(
            f"{self.name} has no number '{name}', which {' and '.join(asking) or 'one of its systems'} asks for; "
            + (cure or f"it has: {', '.join(known) or 'none'}; those of others are named in full, as in physics_rate")
        )


def check_kind(name: str, known: Iterable[str]) -> None:
    """Raise DeclarationError if no imported mechanic has entities of that kind. known: the kinds of a scenario."""
    if not Module.providing(lambda module: name in (archetype.name for archetype in module.archetypes())):
        hint = did_you_mean(name, known, after=" ")
        raise DeclarationError(f"unknown kind of entities {name!r}; {hint}known: {', '.join(known)}")
