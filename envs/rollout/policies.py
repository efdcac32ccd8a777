"""Policies that need no training. A policy is a function (observations) -> actions for a whole batch of worlds.

One with a memory also has a method `reset`, see memory.told.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from outlast.ecs import Clock, columns_of

from ..core.described import Actions, Arrays
from ..core.vector_env import SurvivalVectorEnv

Policy = Callable[[Arrays], Actions]

REACH = 2.0  # metres: strike when an enemy ahead is this close or closer
WOUNDED = 70  # hit points at or below which a heal is used
GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # SplitMix64's step: 2**64 over the golden ratio


def random_policy(env: SurvivalVectorEnv, seed: int = 0) -> Policy:
    """Every action uniform and independent: one draw among all joint actions (216 in the paper).

    Each agent draws from a SplitMix64 generator of its own (Steele, Lea and Flood, OOPSLA 2014).

    Args:
        env: The environment that the policy is to play in.
        seed: Actions are a function of (seed, world, agent, number of the step), so a world's are the same in every
            batch.

    Returns:
        A policy; the observations do not matter to it.
    """
    draw = joint_action_sampler(env.action_sizes)
    (key,) = np.random.SeedSequence([seed, 1]).generate_state(1, np.uint64)
    worlds = np.arange(env.num_worlds, dtype=np.uint64)[:, None] + np.uint64(env.first_world)
    state = mix64(mix64(key + worlds) + np.arange(env.num_agents, dtype=np.uint64))

    def act(observations: Arrays) -> Actions:
        np.add(state, GOLDEN, out=state)
        return draw(mix64(state))

    return act


def noop_policy(env: SurvivalVectorEnv, seed: int = 0) -> Policy:
    """Do nothing: motors idle, nothing attacked, used or given.

    Args:
        env: The environment that the policy is to play in.
        seed: Without effect; all policies are made with one.

    Returns:
        A policy; the observations do not matter to it.
    """
    actions = np.broadcast_to(env.noop.astype(np.int8), (env.num_worlds, env.num_agents, len(env.noop)))
    return lambda observations: actions


def scripted_policy(env: SurvivalVectorEnv, seed: int = 0) -> Policy:
    """Stay in the zone, fetch heals in sight, use them when wounded, strike enemies in reach; look around meanwhile.

    Args:
        env: The environment that the policy is to play in.
        seed: Without effect; the policy is a function of the observations.

    Returns:
        A policy.
    """
    levels = {key: -low for key, low in env.action_columns}  # each way

    def act(observations: Arrays) -> Actions:
        def see(key: str, *names: str) -> Any:
            return observations[key][..., columns_of(env.fields[key], *names)]

        health, position, angle = see("own", "health"), see("own", "x", "y"), see("own", "angle")
        velocity, omega = see("own", "vx", "vy"), see("own", "omega")
        goal, urgent = np.zeros_like(position), np.zeros(health.shape, bool)
        if "zone" in observations:  # towards the next circle; at once if outside of the present one
            goal = see("zone", "next_x", "next_y")
            urgent = _length(position - see("zone", "x", "y")) > 0.9 * see("zone", "radius")
        if "heals" in observations:
            heal, found = _nearest(position, see("heals", "x", "y"), observations["heals_mask"])
            goal = np.where((found & ~urgent)[..., None], heal, goal)
        visible = observations["others_mask"]
        if "team" in env.fields["own"]:
            visible = visible * (see("others", "team") != see("own", "team")[..., None])
        enemy, met = _nearest(position, see("others", "x", "y"), visible)
        close = met & (_length(enemy - position) < 2 * REACH) & ~urgent
        goal = np.where(close[..., None], enemy, goal)
        ahead, left = _rotate(2 * (goal - position) - velocity, -angle)  # slow down in time
        bearing = _rotate(enemy - position, -angle)
        error = np.where(met, np.arctan2(bearing[1], bearing[0]), 1.0)  # no enemy in sight: keep turning
        use = (health <= WOUNDED) & (observations["heal_slot_mask"][..., 0] > 0) if "heal_slot" in observations else 0
        choice = {
            "ahead": _level(ahead / 0.6, levels.get("ahead", 0)),
            "left": _level(left / 0.6, levels.get("left", 0)),
            "turn": _level((4 * error - 3 * omega) / 0.4, levels.get("turn", 0)),
            "attack": met & (_length(enemy - position) < REACH + 0.5),
            "use": use,
        }
        zeros = np.zeros(health.shape, np.int8)
        return np.stack([np.asarray(choice.get(key, 0), np.int8) + zeros for key in levels], axis=-1)

    return act


POLICIES: dict[str, Callable[[SurvivalVectorEnv, int], Policy]] = {
    "random": random_policy,
    "noop": noop_policy,
    "scripted": scripted_policy,
}


def others_policy(name: str, env: SurvivalVectorEnv, agents: Any) -> Policy:
    """One of POLICIES for some agents only, whose observations it gets.

    Args:
        name: Of the policy. "random" is a function of (seed, world, episode, tick, agent), whenever it is called.
        env: The environment that the policy is to play in.
        agents: The indices of the agents, integers (agents,).
    """
    if name == "random":
        draw, clock, ids = joint_action_sampler(env.action_sizes), env.worlds[Clock], np.asarray(agents, np.uint64)
        return lambda observations: draw(hashed(clock.seed, clock.world, clock.episode, clock.tick, ids[None]))
    policy = POLICIES[name](env, 0)
    return policy if name != "noop" else lambda observations: policy(observations)[:, : len(agents)]


def joint_action_sampler(sizes: Any) -> Callable[[Any], Actions]:
    """A function from uniform uint64 numbers to joint actions, int8 (..., actions), all of them equally likely."""
    joint = np.indices(sizes).reshape(len(sizes), -1).T.astype(np.int8)
    count, half = np.uint64(len(joint)), np.uint64(32)

    def sample(numbers: Any) -> Actions:
        actions: Actions = joint[(numbers >> half) * count >> half]
        return actions

    return sample


def mix64(words: Any) -> Any:
    """The mixing function of SplitMix64, on uint64: every bit of the result depends on all bits."""
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))


def hashed(*parts: Any) -> Any:
    """A uniform uint64 for each combination of the parts, uint64 arrays that broadcast."""
    word = np.zeros(1, np.uint64)
    for part in parts:
        word = mix64((word ^ part) + GOLDEN)
    return word


def _length(vectors: Any) -> Any:
    return np.hypot(vectors[..., 0], vectors[..., 1])


def _level(values: Any, idle: int) -> Any:
    """The action for a motor at the nearest whole level, of which there are `idle` each way."""
    return idle + np.clip(np.rint(values), -idle, idle).astype(np.int8)


def _rotate(vectors: Any, angle: Any) -> tuple[Any, Any]:
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * vectors[..., 0] - sine * vectors[..., 1], sine * vectors[..., 0] + cosine * vectors[..., 1]


def _nearest(position: Any, points: Any, mask: Any) -> tuple[Any, Any]:
    """The nearest of the visible points to each agent, and whether there is one."""
    if points.shape[-2] == 0:
        return np.zeros_like(position), np.zeros(position.shape[:-1], bool)
    distance = np.where(mask > 0, _length(points - position[..., None, :]), np.inf)
    index = distance.argmin(-1)
    return np.take_along_axis(points, index[..., None, None], -2)[..., 0, :], np.isfinite(distance.min(-1))
