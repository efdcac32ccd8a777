"""Policies that need no training. A policy is a function (observations) -> actions for a batch of worlds.

A policy with a memory also has a method `reset`; see memory.told. A style is a function from Seen to Intent, for all
agents of all worlds at once; `follow` turns it into a policy. It finds numbers by the names of their fields, so it can
play any game with such fields, and copes if some are missing.
"""

import inspect
import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from outlast.ecs import Clock, Fields, columns_of
from outlast.ecs.declarations.fields import width

from ..core.action_spaces import MOST
from ..core.validation import checked_actions
from ..core.vector_env import Actions, Arrays, SurvivalVectorEnv
from ..errors import UsageError
from ..scenarios.scenario import STYLES as NAMES

Policy = Callable[[Arrays], Actions]
Maker = Callable[[SurvivalVectorEnv, int], Policy]
GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # the increment of SplitMix64: 2**64 over the golden ratio
REACH = 2.0  # metres: reach of a strike, and of giving
STRIKE = REACH + 0.5  # metres: agents strike if an enemy's centre is closer, as a strike has only to meet its rim
SCRATCHED, WOUNDED, WEAK = 90, 70, 30  # with at most this many hit points
LOOK, SWEEP = 1.0, 2.0  # radians: who sees no target turns as if it were so far to the left, and so looks around
HOME, FETCH = 3.0, 10.0  # metres from its post up to which a camper fetches heals, and boxes
COVER = 2.0  # metres from its post within which a camper leaves boxes where they stand
AIMED = 0.3  # radians from straight ahead: a box that is set up now will be between the agent and the enemy
WARY = 5.0  # metres: closer enemies are a threat
BESIDE = 2.0  # metres: a healer stays closer than this to a team-mate
LEAD = 0.5  # seconds: who follows another agent goes to where it will be after this time
AT_FEET = 0.4  # metres, less than the reach of picking up: an item that still lies there does not fit into the bag
# in radii of the zone: agents beyond RIM hurry to the next zone; to wait for it, they go up to INSIDE
RIM, INSIDE = 0.9, 0.7
PATROL, NARROW = 0.6, 3.0  # a hunter circles at this share of the zone's radius, but at least at this many metres
STEP = np.float32(0.6)  # radians: it heads for a point of the circle so far ahead
FEW = 3  # levels of a motor each way; if it has more, a value of 1 means the highest one, see `level`
GAIN = 8.0  # per second: agents with Steering go to their goal, and turn to it, at this times the way that is left
SMALLEST = np.float32(1e-6)  # metres: keeps distances from 0 where they divide


class Target(NamedTuple):
    """One thing that each agent sees: its place, float32 (..., 2), metres, and distance, float32 (...); inf if none."""

    place: Any
    distance: Any

    @property
    def seen(self) -> Any:
        """Return which agents see it, bool (...)."""
        return np.isfinite(self.distance)

    def only(self, condition: Any) -> "Target":
        """Return the target where the condition, bool (...), holds, and none elsewhere."""
        return Target(self.place, np.where(condition, self.distance, np.inf))

    def within(self, radius: float) -> "Target":
        """Return the target where it is closer than this distance, metres, and none elsewhere."""
        return self.only(self.distance < radius)

    def place_or(self, place: Any) -> Any:
        """Return its place, or another one, float32 (..., 2), where no target is seen."""
        return np.where(self.seen[..., None], self.place, place)


class Intent(NamedTuple):
    """Intentions of agents."""

    goal: Any  # where to be, float32 (..., 2), metres
    error: Any  # how far to turn to the left, float32 (...), radians
    attack: Any  # whether to strike, bool (...); the same for these actions:
    use: Any = False
    give: Any = False


class Seen:
    """Observations of some agents, as a rule (worlds, agents, ...).

    Attributes:
        health: Hit points, float32 (...); infinite in games without.
        position: float32 (..., 2), metres. velocity: float32 (..., 2), metres a second.
        angle: float32 (...), radians. omega: float32 (...), radians a second.
        centre: Centre of the next zone, float32 (..., 2), metres; without zones the middle of the room.
        outside: Whether the agent is outside the present zone or close to its rim, bool (...).
        enemies: Which of the others are enemies in sight, 1 or 0, (..., others).
    """

    def __init__(self, fields: Fields, observations: Arrays) -> None:
        self.fields, self.observations = fields, observations
        self.health, self.angle, self.omega = self.health_of("own"), self.of("own", "angle"), self.of("own", "omega")
        self.position, self.velocity = self.of("own", "x", "y"), self.of("own", "vx", "vy")
        self.centre, self.outside = np.zeros_like(self.position), np.zeros(self.health.shape, bool)
        if "zone" in observations:
            self.centre = self.of("zone", "next_x", "next_y")
            self.outside = length(self.position - self.of("zone", "x", "y")) > RIM * self.of("zone", "radius")
        self.enemies, self.has_teams = observations["others_mask"], "team" in fields["own"]
        if self.has_teams:
            self.enemies = self.enemies * (self.of("others", "team") != self.of("own", "team")[..., None])

    @property
    def mates(self) -> Any:
        """Return which of the others are team-mates in sight, 1 or 0, (..., others)."""
        return self.observations["others_mask"] - self.enemies

    def health_of(self, key: str) -> Any:
        """Return the hit points in the rows of that key; infinitely many in games without."""
        has = "health" in self.fields[key]
        return self.of(key, "health") if has else np.full_like(self.of(key, "angle"), np.inf)

    def of(self, key: str, *names: str) -> Any:
        """Return the fields of these names in the rows of that key."""
        return self.observations[key][..., columns_of(self.fields[key], *names)]

    def nearest(self, key: str, mask: Any = None, origin: Any = None, beyond: float = 0.0, lead: float = 0.0) -> Target:
        """Return the nearest entity of a kind.

        Args:
            key: Key of the observation; if the game lacks it, nothing is seen.
            mask: Above 0 for entities that count, (..., entities); None: all in sight.
            origin: Where distances are measured from, metres, (..., 2); None: from each agent.
            beyond: Entities closer than this, in metres, do not count.
            lead: Aim at where entities will be after this many seconds if they keep their velocity.
        """
        if key not in self.observations or self.observations[key].shape[-2] == 0:
            return Target(np.zeros_like(self.position), np.full(self.health.shape, np.inf, np.float32))
        points, origin = self.of(key, "x", "y"), self.position if origin is None else origin
        if lead:
            points = points + lead * self.of(key, "vx", "vy")
        counts = (self.observations[f"{key}_mask"] if mask is None else mask) > 0
        distance = np.hypot(points[..., 0] - origin[..., None, 0], points[..., 1] - origin[..., None, 1])
        if beyond:
            counts &= distance > beyond
        distance = np.where(counts, distance, np.inf)
        index = distance.argmin(-1)[..., None]
        place = np.take_along_axis(points, index[..., None], -2)[..., 0, :]
        return Target(place, np.take_along_axis(distance, index, -1)[..., 0])

    def holds(self, *keys: str) -> Any:
        """Return whether the last slot of the agent's bag holds that item, "heal_slot" or "box_slot", bool (...)."""
        held = [self.observations[f"{key}_mask"][..., 0] > 0 for key in keys if key in self.observations]
        return np.logical_or.reduce(held) if held else np.False_

    def towards(self, target: Target, otherwise: float) -> Any:
        """Return how far to the left the target is, float32 (...), radians; `otherwise` where none is seen."""
        bearing = rotated(target.place - self.position, -self.angle)
        return np.where(target.seen, np.arctan2(bearing[1], bearing[0]), otherwise)

    def post(self) -> Any:
        """Return where to wait for the next zone: in the present one, close to the next, float32 (..., 2), metres."""
        if "zone" not in self.observations:
            return self.centre
        middle = self.of("zone", "x", "y")
        offset, radius = self.centre - middle, INSIDE * self.of("zone", "radius")
        return middle + offset * np.minimum(1, radius / np.maximum(length(offset), SMALLEST))[..., None]

    def patrol(self) -> Any:
        """Return the next place to the left on a circle around the next zone's centre, float32 (..., 2), metres."""
        place = self.fields["own"]["x"]
        radius = self.of("zone", "next_radius")[..., None] if "zone" in self.observations else np.float32(place.scale)
        offset = unit(self.position - self.centre + SMALLEST)  # SMALLEST gives a direction even at the centre itself
        ahead = np.stack(rotated(offset, STEP), -1)
        return self.centre + np.maximum(PATROL * radius, NARROW) * ahead


def follow(style: Callable[[Seen], Intent], env: SurvivalVectorEnv) -> Callable[[Arrays], Actions]:
    """Turn the style into a policy for an environment: a function from observations to actions."""
    # the value of no action; it is also the number of levels each way
    idle = {key: -low for key, low in env.action_columns}
    most = {name: max(value, SMALLEST) for name, value in env.worlds.layout.numbers("steering").items()}
    widths = {key: width(fields) for key, fields in env.worlds.layout.fields.items()}

    def act(observations: Arrays) -> Actions:
        if any(rows.shape[-1] != widths.get(key, rows.shape[-1]) for key, rows in observations.items()):
            raise UsageError(
                f"these observations are of another game than {env.scenario.name}, for which this policy was made: "
                "make one for its environment"
            )
        seen = Seen(env.fields, observations)
        plan = style(seen)
        if not most:  # less the velocity, to slow down in time
            ahead, left = rotated(2 * (plan.goal - seen.position) - seen.velocity, -seen.angle)
            motion = ahead / 0.6, left / 0.6, (4 * plan.error - 3 * seen.omega) / 0.4
        else:
            ahead, left = rotated(GAIN * (plan.goal - seen.position), -seen.angle)
            motion = ahead / most["speed"], left / most["speed"], GAIN * plan.error / most["spin"]
        choice = {
            key: level(value, idle.get(key, 0), shares=bool(most))
            for key, value in zip(("ahead", "left", "turn"), motion, strict=True)
        }
        choice |= {"attack": plan.attack, "use": plan.use, "give": plan.give}
        zeros = np.zeros(seen.health.shape, np.int16)
        return np.stack([zeros + choice.get(key, nothing) for key, nothing in idle.items()], axis=-1)

    return act


def scripted(seen: Seen) -> Intent:
    """Stay in the zone, fetch heals, use them when wounded, and strike enemies in reach.

    Agents go to the next zone, and on the way there to enemies that are close and to heals in sight. Until they see an
    enemy, they look around.
    """
    enemy, heal = seen.nearest("others", seen.enemies), seen.nearest("heals")
    goal = first(enemy.within(2 * REACH), heal).only(~seen.outside).place_or(seen.centre)
    use = (seen.health <= WOUNDED) & seen.holds("heal_slot")
    return Intent(goal, seen.towards(enemy, LOOK), enemy.distance < STRIKE, use)


def camper(seen: Seen) -> Intent:
    """Wait where the next zone will be, do not chase, and strike enemies in reach.

    Agents look around from their post, and turn towards an enemy in sight. They fetch heals around their post, and use
    them when wounded. They break boxes nearby, pick them up, and set them up between themselves and an enemy that comes
    close.
    """
    post, armed = seen.post(), seen.holds("box_slot")
    enemy, heal = seen.nearest("others", seen.enemies), seen.nearest("heals", origin=post).within(HOME)
    idle = ~(armed | enemy.seen | seen.outside)
    item = seen.nearest("box_items", origin=post).within(FETCH).only(idle)
    box = seen.nearest("boxes", origin=post, beyond=COVER).within(FETCH).only(idle & ~item.seen)
    error = seen.towards(first(enemy, item, box), SWEEP)
    shut = armed & (enemy.distance < WARY) & (np.abs(error) < AIMED)
    use = shut | ((seen.health <= WOUNDED) & seen.holds("heal_slot"))
    return Intent(first(heal, item, box).place_or(post), error, (enemy.distance < STRIKE) | box.seen, use)


def hunter(seen: Seen) -> Intent:
    """Chase the nearest enemy in sight, wherever the zone is, and circle in search of one.

    With few hit points left, agents fetch heals in sight, use what they have, and keep to the zone.
    """
    weak = seen.health <= WEAK
    enemy, heal = seen.nearest("others", seen.enemies), seen.nearest("heals").only(weak)
    goal = first(heal, seen.nearest("others", seen.enemies, lead=LEAD)).place_or(seen.patrol())
    goal = np.where((weak & seen.outside)[..., None], seen.centre, goal)
    use = weak & seen.holds("heal_slot", "box_slot")
    return Intent(goal, seen.towards(enemy, SWEEP), enemy.distance < STRIKE, use)


def hoarder(seen: Seen) -> Intent:
    """Fetch all heals and box items in sight, and keep away from enemies.

    Agents use an item when they are nearly dead, or when they stand at another one that does not fit into their bag,
    and strike an enemy that corners them.
    """
    enemy, item = seen.nearest("others", seen.enemies), closer(seen.nearest("heals"), seen.nearest("box_items"))
    threat, post = enemy.within(WARY), seen.post()
    away = seen.position + 2 * unit(seen.position - enemy.place) + unit(post - seen.position)
    goal = first(threat._replace(place=away), item).only(~seen.outside).place_or(post)
    use = ((seen.health <= WEAK) | (item.distance < AT_FEET)) & seen.holds("heal_slot", "box_slot")
    return Intent(goal, seen.towards(first(threat, item, enemy), SWEEP), enemy.distance < STRIKE, use)


def healer(seen: Seen) -> Intent:
    """Stay with team-mates, give heals to those worse off, and strike enemies in reach.

    Agents fetch heals on the way, and use one themselves when nearly dead; without teams, as soon as they are wounded.
    """
    enemy, mate = seen.nearest("others", seen.enemies), seen.nearest("others", seen.mates, lead=LEAD)
    hurt, health = seen.health_of("others"), seen.health[..., None]
    worse = seen.mates * (hurt <= SCRATCHED) * (hurt < health)
    patient = seen.nearest("others", worse).only(seen.holds("heal_slot"))
    strayed, heal = mate.only(mate.distance > BESIDE), seen.nearest("heals")
    goal = first(patient, enemy.within(STRIKE), strayed, heal).only(~seen.outside).place_or(seen.centre)
    error = seen.towards(first(enemy.within(2 * REACH), patient, mate, enemy), SWEEP)
    use = (seen.health <= (WEAK if seen.has_teams else SCRATCHED)) & seen.holds("heal_slot") & ~patient.seen
    return Intent(goal, error, enemy.distance < STRIKE, use, patient.distance < REACH)


def first(*targets: Target) -> Target:
    """Return for each agent the first of the targets that it sees."""
    chosen = targets[-1]
    for target in reversed(targets[:-1]):
        distance = np.where(target.seen, target.distance, chosen.distance)
        chosen = Target(target.place_or(chosen.place), distance)
    return chosen


def closer(one: Target, other: Target) -> Target:
    """Return for each agent the closer of the targets."""
    return first(one.only(one.distance <= other.distance), other)


def length(vectors: Any) -> Any:
    """Return the lengths of vectors (..., 2)."""
    return np.hypot(vectors[..., 0], vectors[..., 1])


def unit(vectors: Any) -> Any:
    """Return the vectors (..., 2) scaled to length 1; 0 stays 0."""
    return vectors / np.maximum(length(vectors), SMALLEST)[..., None]


def rotated(vectors: Any, angle: Any) -> tuple[Any, Any]:
    """Return components x and y of vectors (..., 2), rotated to the left by an angle (...), radians."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * vectors[..., 0] - sine * vectors[..., 1], sine * vectors[..., 0] + cosine * vectors[..., 1]


def level(values: Any, idle: int, shares: bool) -> Any:
    """Return the action for a motor with `idle` levels in each direction, at the level that is nearest to the values.

    These are shares of the highest level; without `shares` they count levels, unless there are more than FEW.
    """
    each = idle if shares or idle > FEW else 1
    return idle + np.clip(np.rint(values * each), -idle, idle).astype(np.int16)


STYLES = dict(zip(NAMES, (scripted, camper, hunter, hoarder, healer), strict=True))


def maker_of(given: Any, name: str) -> Maker:
    """Return a function (env, seed) that makes a user's policy: `given`, or what it returns, if it is of an env.

    given: A policy (observations) -> actions, or a function (env) or (env, seed), whose first parameter is called env,
    that returns one. name: What errors call it.
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
    """Return the environment. Raises UsageError if policies cannot use its observations or actions."""
    reader, actions = made_by_make_vec(env)._reader, env._actions
    forms = ("observations", reader.kind, "dict"), ("scaled", reader.scaled, False), ("actions", actions.kind, "multi")
    for name, here, needed in forms:
        if here != needed:
            raise UsageError(
                f"the environment has {name}={here!r}, and this policy needs {name}={needed!r}: make another one for it"
            )
    return env


def random_policy(env: SurvivalVectorEnv, seed: int = 0) -> Policy:
    """Make a policy whose actions are uniform and independent: a draw among all joint actions (216 in the paper).

    Each agent draws from a SplitMix64 generator of its own (Steele, Lea and Flood, OOPSLA 2014).

    seed: Actions are a function of (seed, world, agent, number of the step), so those of a world are the same in every
    batch. They do not depend on observations.
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
    """Make a policy that does nothing: it does not move, attack, use or give. seed: Without effect."""
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

A scenario with a policy "{name}" of its own has that in its place, see Scenario.with_policies. seed: Without effect, as
the policy is a function of the observations.
"""
    return make


_OF_STYLES = {name: _of_style(name) for name in STYLES}
scripted_policy, camper_policy, hunter_policy, hoarder_policy, healer_policy = _OF_STYLES.values()
POLICIES: dict[str, Maker] = {"random": random_policy, "noop": noop_policy, **_OF_STYLES}


def others_policy(name: str, env: SurvivalVectorEnv, agents: Any) -> Policy:
    """Make one of POLICIES for agents with these indices only. It gets their observations by key, unscaled."""
    if name == "random":  # a function of (seed, world, episode, tick, agent), whenever it is called
        draw, clock, ids = joint_action_sampler(env.action_sizes), env.worlds[Clock], np.asarray(agents, np.uint64)
        return lambda observations: draw(hashed(clock.seed, clock.world, clock.episode, clock.tick, ids[None]))
    if name == "noop":
        nothing = np.broadcast_to(env._actions.zeros, (env.num_worlds, len(agents), len(env.action_sizes)))
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

    return lambda numbers: joint[(numbers >> half) * count >> half]


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
