"""Datasets made of recordings: what the environment returned while it was recorded, row by row."""

import itertools
import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import outlast
from outlast.ecs import Entity
from outlast.envs.cli import main as cli
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.datasets import samples as dataset
from outlast.envs.datasets.export import export_dataset
from outlast.envs.datasets.samples import DatasetSamples, Selection, concatenate, read_samples
from outlast.envs.errors import RecordingError
from outlast.envs.recording import Recording, Replay
from outlast.systems import Respawn
from tests.conftest import draw_actions

WORLDS, STEPS = 4, 70
SHORT = {"ending_limit": 20, "agents_health": 30}
Step = dict[str, Any]


def make(variant: str, autoreset: str) -> SurvivalVectorEnv:
    scenario = outlast.variant(variant).replace(**SHORT)
    return outlast.make_vec(scenario, WORLDS, seed=1, autoreset_mode=autoreset, copy=True, first_world=10)


def play(env: SurvivalVectorEnv) -> list[Step]:
    """Play, and write down each step of each world as any learner would: from what the calls return."""
    rng, rows, mode = np.random.default_rng(0), list[Step](), env.autoreset_mode
    observations, _ = env.reset()
    episode, tick, done = np.ones(WORLDS, int), np.zeros(WORLDS, int), np.zeros(WORLDS, bool)
    for _ in range(STEPS):
        alive = env.worlds[Entity].alive[:, env.worlds.span("agent")] != 0
        actions = draw_actions(env, rng)
        after, rewards, terminated, truncated, info = env.step(actions)
        for w in range(WORLDS):
            if done[w]:  # NEXT_STEP: it was only reset
                episode[w], tick[w] = episode[w] + 1, 0
                continue
            ended = bool(terminated[w] or truncated[w])
            same = ended and mode is AutoresetMode.SAME_STEP
            following = info["final_obs"][w] if same else {key: array[w] for key, array in after.items()}
            row = {"world": 10 + w, "episode": episode[w], "tick": tick[w], "alive": alive[w], "actions": actions[w]}
            row |= {"rewards": rewards[w], "terminated": terminated[w], "truncated": truncated[w], "last": ended}
            rows.append(row | {"before": {key: array[w] for key, array in observations.items()}, "after": following})
            tick[w] += 1
            if same:
                episode[w], tick[w] = episode[w] + 1, 0
        ended = terminated | truncated
        done = ended if mode is AutoresetMode.NEXT_STEP else done
        observations = after
        if mode is AutoresetMode.DISABLED and (mask := ended | (rng.random(WORLDS) < 0.05)).any():
            observations, _ = env.reset(options={"reset_mask": mask})
            episode[mask], tick[mask] = episode[mask] + 1, 0
    keys = [(row["world"], row["episode"]) for row in rows]
    for k, row in enumerate(rows):  # reset in mid-episode, or at the end
        row["last"] = keys[k] not in keys[k + 1 :]
    return rows


def check(found: DatasetSamples, rows: list[Step]) -> None:
    """Every row, in the same order; final is what came after the last ones."""
    assert len(found) == len(rows)
    for key, column in found.columns.items():
        np.testing.assert_array_equal(column, np.array([row[key] for row in rows]), err_msg=key)
    last = [row["after"] for row in rows if row["last"]]
    for key in found.observations:
        np.testing.assert_array_equal(found.observations[key], np.array([row["before"][key] for row in rows]))
        np.testing.assert_array_equal(found.final[key], np.array([after[key] for after in last]))


def whole(path: Path) -> tuple[Replay, Selection]:
    recording = Recording.open(path)
    return Replay(recording), Selection(range(recording.num_worlds), 0, len(recording) - 1)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: Any) -> tuple[Path, list[Step]]:
    env, path = make("teams_3", "NextStep"), tmp_path_factory.mktemp("data") / "a.rec"
    with outlast.record(env, path):
        return path, play(env)


@pytest.mark.parametrize("variant", ["ffa_1", "teams_3"])
@pytest.mark.parametrize("autoreset", ["NextStep", "SameStep", "Disabled"])
def test_samples_are_what_step_returned(tmp_path: Path, variant: str, autoreset: str) -> None:
    env = make(variant, autoreset)
    with outlast.record(env, tmp_path / "a.rec"):
        rows = play(env)
    assert sum(row["last"] for row in rows) > WORLDS
    check(concatenate(list(read_samples(*whole(tmp_path / "a.rec")))), rows)


@pytest.mark.parametrize("begin", ["seeds", "keys"])
def test_episodes_are_told_apart_whatever_they_are_keyed_by(tmp_path: Path, begin: str) -> None:
    """A clock's number of the episode begins again with a seed, and with a level that has a key."""
    varied = outlast.variant("ffa_2").replace(ending_limit=3).vary(melee_damage=outlast.distributions.integers(5, 40))
    env = outlast.make_vec(varied, 2, seed=0, autoreset_mode="Disabled")
    env.reset()
    with outlast.record(env, tmp_path / "a.rec"):
        for k in range(3):
            if begin == "keys" and k:
                env.set_levels([outlast.levels.Level({"melee_damage": 10 + k}, key=(7, 0, 1))] * 2)
            env.reset(**{"seed": k} if begin == "seeds" else {})
            for _ in range(3):
                env.step(np.tile(env.noop, (2, 2, 1)))
    columns = concatenate(list(read_samples(*whole(tmp_path / "a.rec")))).columns
    found = list(zip(columns["world"], columns["episode"], columns["tick"], strict=True))
    assert found == [(w, 1 + k, tick) for k in range(3) for tick in range(3) for w in range(2)]
    replay = Replay(Recording.open(tmp_path / "a.rec"))
    for _ in replay.ticks():
        assert all((rows["episode"] == replay.episodes[rows["world"]]).all() for rows in replay.events().values())
    assert replay.episodes.tolist() == [3, 3]


def test_some_worlds_and_some_ticks(recorded: tuple[Path, list[Step]]) -> None:
    """What is last is so within what was asked for."""
    path, rows = recorded
    replay, _ = whole(path)
    found = concatenate(list(read_samples(replay, Selection([1, 3], 1, STEPS // 2))))
    inside = [row for row in rows if row["world"] in (11, 13)]
    assert set(found.columns["world"]) == {11, 13}
    keys = ("world", "episode", "tick")
    expected = {tuple(int(row[key]) for key in keys) for row in inside[: len(found)]}
    assert set(zip(*(found.columns[key].tolist() for key in keys), strict=True)) == expected
    assert found.columns["last"].sum() == len({(row["world"], row["episode"]) for row in inside[: len(found)]})


# ---- files


def export(capsys: Any, path: Path, out: object, *options: str) -> tuple[int, str, str]:
    status = cli.main(["replay", str(path), "--data", str(out), "--quiet", *options])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_shards(capsys: Any, recorded: tuple[Path, list[Step]], tmp_path: Path, monkeypatch: Any) -> None:
    path, rows = recorded
    monkeypatch.setattr(dataset, "SHARD_BYTES", 200_000)
    status, out, _ = export(capsys, path, tmp_path / "data")
    assert (status, out) == (0, f"{tmp_path / 'data'}: {len(rows) * 4:,} agent-steps\n")
    about = json.loads((tmp_path / "data" / "manifest.json").read_text())
    files = [shard["file"] for shard in about["shards"]]
    assert len(files) > 1
    assert sorted(os.listdir(tmp_path / "data")) == ["manifest.json", *files]
    shards = [dict(np.load(tmp_path / "data" / file, allow_pickle=False)) for file in files]
    assert [len(shard["world"]) for shard in shards] == [shard["samples"] for shard in about["shards"]]
    parts = [
        DatasetSamples(
            {key: array for key, array in shard.items() if "/" not in key},
            {key[13:]: array for key, array in shard.items() if key.startswith("observations/")},
            {key[6:]: array for key, array in shard.items() if key.startswith("final/")},
        )
        for shard in shards
    ]
    check(concatenate(parts), rows)
    assert {key: list(a.shape[2:]) for key, a in parts[0].observations.items()} == about["observations"]
    assert about["columns"].keys() == parts[0].columns.keys()
    assert [action["size"] for action in about["actions"]] == [3, 3, 3, 2, 2, 2]
    assert os.listdir(tmp_path) == ["data"]


def test_parquet(capsys: Any, recorded: tuple[Path, list[Step]], tmp_path: Path, monkeypatch: Any) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    path, rows = recorded
    monkeypatch.setattr(dataset, "SHARD_BYTES", 200_000)  # row groups
    status, out, _ = export(capsys, path, tmp_path / "data.parquet")
    assert (status, f"{len(rows) * 4:,} agent-steps" in out) == (0, True)
    file = pq.ParquetFile(tmp_path / "data.parquet")
    assert file.num_row_groups > 1
    about = json.loads(file.schema_arrow.metadata[b"outlast"])
    table = file.read()
    agents = [(row, i) for row in rows for i in range(4)]
    for key in ("world", "episode", "tick", "terminated", "truncated", "last"):
        assert table[key].to_pylist() == [row[key] for row, _ in agents]
    assert table["agent"].to_pylist() == [i for _, i in agents]
    assert table["alive"].to_pylist() == [row["alive"][i] for row, i in agents]
    assert table["reward"].to_pylist() == [row["rewards"][i] for row, i in agents]
    for k, action in enumerate(about["actions"]):
        assert table[action["name"]].to_pylist() == [row["actions"][i, k] for row, i in agents]
    for key, shape in about["observations"].items():
        assert (
            str(table.schema.field(f"observation_{key}").type) == f"fixed_size_list<element: float>[{np.prod(shape)}]"
        )
        seen = np.array(table[f"observation_{key}"].to_pylist(), np.float32).reshape(-1, *shape)
        np.testing.assert_array_equal(seen, np.array([row["before"][key][i] for row, i in agents]))
        final = table[f"final_{key}"].to_pylist()
        assert [entry is not None for entry in final] == [row["last"] for row, _ in agents]
        ends = np.array([entry for entry in final if entry is not None], np.float32).reshape(-1, *shape)
        np.testing.assert_array_equal(ends, np.array([row["after"][key][i] for row, i in agents if row["last"]]))


def test_flat_parquet_has_a_named_column_for_each_number(
    capsys: Any, recorded: tuple[Path, list[Step]], tmp_path: Path
) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    path, rows = recorded
    lists, flat = tmp_path / "lists.parquet", tmp_path / "flat.parquet"
    assert export(capsys, path, lists)[0] == export(capsys, path, flat, "--flat")[0] == 0
    nested, table = pq.read_table(lists), pq.read_table(flat)
    assert not [field.name for field in table.schema if not str(field.type).isidentifier()]  # no lists
    env = make("teams_3", "NextStep")
    names = [name.replace(".", "_") for name in env.flat_names]
    assert {"own_health", "others_0_x", "others_2_angle", "heals_mask_14"} <= {*names}
    kept = [name for name in nested.column_names if not name.startswith(("observation_", "final_"))]
    assert table.column_names == [*kept, *names, *(f"final_{name}" for name in names)]
    for part, prefix in (("observation_", ""), ("final_", "final_")):
        keys = [name for name in nested.column_names if name.startswith(part)]
        joined = zip(*(nested[key].to_pylist() for key in keys), strict=True)
        expected = [[None] * len(names) if None in row else [*itertools.chain(*row)] for row in joined]
        found = zip(*(table[f"{prefix}{name}"].to_pylist() for name in names), strict=True)
        assert [list(row) for row in found] == expected
    health = rows[0]["before"]["own"][:, env.fields["own"]["health"].start]
    assert table["own_health"].to_pylist()[:4] == health.tolist()


def test_columns_of_flat_parquet_with_one_name_are_refused() -> None:
    parquet = pytest.importorskip("outlast.envs.datasets.parquet")
    replay: Any = SimpleNamespace(worlds=SimpleNamespace(layout=SimpleNamespace(fields={})))
    assert parquet._numbers(replay, {"a": [2, 1], "b": [1]}) == {"a": ["a_0_0", "a_1_0"], "b": ["b_0"]}
    with pytest.raises(RecordingError, match=r"two numbers .* would be called 'a_0_0': leave out --flat"):
        parquet._numbers(replay, {"a": [2, 1], "a_0": [1]})
    with pytest.raises(RecordingError, match=r"two numbers .* would be called 'final_a_0': leave out --flat"):
        parquet._numbers(replay, {"final_a": [1], "a": [1]})


def test_flat_is_for_tables(capsys: Any, recorded: tuple[Path, list[Step]], tmp_path: Path) -> None:
    for options in ((), ("--data", str(tmp_path / "data")), ("--html", str(tmp_path / "page.html"))):
        assert cli.main(["replay", str(recorded[0]), "--quiet", "--flat", *options]) == 2
        assert "--flat is for tables of samples: give --data NAME.parquet, too" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_minari(capsys: Any, recorded: tuple[Path, list[Step]], tmp_path: Path, monkeypatch: Any) -> None:
    """An episode for each agent of each episode of a world; what was cut off is truncated."""
    minari = pytest.importorskip("minari")
    path, rows = recorded
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    status, out, err = export(capsys, path, "minari:outlast/test-v0")
    assert (status, err, f"{len(rows) * 4:,} agent-steps" in out) == (0, "", True)
    found = minari.load_dataset("outlast/test-v0")
    metadata = list(found.storage.get_episode_metadata(range(found.total_episodes)))
    assert found.total_steps == len(rows) * 4
    for episode, known in zip(found.iterate_episodes(), metadata, strict=True):
        options = known["options"]
        own = [row for row in rows if (row["world"], row["episode"]) == (options["world"], options["episode"])]
        i = options["agent"]
        np.testing.assert_array_equal(episode.actions, np.array([row["actions"][i] for row in own]))
        np.testing.assert_array_equal(episode.rewards, np.array([row["rewards"][i] for row in own]))
        assert episode.terminations.tolist() == [row["terminated"] for row in own]
        assert episode.truncations.tolist() == [False] * (len(own) - 1) + [not own[-1]["terminated"]]
        for key, array in episode.observations.items():
            seen = [*(row["before"][key][i] for row in own), own[-1]["after"][key][i]]
            np.testing.assert_array_equal(array, np.array(seen))
    env = found.recover_environment(others="noop").unwrapped
    assert env.base_env.scenario == Recording.open(path).scenario
    assert (env.observation_space, env.action_space) == (found.observation_space, found.action_space)
    status, _, err = export(capsys, path, "minari:outlast/test-v0")
    assert (status, "there is a Minari dataset outlast/test-v0" in err) == (2, True)
    status, _, err = export(capsys, path, "minari:nothing")
    assert (status, "NAME-v0 is needed" in err) == (2, True)


@pytest.mark.parametrize("kind", ["plain", "levels"])
def test_an_episode_of_a_minari_dataset_can_be_played_again(tmp_path: Path, monkeypatch: Any, kind: str) -> None:
    """Its metadata begin it, and its actions, with those of the others, repeat it bit by bit, after deaths, too."""
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    game = outlast.variant("ffa_3").replace(**SHORT)
    if kind == "levels":
        game = game.vary(agents_health=outlast.distributions.integers(5, 60))
    env, rng = outlast.make_vec(game, 2, seed=5, first_world=3), np.random.default_rng(0)
    with outlast.record(env, tmp_path / "a.rec"):
        for seed in (5, 6):
            if kind == "levels":
                env.set_levels(
                    [
                        outlast.levels.Level({"agents_health": 7}, key=(8, 0, 2)),
                        outlast.levels.Level({"agents_health": 9}),
                    ]
                )
            env.reset(seed=seed)
            for _ in range(STEPS):
                env.step(draw_actions(env, rng))
    export_dataset("minari:outlast/again-v0", *whole(tmp_path / "a.rec"))
    data = minari.load_dataset("outlast/again-v0")
    episodes = list(data.iterate_episodes())
    metadata = list(data.storage.get_episode_metadata(range(len(episodes))))
    actions = {
        tuple(known["options"][key] for key in ("world", "episode", "agent")): episode.actions
        for episode, known in zip(episodes, metadata, strict=True)
    }
    assert len({known["seed"] for known in metadata}) == 2 + (kind == "levels")
    for learner in (0, 1):
        theirs: Any = iter(())
        again = data.recover_environment(learner=learner, others=lambda seen: next(theirs)[None, None]).unwrapped  # noqa: B023
        for episode, known in zip(episodes, metadata, strict=True):
            world, number, agent = (known["options"][key] for key in ("world", "episode", "agent"))
            if agent != learner:
                with pytest.raises(
                    ValueError, match=rf"agent {agent} and seed \d+, not agent {learner} and .*learner={agent}"
                ):
                    again.reset(seed=known["seed"], options=known["options"])
                continue
            seen = [again.reset(seed=known["seed"], options=known["options"])[0]]
            rewards, theirs = [], iter(actions[world, number, 1 - learner])
            for action in episode.actions:
                observation, reward, *_ = again.step(action)
                seen.append(observation)
                rewards.append(reward)
            np.testing.assert_array_equal(rewards, episode.rewards)
            for key, rows in episode.observations.items():
                np.testing.assert_array_equal(rows, np.array([each[key] for each in seen]))
    with pytest.raises(ValueError, match="those in the metadata of an episode are needed"):
        again.reset(options={"world": 3})


def test_minari_of_an_agent_alone(tmp_path: Path, monkeypatch: Any) -> None:
    """There are no others, of which Arrow would end the process: it divides by the size of their rows."""
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = outlast.make_vec("ffa_1", 1, seed=0, n_agents=1, ending_limit=3)
    with outlast.record(env, tmp_path / "a.rec"):
        seen, _ = env.reset()
        seen, *_ = env.step(env.noop[None, None])
    export_dataset("minari:outlast/alone-v0", Replay(tmp_path / "a.rec"), Selection([0], 0, 1))
    (episode,) = minari.load_dataset("outlast/alone-v0").iterate_episodes()
    assert episode.observations.keys() == seen.keys() - {"others", "others_mask"}
    for key, array in episode.observations.items():
        np.testing.assert_array_equal(array[-1], seen[key][0, 0])


def test_minari_of_a_game_in_which_agents_come_back(tmp_path: Path, monkeypatch: Any) -> None:
    """Its environment cannot end with the death of an agent."""
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    game = outlast.variant("ffa_1").with_(Respawn(ticks=2)).replace(ending_rule="never", ending_limit=2)
    env = outlast.make_vec(game, 1, seed=0)
    with outlast.record(env, tmp_path / "a.rec"):
        env.reset()
        env.step(np.tile(env.noop, (1, 2, 1)))
    assert export_dataset("minari:outlast/back-v0", Replay(tmp_path / "a.rec"), Selection([0], 0, 1)) == 2
    again = minari.load_dataset("outlast/back-v0").recover_environment(others="noop")
    assert again.reset()[1]["alive"]


@pytest.mark.parametrize(
    ("module", "library", "name", "extra"),
    [("minari", "minari", "minari:outlast/none-v0", "data"), ("parquet", "pyarrow", "none.parquet", "data")],
)
def test_without_the_library_the_error_names_the_cure(
    capsys: Any, recorded: tuple[Path, list[Step]], monkeypatch: Any, module: str, library: str, name: str, extra: str
) -> None:
    monkeypatch.delitem(sys.modules, f"outlast.envs.datasets.{module}", raising=False)
    monkeypatch.setitem(sys.modules, library, None)
    status, _, err = export(capsys, recorded[0], name)
    assert (status, f"pip install 'outlast[{extra}]'" in err) == (2, True)


def test_the_folder_of_minari_is_named_where_it_cannot_be(
    capsys: Any, recorded: tuple[Path, list[Step]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("minari", reason="needs Minari: outlast[data]")
    (tmp_path / "file").touch()
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "file" / "root"))
    status, _, err = export(capsys, recorded[0], "minari:own-v0")
    assert (status, str(tmp_path / "file" / "root") in err, "no dataset was written" in err) == (2, True, True)


@pytest.mark.parametrize("name", ["data", "data.parquet"])
def test_what_another_process_exports_meanwhile_is_kept(
    recorded: tuple[Path, list[Step]], tmp_path: Path, name: str
) -> None:
    if name == "data.parquet":
        pytest.importorskip("pyarrow", reason="needs pyarrow: outlast[data]")
    out, replay = tmp_path / name, Replay(recorded[0])

    def theirs(tick: int) -> None:
        if tick == 3:
            out.mkdir() if name == "data" else out.touch()

    message = f"{name} exists, as another process has just written it; this is in .*data-2"
    with pytest.raises(RecordingError, match=message):
        export_dataset(str(out), replay, Selection([0], 0, 5, progress=theirs))
    assert (list(out.iterdir()) if name == "data" else out.read_bytes()) in ([], b"")
    kept = out.with_stem("data-2")
    assert kept.is_dir() == (name == "data")
    assert kept.stat().st_size > 0


@pytest.mark.parametrize("name", ["data", "data.parquet"])
def test_nothing_is_overwritten_and_nothing_left_half_written(
    capsys: Any, recorded: tuple[Path, list[Step]], tmp_path: Path, monkeypatch: Any, name: str
) -> None:
    if name == "data.parquet":
        pytest.importorskip("pyarrow", reason="needs pyarrow: outlast[data]")
    out = tmp_path / name
    out.write_text("precious")
    status, _, err = export(capsys, recorded[0], out)
    assert (status, "never overwrite files" in err, out.read_text()) == (2, True, "precious")
    out.unlink()
    monkeypatch.setattr(dataset, "SHARD_BYTES", 20_000)
    run, count = Replay._run, iter(range(STEPS // 2))

    def interrupted(self: Any, record: Any) -> None:
        if next(count, None) is None:
            raise KeyboardInterrupt
        run(self, record)

    monkeypatch.setattr(Replay, "_run", interrupted)
    assert export(capsys, recorded[0], out)[0] == 130
    assert os.listdir(tmp_path) == []
