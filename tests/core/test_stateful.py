"""Any sequence of calls, on several environments at once: what comes back is what tests.helpers.model predicts."""

import secrets
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import seed as fixed_seed
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test

from outlast import VARIANTS, Scenario
from outlast.envs.errors import ActionError, ClosedError, NotResetError, PendingError, StateError
from outlast.envs.snapshots.state import State
from outlast.systems import Boxes
from tests.conftest import COMPILED, scaled
from tests.helpers.invariants import SCENARIOS, scenario
from tests.helpers.model import ModelledEnv, Outcomes, SavedState, replay_alone

SHORT: dict[str, Any] = {  # episodes of a few ticks, with deaths in them
    "agents_health": 15, "ending_limit": 9,
    "safe_zone_radii": (5.0, 2.0), "safe_zone_stand": 2, "safe_zone_shrink": 2, "safe_zone_damage": 3,
}  # fmt: skip
SMALL: dict[str, Any] = {  # boxes that reach into no other cell: they would push agents out of so small a room
    "boxes_width": 0.8, "boxes_width_deviation": 0.1, "boxes_height": 0.8, "boxes_height_deviation": 0.1,
}  # fmt: skip
NAMES = [*VARIANTS, *(name for name in SCENARIOS if name not in VARIANTS)]
MOST, KEPT = 3, 6  # environments and states at a time

which = st.integers(0, 5)  # of the environments, states ... that there are: their remainder by their number
seed = st.sampled_from([0, 1, 2**64 - 1])
acts = st.integers(0, 1)  # few, so that histories come again
options = st.fixed_dictionaries(
    {
        "worlds": st.sampled_from([1, 2, 3, 5, 20] if COMPILED else [1, 2]),
        "seed": seed,
        "threads": st.sampled_from([1, 1, 2, 3]),
        "autoreset_mode": st.sampled_from(["NextStep", "SameStep", "Disabled"]),
        "copy": st.booleans(),
        "first_world": st.sampled_from([0, 0, 2]),
    }
)


def _filled(env: Any, value: Any, extra: int = 0) -> Any:
    return np.full((env.num_worlds + extra, env.num_agents, len(env.action_sizes)), value)


def _cut(state: State) -> State:
    return State(state.scenario, state.arrays | {"world": state.arrays["world"][:, 8:]})


BAD: dict[str, tuple[Callable[[Any], Any], type[Exception]]] = {
    "a world too many": (lambda env: env.step(_filled(env, 0, 1)), ActionError),
    "an action out of range": (lambda env: env.step(_filled(env, 7)), ActionError),
    "sent out of range": (lambda env: (env.send(_filled(env, 7)), env.recv()), ActionError),
    "a mask of none": (lambda env: env.reset(options={"reset_mask": np.zeros(env.num_worlds, bool)}), ValueError),
    "a good mask, a bad seed": (lambda env: env.reset(seed=0.5, options={"reset_mask": [True] * env.num_worlds}),
                                ValueError),
    "recv without send": (lambda env: env.recv(), PendingError),
    "a state of other shape": (lambda env: env.set_state(_cut(env.get_state())), StateError),
    "worlds that are not there": (lambda env: env.set_state(env.get_state([0]), [99]), (IndexError, ValueError)),
    "an array too small": (lambda env: env.observe(np.zeros((1, 1, 1), np.float32)), (ValueError, NotResetError)),
    "a pickle": (lambda env: env.__reduce_ex__(4), TypeError),
}  # fmt: skip


class Calls(RuleBasedStateMachine):
    """Environments of one scenario, some with a number changed, and states that go from one to the other."""

    def __init__(self, names: list[str], folder: Path) -> None:
        super().__init__()
        self.names, self.scenarios = names, list[Scenario]()
        self.memory, self.players = Outcomes(), list[ModelledEnv]()
        self.states: list[SavedState] = []
        self.file = folder / "state.npz"

    def player(self, number: int) -> ModelledEnv:
        return self.players[number % len(self.players)]

    @initialize(options=options, data=st.data())
    def first(self, options: dict[str, Any], data: Any) -> None:
        name = data.draw(st.sampled_from(self.names))
        own = {} if scenario(name).numbers()["room_width"] else {"room_size": 12.0}
        mine = scenario(name, **SHORT, **own, **(SMALL if Boxes in scenario(name) else {}))
        harder = mine.numbers()["melee_damage"] + 1
        self.scenarios = [mine, replace(mine, name="other").replace(melee_damage=harder)]
        self.players.append(ModelledEnv(self.memory, self.scenarios[0], **options))
        self.players[0].reset()

    @rule(options=options, other=st.sampled_from([0, 0, 0, 1]), begin=st.sampled_from([True, True, False]))
    @precondition(lambda self: len(self.players) < MOST)
    def open(self, options: dict[str, Any], other: int, begin: bool) -> None:
        self.players.append(ModelledEnv(self.memory, self.scenarios[other], **options))
        if begin:
            self.players[-1].reset()

    @rule(number=which, seed=st.none() | seed)
    def reset(self, number: int, seed: int | None) -> None:
        self.player(number).reset(seed)

    @rule(number=which, data=st.data())
    def reset_with_a_list(self, number: int, data: Any) -> None:
        worlds = self.player(number).env.num_worlds
        seeds = data.draw(st.lists(seed, min_size=worlds, max_size=worlds))
        self.player(number).reset(np.array(seeds, np.uint64) if worlds % 2 else seeds)

    @rule(number=which, seed=st.none() | seed, chosen=st.integers(0, 2**20 - 1))
    def reset_some(self, number: int, seed: int | None, chosen: int) -> None:
        worlds = self.player(number).env.num_worlds
        mask = np.array([chosen >> w & 1 for w in range(worlds)], bool)
        self.player(number).reset(seed, mask if mask.any() else ~mask)

    @rule(number=which)
    def reset_what_ended(self, number: int) -> None:
        player = self.player(number)
        if player.done.any():
            player.reset(None, player.done)

    @rule(number=which, acts=st.lists(acts, min_size=1, max_size=6))
    def step(self, number: int, acts: list[int]) -> None:
        for act in acts:
            self.player(number).step(act)

    @rule(number=which, act=acts)
    def step_to_an_end(self, number: int, act: int) -> None:
        player = self.player(number)
        for _ in range(SHORT["ending_limit"]):
            if not player.done.any():
                player.step(act)

    @rule(number=which, act=acts)
    def send_and_recv(self, number: int, act: int) -> None:
        self.player(number).step(act, sent=True)

    @rule(number=which, chosen=st.lists(st.integers(0, 19), min_size=1, max_size=4))
    def get_state(self, number: int, chosen: list[int]) -> None:
        """Of some worlds; of those that have ended, if there are any, as they are the rarest."""
        player = self.player(number)
        ended = np.flatnonzero(player.done)
        where = ended if ended.size else np.array(chosen) % player.env.num_worlds
        self.states = [*self.states, player.get_state(where)][-KEPT:]

    @rule(number=which, state=which, first=st.integers(0, 19))
    @precondition(lambda self: self.states)
    def set_state(self, number: int, state: int, first: int) -> None:
        player, saved = self.player(number), self.states[state % len(self.states)]
        where = (first + np.arange(min(len(saved.state), player.env.num_worlds))) % player.env.num_worlds
        if saved.scenario is not player.scenario:
            player.refused(lambda: player.env.set_state(saved.state[: len(where)], where), StateError)
        elif len(where) == len(saved.state):
            player.set_state(saved, where)

    @rule(number=which, state=which)
    @precondition(lambda self: self.states)
    def copy_one_onto_all(self, number: int, state: int) -> None:
        player, saved = self.player(number), self.states[state % len(self.states)]
        if saved.scenario is player.scenario:
            returns, alive = saved.memory
            one = SavedState(saved.state[0], saved.histories[:1], (returns[:1], alive[:1]), saved.scenario)
            player.set_state(one, np.arange(player.env.num_worlds))

    @rule(number=which, other=which, acts=acts, at_an_end=st.booleans())
    @precondition(lambda self: len(self.players) > 1)
    def hand_over(self, number: int, other: int, acts: int, at_an_end: bool) -> None:
        player, receiver = self.player(number), self.player(other)
        if at_an_end:
            self.step_to_an_end(number, acts)
        if receiver.scenario is player.scenario:
            worlds = np.arange(min(receiver.env.num_worlds, player.env.num_worlds))
            receiver.set_state(player.get_state(worlds), worlds)
            receiver.step(acts)

    @rule(state=which)
    @precondition(lambda self: self.states)
    def through_a_file(self, state: int) -> None:
        number = state % len(self.states)
        saved = self.states[number]
        saved.state.save(self.file)
        loaded = State.load(self.file)
        assert loaded.arrays.keys() == saved.state.arrays.keys()
        self.states[number] = saved._replace(state=loaded)

    @rule(number=which, bad=st.sampled_from(sorted(BAD)))
    def bad_calls(self, number: int, bad: str) -> None:
        call, error = BAD[bad]
        player, expected = self.player(number), error if isinstance(error, tuple) else (error,)
        player.refused(lambda: call(player.env), *expected, *([NotResetError] if error is ActionError else []))

    @rule(number=which)
    @precondition(lambda self: len(self.players) > 1)
    def close(self, number: int) -> None:
        env = self.players.pop(number % len(self.players)).env
        env.close()
        env.close()
        for call in (env.reset, env.get_state, env.observe, env.render, lambda: env.step(0), lambda: env.send(0)):
            with pytest.raises(ClosedError):
                call()

    def teardown(self) -> None:
        for player in self.players:
            for history in player.histories[-1:]:
                if history is not None:
                    replay_alone(self.memory, player.scenario, history)
            player.env.close()


def run(names: list[str], folder: Path, seeds: Iterable[int], steps: int) -> None:
    """A few examples of each seed: one run of many would vary the same few. What fails is shown, and not shortened."""
    limits = settings(
        max_examples=3,
        stateful_step_count=steps,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    for number in seeds:
        run_state_machine_as_test(fixed_seed(number)(lambda: Calls(names, folder)), settings=limits)


def test_calls_in_any_order(tmp_path: Path) -> None:
    run(NAMES, tmp_path, range(scaled(10, least=3)), 30 if COMPILED else 8)


@pytest.mark.nightly
@pytest.mark.skipif(not COMPILED, reason="thousands of calls")
@pytest.mark.parametrize("name", NAMES)
def test_many_calls_in_any_order(name: str, tmp_path: Path) -> None:
    run([name], tmp_path, [secrets.randbits(32) for _ in range(20)], 60)
