"""Bad input to one of two equal environments: what is refused must change nothing."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from outlast.envs.core.vector_env import SurvivalVectorEnv
from tests.conftest import digest, draw_actions


def begin(pair: Sequence[SurvivalVectorEnv]) -> None:
    """Bring both into the middle of an episode."""
    for env in pair:
        env.reset(seed=4)
    _go_on(pair, 2)


def refuses(pair: Sequence[SurvivalVectorEnv], call: Callable[[Any], Any], error: type[Exception], *words: str) -> None:
    """Check that `call` raises `error` with all words, and that all goes on, in the next episode too, as without it."""
    begin(pair)
    with pytest.raises(error) as raised:
        call(pair[0])
    assert type(raised.value) is error
    for word in words:
        assert word in str(raised.value)
    _go_on(pair, 4)


def _go_on(pair: Sequence[SurvivalVectorEnv], ticks: int) -> None:
    """Step both with the same actions; the tick after the second one is a reset."""
    rng = np.random.default_rng(ticks)
    for tick in range(ticks):
        assert digest(pair[0].worlds) == digest(pair[1].worlds)
        actions = draw_actions(pair[0], rng)
        for env in pair:
            env.step(actions) if tick != 2 else env.reset()
    assert digest(pair[0].worlds) == digest(pair[1].worlds)
