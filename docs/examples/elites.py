"""MAP-Elites: levels in which agents behave in many ways. Run it for a minute: python docs/examples/elites.py 60."""

import sys
import time

import numpy as np

import outlast
from outlast.systems import Behaviour

GAME = (
    outlast.variant("ffa_3")
    .with_(Behaviour())
    .vary(
        cameras_depth=outlast.distributions.uniform(3.0, 14.0),
        cameras_fov=outlast.distributions.uniform(0.4, 3.0),
        melee_damage=outlast.distributions.integers(1, 20),
        motors_ahead=outlast.distributions.log_uniform(0.03, 0.5),
        n_boxes=outlast.distributions.integers(1, 8),
        safe_zone_damage=outlast.distributions.integers(1, 5),
    )
)
# cells each way; metres moved, and share of ticks with an enemy in view, of the last cell
SIZE, FARTHEST, MOST = 10, 160.0, 0.6


def cells_of(found):
    """The cell of the grid that each episode is in, (episodes, 2)."""
    way, view = found["distance_travelled"].mean(1) / FARTHEST, found["enemy_in_view"].mean(1) / MOST
    return np.minimum(SIZE * np.stack([way, view], 1), SIZE - 1).astype(int)


def fill(seconds, worlds=128, seed=0):
    """By cell, the longest episode that was found there, in ticks, and its level."""
    rng, elites = np.random.default_rng(seed), {}
    env = outlast.make_vec(GAME, worlds, seed=seed)
    policy, end = outlast.policies.scripted_policy(env), time.monotonic() + seconds
    while not elites or time.monotonic() < end:
        parents, count = [level for _, level in elites.values()], 2
        if not parents:
            parents, count = [outlast.levels.Level()], len(GAME.varied)
        levels = [parents[k].mutated(GAME, rng, count, rekey=True) for k in rng.integers(len(parents), size=worlds)]
        env.set_levels(levels)
        found = outlast.rollout(env, policy, keep=True).arrays()
        for cell, length, level in zip(map(tuple, cells_of(found)), found["length"], levels):
            if length > elites.get(cell, (0, None))[0]:
                elites[cell] = length, level
    env.close()
    return elites


def text(elites):
    """The grid as text: hundreds of ticks in each cell, the way to the right and the view upwards."""
    rows = [[elites.get((x, y), (None, None))[0] for x in range(SIZE)] for y in reversed(range(SIZE))]
    return "\n".join(" ".join("  ." if ticks is None else f"{ticks / 100:3.0f}" for ticks in row) for row in rows)


if __name__ == "__main__":
    found = fill(float(sys.argv[1]) if len(sys.argv) > 1 else 60)
    print(text(found))
    print(f"{len(found)} of {SIZE**2} cells are filled")
