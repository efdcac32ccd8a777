"""Files of events: what env.events() said, in a table; whole or not there."""

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import outlast
from outlast.components import Bag, Phase, Side
from outlast.ecs import Array, Clock, DeclarationError, Event, Module, Read, Rows, Singleton, Write, column, emit
from outlast.envs.rollout.policies import random_policy
from outlast.envs.rollout.table_file import COLUMNS, event_table
from outlast.envs.web.world_json import events
from tests.conftest import run
from tests.helpers.outputs import rows_of

ROLLOUT = ("rollout", "ffa_2", "--worlds=3", "--set=safe_zone_damage=20", "--set=pickup_reach=4.0", "--quiet")


def test_a_file_says_what_the_environment_said(capsys, tmp_path: Path) -> None:
    """Of the same rollout: every event of it, in order of steps, then of worlds; entities by their names."""
    path = tmp_path / "events.csv"
    status, _, err = run(capsys, *ROLLOUT, "--steps=120", "--events", path)
    assert (status, err) == (0, "")
    env = outlast.make_vec("ffa_2", 3, seed=0, safe_zone_damage=20, pickup_reach=4.0)
    policy, (seen, _), expected = random_policy(env, 0), env.reset(), []
    layout = env.worlds.layout
    names = [f"{kind} {k}" for kind, rows in layout.spans.items() for k in range(len(rows))] + [""]
    roles = {"hit": ("agent", "target"), "death": ("by", "agent"), "strike": ("agent", "target")}
    for _ in range(120):
        seen = env.step(policy(seen))[0]
        found = [(int(row["world"]), name, row) for name, rows in env.events().items() for row in rows]
        for w, name, row in sorted(found, key=lambda each: each[0]):
            who, whom = (names[row[role]] for role in roles.get(name, ("agent", "item")))
            amount = str(row["amount"]) if name == "hit" else ""
            why = layout.labels["damage_type"][row["damage_type"]] if name in ("hit", "death") else ""
            more = f"side={row['side']}" if name in ("hit", "death") and row["side"] >= 0 else ""
            times = [str(row[time]) for time in ("episode", "tick")]
            expected.append([str(w), *times, name, who, whom, amount, why, more])
    rows = rows_of(path)
    assert list(rows[0]) == list(COLUMNS)
    assert [list(row.values()) for row in rows] == expected
    assert {"hit", "death", "strike", "item_picked", "item_used"} <= {row["event"] for row in rows}


def test_a_replay_writes_the_same_file(capsys, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("live.csv", "again.csv", "some.csv")]
    record = tmp_path / "a.rec"
    run(capsys, *ROLLOUT, "--steps=50", "--events", files[0], "--record", record)
    assert run(capsys, "replay", record, "--events", files[1], "--quiet")[:2] == (0, f"{files[1]}\n")
    assert files[0].read_bytes() == files[1].read_bytes()
    run(capsys, "replay", record, "--events", files[2], "--worlds=1,2", "--from=10", "--to=30", "--quiet")
    chosen = [row for row in rows_of(files[0]) if row["world"] != "0" and 10 <= int(row["tick"]) <= 30]
    assert rows_of(files[2]) == chosen


def test_what_cannot_be_is_refused(capsys, tmp_path: Path, monkeypatch) -> None:
    _, _, err = run(capsys, *ROLLOUT, "--steps=3", "--events", tmp_path / "b.csv", "--ray")
    assert "--events, --csv, --specialize and --interpret are for one machine: leave them out with --ray" in err
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    _, _, err = run(capsys, *ROLLOUT, "--steps=3", "--events", tmp_path / "b.parquet")
    assert "pip install 'outlast[data]'" in err
    assert not list(tmp_path.iterdir())


class Shout(Event, capacity="agents", whom="listener"):
    agent: Array = column("i4", unit="entity")
    listener: Array = column("i4", unit="entity")
    amount: Array = column("f4", unit="decibels")
    words: Array = column("i1", 2)
    target: Array = column("f4")  # metres: no entity
    side: Array = column("i4", unit="side")


@dataclass(frozen=True)
class Shouting(Module):
    def singletons(self) -> Iterable[Singleton]:
        return [Shout()]


@Shouting.system(Phase.GIVE)
def shout(shouts: Write[Shout], side: Read[Side], clock: Read[Clock], agents: Rows[Bag]) -> None:
    """In every third tick, agent 1 to agent 0; agent 0 to nobody."""
    if clock.tick[0] % np.uint64(3) == 0:
        for i in range(2):
            k = emit(shouts)
            shouts.agent[k], shouts.listener[k] = agents[i], agents[0] if i == 1 else -1
            shouts.amount[k], shouts.side[k] = 2.5, side.side[agents[i]] if i == 1 else -1
            shouts.words[k, 0], shouts.words[k, 1], shouts.target[k] = i, 7, 1.5


def test_a_users_own_events_are_everywhere(tmp_path: Path) -> None:
    env = outlast.make_vec(outlast.variant("ffa_1").with_(Shouting()), 2, seed=0)
    env.reset()
    for _ in range(3):
        env.step(np.tile(env.noop, (2, env.num_agents, 1)))
    rows = env.events()["shout"]
    found = rows[["world", "tick", "agent", "listener"]].tolist()
    assert found == [(w, 3, i, [-1, 0][i]) for w in (0, 1) for i in (0, 1)]
    table = event_table(env.worlds.layout, {"shout": rows}, first_world=5)
    words = [[str(column[k]) for column in table.values()] for k in range(4)]
    assert words[2] == ["6", "1", "3", "shout", "agent 0", "", "2.5", "", "words=[0, 7] target=1.5"]
    assert words[3] == ["6", "1", "3", "shout", "agent 1", "agent 0", "2.5", "", "words=[1, 7] target=1.5 side=1"]
    page = [event for event in events(env.worlds, 1) if event["kind"] == "other"]
    causes = ["shout 2.5 words=[0, 7] target=1.5", "shout agent 0 2.5 words=[1, 7] target=1.5 side=1"]
    assert [(event["agent"], event["cause"]) for event in page] == [*enumerate(causes)]
    rows["agent"] = 1000
    with pytest.raises(DeclarationError, match=r"the event Shout has agent = 1000, and its unit is 'entity': -1 to"):
        event_table(env.worlds.layout, {"shout": rows})
