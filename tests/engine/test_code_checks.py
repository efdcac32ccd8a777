"""Code that would give a silent wrong number is refused: variables without a value, and one random number for two."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numba.np import arrayobj

from outlast.components import Hit, Phase, Side
from outlast.ecs import (
    Archetype,
    Array,
    Clock,
    Component,
    DeclarationError,
    Module,
    Observation,
    RangeError,
    Read,
    Rows,
    Singleton,
    Write,
    column,
)
from outlast.ecs.compilation.compile_errors import of_numba
from outlast.envs.core.make import make_vec
from outlast.envs.scenarios.variants import variant


class Prey(Component):
    prey: Array = column("i4", fill=-1, unit="entity")
    x: Array = column("f4")
    y: Array = column("f4")
    drawn: Array = column("i4")


def played(function: Callable[..., Any], phase: Phase = Phase.LOOK, **order: Any) -> Any:
    """Worlds with a mechanic of that one system, after a reset."""
    members = {"archetypes": lambda self: [Archetype("agent", (Prey(),))]}
    mechanic = type("Hunt", (Module,), members)
    mechanic.system(phase, **order)(function)
    env = make_vec(variant("ffa_1").with_(mechanic()), 2, seed=0)
    env.reset()
    return env


# ---- events


@pytest.mark.usefixtures("untried")
def test_the_count_of_an_event_stays_in_its_list() -> None:
    def cancel(hits: Write[Hit], agents: Rows[Prey]) -> None:
        hits.count[0] -= 1

    env = played(cancel, Phase.MELEE, before="melee.strike")
    with pytest.raises(
        RangeError, match=r"Hit\.count after hunt\.cancel: an integer is out of the range .*: 0 to 4 is"
    ):
        env.step(np.zeros((2, 2, len(env.action_sizes)), int))


def test_an_error_that_numba_raises_names_no_line_of_its_own() -> None:
    def compare(prey: Write[Wide], agents: Rows[Prey]) -> None:
        if prey.wide > 0:
            prey.wide[0] = 1

    mechanic = type("Hunt", (Module,), {"archetypes": lambda self: [Archetype("agent", (Prey(),))]})
    mechanic.singletons = lambda self: [Wide()]
    mechanic.system(Phase.DRIVE)(compare)
    env = make_vec(variant("ffa_1").with_(mechanic()), 1, seed=0)
    env.reset()
    with pytest.raises(
        ValueError, match=r"^(hunt\.compare: )?The truth value of an array with more than one element is amb"
    ):
        env.step(np.zeros((1, 2, len(env.action_sizes)), int))


@pytest.mark.parametrize(
    ("file", "own"),
    [
        (arrayobj.__file__, True),
        ("/another/venv/lib/site-packages/numba/np/arrayobj.py", True),  # that has compiled what is in the cache
        ("/home/me/numba/game.py", False),
        ("/home/me/numba", False),
        ("game.py", False),
    ],
)
def test_files_of_numba_are_known_wherever_it_is_installed(file: str, own: bool) -> None:
    assert of_numba(file) is own


class Wide(Singleton):
    wide: Array = column("f4", 3)


# ---- what a scenario has


def test_a_kind_is_in_the_world_after_reset_or_not() -> None:
    class Here(Module):
        def archetypes(self) -> Any:
            return [Archetype("agent", (Prey(),), alive=False)]

    with pytest.raises(
        DeclarationError, match=r"one module has 'agent' in the world right after reset, and another one"
    ):
        make_vec(variant("ffa_1").with_(Here()), 1)


def test_a_kind_of_entities_that_there_is_nowhere_is_refused() -> None:
    worlds = make_vec("ffa_1", 1).worlds
    assert worlds.span("box") == slice(0, 0)  # another mechanic's
    with pytest.raises(
        DeclarationError, match=r"there are no entities of the kind 'agents'; did you mean agent\? known"
    ):
        worlds.span("agents")


def test_a_column_is_not_called_as_what_components_have() -> None:
    with pytest.raises(DeclarationError, match=r"Wrong\.columns: no column can be called so"):
        type("Wrong", (Component,), {"columns": column("i4")})


class Flash(Observation):
    flash: Array = column("f4", "agents", 1)


class Flashes(Module):
    def singletons(self) -> Any:
        return [Flash()]


@Flashes.system(Phase.OBSERVE)
def flash_once(view: Write[Flash], clock: Read[Clock], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        if clock.tick[0] == 3:
            view.flash[i, 0] = 1


def test_an_observation_that_is_not_always_written_is_not_of_the_last_episode() -> None:
    env = make_vec(variant("ffa_1").with_(Flashes()), 1, seed=0)
    noop = np.broadcast_to(env.noop, (1, 2, len(env.action_sizes)))
    for _ in range(2):
        seen = [env.reset(seed=0)[0]["flash"].max(), *(env.step(noop)[0]["flash"].max() for _ in range(4))]
        assert seen == [0, 0, 0, 1, 1]
