"""Actions, observations and rewards of added mechanics: what they hold in resets, and that none is mistaken."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import End, Phase, Reward, SelfView, Side

from outlast.ecs import (  # isort: skip
    Action, Archetype, Array, Clock, Component, DeclarationError, Field, Observation, Offset, Read, RowIndex, Rows,
    Signal, Write, column, kernel,
)  # fmt: skip
from outlast.systems import Rewards
from tests.helpers.mechanics import DUEL, duel, idle, kind, mechanic

SHORT = DUEL.replace(ending_rule="never", ending_limit=5)
UNPAID = SHORT.without(Rewards)
MODES = ["NextStep", "SameStep", "Disabled"]


class Say(Action):
    say: Array = column("i1", "agents", low=0, high=3)


class Word(Component):
    word: Array = column("i4")


Talk = kind(
    "Talk",
    archetypes=[Archetype("agent", (Word(),))],
    singletons=[Say()],
    fields={"own": (Field("word"), Field("heard"))},
)
TALK = SHORT.with_(Talk())


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


def doing(env: Any, action: type[Action], value: int) -> Any:
    actions = idle(env)
    actions[..., [key for key, *_ in env.worlds.layout.actions].index(action)] = value
    return actions


def heard(env: Any, observations: Any) -> Any:
    start = env.fields["own"]["word"].start
    return observations["own"][0, 0, start : start + 2].tolist()


@pytest.mark.parametrize("mode", MODES)
def test_nothing_was_done_before_an_episode_began(mode: str) -> None:
    env, resets = duel(game=TALK, count=2, autoreset_mode=mode), 0
    for _ in range(13):
        observations, *ends, _ = env.step(doing(env, Say, 2))
        if mode == "Disabled" and ends[2].any():
            observations, _ = env.reset(options={"reset_mask": ends[2]})
        begins = env.worlds[Clock].tick[0, 0] == 0
        assert heard(env, observations) == [0, 0] if begins else [2, 2]
        resets += begins
    assert resets == 2
    assert heard(env, env.reset(seed=5)[0]) == [0, 0]


@pytest.mark.parametrize("mode", MODES[:2])
def test_what_is_kept_of_actions_replays(mode: str, tmp_path: Path) -> None:
    env, generator = duel(game=TALK, count=3, autoreset_mode=mode), np.random.default_rng(0)
    env.step(doing(env, Say, 3))
    with outlast.record(env, tmp_path / "talk.rec"):
        env.reset(seed=1)
        for _ in range(14):
            env.step(generator.integers(0, env.action_sizes, (3, 2, len(env.action_sizes))))
    replay = outlast.Replay(outlast.Recording.open(tmp_path / "talk.rec", scenario=TALK))
    assert len(list(replay.ticks())) > 14


Pays = kind("Pays", singletons=[Reward()])


@Pays.system(Phase.REWARD)
def add(reward: Write[Reward], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        reward.reward[i] += i + 1


def test_rewards_that_are_added_to_begin_at_0() -> None:
    env = duel(Pays(), game=UNPAID)
    assert [env.step(idle(env))[1][0].tolist() for _ in range(8)] == [[1, 2]] * 5 + [[0, 0]] + [[1, 2]] * 2


Hasty = kind("Hasty")


@Hasty.system(Phase.DRIVE)
def bonus(reward: Write[Reward], agents: Rows[Side]) -> None:
    reward.reward[0] = 1


def test_a_reward_that_would_be_overwritten_is_refused() -> None:
    with pytest.raises(
        DeclarationError, match=r"hasty.bonus writes Reward in vain: rewards.pay .* Phase.REWARD, after"
    ):
        duel(Hasty())
    env = duel(Hasty(), Pays(), game=UNPAID)
    assert env.step(idle(env))[1].tolist() == [[2, 2]]


Generous = kind("Generous")


@Generous.system(Phase.REWARD, after=Reward)
def pay(reward: Write[Reward], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        reward.reward[i] += 1


@Generous.system(Phase.END, after=End)
def end(end: Write[End]) -> None:
    end.terminated[0] = True


@pytest.mark.parametrize("mode", MODES)
def test_a_reset_neither_pays_nor_ends(mode: str) -> None:
    env = duel(Generous(), count=3, autoreset_mode=mode)
    assert not env.worlds[Reward].reward.any()
    for k in range(4):
        _, rewards, ends, _, info = env.step(idle(env))
        begins = mode == "NextStep" and k % 2
        assert rewards.tolist() == [[0.0 if begins else 2.0] * 2] * 3
        assert ends.tolist() == [not begins] * 3
        if ends.any():
            assert info["statistics"]["length"].tolist() == [1] * 3
        if mode == "Disabled":
            env.reset(options={"reset_mask": ends})


def test_the_tick_of_a_reset_pays_nothing_in_a_replay(tmp_path: Path) -> None:
    """It leaves the rewards of worlds that wait as they are."""
    env, paid = duel(game=(game := DUEL.with_(Generous())), count=3, autoreset_mode="Disabled"), list[Any]()
    with outlast.record(env, tmp_path / "a.rec"):
        for mask in ([True] * 3, None, [True, False, True], [False, True, False], None):
            env.step(idle(env)) if mask is None else env.reset(options={"reset_mask": np.array(mask)})
            paid.append(env.worlds[Reward].reward.tolist())
    replay = outlast.Replay(outlast.Recording.open(tmp_path / "a.rec", scenario=game))
    assert [replay.worlds[Reward].reward.tolist() for _ in replay.ticks()] == paid
    assert paid[2] == [[0, 0], [2, 2], [0, 0]]


class Rare(Component):
    worth: Array = column("f4", fill=3)


PaysMore = kind("PaysMore", Pays)


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
    brings = mechanic("Brings", archetypes=[Archetype("agent", (Rare(),))])
    game = UNPAID.with_(PaysMore()).ordered("pays_more.add", "pays_more.add_more")
    for more, paid in ((), [2, 3]), ((brings,), [24, 125]):
        env = duel(*more, game=game, interpret=interpret)
        assert env.step(idle(env))[1].tolist() == [paid]


ActionTwin = type("Twin", (Action,), {"twin": column("i1", "agents", low=0, high=3)})
SignalTwin = type("Twin", (Signal,), {"twin": column("f4", "agents", key="other")})
One, Other = (type("Seen", (Observation,), {"value": column("f4", "agents", 1, key=f"twin_{k}")}) for k in "ab")
Twins = kind("Twins", singletons=[ActionTwin(), SignalTwin(), One(), Other()])


@Twins.system(Phase.OBSERVE)
def copy(signal: Write[SignalTwin], action: Read[ActionTwin], one: Write[One], other: Write[Other]) -> None:
    for i in range(signal.twin.size):
        signal.twin[i] += action.twin[i]
        one.value[i, 0], other.value[i, 0] = 1, 2


def test_components_of_one_name_are_told_apart() -> None:
    env = duel(Twins(), count=2)
    for _ in range(2):
        env.step(doing(env, ActionTwin, 3))
        assert env.worlds[SignalTwin].twin.tolist() == [[3, 3]] * 2
    env = duel(Twins(), game=DUEL.vary(n_agents=outlast.distributions.integers(1, 3)), count=8)
    observations, info = env.reset()
    assert not info["present"].all()
    for key, value in (("twin_a", 1), ("twin_b", 2)):
        assert np.array_equal(observations[key][..., 0], value * info["present"])


class Flash(Observation):
    flash: Array = column("f4", "agents", 1)


Flashes = kind("Flashes", singletons=[Flash()])


@Flashes.system(Phase.OBSERVE)
def flash_once(view: Write[Flash], clock: Read[Clock], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        if clock.tick[0] == 3:
            view.flash[i, 0] = 1


def test_an_observation_that_is_not_always_written_is_not_of_the_last_episode() -> None:
    env = duel(Flashes())
    for _ in range(2):
        seen = [env.reset(seed=0)[0]["flash"].max(), *(env.step(idle(env))[0]["flash"].max() for _ in range(4))]
        assert seen == [0, 0, 0, 1, 1]
