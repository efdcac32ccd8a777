"""Under uniformly random actions the episodes of the eight variants are those of the original (rules, section 9)."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

import outlast
from outlast.components import Body
from outlast.ecs import Entity
from tests.conftest import COMPILED, draw_actions, few_by_day

EPISODES = 1024
ERRORS = 4  # combined standard errors
GLIMPSE = 100  # steps over which what is visible was counted
TABLE = list(csv.DictReader((Path(__file__).parents[1] / "data" / "random_statistics.csv").read_text().splitlines()))
VARIANTS = list(dict.fromkeys(row["variant"] for row in TABLE))

Samples = dict[str, np.ndarray]


def play(variant: str) -> Samples:
    """The first episode of each world, under the names of the table: one value an episode."""
    env, rng = outlast.make_vec(variant, EPISODES, seed=1), np.random.default_rng(1)
    observation, _ = env.reset()
    seen = {key: np.zeros(EPISODES) for key in ("others", "heals", "boxes") if f"{key}_mask" in observation}
    speed, lived, watched = np.zeros(EPISODES), np.zeros(EPISODES), np.zeros(EPISODES)
    statistics: Samples = {}
    body, agents, running, step = env.worlds[Body], slice(0, env.num_agents), np.ones(EPISODES, bool), 0
    while running.any():
        observation, _, terminated, _, info = env.step(draw_actions(env, rng))
        step += 1
        alive = env.worlds[Entity].alive[:, agents] * running[:, None]
        speed += (np.hypot(body.vx[:, agents], body.vy[:, agents]) * alive).sum(1)
        lived += alive.sum(1)
        if step <= GLIMPSE:
            watched += running
            for key, total in seen.items():
                total += observation[f"{key}_mask"].mean((1, 2)) * running
        ended = running & terminated
        for key, values in info.get("statistics", {}).items():
            statistics.setdefault(key, np.zeros(values.shape))[ended] = values[ended]
        running &= ~terminated
    env.close()
    counts = ("first_death", "heals_used", "boxes_placed")
    return {
        "steps": statistics["length"],
        **{key.replace("_", " "): statistics[key] for key in counts if key in statistics},
        **{f"{key} visible": total / watched for key, total in seen.items()},
        "kills": statistics["kills"].sum(1),
        "return 0": statistics["return"][:, 0],
        "return 1": statistics["return"][:, -1],
        "mean speed": speed / lived,
    }


def errors_apart(row: dict[str, str], sample: np.ndarray) -> float:
    """Combined standard errors between the table's mean and ours.

    Where the table has no deviation, or one that is smaller than ours, ours stands for it: of a rare count, a small
    sample that happens to have a small mean has a small deviation too.
    """
    deviation = max(float(row["deviation"] or 0), sample.std())
    error = math.sqrt(deviation**2 / int(row["episodes"]) + sample.var() / len(sample))
    return float(sample.mean() - float(row["mean"])) / error


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="half a million world-steps a variant")
@pytest.mark.parametrize("variant", few_by_day(VARIANTS, ("1v1_heals_low",)))
def test_random_play_gives_the_statistics_of_the_original(variant: str) -> None:
    samples, rows = play(variant), [row for row in TABLE if row["variant"] == variant]
    assert {row["quantity"] for row in rows} == samples.keys()
    apart = {row["quantity"]: round(errors_apart(row, samples[row["quantity"]]), 2) for row in rows}
    print(variant, apart)
    assert max(map(abs, apart.values())) < ERRORS, apart
