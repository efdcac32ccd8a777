"""Factories of environments, from a scenario or its name."""

from collections.abc import Collection
from typing import Unpack

from gymnasium.vector import AutoresetMode

from ..core.vector_env import SurvivalVectorEnv, world_options
from ..scenarios.known_numbers import Numbers
from ..scenarios.parse import checks_keywords, options_of, resolve
from ..scenarios.scenario import Scenario


@checks_keywords
def make_vec(
    scenario: str | Scenario,
    num_worlds: int,
    *,
    seed: int | None = None,
    threads: int = 1,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    copy: bool = True,
    check_actions: bool = True,
    first_world: int = 0,
    render_mode: str | None = None,
    actions: str = "multi",
    observations: str = "dict",
    scaled: bool = False,
    action_masks: bool = False,
    specialize: bool = False,
    interpret: Collection[str] = (),
    **numbers: Unpack[Numbers],
) -> SurvivalVectorEnv:
    """Make an environment of `num_worlds` worlds of a scenario, which are stepped together.

    >>> env = outlast.make_vec("teams_3", 4096, seed=0, threads=2, copy=False, melee_damage=20)

    Args:
        scenario: A Scenario, or the name of one: "ffa_3", "teams_2+health_cap", "mygame.py:arena", "arena.json".
        num_worlds: How many worlds.
        seed: What keys the random numbers of world i, by (seed, first_world + i); None: a seed from the operating
            system.
        threads: Threads among which a step divides the worlds, with the same results.
        autoreset_mode: When a world that ended begins its next episode: NEXT_STEP, SAME_STEP or DISABLED of
            gymnasium.vector.AutoresetMode, or their values, such as "NextStep".
        copy: Whether to return observations in new arrays; if not, which is faster, they are read-only views, and the
            next call overwrites them, and any tensors that share their memory, such as those from jax.device_put.
        check_actions: Whether to check the range of actions; if not, an action out of range has an unspecified effect,
            but does no harm.
        first_world: Number of the first world, for batches that each hold a part of the worlds of one seed.
        render_mode: "rgb_array", "ansi" or None.
        actions: "multi", an integer for each action; "joint", one integer for all actions of an agent, 0 to 215 in the
            paper; or "continuous", a float from -1 to 1 for each action, whose values share that range equally.
        observations: "dict", arrays by key; "flat", one array that joins those of all keys; or, from make_vec only,
            "rows", by key, with lists of the rows that agents see and who sees them, instead of padded rows and masks.
        scaled: Whether to divide observations, and `state`, by the scales of their fields to about -1 to 1, with angles
            wrapped; columns without bounds are clipped to -10 to 10.
        action_masks: Whether to put "action_mask" into info, int8: what `action_masks` returns.
        specialize: Whether to compile for this scenario alone: steps then take 15 to 25 % less time, but new mechanics
            or sizes take some ten seconds to compile, once; otherwise, scenarios share their compiled code.
        interpret: Labels of systems ("melee.aim") to run as Python, for breakpoints and print; slow.
        **numbers: Numbers of the scenario to change, as for `Scenario.replace`.

    Raises:
        ScenarioError: The variant is unknown, or the scenario has no rewards or no ending.
        NumberError: A number is out of its range, or does not exist (then it is a KeywordError).
        ScheduleError: The order of the scenario's systems is ambiguous, or `interpret` names a system it does not have.
        ValueError: An option is out of its range.
    """
    asked = resolve(scenario, numbers, options_of(make_vec))
    return SurvivalVectorEnv(asked, num_worlds, **world_options(locals()))
