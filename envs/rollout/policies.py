"""Policies that need no training. A policy is a function (observations) -> actions for a batch of worlds.

A policy with a memory also has a method `reset`; see memory.told.
"""

import inspect
import math
from collections.abc import Callable
from typing import Any, Protocol, cast

import numpy as np

from outlast.ecs import Clock

from ..core.action_spaces import MOST
from ..core.validation import checked_actions
from ..core.vector_env import Actions, Arrays, SurvivalVectorEnv
from ..errors import UsageError
from ..scenarios.scenario import STYLES as NAMES
from .styles import camper, follow, healer, hoarder, hunter, scripted

Policy = Callable[[Arrays], Actions]

GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # the increment of SplitMix64: 2**64 over the golden ratio


STYLES = dict(zip(NAMES, (scripted, camper, hunter, hoarder, healer), strict=True))


def maker_of(given: Any, name: str) -> Callable[[SurvivalVectorEnv, int], Policy]:
    """Return a function (env, seed) that makes a user's policy: `given`, or what it returns, if it is of an env.

    Args:
        given: A policy (observations) -> actions, or a function (env) or (env, seed), whose first parameter is called
            env, that returns one.
        name: What errors call it.

    Raises:
        UsageError: It is not a function; or later, it returned another type.
    """
    if not callable(given):
        raise UsageError(f"{name} is {given!r:.60}: a policy, or a function (env, seed) that returns one, is needed")
    parameters = [*inspect.signature(given).parameters]

    def make(env: SurvivalVectorEnv, seed: int) -> Policy:
        policy = given(*(env, seed)[: len(parameters)]) if parameters[:1] == ["env"] else given
        if not callable(policy):
            raise UsageError(f"{name} returned {policy!r:.60}: a function (observations) -> actions is needed")
        return cast(Policy, policy)

    return make


def style_policy(style: str, env: SurvivalVectorEnv) -> Policy:
    """Make the policy of that name: the scenario's own, see Scenario.with_policies, or else that of the style."""
    own = dict(env.scenario.policies).get(style)
    if own is None:
        return follow(STYLES[style], env)
    name, axes = f"'{style}' of {env.scenario.name}", {key: rows.ndim - 2 for key, rows in env._reader.views.items()}
    policy = maker_of(own, name)(env, 0)
    if callable(getattr(policy, "reset", None)):
        raise UsageError(f"{name} has a memory (a method reset): a scenario's own policies have none")

    def act(observations: Arrays) -> Actions:
        key, rows = next(iter(observations.items()))
        shape = (*rows.shape[: rows.ndim - axes[key]], len(env.action_sizes))
        actions = policy({key: values.copy() for key, values in observations.items()})  # which it may keep
        what, who, sizes = f"the actions of {name}", f"an agent that plays '{style}'", env.action_sizes
        return checked_actions(actions, shape, sizes, what=what, axes="(..., actions)", who=who)

    return act


def made_by_make_vec(env: SurvivalVectorEnv) -> SurvivalVectorEnv:
    """Return the environment. Raises UsageError if it is something else."""
    if not isinstance(env, SurvivalVectorEnv):
        raise UsageError(
            f"a policy is made for what make_vec returns, as in scripted_policy(env), not for {type(env).__name__}: "
            "give env.unwrapped of a gymnasium wrapper, or env.base_env of an adapter"
        )
    return env


def plain(env: SurvivalVectorEnv) -> SurvivalVectorEnv:
    """Return the environment, if policies can use its observations and actions.

    Raises:
        UsageError: Its observations are flat or scaled, its actions are not "multi", or it is not an environment.
    """
    env = made_by_make_vec(env)
    forms = {"observations": (env._reader.kind, "dict"), "scaled": (env._reader.scaled, False)}
    forms["actions"] = env._actions.kind, "multi"
    for name, (here, needed) in forms.items():
        if here != needed:
            raise UsageError(
                f"the environment has {name}={here!r}, and this policy needs {name}={needed!r}: make another one for it"
            )
    return env


def random_policy(env: SurvivalVectorEnv, seed: int = 0) -> Policy:
    """Make a policy whose actions are uniform and independent: a draw among all joint actions (216 in the paper).

    Each agent draws from a SplitMix64 generator of its own (Steele, Lea and Flood, OOPSLA 2014).

    Args:
        env: The environment that the policy is to play in.
        seed: Actions are a function of (seed, world, agent, number of the step), so those of a world are the same in
            every batch.

    Returns:
        A policy, which ignores the observations.
    """
    draw = joint_action_sampler(made_by_make_vec(env).action_sizes)
    (key,) = np.random.SeedSequence([seed, 1]).generate_state(1, np.uint64)
    worlds = np.arange(env.num_worlds, dtype=np.uint64)[:, None] + np.uint64(env.first_world)
    state = mix64(mix64(key + worlds) + np.arange(env.num_agents, dtype=np.uint64))

    def act(observations: Arrays) -> Actions:
        np.add(state, GOLDEN, out=state)
        return env._actions.given(draw(mix64(state)))

    return act


def noop_policy(env: SurvivalVectorEnv, seed: int = 0) -> Policy:
    """Make a policy that does nothing: it does not move, attack, use or give.

    Args:
        env: The environment that the policy is to play in.
        seed: Without effect; all policies are made with one.

    Returns:
        A policy, which ignores the observations.
    """
    actions = np.broadcast_to(made_by_make_vec(env).noop, (env.num_worlds, env.num_agents, *env.noop.shape))
    return lambda observations: actions


class PolicyMaker(Protocol):
    """A function that makes policies of a style: see `_of_style`."""

    def __call__(self, env: SurvivalVectorEnv, seed: int = 0) -> Policy:
        """Make a policy for an environment. seed: Without effect."""


def _of_style(name: str) -> PolicyMaker:
    """Return the function that makes the policies of a style, documented by what the style does."""

    def make(env: SurvivalVectorEnv, seed: int = 0) -> Policy:
        return style_policy(name, plain(env))

    make.__name__ = make.__qualname__ = f"{name}_policy"
    make.__doc__ = f"""Make a policy of the style `{name}`: {inspect.cleandoc(STYLES[name].__doc__ or "")}

A scenario with a policy "{name}" of its own has that in its place, see Scenario.with_policies.

Args:
    env: The environment that the policy is to play in.
    seed: Without effect; the policy is a function of the observations.

Returns:
    A policy.
"""
    return make


scripted_policy, camper_policy, hunter_policy, hoarder_policy, healer_policy = map(_of_style, STYLES)

POLICIES: dict[str, Callable[[SurvivalVectorEnv, int], Policy]] = {
    "random": random_policy,
    "noop": noop_policy,
    "scripted": scripted_policy,
    "camper": camper_policy,
    "hunter": hunter_policy,
    "hoarder": hoarder_policy,
    "healer": healer_policy,
}


def others_policy(name: str, env: SurvivalVectorEnv, agents: Any) -> Policy:
    """Make one of POLICIES for some agents only. It gets their observations by key and unscaled, for any form of env.

    Args:
        name: Name of the policy. "random" is a function of (seed, world, episode, tick, agent), whenever it is called.
        env: The environment that the policy is to play in.
        agents: The indices of the agents, integers (agents,).
    """
    if name == "random":
        draw, clock, ids = joint_action_sampler(env.action_sizes), env.worlds[Clock], np.asarray(agents, np.uint64)
        return lambda observations: draw(hashed(clock.seed, clock.world, clock.episode, clock.tick, ids[None]))
    if name == "noop":
        shape = (env.num_worlds, len(agents), len(env.action_sizes))
        nothing = np.broadcast_to(env._actions.zeros, shape)
        return lambda observations: nothing
    return style_policy(name, env)


def joint_action_sampler(sizes: Any) -> Callable[[Any], Actions]:
    """Make a function from uniform uint64 numbers to equally likely joint actions, int16 (..., actions)."""
    half = np.uint64(32)
    if math.prod(int(size) for size in sizes) > MOST:  # a table would be too large, so each action gets bits of its own

        def each(numbers: Any) -> Actions:
            words = mix64(numbers[..., None] + GOLDEN * np.arange(1, len(sizes) + 1, dtype=np.uint64))
            return ((words >> half) * sizes.astype(np.uint64) >> half).astype(np.int16)

        return each
    joint: Any = np.indices(sizes).reshape(len(sizes), -1).T.astype(np.int16)
    count = np.uint64(len(joint))

    def sample(numbers: Any) -> Actions:
        return joint[(numbers >> half) * count >> half]

    return sample


def mix64(words: Any) -> Any:
    """Return the mixing function of SplitMix64, on uint64: every bit of the result depends on all bits."""
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))


def hashed(*parts: Any) -> Any:
    """Return a uniform uint64 for each combination of the parts, which are uint64 arrays that broadcast."""
    word = np.zeros(1, np.uint64)
    for part in parts:
        word = mix64((word ^ part) + GOLDEN)
    return word
