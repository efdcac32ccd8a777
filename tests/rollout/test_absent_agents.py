"""Agents that an episode does not have: no mean, no row, no dataset and no win counts them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Score
from outlast.distributions import integers
from outlast.envs.core.agents import fewest_sides, present, side
from outlast.envs.datasets.export import export_dataset
from outlast.envs.datasets.samples import Selection
from outlast.envs.recording import Recording, Replay
from outlast.systems import Teams
from outlast.training.base.metrics import BehaviourMetrics, EpisodeMetrics, means
from tests.conftest import draw_actions
from tests.helpers.execution_modes import short
from tests.helpers.outputs import rows_of

WORLDS = 30
ALONE = short("ffa_3").vary(n_agents=integers(1, 3))
PAIRS = short("teams_3").vary(n_agents=integers(2, 4))
GAMES = pytest.mark.parametrize("scenario", [ALONE, PAIRS], ids=["free for all", "teams"])
Episode = dict[str, Any]


def episodes(scenario: Any, steps: int = 70, mode: str = "NextStep") -> list[Episode]:
    """Of random agents, as info reports them: statistics, how many agents there were, and on which sides."""
    env, found = outlast.make_vec(scenario, WORLDS, seed=3, autoreset_mode=mode), []
    rng = np.random.default_rng(0)
    _, info = env.reset()
    for _ in range(steps):
        there = info["present"]
        *_, info = env.step(draw_actions(env, rng))
        for w in np.flatnonzero(info.get("_statistics", ())):
            own = {key: values[w] for key, values in info["statistics"].items()}
            own["there"] = {key: values[w] for key, values in info["statistics_present"].items()}
            found.append(own | {"count": int(there[w].sum())})
    env.close()
    return found


@GAMES
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_infos_say_which_entries_an_episode_had(scenario: Any, mode: str) -> None:
    found = episodes(scenario, mode=mode)
    assert len({episode["count"] for episode in found}) == 3
    for episode in found:
        assert episode["agents_count"] == episode["count"]
        agents = np.arange(len(episode["return"])) < episode["count"]
        assert episode["there"]["return"].tolist() == agents.tolist()
        sides = episode["count"] if scenario is ALONE else 2
        assert episode["there"]["kills"].tolist() == [side < sides for side in range(len(episode["kills"]))]
        assert not episode["return"][~agents].any()


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
    """A dash in the table, null in JSON."""
    seeds = (seed for seed in range(20) if outlast.make_vec(ALONE, 1, seed=seed).reset()[1]["present"].sum() < 3)
    summary = outlast.rollout(ALONE, worlds=1, seed=next(seeds))
    row = summary.as_dict()["statistics"]["return_2"]
    assert row == {"mean": None, "std_error": None, "episodes": 0}
    json.dumps(row, allow_nan=False)
    line = next(line for line in str(summary).splitlines() if line.startswith("return 2 "))
    assert line.split()[2:] == ["-", "-", "0"]


def first_of_each() -> list[Episode]:
    """How many agents the first episode of every world has."""
    env = outlast.make_vec(ALONE, WORLDS, seed=3)
    _, info = env.reset()
    return [{"count": int(there.sum())} for there in info["present"]]


def test_nobody_wins_alone() -> None:
    """Episodes with one side are no games: they are neither won nor lost."""
    summary = outlast.rollout(ALONE, "noop", others="noop", worlds=WORLDS, seed=3)
    games = sum(episode["count"] > 1 for episode in first_of_each())
    assert summary.outcomes["noop"].sum() == games < WORLDS


@GAMES
def test_what_training_measures(scenario: Any) -> None:
    env = outlast.make_vec(scenario, WORLDS, seed=3, autoreset_mode="Disabled")
    env.reset()
    measured, behaviour, rng = EpisodeMetrics(env), BehaviourMetrics(env), np.random.default_rng(0)
    kills: list[list[float]] = [[] for _ in range(env.worlds.dims["sides"])]
    alive = there = 0
    for _ in range(70):
        *_, terminated, truncated, info = env.step(draw_actions(env, rng))
        behaviour.after_step()
        there += int(present(env.worlds).sum())
        alive += int((env.worlds[Score].alive > 0).sum())
        if (done := terminated | truncated).any():
            measured.add(info["statistics"], np.ones((WORLDS, env.num_agents), bool))
            for w in np.flatnonzero(done):
                for side in np.flatnonzero(info["statistics_present"]["kills"][w]):
                    kills[side].append(float(info["statistics"]["kills"][w, side]))
            env.reset(options={"reset_mask": done})
    found = means([measured.tallies()])
    for side, values in enumerate(kills):
        assert found[f"rollout/kills{side}"] == pytest.approx(np.mean(values))
    assert behaviour.there == there


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
    there = [each["count"] for each in first_of_each()]
    assert [sorted(counts[w, 1]) for w in range(WORLDS)] == [list(range(count)) for count in there]


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
    env.close()
