"""Mechanics of one's own that once gave wrong numbers in some ticks or worlds only."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Bag, Body, Health, Item, ObservationMasks, Phase, Reward, SelfView, Side, Sight
from outlast.components.inventory import place, push
from outlast.components.sight import is_set, set_bit
from outlast.ecs import (
    AbsentError,
    Action,
    Add,
    Archetype,
    Array,
    Clock,
    Component,
    DeclarationError,
    Entity,
    Field,
    Module,
    Observation,
    Offset,
    RangeError,
    Read,
    RowIndex,
    Rows,
    Signal,
    Singleton,
    Statistic,
    Write,
    column,
    exists,
    kernel,
)
from outlast.systems import Motors, Rewards
from tests.conftest import COMPILED

DUEL = outlast.variant("ffa_1").replace(ending_rule="never", ending_limit=5)
MODES = ["NextStep", "SameStep", "Disabled"]


class Say(Action):
    say: Array = column("i1", "agents", low=0, high=3)


class Word(Component):
    word: Array = column("i4")


class Talk(Module):
    """What agents say is kept, and everybody's own word is seen: both in resets, too."""

    def archetypes(self) -> list[Archetype]:
        return [Archetype("agent", (Word(),))]

    def singletons(self) -> list[Singleton]:
        return [Say()]

    def fields(self) -> dict[str, tuple[Field, ...]]:
        return {"own": (Field("word"), Field("heard"))}


@Talk.system(Phase.LOOK)
def keep(word: Write[Word], said: Read[Say], agents: Rows[Word]) -> None:
    for i in range(agents.size):
        word.word[agents[i]] = said.say[i]


@Talk.system(Phase.OBSERVE)
def hear(
    view: Write[SelfView], word: Read[Word], said: Read[Say], agents: Rows[Word], own_word: Offset, own_heard: Offset
) -> None:
    for i in range(agents.size):
        view.own[i, own_word], view.own[i, own_heard] = word.word[agents[i]], said.say[i]


TALK = DUEL.with_(Talk())


def say(env: Any, word: int) -> Any:
    """Actions that do nothing but say it."""
    actions = np.tile(env.noop, (env.num_envs, env.num_agents, 1))
    actions[..., [key for key, *_ in env.worlds.layout.actions].index(Say)] = word
    return actions


def heard(env: Any, observations: Any) -> list[float]:
    start = env.fields["own"]["word"].start
    values: list[float] = observations["own"][0, 0, start : start + 2].tolist()
    return values


@pytest.mark.parametrize("mode", MODES)
def test_nothing_was_done_before_an_episode_began(mode: str) -> None:
    env = outlast.make_vec(TALK, 2, seed=0, autoreset_mode=mode)
    env.reset()
    resets = 0
    for _ in range(13):
        observations, *ends, _ = env.step(say(env, 2))
        if mode == "Disabled" and ends[2].any():
            observations, _ = env.reset(options={"reset_mask": ends[2]})
        begins = env.worlds[Clock].tick[0, 0] == 0
        assert heard(env, observations) == [0, 0] if begins else [2, 2]
        resets += begins
    assert resets == 2
    assert heard(env, env.reset(seed=5)[0]) == [0, 0]


@pytest.mark.parametrize("mode", MODES[:2])
def test_what_is_kept_of_actions_replays(mode: str, tmp_path: Path) -> None:
    env = outlast.make_vec(TALK, 3, seed=0, autoreset_mode=mode)
    env.reset()
    env.step(say(env, 3))
    generator = np.random.default_rng(0)
    with outlast.record(env, tmp_path / "talk.rec"):
        env.reset(seed=1)
        for _ in range(14):
            env.step(generator.integers(0, env.action_sizes, (3, 2, len(env.action_sizes))))
    replay = outlast.Replay(outlast.Recording.open(tmp_path / "talk.rec", scenario=TALK))
    assert len(list(replay.ticks())) > 14


class Rare(Component):
    worth: Array = column("f4", fill=3)


class Brings(Module):
    def archetypes(self) -> list[Archetype]:
        return [Archetype("agent", (Rare(),))]


class Pays(Module):
    def singletons(self) -> list[Singleton]:
        return [Reward()]


@Pays.system(Phase.REWARD)
def add(reward: Write[Reward], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        reward.reward[i] += i + 1


def test_rewards_that_are_added_to_begin_at_0() -> None:
    env = outlast.make_vec(DUEL.without(Rewards).with_(Pays()), 2, seed=0)
    env.reset()
    paid = [env.step(say_nothing(env))[1].tolist() for _ in range(8)]
    assert paid == [[[1, 2]] * 2] * 5 + [[[0, 0]] * 2] + [[[1, 2]] * 2] * 2


class PaysMore(Pays):
    pass


@kernel
def worth(rare: Any, e: int) -> Any:
    return 1 if rare is None else rare.worth[e]


@PaysMore.system(Phase.REWARD)
def add_more(
    reward: Write[Reward],
    rare: Read[Rare] | None,
    some: Rows[Rare] | None,
    of: RowIndex[Rare] | None,
    agents: Rows[Side],
) -> None:
    for i in range(agents.size):
        reward.reward[i] += worth(rare, agents[i])
        if of is not None and some is not None:
            reward.reward[i] += 10 * some.size + 100 * of[agents[i]]


@pytest.mark.parametrize("interpret", [(), ("pays_more.add_more",)])
def test_what_a_game_lacks_is_none(interpret: tuple[str, ...]) -> None:
    for more, paid in ((), [2, 3]), ((Brings(),), [24, 125]):
        game = DUEL.without(Rewards).with_(PaysMore(), *more).ordered("pays_more.add", "pays_more.add_more")
        env = outlast.make_vec(game, 1, seed=0, interpret=interpret)
        env.reset()
        assert env.step(say_nothing(env))[1].tolist() == [paid]


class LastPaid(Observation):
    paid: Array = column("f4", "agents", 1)


class Remembers(Module):
    def singletons(self) -> list[Singleton]:
        return [LastPaid()]


@Remembers.system(Phase.OBSERVE)
def recall(view: Write[LastPaid], reward: Read[Reward]) -> None:
    for i in range(reward.reward.size):
        view.paid[i, 0] = reward.reward[i]


def test_the_reward_of_the_tick_before_can_be_observed() -> None:
    """Observations are written ahead of rewards."""
    env = outlast.make_vec(DUEL.without(Rewards).with_(Pays(), Remembers()), 1, seed=0)
    env.reset()
    seen = [env.step(say_nothing(env))[0]["paid"][0, :, 0].tolist() for _ in range(3)]
    assert seen == [[0, 0], [1, 2], [1, 2]]


def namesakes() -> tuple[type[Action], type[Signal]]:
    def action() -> type[Action]:
        class Twin(Action):
            twin: Array = column("i1", "agents", low=0, high=3)

        return Twin

    def signal() -> type[Signal]:
        class Twin(Signal):
            twin: Array = column("f4", "agents", key="other")

        return Twin

    return action(), signal()


ActionTwin, SignalTwin = namesakes()


class Twins(Module):
    def singletons(self) -> list[Singleton]:
        return [ActionTwin(), SignalTwin()]


@Twins.system(Phase.OBSERVE)
def copy(signal: Write[SignalTwin], action: Read[ActionTwin]) -> None:  # type: ignore[valid-type]
    for i in range(signal.twin.size):
        signal.twin[i] += action.twin[i]


def test_components_of_one_name_are_told_apart() -> None:
    env = outlast.make_vec(DUEL.with_(Twins()), 2, seed=0)
    env.reset()
    actions = say_nothing(env)
    actions[..., [key for key, *_ in env.worlds.layout.actions].index(ActionTwin)] = 3
    for _ in range(2):
        env.step(actions)
        assert env.worlds[SignalTwin].twin.tolist() == [[3, 3]] * 2


def seen(name: str) -> type[Observation]:
    class Seen(Observation):
        value: Array = column("f4", "agents", 1, key=name)

    return Seen


One, Other = seen("twin_smell"), seen("twin_sound")


class Pair(Module):
    def singletons(self) -> list[Singleton]:
        return [One(), Other()]


@Pair.system(Phase.OBSERVE)
def fill(one: Write[One], other: Write[Other]) -> None:  # type: ignore[valid-type]
    for i in range(one.value.shape[0]):
        one.value[i, 0], other.value[i, 0] = 1, 2


def test_classes_that_one_function_has_made_are_told_apart() -> None:
    """In rows of the absent, which are cleared."""
    env = outlast.make_vec(DUEL.with_(Pair()).vary(n_agents=outlast.integers(1, 3)), 8, seed=0)
    observations, info = env.reset()
    assert not info["present"].all()
    for key, value in (("twin_smell", 1), ("twin_sound", 2)):
        assert np.array_equal(observations[key][..., 0], value * info["present"])


class Hasty(Module):
    pass


@Hasty.system(Phase.DRIVE)
def bonus(reward: Write[Reward], agents: Rows[Side]) -> None:
    reward.reward[0] = 1


def test_a_reward_that_would_be_overwritten_is_refused() -> None:
    with pytest.raises(
        DeclarationError, match=r"hasty.bonus writes Reward in vain: rewards.pay .* Phase.REWARD, after="
    ):
        outlast.make_vec(DUEL.with_(Hasty()), 1)
    env = outlast.make_vec(DUEL.without(Rewards).with_(Hasty(), Pays()), 1, seed=0)
    env.reset()
    assert env.step(say_nothing(env))[1].tolist() == [[2, 2]]


def say_nothing(env: Any) -> Any:
    return np.tile(env.noop, (env.num_envs, env.num_agents, 1))


class Rises(Module):
    pass


@Rises.system(Phase.RESPAWN)
def rise(entities: Write[Entity], health: Write[Health], agents: Rows[Side]) -> None:
    for e in agents:
        if not entities.alive[e]:
            entities.alive[e], health.points[e] = 1, 100


class Returns(Module):
    pass


@Returns.system(Phase.RESPAWN)
def bring_back(entities: Write[Entity], health: Write[Health], agents: Rows[Side]) -> None:
    for e in agents:
        if not entities.alive[e] and exists(entities, e):
            entities.alive[e], health.points[e] = 1, 100


@pytest.mark.usefixtures("untried")
@pytest.mark.parametrize("interpret", [False, True])
def test_who_is_absent_is_not_brought_back(interpret: bool) -> None:
    varied = DUEL.vary(n_agents=outlast.integers(1, 3))
    env = outlast.make_vec(varied.with_(Rises()), 8, seed=0, interpret=("rises.rise",) if interpret else ())
    env.reset()
    with pytest.raises(AbsentError, match=r"(after rises.rise: )?an entity is alive .* exists\(entities, e\) is False"):
        env.step(say_nothing(env))
    env = outlast.make_vec(varied.with_(Returns()), 8, seed=0, interpret=("returns.bring_back",) if interpret else ())
    present = env.reset()[1]["present"]
    assert not present.all()
    env.worlds[Health].points[:] = 0
    for _ in range(2):
        info = env.step(say_nothing(env))[-1]
    assert (info["alive"] == present).all()


class Defects(Module):
    pass


@Defects.system(Phase.RESPAWN)
def defect(side: Write[Side], agents: Rows[Side]) -> None:
    side.side[agents[0]] = 7


class Fills(Module):
    pass


@Fills.system(Phase.MELEE)
def overfill(bag: Write[Bag], agents: Rows[Bag]) -> None:
    for e in agents:
        bag.items[e, 0], bag.count[e] = -1, 1000


class Doubles(Module):
    pass


@Doubles.system(Phase.RESPAWN)
def double(entities: Write[Entity], agents: Rows[Side]) -> None:
    entities.alive[agents[1]] += 1


class Marks(Component):
    mark: Any = column("i4", unit="entity")
    last: Any = column("i4", low=5, fill=5)  # rows without the component hold 0


class Marked(Singleton):
    marked: Any = column("i4", 2, below="rows")


class Points(Module):
    def archetypes(self) -> list[Archetype]:
        return [Archetype("agent", (Marks(),))]

    def singletons(self) -> list[Singleton]:
        return [Marked()]


@Points.system(Phase.MELEE)
def point(marks: Write[Marks], marked: Write[Marked], agents: Rows[Marks]) -> None:
    marks.mark[agents[1]] -= 2
    marked.marked[0] = 0


class Adds(Points):
    pass


@Adds.system(Phase.MELEE)
def point(marked: Add[Marked]) -> None:  # noqa: F811
    marked.marked[1] -= 1


@pytest.mark.usefixtures("untried")
@pytest.mark.parametrize("interpret", [False, True])
@pytest.mark.parametrize(
    ("module", "words"),
    [
        (Defects(), r"agent\.Side\.side after defects\.defect: .*: -1 to 1 is needed"),
        (Fills(), r"inventory\.Bag\.count after fills\.overfill: .*: 0 to 4 is needed"),
        (Doubles(), r"component\.Entity\.alive after doubles\.double: .*: 0 to 1 is needed"),
        (Points(), r"Marks\.mark after points\.point: .*: -1 to \d+ is needed"),
        (Adds(), r"Marked\.marked after adds\.point: .*: 0 to \d+ is needed"),
    ],
)
def test_integers_that_a_column_cannot_hold_are_refused(module: Module, words: str, interpret: bool) -> None:
    """Ahead of the first system that would take them for an index, or for bits."""
    label = module.systems()[-1].label
    env = outlast.make_vec(DUEL.with_(module), 2, seed=0, interpret=(label,) if interpret else ())
    env.reset()
    with pytest.raises(RangeError, match=words):
        env.step(say_nothing(env))


def push_far(bag: Write[Bag], item: Write[Item], agents: Rows[Bag]) -> None:
    push(bag, item, agents[0], 100_000)


def place_far(body: Write[Body], entities: Write[Entity], agents: Rows[Side]) -> None:
    place(body, entities, 100_000 + agents[0], 0.0, 0.0)


def look_far(side: Write[Side], masks: Read[ObservationMasks], agents: Rows[Side]) -> None:
    if is_set(masks.filled, 10_000_000 + agents[0], 3):
        side.side[agents[0]] = 0


@pytest.mark.usefixtures("untried")
@pytest.mark.parametrize("interpret", [False, True])
@pytest.mark.parametrize("function", [push_far, place_far, look_far])
def test_functions_of_outlast_check_the_indices_that_others_give_them(function: Any, interpret: bool) -> None:
    class Far(Module):
        pass

    Far.system(Phase.RESPAWN)(function)
    label = f"far.{function.__name__}"
    env = outlast.make_vec(DUEL.with_(Far()), 2, seed=0, interpret=(label,) if interpret else ())
    env.reset()
    named = f"^{label}.*" if COMPILED and not interpret else ""
    with pytest.raises(IndexError, match=f"{named}out of bounds"):
        env.step(say_nothing(env))


@pytest.mark.parametrize("shows", [False, True])
def test_a_mechanic_hides_and_shows(shows: bool) -> None:
    """Agents see each other never, or always; all else is seen as before."""

    class Fog(Module):
        pass

    @Fog.system(Phase.SEE, after=Sight)
    def veil(sight: Write[Sight], agents: Rows[Side]) -> None:
        for i in range(agents.size):
            for o in agents:
                set_bit(sight.visible, i, o, shows)

    clear, foggy = (outlast.make_vec(game, 64, seed=0) for game in (DUEL, DUEL.with_(Fog())))
    one, other = clear.reset()[0], foggy.reset()[0]
    assert 0 < one["others_mask"].mean() < 1
    assert (other["others_mask"] == shows).all()
    assert np.array_equal(one["heals_mask"], other["heals_mask"])


def test_a_system_is_of_a_mechanic_of_its_author() -> None:
    """On one of outlast's, it would be part of every game of the process, by the same name."""
    with pytest.raises(DeclarationError, match=r"motors.hurry: Motors is outlast's own, .* class MyMotors\(Motors\)"):

        @Motors.system(Phase.DRIVE)
        def hurry(agents: Rows[Side]) -> None:
            pass

    class Hurried(Motors):
        pass

    @Hurried.system(Phase.DRIVE)
    def slow(agents: Rows[Side]) -> None:
        pass

    assert "hurried.slow" in [system.label for system in DUEL.with_(Hurried()).worlds(1).schedule.systems]


@dataclass(frozen=True)
class Mute(Module):
    def fields(self) -> dict[str, tuple[Field, ...]]:
        return {"own": (Field("mood"),)}


@dataclass(frozen=True)
class Purse(Module):
    """One Offset for two fields, which lie one behind the other; and none is written where it is closed."""

    closed: bool = False

    def fields(self) -> dict[str, tuple[Field, ...]]:
        return {"own": (Field("gold"), Field("silver"))}

    def systems(self) -> Any:
        return [] if self.closed else super().systems()


@Purse.system(Phase.OBSERVE)
def show(view: Write[SelfView], agents: Rows[Side], own_gold: Offset) -> None:
    for i in range(agents.size):
        view.own[i, own_gold], view.own[i, own_gold + 1] = 1, 2


@pytest.mark.parametrize("closed", [False, True])
def test_fields_are_written_by_one_offset_or_not_at_all(closed: bool) -> None:
    env = outlast.make_vec(DUEL.with_(Purse(closed=closed)), 1, seed=0)
    start = env.fields["own"]["gold"].start
    assert env.reset()[0]["own"][0, 0, start : start + 2].tolist() == ([0, 0] if closed else [1, 2])


class Behind(Module):
    def fields(self) -> dict[str, tuple[Field, ...]]:
        return {"own": (Field("lost"), Field("kept"))}


@Behind.system(Phase.OBSERVE)
def show_kept(view: Write[SelfView], agents: Rows[Side], own_kept: Offset) -> None:
    for i in range(agents.size):
        view.own[i, own_kept] = 1


def test_an_offset_is_no_writer_of_what_lies_ahead_of_it() -> None:
    with pytest.raises(DeclarationError, match="no system writes the field 'lost' that behind adds to 'own'"):
        outlast.make_vec(DUEL.with_(Behind()), 1)


def test_a_field_that_no_system_writes_is_refused() -> None:
    with pytest.raises(
        DeclarationError, match=r"no system writes the field 'mood' that mute adds to 'own', .*: Offset"
    ):
        outlast.make_vec(DUEL.with_(Mute()), 1)


class Sums(Statistic):
    least: Any = column("f8")
    middle: Any = column("f8")
    total: Any = column("f8")
    healthy: Any = column("i4")


class Gathers(Module):
    def singletons(self) -> list[Singleton]:
        return [Sums()]


@Gathers.system(Phase.MELEE, before=Health)
def gather(sums: Write[Sums], health: Write[Health], body: Read[Body], agents: Rows[Side]) -> None:
    health.points[agents] -= 1
    sums.least[0] += np.sort(body.x[agents])[0] + body.x[agents].min()
    sums.middle[0] += health.points[agents].mean() + np.clip(body.x[:4], -1, 1).sum()
    sums.total[0] += body.y[agents].sum() + body.x[:4].copy().sum()
    sums.healthy[0] += int(np.argmin(body.x[agents])) + int((health.points[agents] > 50).sum())


def test_rows_can_be_gathered_copied_and_sorted() -> None:
    """numpy's ways to take several rows at once: compiled and as Python."""
    found = []
    for interpret in ((), ("gathers.gather",)):
        env = outlast.make_vec(DUEL.with_(Gathers()), 2, seed=0, interpret=interpret)
        env.reset()
        for _ in range(5):
            env.step(say_nothing(env))
        found.append([np.array(values) for values in env.worlds[Sums]])
    for one, two in zip(*found, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-6)
        assert one.any()


class Reaches(Module):
    def singletons(self) -> list[Singleton]:
        return [Sums()]


@Reaches.system(Phase.MELEE)
def reach(body: Read[Body], sums: Write[Sums]) -> None:
    sums.least[0] += body.x[np.array([0, 100_000])].sum()


@pytest.mark.usefixtures("untried")
@pytest.mark.skipif(not COMPILED, reason="numpy's own message")
def test_rows_that_are_gathered_are_there() -> None:
    env = outlast.make_vec(DUEL.with_(Reaches()), 1, seed=0)
    env.reset()
    with pytest.raises(IndexError, match=r"reaches.reach"):
        env.step(say_nothing(env))
