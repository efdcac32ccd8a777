"""Replays: the same bits as what was recorded, whatever was done; where they are not, tick and component are named."""

import contextlib
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Body, Fault, Health
from outlast.ecs import Clock, Entity, Signal
from outlast.envs.adapters.gymnasium_learners import SurvivalLearnerVectorEnv
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import RecordingError, ReplayError
from outlast.envs.recording import Recording, Replay
from outlast.envs.recording.recorder import Digests
from outlast.envs.rollout.local import rollout
from outlast.envs.rollout.policies import POLICIES
from tests.conftest import draw_actions
from tests.helpers.execution_modes import short
from tests.helpers.model import digest_of_episode

WORLDS, STEPS = 5, 90
SHORT = {"ending_limit": 25, "agents_health": 40}


def make(variant: str = "teams_3", worlds: int = WORLDS, **options: Any) -> SurvivalVectorEnv:
    return outlast.make_vec(outlast.variant(variant).replace(**SHORT), worlds, seed=1, **options)


class Watched:
    def __init__(self, env: SurvivalVectorEnv) -> None:
        self.states: list[str] = []
        run = env.worlds.run

        def watched(mode: Any) -> None:
            run(mode)
            self.states.append(digest_of_episode(env.worlds))

        env.worlds.run = watched  # type: ignore[method-assign]


def replayed(path: Path, **options: Any) -> list[str]:
    replay = Replay(Recording.open(path, **options))
    return [digest_of_episode(replay.worlds) for _ in replay.ticks()]


@pytest.mark.parametrize("autoreset", ["NextStep", "SameStep"])
@pytest.mark.parametrize("variant", ["ffa_1", "ffa_3", "teams_3"])
def test_every_tick_is_the_same(tmp_path: Path, variant: str, autoreset: str) -> None:
    env = make(variant, autoreset_mode=autoreset)
    env.reset()
    env.step(draw_actions(env, np.random.default_rng(9)))  # it has a past
    watched, rng = Watched(env), np.random.default_rng(0)
    with outlast.record(env, tmp_path / "a.rec"):
        env.reset()
        for _ in range(STEPS):
            env.step(draw_actions(env, rng))
    assert len(set(watched.states)) > STEPS
    assert replayed(tmp_path / "a.rec") == watched.states


def test_partial_resets_and_new_seeds_are_in_it(tmp_path: Path) -> None:
    env = make(autoreset_mode="Disabled")
    watched, rng = Watched(env), np.random.default_rng(0)
    with outlast.record(env, tmp_path / "a.rec"):
        env.reset(seed=5)
        for step in range(STEPS):
            *_, terminated, truncated, _ = env.step(draw_actions(env, rng))
            if (done := terminated | truncated | (rng.random(WORLDS) < 0.05)).any():
                seed = [None, 2**64 - 1 - step, list(range(step, step + WORLDS))][step % 3]
                env.reset(seed=seed, options={"reset_mask": done})
        env.reset()
        env.step(draw_actions(env, rng))
    assert len(watched.states) > STEPS + 4
    assert replayed(tmp_path / "a.rec") == watched.states


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("learners", [False, True])
def test_adapters_are_recorded_by_their_base_env(tmp_path: Path, learners: bool, mode: str) -> None:
    scenario = short("ffa_3").replace(n_agents=4)
    make = partial(SurvivalLearnerVectorEnv, 3) if learners else partial(outlast.adapters.make_agents, num_worlds=3)
    env = make(scenario=scenario, autoreset_mode=mode)
    watched, rng = Watched(env.base_env), np.random.default_rng(0)
    warned = pytest.warns(UserWarning, match="ends that an adapter adds") if learners else contextlib.nullcontext()
    with warned:
        recorder = outlast.record(env.base_env, tmp_path / "a.rec")
    with recorder:
        env.reset(seed=0)
        for _ in range(40):
            env.step(rng.integers(0, env.base_env.action_sizes, (env.num_envs, 6)))
    assert replayed(tmp_path / "a.rec") == watched.states


def test_threads_and_numbers_of_worlds_make_no_difference(tmp_path: Path) -> None:
    """Digests of larger batches take turns: 64 worlds a tick."""
    env = make("ffa_1", worlds=150, threads=2, first_world=3)
    summary = None
    with outlast.record(env, tmp_path / "a.rec", episodes=0):
        summary = rollout(env, POLICIES["random"](env, 0), 60)
    replay = Replay(found := Recording.open(tmp_path / "a.rec"), threads=3)
    assert list(replay.ticks()) == list(range(len(found)))
    assert str(replay.summary) == str(summary)
    assert (replay.summary.episodes, replay.worlds[Clock].world[0, 0]) == (summary.episodes, 3)


@pytest.mark.parametrize("asked", [{"episodes": 1}, {"episodes": 3}, {"steps": 150}, {"steps": 3}])
def test_a_replay_has_the_table_of_the_rollout(tmp_path: Path, asked: dict[str, Any]) -> None:
    given: dict[str, Any] = {"worlds": 4, "seed": 3, "record": tmp_path / "a.rec"}
    summary = outlast.rollout(short("ffa_2"), "scripted", **given, **asked)
    replay = Replay(tmp_path / "a.rec")
    assert [*replay.ticks()]
    assert str(replay.summary) == str(summary)
    assert replay.summary.episodes_per_world == asked.get("episodes", 0)


def test_a_replay_of_a_loop_of_ones_own_counts_the_first_episodes(tmp_path: Path) -> None:
    """Once every world has ended one; until then, all."""
    zone = {"safe_zone_damage": 20, "safe_zone_stand": 20, "safe_zone_shrink": 10}
    env = outlast.make_vec("ffa_2", 3, seed=0, **zone)
    with outlast.record(env, tmp_path / "a.rec"):
        expected = rollout(env, POLICIES["scripted"](env, 0), episodes=1)
        for _ in range(60):
            env.step(np.tile(env.noop, (3, 2, 1)))
    replay, headings = Replay(tmp_path / "a.rec"), dict[str, None]()
    for _ in replay.ticks():
        headings[str(replay.summary).partition("\n")[0]] = None
    assert str(replay.summary) == str(expected)
    assert [*headings][-1] == "3 whole episodes, the first of every world"
    assert any("lean towards short" in heading for heading in headings)


def test_mechanics_of_others_need_the_scenario(tmp_path: Path, monkeypatch: Any) -> None:
    """What a file names is never imported."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "docs" / "examples"))
    from poison import Poison

    scenario = outlast.variant("teams_2").with_(Poison(strength=20))
    env = outlast.make_vec(scenario, 2, seed=0)
    watched = Watched(env)
    with outlast.record(env, tmp_path / "a.rec"):
        rollout(env, POLICIES["random"](env, 0), 30)
    monkeypatch.delitem(sys.modules, "poison")
    with pytest.raises(RecordingError, match=r"poison\.Poison is not one of outlast's own.*scenario=\.\.\."):
        Recording.open(tmp_path / "a.rec")
    assert "poison" not in sys.modules
    with pytest.raises(RecordingError, match=r"all of its mechanics|there is no file nowhere\.py"):
        Recording.open(tmp_path / "a.rec", scenario="nowhere.py:game")
    assert replayed(tmp_path / "a.rec", scenario=scenario) == watched.states
    with pytest.raises(RecordingError, match="poison_strength is 20 there and 30 here"):
        Recording.open(tmp_path / "a.rec", scenario=scenario.with_(Poison()))


def test_some_ticks_of_some_worlds(tmp_path: Path) -> None:
    """The first and the last that are asked for, and of those between the ones in which a world takes part."""
    env, third = make(worlds=3, autoreset_mode="Disabled"), np.array([False, False, True])
    with outlast.record(env, tmp_path / "a.rec"):
        for mask in (None, third, ~third, third, ~third, None):
            env.reset(options=None if mask is None else {"reset_mask": mask})
    replay = Replay(Recording.open(tmp_path / "a.rec"))
    assert list(replay.ticks(first=2, last=4)) == [2, 3, 4]
    for worlds in ([2], (2,), np.array([2]), iter([2])):
        assert list(replay.ticks(first=2, worlds=worlds)) == [2, 3, 5]
    assert list(replay.ticks(first=1, last=4, worlds=[0, 1])) == [1, 2, 4]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"first": 3, "last": 2}, "ticks 3 to 2: 0 <= from <= to <= 4 is needed"),
        ({"last": 5}, "ticks 0 to 5"),
        ({"first": 1.5}, "tick 1.5: integers are needed"),
        ({"worlds": [0, 3]}, "world 3 does not exist; they are 0 to 2"),
        ({"worlds": [-1]}, "world -1 does not exist"),
        ({"worlds": 0}, r"worlds = 0: their numbers are needed, as in \[0, 3\]"),
    ],
)
def test_ticks_and_worlds_that_there_are_not_are_refused(tmp_path: Path, asked: dict[str, Any], message: str) -> None:
    replay = Replay(_idle(tmp_path / "a.rec"))
    with pytest.raises(RecordingError, match=message):
        replay.ticks(**asked)


def test_a_second_pass_ends_the_first(tmp_path: Path) -> None:
    """There is one set of worlds: of two passes at once neither would be what was recorded."""
    replay = Replay(_idle(tmp_path / "a.rec"))
    one = replay.ticks()
    assert [next(one), next(one)] == [0, 1]
    two = replay.ticks()
    assert next(one) == 2  # nothing of the second was asked for yet
    assert next(two) == 0
    with pytest.raises(RecordingError, match=r"has begun anew; make a second Replay for both"):
        next(one)
    assert list(two) == [1, 2, 3, 4]


def _idle(path: Path) -> Path:
    env = make(worlds=3)
    with outlast.record(env, path):
        env.reset()
        for _ in range(4):
            env.step(np.broadcast_to(env.noop, (3, env.num_agents, *env.noop.shape[-1:])))
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory: Any) -> Path:
    """A rollout of 70 worlds, whose digests take turns."""
    path: Path = tmp_path_factory.mktemp("replay") / "a.rec"
    env = outlast.make_vec("teams_3", 70, seed=1)
    with outlast.record(env, path):
        rollout(env, POLICIES["random"](env, 0), 60)
    return path


@pytest.mark.parametrize(
    ("component", "column", "world", "after", "found"),
    [
        (Health, "points", 3, 5, 6),
        (Body, "angle", 63, 6, 8),  # digests are of worlds 0 to 63 in every other tick
        (Entity, "identity", 65, 6, 7),
        (Fault, "physics", 0, 7, 8),
    ],
)
def test_a_difference_is_named_by_tick_and_component(
    path: Path, component: Any, column: str, world: int, after: int, found: int
) -> None:
    """In the next tick whose digest is of that world."""
    replay = Replay(Recording.open(path))

    def meddle() -> None:
        for number in replay.ticks():
            if number == after:
                values = getattr(replay.worlds[component], column)
                values[world, min(2, values.shape[1] - 1)] += 1

    of = "0 to 63" if world < 64 else "64 to 69"
    with pytest.raises(ReplayError, match=rf"tick {found} is the first that differs \(worlds {of}\)") as error:
        meddle()
    assert component.__name__ in str(error.value)
    assert f"recorded by outlast {outlast.__version__} on " in str(error.value)


def test_digests_depend_on_every_byte_of_every_world_alone() -> None:
    """A flipped bit changes the digest of its own component and no other; moved to another world it is another one."""
    env = make("teams_3", 3)
    env.reset()
    digests, worlds = Digests(env.worlds), env.worlds
    before, rng = digests.compute(0), np.random.default_rng(0)
    missed = tried = 0
    for k, component in enumerate(c for c in worlds.components if c.packed or issubclass(c, Signal)):
        assert digests.names[k] == component.__name__
        for column in worlds[component]:
            found = []
            for _ in range(20):
                where = tuple(int(rng.integers(size)) for size in column.shape)
                kept = column[where].copy()
                column[where] = _flipped(kept, int(rng.integers(8 * column.itemsize)))
                changed = np.flatnonzero(digests.compute(0) != before)
                assert set(changed) <= {k}
                missed, tried = missed + (len(changed) == 0), tried + 1
                found.append(digests.compute(0)[k])
                column[where] = kept
    assert (digests.compute(0) == before).all()
    assert missed <= max(2, tried // 2**12)


def test_digests_depend_on_where_a_change_is_and_signs_in_many_worlds() -> None:
    env = make("teams_3", 64)
    env.reset()
    digests, points = Digests(env.worlds), env.worlds[Health].points
    seen = set()
    for w in range(64):
        for e in range(4):
            points[w, e] -= 1
            seen.add(digests.compute(0)[digests.names.index("Health")])
            points[w, e] += 1
    assert len(seen) > 250  # of 256
    before = digests.compute(0)
    env.worlds[Body].vx[:, 0] = -0.0  # in an even number of worlds
    changed = np.flatnonzero(digests.compute(0) != before)
    assert [digests.names[k] for k in changed] == ["Body"]


def _flipped(value: Any, bit: int) -> Any:
    raw = np.array(value).reshape(1).view(np.uint8).copy()
    raw[bit // 8] ^= np.uint8(1 << bit % 8)
    return raw.view(np.array(value).dtype)[0]
