"""Making environments from a scenario or its name."""

from collections.abc import Collection

from gymnasium.vector import AutoresetMode

from ..scenarios.naming import resolve
from ..scenarios.scenario import Number, Scenario
from .validation import renamed
from .vector_env import SurvivalVectorEnv


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
    **numbers: Number,
) -> SurvivalVectorEnv:
    """Make `num_worlds` worlds of a variant or scenario that are stepped together.

    >>> env = outlast.make_vec("teams_3", 4096, seed=0, threads=2, copy=False, melee_damage=20)

    Args:
        scenario: A Scenario, or the name of one: "ffa_3", "teams_2+health_cap", "mygame.py:arena", "arena.json".
        num_worlds: How many worlds.
        seed: Keys the random numbers of world i by (seed, first_world + i); None: by a seed from the system.
        threads: Threads that share the worlds in a step.
        autoreset_mode: When a world that ended begins its next episode; see gymnasium.vector.AutoresetMode.
        copy: Whether observations are arrays of the caller's own. False is faster: they are read-only views that the
            next call overwrites.
        check_actions: Whether the range of actions is checked. Without that, actions out of range have no particular
            meaning, but do no harm.
        first_world: Number of the first world: world i of a batch is world i of any other batch of the same seed.
        render_mode: "rgb_array", "ansi" or None.
        actions: "multi", an integer for each action; "joint", one for all of an agent's: 0 to 215 in the paper; or
            "continuous", a float from -1 to 1 for each, whose range has an equal part for each value.
        observations: "dict", arrays by key, or "flat", one array with all keys one behind the other.
        scaled: Whether observations, and `state`, are divided by the scales of their fields to about -1 to 1, with
            angles wrapped; what has no bounds is clipped to -10 to 10.
        action_masks: Whether info has "action_mask", int8: what `action_masks` returns.
        specialize: Whether to compile for this scenario alone: steps take 15 to 25 % less time, and a scenario whose
            mechanics or sizes are new some ten seconds, once. Otherwise scenarios share what is compiled.
        interpret: Labels of systems ("melee.aim") to run as Python, for breakpoints and print; slow.
        **numbers: Numbers of the scenario to change, as `Scenario.replace` takes them.

    Raises:
        ScenarioError: No such variant, or a scenario without rewards or ends.
        NumberError: No such number, which is a KeywordError, or one that is out of its range.
        ScheduleError: The order of the scenario's systems is ambiguous, or `interpret` names none of them.
        ValueError: An option that is out of its range.
    """
    autoreset_mode = renamed(numbers, "autoreset", "autoreset_mode", autoreset_mode)
    return SurvivalVectorEnv(
        resolve(scenario, numbers, OPTIONS),
        num_worlds,
        seed=seed,
        threads=threads,
        autoreset_mode=autoreset_mode,
        copy=copy,
        check_actions=check_actions,
        first_world=first_world,
        render_mode=render_mode,
        actions=actions,
        observations=observations,
        scaled=scaled,
        action_masks=action_masks,
        specialize=specialize,
        interpret=interpret,
    )


OPTIONS = tuple(make_vec.__kwdefaults__ or ())  # its keywords
