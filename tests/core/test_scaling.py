"""outlast.scaled: observations of any adapter, about -1 to 1."""

import contextlib
import math

import numpy as np
import pytest

import outlast
from outlast.ecs import columns_of


def test_numbers_are_divided_by_their_scales_and_angles_wrapped() -> None:
    """F23: other libraries had raw numbers only, angles of hundreds of radians late in an episode."""
    with contextlib.closing(outlast.make_vec("teams_4", 16, seed=0)) as env:
        observations, _ = env.reset()
        policy = outlast.random_policy(env, 0)
        for _ in range(30):
            observations, *_ = env.step(policy(observations))
        observations["own"][0, 0, columns_of(env.fields["own"], "angle")] = 50 * math.tau + 1
        before = {key: values.copy() for key, values in observations.items()}
        seen = outlast.scaled(observations, env.fields)
        own = env.fields["own"]
        places = columns_of(own, "x", "y")
        np.testing.assert_allclose(seen["own"][..., places], before["own"][..., places] / 12.5)
        assert seen["own"][0, 0, columns_of(own, "angle")] == pytest.approx(1 / math.pi, abs=1e-5)
        assert (seen["own"][..., columns_of(own, "id")] == before["own"][..., columns_of(own, "id")]).all()
        assert max(np.abs(seen[key]).max() for key in ("zone", "others", "heals", "boxes")) < 4  # ids up to 3
        for key, values in observations.items():
            np.testing.assert_array_equal(values, before[key])  # it makes copies
            assert seen[key].dtype == np.float32
            assert seen[key].shape == values.shape
            if key.endswith("_mask"):
                assert seen[key] is values
            elif key not in ("own", "others"):
                assert ((seen[key] == 0) == (values == 0)).all()


def test_agents_as_sub_environments_are_scaled_alike() -> None:
    with contextlib.closing(outlast.make_agents("ffa_1", 2, seed=0)) as env:
        seen = outlast.scaled(env.reset()[0], env.base_env.fields)
        assert np.abs(seen["own"]).max() <= 1
