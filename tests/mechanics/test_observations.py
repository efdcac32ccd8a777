"""Cameras, observations, rewards, ends, statistics and the zone: ticks of random worlds against their naive forms."""

import numpy as np
import pytest

import outlast
from outlast.components import ObservationMasks
from outlast.ecs.kernels.simd import SIMD_WIDTH
from tests.conftest import few_by_day
from tests.helpers import naive_observations
from tests.helpers.naive_world import TOLERANCE
from tests.helpers.random_worlds import DAILY, KINDS, play

kinds = pytest.mark.parametrize("kind", few_by_day(KINDS, DAILY))


@kinds
def test_agents_observe_what_their_cameras_see_and_nothing_else(kind: str) -> None:
    for tick in play(kind):
        tick.want.zone = tick.after.zone
        for i in range(len(tick.want.of("agent"))):
            observed = naive_observations.observe(tick.want, i)
            assert set(observed) == set(tick.observation)
            for key, value in observed.items():
                np.testing.assert_allclose(tick.observation[key][i], value, atol=TOLERANCE, err_msg=f"{key} of {i}")


@kinds
def test_cameras_of_these_worlds_see_some_and_not_all(kind: str) -> None:
    ticks = [tick for tick in play(kind) if any(tick.want.seen)]
    shares = [len(seen) / len(tick.want.entities) for tick in ticks for seen in tick.want.seen if seen]
    assert len(ticks) > len(play(kind)) / 2
    assert 0.02 < np.mean(shares) < 0.5


@kinds
def test_the_zone_keeps_to_its_calendar(kind: str) -> None:
    for tick in play(kind):
        assert tick.after.zone == pytest.approx(tick.want.zone, abs=TOLERANCE)


@kinds
def test_rewards_are_the_papers_formula(kind: str) -> None:
    rewards = [[naive_observations.reward(tick.want, i) for i in range(len(tick.reward))] for tick in play(kind)]
    assert [tick.reward for tick in play(kind)] == rewards
    assert len({reward for row in rewards for reward in row}) >= 4


@kinds
def test_episodes_end_by_their_rule_or_at_the_limit(kind: str) -> None:
    ends = [naive_observations.end(tick.want) for tick in play(kind)]
    assert [tick.end for tick in play(kind)] == ends
    assert len(set(ends)) == (3 if KINDS[kind][1].get("ending_limit") else 2)


@kinds
def test_statistics_count_every_tick(kind: str) -> None:
    for tick in play(kind):
        want = naive_observations.statistics(tick.want, tick.before.statistics)
        assert tick.after.statistics.keys() == want.keys()
        for key, value in want.items():
            assert tick.after.statistics[key] == pytest.approx(value, rel=1e-6), key


@pytest.mark.parametrize("mode", ["masked", "revealed", "omniscient"])
def test_masks_have_bits_of_rows_only(mode: str) -> None:
    """Not of what lies in memory behind the last row, which compiled kernels read."""
    env = outlast.make_vec("teams_4", 2, seed=0, cameras_mode=mode)
    env.reset()
    rows = env.worlds.layout.dims["rows"]
    assert rows % SIMD_WIDTH
    for bits in env.worlds[ObservationMasks]:
        assert not (bits[..., -1] >> rows % SIMD_WIDTH).any()
    env.close()
