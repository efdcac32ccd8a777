"""Policies that need no training. A policy is a function (observations) -> actions for a whole batch of worlds."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..core.vector_env import Actions, Arrays, SurvivalVectorEnv

Policy = Callable[[Arrays], Actions]

REACH = 2.0  # metres: strike when an enemy ahead is this near or nearer
WOUNDED = 70  # hit points at or below which a heal is used
GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # SplitMix64's step: 2**64 over the golden ratio


def random_policy(env: SurvivalVectorEnv, seed: int = 0) -> Policy:
    """Every action uniform and independent: one draw among all joint actions (216 in the paper).

    It is a function of (seed, world, agent, number of the step): a world's actions are the same in every batch. Each
    agent draws from a SplitMix64 generator of its own (Steele, Lea and Flood, OOPSLA 2014).
    """
    draw = joint_actions(env.action_sizes)
    (key,) = np.random.SeedSequence([seed, 1]).generate_state(1, np.uint64)
    worlds = np.arange(env.num_worlds, dtype=np.uint64)[:, None] + np.uint64(env.first_world)
    state = mixed(mixed(key + worlds) + np.arange(env.num_agents, dtype=np.uint64))

    def act(observations: Arrays) -> Actions:
        np.add(state, GOLDEN, out=state)
        return draw(mixed(state))

    return act


def noop_policy(env: SurvivalVectorEnv, seed: int = 0) -> Policy:
    """Do nothing: motors idle, nothing attacked, used or given."""
    actions = np.broadcast_to(env.noop.astype(np.int8), (env.num_worlds, env.num_agents, len(env.noop)))
    return lambda observations: actions


def scripted_policy(env: SurvivalVectorEnv, seed: int = 0) -> Policy:
    """Stay in the zone, fetch heals in sight, use them when wounded, strike enemies in reach; look around meanwhile."""
    levels = {key: -low for key, low in env.action_columns}  # each way
    teams = env.worlds.dims["features"] - 8  # 1 if rows hold a team

    def act(observations: Arrays) -> Actions:
        me, zone = observations["self"], observations.get("zone")
        health, place, angle = me[..., teams + 1], me[..., teams + 2 : teams + 4], me[..., teams + 4]
        speed, omega = me[..., teams + 5 : teams + 7], me[..., teams + 7]
        goal, urgent = np.zeros_like(place), np.zeros(health.shape, bool)
        if zone is not None:  # towards the next circle; at once if outside of the present one
            goal, urgent = zone[..., 3:5], _length(place - zone[..., :2]) > 0.9 * zone[..., 2]
        if "heals" in observations:
            heal, found = _nearest(place, observations["heals"], observations["heals_mask"])
            goal = np.where((found & ~urgent)[..., None], heal, goal)
        others, seen = observations["others"], observations["others_mask"]
        if teams:
            seen = seen * (others[..., 1] != me[..., None, 1])
        enemy, met = _nearest(place, others[..., teams + 2 : teams + 4], seen)
        near = met & (_length(enemy - place) < 2 * REACH) & ~urgent
        goal = np.where(near[..., None], enemy, goal)
        wish = 2 * (goal - place) - speed  # slow down in time
        ahead, left = _turned(wish, -angle)
        view = _turned(enemy - place, -angle)
        error = np.where(met, np.arctan2(view[1], view[0]), 1.0)  # nobody in sight: keep turning
        choice = {
            "ahead": _level(ahead / 0.6, levels.get("ahead", 0)),
            "left": _level(left / 0.6, levels.get("left", 0)),
            "turn": _level((4 * error - 3 * omega) / 0.4, levels.get("turn", 0)),
            "attack": met & (_length(enemy - place) < REACH + 0.5),
            "use": (health <= WOUNDED) & (observations["heal_slot_mask"][..., 0] > 0)
            if "heal_slot" in observations
            else 0,
        }
        zeros = np.zeros(health.shape, np.int8)
        return np.stack([np.asarray(choice.get(key, 0), np.int8) + zeros for key in levels], axis=-1)

    return act


POLICIES: dict[str, Callable[[SurvivalVectorEnv, int], Policy]] = {
    "random": random_policy,
    "noop": noop_policy,
    "scripted": scripted_policy,
}


def joint_actions(sizes: Any) -> Callable[[Any], Actions]:
    """A function from uniform uint64 words to joint actions, int8 (..., actions), all of them equally likely."""
    joint = np.indices(sizes).reshape(len(sizes), -1).T.astype(np.int8)
    count, half = np.uint64(len(joint)), np.uint64(32)

    def drawn(words: Any) -> Actions:
        actions: Actions = joint[(words >> half) * count >> half]
        return actions

    return drawn


def mixed(words: Any) -> Any:
    """SplitMix64's mixing of uint64: every bit of the result depends on all bits."""
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))


def _length(vectors: Any) -> Any:
    return np.hypot(vectors[..., 0], vectors[..., 1])


def _level(values: Any, most: int) -> Any:
    """The action for a wish that is a whole number of levels, or nearly: `most` is to do nothing."""
    return most + np.clip(np.rint(values), -most, most).astype(np.int8)


def _turned(vectors: Any, angle: Any) -> tuple[Any, Any]:
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * vectors[..., 0] - sine * vectors[..., 1], sine * vectors[..., 0] + cosine * vectors[..., 1]


def _nearest(place: Any, points: Any, mask: Any) -> tuple[Any, Any]:
    """The nearest of the seen points to each agent, and whether there is one."""
    if points.shape[-2] == 0:
        return np.zeros_like(place), np.zeros(place.shape[:-1], bool)
    distance = np.where(mask > 0, _length(points - place[..., None, :]), np.inf)
    index = distance.argmin(-1)
    return np.take_along_axis(points, index[..., None, None], -2)[..., 0, :], np.isfinite(distance.min(-1))
