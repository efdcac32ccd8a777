"""Ctrl-C at any line: a call has not begun, is complete, or the environment demands a reset.

A step that a fault interrupts is complete for all other worlds. Threads that share worlds, and jobs in threads, are
interrupted in tests/engine/test_team.py and tests/core/test_jobs_in_threads.py.
"""

import collections
import contextlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import SurvivalVectorEnv, make_vec, variant
from outlast.adapters import make_agents
from outlast.components import Body
from outlast.envs.errors import FaultError, NotResetError
from tests.helpers.execution_modes import equal
from tests.helpers.model import digest_of_episode

MODES = ("NextStep", "SameStep")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are those of POSIX")


@pytest.mark.parametrize("autoreset", MODES)
@pytest.mark.parametrize("make", [make_vec, make_agents])
def test_a_fault_in_one_world_keeps_no_other_from_ending(make: Any, autoreset: str) -> None:
    envs = [make(variant("ffa_1").replace(ending_limit=2), 3, seed=0, autoreset_mode=autoreset) for _ in range(2)]
    idle, some = np.ones((3, 2, 6), int), np.array([False, True, False])
    if make is make_agents:
        idle, some = idle.reshape(6, 6), np.repeat(some, 2)
    worlds = [env.worlds if make is make_vec else env.base_env.worlds for env in envs]
    for env in envs:
        env.reset()
        env.step(idle)
    worlds[0][Body].vx[1, 0] = np.nan
    for k, env in enumerate(envs):
        with pytest.raises(FaultError, match="world 1") if k == 0 else contextlib.nullcontext():
            env.step(idle)
        env.reset(seed=5 if make is make_vec else [5] * 6, options={"reset_mask": some})
    for _ in range(3):
        (one, *paid), (other, *wanted) = (env.step(idle)[:4] for env in envs)
        assert equal(one, other)
        np.testing.assert_equal(paid, wanted)
    assert digest_of_episode(worlds[0]) == digest_of_episode(worlds[1])


@pytest.mark.parametrize(
    ("name", "autoreset", "stride"),
    [
        ("step", "NextStep", 1),
        ("step", "SameStep", 1),
        ("reset", "NextStep", 1),
        ("set_state", "SameStep", 7),
        pytest.param("set_state", "SameStep", 1, marks=pytest.mark.nightly),
    ],
)
def test_interrupted_at_any_line(name: str, autoreset: str, stride: int) -> None:
    scenario, idle = variant("ffa_3").replace(agents_health=20, ending_limit=3), np.ones((3, 2, 6), int)
    env, clean, other = (make_vec(scenario, 3, seed=seed, autoreset_mode=autoreset) for seed in (1, 1, 2))
    for each in (env, clean):
        each.reset(seed=1)
        for _ in range(2):
            each.step(idle)
    other.reset()
    kept, state, seen = clean.get_state(), other.get_state([0, 1]), collections.Counter[str]()
    call: Callable[[SurvivalVectorEnv], object] = {
        "step": lambda env: env.step(idle),
        "reset": lambda env: env.reset(),
        "set_state": lambda env: env.set_state(state, [1, 2]),
    }[name]
    call(clean)
    before, after = digest_of_episode(env.worlds), digest_of_episode(clean.worlds)
    assert before != after
    while interrupted_at(stride * seen.total(), lambda: call(env)):
        found = digest_of_episode(env.worlds)
        if env.get_state().arrays["started"].all():
            assert found in (before, after), seen
            seen["complete" if found == after else "not begun"] += 1
        else:
            seen["interrupted"] += 1
            with pytest.raises(NotResetError, match="interrupted"):
                env.step(idle)
        env.reset(seed=1)
        env.set_state(kept)
        assert digest_of_episode(env.worlds) == before
    assert digest_of_episode(env.worlds) == after
    assert seen["complete"], seen
    assert seen["not begun"], seen
    assert seen["interrupted"] or name == "step", seen  # all of a step is one compiled call


def interrupted_at(line: int, call: Callable[[], object]) -> bool:
    """Make the call with a KeyboardInterrupt ahead of the line-th line that it runs; whether it came so far.

    Lines are those of envs/ and of the engine's steps.

    The 2300 lines that check a state, ahead of all that changes anything, do not count.
    """
    root, ran, outer = Path(outlast.__file__).parent, 0, sys.gettrace()

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal ran
        file = frame.f_code.co_filename
        counted = file.startswith((f"{root}/envs/", f"{root}/ecs/running/step.py"))
        if not counted or (
            file.endswith("/snapshots/state.py") and frame.f_code.co_name not in ("restore", "snapshot")
        ):
            return None
        ran += event == "line"
        if ran > line:
            raise KeyboardInterrupt
        return trace

    sys.settrace(trace)
    try:
        call()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(outer)
    return False
