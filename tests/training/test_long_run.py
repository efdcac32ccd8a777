"""long-run: checkpoints of a run, measured; and the mechanic that counts whom mates strike."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Item
from outlast.ecs import Entity
from outlast.envs.core.spaces import side, statistics
from outlast.training.base.errors import TrainingError
from outlast.training.research.__main__ import main
from outlast.training.research.long_run import COUNTED, SHARES, chosen
from outlast.training.research.teamwork import Teamwork
from tests.conftest import draw_actions, scaled
from tests.helpers.outputs import rows_of

GAME, WITHIN = "teams_2", 3
DENSE = outlast.variant(GAME).replace(
    agents_count=6, room_size=7.0, safe_zone_damage=0, melee_reach=3.0, heals_count=6, pickup_reach=1.0
)


def test_checkpoints_play_against_each_other_and_against_who_answers_them(tmp_path: Path, capsys: Any) -> None:
    small: dict[str, Any] = {"worlds": 4, "rollout": 64, "every": 1, "quiet": True}
    run, other, out = (tmp_path / name for name in ("run", "other", "out"))
    outlast.train(GAME, run, steps=1280, **small)  # five rollouts of 256 agent-steps
    assert [path.name for path in chosen(run)] == [f"steps_{steps:010}.zip" for steps in (256, 512, 1024, 1280)]
    outlast.train(GAME, other, steps=512, opponents={chosen(run)[1]: 1}, **small)
    words = ("--episodes", "2", "--out", str(out))
    assert main(["long-run", GAME, str(run), "--responses", str(other), *words]) == 0
    policies = ["256", "512", "1024", "1280", "scripted"]
    found, games = rows_of(out / "figures.csv"), rows_of(out / "crossplay.csv")
    assert list(dict.fromkeys(row["policy"] for row in found)) == policies
    names = {row["figure"] for row in found}
    assert {"Elo", "wins against scripted", "ticks", "kills", "heals held"} <= names
    assert names <= {"Elo", "wins against scripted", *SHARES} | {title for title, _ in COUNTED.values()}
    wins = {(row["policy"], row["against"]): float(row["wins"]) for row in games}
    assert wins.keys() == {(one, its) for one in policies for its in policies if one != its}
    assert all(wins[its, one] == 1 - wins[one, its] for one, its in wins)
    responses = [
        (row["run"], row["against"], row["steps"], row["warm start"]) for row in rows_of(out / "responses.csv")
    ]
    assert responses == [("run", "512", steps, "no") for steps in ("256", "512")]
    assert "1280" in capsys.readouterr().out
    assert main(["long-run", GAME, str(other), *words]) == 0
    assert rows_of(out / "figures.csv")[: len(found)] == found  # of the run that is not measured again
    assert main(["long-run", GAME, "--responses", str(run)]) == 2
    assert "run was not trained against one checkpoint, but against self:1" in capsys.readouterr().err
    assert main(["long-run", GAME]) == 2
    assert "there is nothing to measure" in capsys.readouterr().err
    with pytest.raises(TrainingError, match="has no checkpoint"):
        chosen(out)
    (out / "figures.csv").write_text("figure\n1\n")
    assert main(["long-run", GAME, str(other), *words]) == 2
    assert "figures.csv has the columns figure: choose another folder" in capsys.readouterr().err


def test_teamwork_is_that_of_the_naive_form() -> None:
    env = outlast.make_vec(DENSE.with_(Teamwork(within=WITHIN)), 8, seed=3)
    env.reset()
    rng, span, sides = np.random.default_rng(4), env.worlds.span("agent"), side(env.worlds).copy()
    latest: dict[tuple[int, int], tuple[int, int]] = {}  # by world and agent: tick and target
    first = np.full_like(env.worlds[Item].holder, -1)
    beside, focused, helped = np.zeros((3, env.num_worlds, env.num_agents), int)
    for tick in range(scaled(150, least=20)):
        env.step(draw_actions(env, rng))
        for use in env.events()["item_used"]:  # who had picked it up is the first holder since it lay on the ground
            w, me, by = use["world"], use["agent"], first[use["world"], use["item"]]
            helped[w, me - span.start] += by not in (-1, me) and sides[w, by - span.start] == sides[w, me - span.start]
        holder = env.worlds[Item].holder
        first = np.where((holder < 0) | (first < 0), holder, first)
        events = env.events()["hit"]
        rows = events["world"], events["agent"] - span.start, events["target"] - span.start, events["amount"]
        there = [hit for hit in zip(*rows, strict=True) if hit[1] >= 0]
        hits = [(w, me, it, lost) for w, me, it, lost in there if sides[w, me] != sides[w, it]]
        latest |= {(w, me): (tick, it) for w, me, it, _ in hits}
        for w, me, it, lost in hits:
            living = env.worlds[Entity].alive[w, span].astype(bool)
            enemies = {int(e) for e in np.flatnonzero(living & (sides[w] != sides[w, me]))} - {it}
            mates = [latest.get((w, int(j)), (-99, 0)) for j in np.flatnonzero(sides[w] == sides[w, me]) if j != me]
            fighting = [target for at, target in mates if tick - at <= WITHIN]
            beside[w, me] += lost * bool(enemies and fighting)
            focused[w, me] += lost * bool(enemies and it in fighting)
    counted = statistics(env.worlds, np.ones(env.num_worlds, bool))
    np.testing.assert_array_equal(counted["damage_beside"], beside)
    np.testing.assert_array_equal(counted["damage_focused"], focused)
    np.testing.assert_array_equal(counted["heals_of_mates"], helped)
    assert (focused < beside).any()
    assert focused.any()
    assert helped.any()
    env.close()
