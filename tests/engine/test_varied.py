"""Numbers that vary, of mechanics of all kinds: what systems get, what episodes begin with, and what is refused."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

import outlast
from outlast.components import Phase, Side
from outlast.distributions import choice, integers, log_uniform, uniform
from outlast.ecs import (
    INDEX,
    RESET,
    Archetype,
    Array,
    Component,
    DeclarationError,
    Entity,
    Module,
    NumberError,
    Read,
    Rows,
    Scratch,
    Singleton,
    Write,
    column,
    kernel,
    number,
    of,
    ref,
)
from outlast.envs.core.vector_env import SurvivalVectorEnv
from tests.helpers.mechanics import DUEL, mechanic

WORLDS = 16


class Note(Singleton):
    real: Array = column("f4")
    whole: Array = column("i4")
    switch: Array = column("i1")
    word: Array = column("i4")
    row: Array = column("f4", "notes")
    product: Array = column("f4")
    start: Array = column("i4")
    small: Array = column("u1")
    share: Array = column("f4")
    coins: Array = column("i4")


class Coin(Component):
    worth: Array = column("i4")


@dataclass(frozen=True)
class Lab(Module):
    """Notes what systems get of numbers of every type, and begins with some."""

    real: float = number(0.5, low=0, high=9)
    whole: int = number(3, low=0, high=300)
    switch: bool = number(False)
    word: str = number("low", choices=("low", "middle", "high"))
    row: tuple[float, ...] = number((1.0, 2.0))
    start: int = number(7)
    small: bool = number(True)
    share: float = number(1.5, scales_with="room_size")
    coins: int = number(3, low=1)
    worth: int = 2  # a plain default is one of a number, too

    def singletons(self) -> Any:
        return [Note(start=ref("start"), small=ref("small"), share=ref("share"), coins=ref("coins"))]

    def dims(self) -> dict[str, int | str]:
        return {"notes": 2}

    def archetypes(self) -> Any:
        return [Archetype("coin", (Coin(worth=ref("worth")),), ref("coins"))]


@kernel
def half(value: float) -> float:
    return value * np.float32(0.5)


@Lab.system(Phase.SPAWN)
def note(
    notes: Write[Note], real: float, whole: int, switch: bool, word: int, row: tuple[float, ...], start: int
) -> None:
    notes.real[0], notes.whole[0], notes.switch[0], notes.word[0] = half(real), whole, 1 if switch else 0, word
    for k in range(len(row)):
        notes.row[k] = row[k]


@Lab.system(Phase.OBSERVE, compiled=False)
def note_as_python(notes: Write[Note], real: float, whole: int) -> None:
    notes.product[0] = real * whole


def made(module: Module, **varied: Any) -> SurvivalVectorEnv:
    env = outlast.make_vec(DUEL.with_(module).vary(**varied), WORLDS, seed=3)
    env.reset()
    return env


def test_systems_and_prefabs_get_numbers_of_every_type() -> None:
    env = made(
        Lab(),
        lab_real=uniform(1, 2),
        lab_whole=integers(0, 300),
        lab_switch=choice(True, False),
        lab_word=choice("low", "high"),
        lab_row=choice((1, 2), (3.3, 4)),
        lab_start=integers(1, 9),
        lab_small=choice(True, False),
        lab_share=log_uniform(1, 4),
        lab_coins=integers(1, 5),
        lab_worth=integers(3, 4),
    )
    drawn, notes, coins = env.worlds.numbers(), env.worlds[Note], env.worlds.span("coin")
    expected = {
        "real": drawn["lab_real"] * np.float32(0.5),
        "whole": drawn["lab_whole"],
        "switch": drawn["lab_switch"],
        "word": np.where(drawn["lab_word"] == "high", 2, 0),
        "start": drawn["lab_start"],
        "small": drawn["lab_small"],
        "share": drawn["lab_share"],
        "coins": drawn["lab_coins"],
        "product": drawn["lab_real"] * drawn["lab_whole"].astype(np.float32),
    }
    for name, values in expected.items():
        assert len(np.unique(values)) > 1
        np.testing.assert_array_equal(getattr(notes, name)[:, 0], values, name)
    np.testing.assert_array_equal(notes.row, drawn["lab_row"])
    assert (env.worlds[Coin].worth[:, coins] == drawn["lab_worth"][:, None]).all()
    assert ((env.worlds[Entity].identity[:, coins] >= 0).sum(1) == drawn["lab_coins"]).all()


class Pile(Singleton):
    half: Array = column("f4")


@dataclass(frozen=True)
class Odd(Module):
    """Numbers that decide on more than what kernels compute with."""

    count: int = number(3, low=1, high=9)
    more: int = number(1, low=1)
    memory: int = number(3, low=1)
    extra: bool = number(False)
    idle: int = number(1)
    reach: float = number(1.0, per_agent=True)
    nothing: float = number(1.0, per_agent=True)

    def singletons(self) -> Any:
        return [Pile(half=self.count / 2)]

    def archetypes(self) -> Any:
        return [Archetype("pebble", (Coin(),), ref("count"))]

    def systems(self) -> Any:
        return [system for system in super().systems() if self.extra or system.name != "add"]

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return np.zeros(self.memory if name == "memory" else int(self.reach), np.float32)


@Odd.system(Phase.SPAWN)
def work(pile: Write[Pile], memory: Scratch, by_agent: Scratch, agents: Rows[Side], reach: float, more: int) -> None:
    for e in agents:
        pile.half[0] += of(reach, e) + memory[0] + by_agent[0]


@Odd.system(Phase.SPAWN, after="odd.work")
def add(pile: Write[Pile]) -> None:
    pile.half[0] += 1


@pytest.mark.parametrize(
    ("name", "drawn", "reason"),
    [
        ("count", integers(1, 4), r"Odd.singletons\(\) reads it"),
        ("memory", integers(1, 4), r"Odd.scratch\(\) reads it: it decides how much memory systems have"),
        ("extra", choice(True, False), r"Odd.systems\(\) reads it: it decides which systems run"),
        ("idle", integers(1, 4), "no system of odd gets it"),
        ("reach", None, r"Odd.scratch\(\) reads it"),
        ("nothing", None, "no system of odd gets it"),
    ],
)
def test_what_is_decided_once_cannot_vary_or_differ_by_role(name: str, drawn: Any, reason: str) -> None:
    game, numbers = DUEL.with_(Odd()), {f"odd_{name}": drawn or 4.0}
    with pytest.raises(NumberError, match=f"odd_{name} cannot (vary|differ by role): {reason}"):
        (game.vary(**numbers) if drawn else game.roles(one=outlast.role(1, **numbers), other=outlast.role())).worlds(1)


def test_a_count_among_others_of_a_kind_cannot_vary() -> None:
    scenario = DUEL.with_(Lab(), mechanic("Others", archetypes=[Archetype("coin", (), 2)]))
    with pytest.raises(NumberError, match="lab_coins cannot vary: it is not the only count of the entities 'coin'"):
        scenario.vary(lab_coins=integers(1, 4)).worlds(1)


@pytest.mark.parametrize(
    "drawn",
    [
        {"agents_health": integers(120, 150), "mortality_limit": choice(150, 200)},
        {"inventory_capacity": integers(1, 3)},
        {"safe_zone_radii": choice((8, 4), (7, 3))},
    ],
)
def test_a_value_that_no_world_has_decides_on_nothing(drawn: Any) -> None:
    labels = [system.label for system in DUEL.vary(**drawn).worlds(1).schedule.systems]
    assert ("inventory.close_slots" in labels) == ("inventory_capacity" in drawn)


class Tag(Component):
    real: Array = column("f4")
    whole: Array = column("i4")
    small: Array = column("i1")
    few: Array = column("i4", low=0, high=5)
    place: Array = column("i4")


@dataclass(frozen=True)
class Tagged(Module):
    """Begins with numbers in columns that are given by `columns`."""

    real: float = number(1.0, per_agent=True)
    whole: int = number(3, per_agent=True)
    pair: tuple[float, ...] = number((1.0, 2.0))
    count: int = number(2, low=1, per_agent=True)
    columns: ClassVar[dict[str, str]] = {}
    kind: ClassVar[str] = "agent"
    sized: ClassVar[bool] = False

    def archetypes(self) -> Any:
        tag = Tag(place=INDEX, **{column: ref(name) for column, name in self.columns.items()})
        return [Archetype(self.kind, (tag,), 0 if self.kind == "agent" else ref("count"))]

    def dims(self) -> Any:
        return {"pairs": len(self.pair), **({"lots": ref("whole")} if self.sized else {})}


@Tagged.system(Phase.SPAWN)
def read(tags: Write[Tag], rows: Rows[Tag], real: float, whole: int, pair: tuple[float, ...], count: int) -> None:
    pass


def tagged(kind: str = "agent", sized: bool = False, **columns: str) -> Module:
    """A mechanic of which these columns begin as these numbers."""
    own = {"name": "tagged", "columns": columns, "kind": kind, "sized": sized}
    made: Any = type("Own", (Tagged,), own | {"__annotations__": dict.fromkeys(own, ClassVar[Any])})
    return made()


def test_references_are_values_for_worlds_and_for_agents() -> None:
    game = DUEL.with_(tagged(real="real", small="whole", few="count"))
    worlds = game.vary(tagged_whole=integers(-9, 9), tagged_real=uniform(0, 1)).worlds(WORLDS)
    worlds.seed(5, np.arange(WORLDS))
    worlds.run(np.full(WORLDS, RESET, np.int8))
    for held, name in (("small", "whole"), ("real", "real"), ("few", "count")):
        values = np.broadcast_to(worlds.number(f"tagged_{name}"), WORLDS)
        assert (getattr(worlds[Tag], held)[:, :2] == values[:, None]).all()
    assert worlds[Tag].place[0, :2].tolist() == [0, 1]
    assert "tagged_pair" in game.vary(tagged_pair=choice((1, 2), (3, 4))).worlds(1).layout.varied  # its length is read
    worlds = game.roles(one=outlast.role(1, tagged_whole=-7), other=outlast.role()).worlds(1)
    worlds.run(np.full(1, RESET, np.int8))
    assert worlds[Tag].small[0, :2].tolist() == [-7, 3]
    assert not any("_reads" in vars(kind) for kind in Module.imported())  # the copies that note what is read


@pytest.mark.parametrize(
    ("module", "differing", "words"),
    [
        (tagged(whole="size"), {}, r"agent: Tag.whole is ref\('size'\), which is not a number of tagged"),
        (tagged(whole="real"), {"real": uniform(0, 1)}, "tagged_real cannot vary: Tag.whole is int32, and the number"),
        (tagged(small="whole"), {"whole": integers(0, 300)}, "Tag.small has the range -128 to 127, and .* can be 300"),
        (tagged(few="whole"), {"whole": choice(2, 6)}, "Tag.few has the range 0 to 5, and the number can be 6"),
        (tagged(real="pair"), {"pair": choice((1, 2), (3, 4))}, "the value has shape|a tuple can only be given"),
        (tagged(sized=True), {"whole": integers(1, 3)}, "it decides how large the dimension 'lots' is"),
        (tagged("box", whole="whole"), {"whole": outlast.role(1)}, "Tag.whole of 'box' is the number, and only agents"),
        (tagged("tag"), {"count": outlast.role(1)}, "tagged_count cannot differ by role: it counts the entities 'tag'"),
    ],
)
def test_references_that_cannot_be_are_refused(module: Module, differing: dict[str, Any], words: str) -> None:
    game = DUEL.with_(module)
    role = {name for name, value in differing.items() if isinstance(value, outlast.ecs.Role)}
    numbers: Any = {f"tagged_{name}": 4 if name in role else drawn for name, drawn in differing.items()}
    if role:
        game = game.roles(one=outlast.role(1, **numbers), other=outlast.role())
    with pytest.raises((NumberError, DeclarationError), match=words):
        (game if role else game.vary(**numbers)).worlds(1)


@dataclass(frozen=True)
class Cap(Module):
    """A number that has to fit one of another mechanic."""

    most: int = number(999)

    def check(self, layout: Any) -> None:
        if (health := layout.numbers("agents")["health"]) > self.most:
            raise NumberError(f"agents begin with {health}, more than {self.most}")


@Cap.system(Phase.SPAWN)
def keep(entities: Read[Entity], most: int) -> None:
    pass


def test_what_is_set_in_mid_run_fits_all_values_that_there_are() -> None:
    scenario = DUEL.with_(Cap())
    varied = scenario.vary(agents_health=integers(50, 150)).worlds(1)
    differing = scenario.roles(strong=outlast.role(1, agents_health=180), weak=outlast.role()).worlds(1)
    for worlds, most in ((varied, 150), (differing, 180)):
        with pytest.raises(NumberError, match=f"agents begin with {most}, more than 120"):
            worlds.set_numbers(cap_most=120)
        assert not worlds.changed
    with pytest.raises(NumberError, match="agents_health cannot change while worlds run: it varies from world to"):
        varied.set_numbers(agents_health=70)
