"""Agents that an episode does not have: no mean, no row, no dataset and no win counts them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.distributions import integers
from outlast.envs.core.spaces import fewest_sides, side
from outlast.envs.datasets.export import export_dataset
from outlast.envs.datasets.samples import Selection
from outlast.envs.recording import Recording, Replay
from outlast.systems import Teams
from tests.conftest import draw_actions
from tests.helpers.execution_modes import short
from tests.helpers.outputs import rows_of

WORLDS = 30
ALONE = short("ffa_3").vary(n_agents=integers(1, 3))
PAIRS = short("teams_3").vary(n_agents=integers(2, 4))
GAMES = pytest.mark.parametrize("scenario", [ALONE, PAIRS], ids=["free for all", "teams"])
Episode = dict[str, Any]


@GAMES
def test_final_info_is_what_info_was(scenario: Any) -> None:
    """Under SAME_STEP: numbers, agents and statistics of the episode that ended, not of the one that begins."""
    one, other = (outlast.make_vec(scenario, WORLDS, seed=3, autoreset_mode=mode) for mode in ("SameStep", "Disabled"))
    one.reset(), other.reset()
    rng, ends = np.random.default_rng(0), 0
    for _ in range(70):
        actions = draw_actions(one, rng)
        *_, info = one.step(actions)
        *_, terminated, truncated, expected = other.step(actions)
        if (done := terminated | truncated).any():
            final = info["final_info"]
            for key in ("alive", "present"):
                np.testing.assert_array_equal(final[key][done], expected[key][done])
            for key, values in expected["numbers"].items():
                np.testing.assert_array_equal(final["numbers"][key][done], values[done])
            other.reset(options={"reset_mask": done})
            ends += 1
    assert ends


def check_means(table: dict[str, dict[str, Any]], expected: list[Episode]) -> None:
    """Of every statistic over the episodes that had the agent or side."""
    for name, row in table.items():
        key, _, k = name.rpartition("_")
        if key not in expected[0]["there"]:
            continue
        values = [float(each[key][int(k)]) for each in expected if each["there"][key][int(k)]]
        assert row["episodes"] == len(values)
        assert row["mean"] == (pytest.approx(np.mean(values)) if values else None)
        if len(values) > 1:
            assert row["std_error"] == pytest.approx(np.std(values, ddof=1) / len(values) ** 0.5, abs=1e-6)


@GAMES
def test_means_of_a_rollout(scenario: Any, tmp_path: Path) -> None:
    """The same from the rows of --csv, which are empty there, and from the replay of a recording."""
    files = {"csv": tmp_path / "episodes.csv", "record": tmp_path / "fight.osr"}
    summary = outlast.rollout(scenario, "random", worlds=WORLDS, seed=3, **files)
    expected = []
    for row in rows_of(files["csv"]):
        count, there = int(row["agents_count"]), {}
        for key in ("return", "kills"):
            cells = [row[name] for name in sorted(name for name in row if name.startswith(f"{key}_"))]
            there[key] = [cell != "" for cell in cells]
            row[key] = cells  # type: ignore[assignment]
        assert there["return"] == [i < count for i in range(len(there["return"]))]
        expected.append({**row, "there": there})
    table = summary.as_dict()["statistics"]
    check_means(table, expected)
    assert table["return_0"]["episodes"] == WORLDS > table["return_2"]["episodes"]
    assert "episodes" not in table["length"]
    line = next(line for line in str(summary).splitlines() if line.startswith("return 2 "))
    assert line.split()[-1] == str(table["return_2"]["episodes"])
    replay = Replay(Recording.open(files["record"]))
    for _ in replay.ticks():
        pass
    assert replay.summary.as_dict()["statistics"]["return_0"]["episodes"] >= WORLDS
    replay.close()


def test_who_was_never_there_has_no_mean() -> None:
    seeds = (seed for seed in range(20) if outlast.make_vec(ALONE, 1, seed=seed).reset()[1]["present"].sum() < 3)
    summary = outlast.rollout(ALONE, worlds=1, seed=next(seeds))
    row = summary.as_dict()["statistics"]["return_2"]
    assert row == {"mean": None, "std_error": None, "episodes": 0}
    json.dumps(row, allow_nan=False)
    line = next(line for line in str(summary).splitlines() if line.startswith("return 2 "))
    assert line.split()[2:] == ["-", "-", "0"]


def first_counts() -> list[int]:
    """How many agents the first episode of every world has."""
    return [int(there.sum()) for there in outlast.make_vec(ALONE, WORLDS, seed=3).reset()[1]["present"]]


def test_nobody_wins_alone() -> None:
    summary = outlast.rollout(ALONE, "noop", others="noop", worlds=WORLDS, seed=3)
    games = sum(count > 1 for count in first_counts())
    assert summary.outcomes["noop"].sum() == games < WORLDS


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    path = tmp_path / "fight.osr"
    env = outlast.make_vec(ALONE, WORLDS, seed=3)
    with outlast.record(env, path):
        outlast.rollout(env, "random")
    env.close()
    return path


def export(path: Path, target: Path | str) -> int:
    recording = Recording.open(path)
    replay = Replay(recording)
    try:
        return export_dataset(str(target), replay, Selection(range(WORLDS), 0, len(recording) - 1))
    finally:
        replay.close()


def test_datasets_mark_or_leave_out(recorded: Path, tmp_path: Path) -> None:
    """.npz files have a column `present`; in Parquet there are no rows; all say how many agent-steps there are."""
    steps = export(recorded, tmp_path / "samples")
    with np.load(tmp_path / "samples" / "shard_000000.npz") as shard:
        there, alive = shard["present"], shard["alive"]
        assert there.sum() == steps < there.size
        assert not (alive & ~there).any()
        for key in ("rewards", "observations/own", "observations/others"):
            assert not shard[key][~there].any()
        expected = {(int(w), int(e), int(t), i) for w, e, t, row in zip(
            shard["world"], shard["episode"], shard["tick"], there, strict=True
        ) for i in np.flatnonzero(row).tolist()}  # fmt: skip
    assert "present" in json.loads((tmp_path / "samples" / "manifest.json").read_text())["columns"]
    pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow")
    assert export(recorded, tmp_path / "samples.parquet") == steps
    table = pq.read_table(tmp_path / "samples.parquet")
    assert {tuple(row[key] for key in ("world", "episode", "tick", "agent")) for row in table.to_pylist()} == expected


def test_minari_has_an_episode_for_each_agent_that_was_there(recorded: Path, tmp_path: Path, monkeypatch) -> None:
    minari = pytest.importorskip("minari", reason="needs Minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    steps = export(recorded, "minari:absent-v0")
    dataset = minari.load_dataset("absent-v0")
    counts: dict[tuple[int, int], list[int]] = {}
    for episode in dataset.iterate_episodes():
        options = dataset.storage.get_episode_metadata([episode.id])
        about = next(iter(options))["options"]
        counts.setdefault((about["world"], about["episode"]), []).append(about["agent"])
    assert dataset.total_steps == steps
    assert [sorted(counts[w, 1]) for w in range(WORLDS)] == [list(range(count)) for count in first_counts()]


@pytest.mark.parametrize(
    ("scenario", "expected"),
    [
        (short("ffa_3"), 2),
        (ALONE, 1),
        (PAIRS, 2),
        (PAIRS.with_(Teams(sizes=(1, 3))), 2),
        (PAIRS.with_(Teams(sizes=(2, 2))), 1),
        (PAIRS.with_(Teams(sizes=(2, 2))).vary(n_agents=integers(3, 4)), 2),
        (short("teams_3").replace(n_agents=6, teams_count=3).vary(n_agents=integers(3, 6)), 3),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_sides_that_every_episode_has(scenario: Any, expected: int) -> None:
    """Of unequal teams, the last ones may have nobody."""
    env = outlast.make_vec(scenario, WORLDS, seed=3)
    env.reset()
    assert fewest_sides(env.worlds) == expected
    found = [len({*each.tolist()} - {-1}) for each in side(env.worlds)]
    assert min(found) == expected
