"""Datasets made of recordings: what the environment returned while it was recorded, row by row."""

import itertools
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import outlast
from outlast.components import Phase
from outlast.ecs import Action, Entity, Observation, Read, Write, column
from outlast.envs.cli import main as cli
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.datasets import samples as dataset
from outlast.envs.datasets.export import export_dataset
from outlast.envs.datasets.samples import DatasetSamples, Selection, concatenate, read_samples
from outlast.envs.errors import RecordingError
from outlast.envs.recording import Recording, Replay
from outlast.systems import Respawn
from tests.conftest import draw_actions
from tests.helpers.mechanics import duel, idle, kind, taking

WORLDS, STEPS = 4, 70
SHORT = {"ending_limit": 20, "agents_health": 30}
Step = dict[str, Any]
Recorded = tuple[Path, list[Step]]


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
    assert len(found) == len(rows)
    for key, values in found.columns.items():
        np.testing.assert_array_equal(values, np.array([row[key] for row in rows]), err_msg=key)
    last = [row["after"] for row in rows if row["last"]]
    for key in found.observations:
        np.testing.assert_array_equal(found.observations[key], np.array([row["before"][key] for row in rows]))
        np.testing.assert_array_equal(found.final[key], np.array([after[key] for after in last]))


def whole(path: Path) -> tuple[Replay, Selection]:
    recording = Recording.open(path)
    return Replay(recording), Selection(range(recording.num_worlds), 0, len(recording) - 1)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: Any) -> Recorded:
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


def test_some_worlds_and_some_ticks(recorded: Recorded) -> None:
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


def export(capsys: Any, path: Path, out: object, *options: str) -> tuple[int, str, str]:
    status = cli.main(["replay", str(path), "--data", str(out), "--quiet", *options])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_shards(capsys: Any, recorded: Recorded, tmp_path: Path, monkeypatch: Any) -> None:
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


def test_parquet(capsys: Any, recorded: Recorded, tmp_path: Path, monkeypatch: Any) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    path, rows = recorded
    monkeypatch.setattr(dataset, "SHARD_BYTES", 200_000)  # row groups
    status, out, _ = export(capsys, path, tmp_path / "data.parquet")
    assert (status, f"{len(rows) * 4:,} agent-steps" in out) == (0, True)
    file = pq.ParquetFile(tmp_path / "data.parquet")
    assert file.num_row_groups > 1
    about = json.loads(file.schema_arrow.metadata[b"outlast"])
    table = file.read()

    def read(key: str, *shape: int) -> Any:
        values = np.array([each for each in table[key].to_pylist() if each is not None])
        return values.reshape(-1, 4, *shape)

    columns = {key: read(key)[:, 0] for key in ("world", "episode", "tick", "terminated", "truncated", "last")}
    columns |= {"alive": read("alive"), "rewards": read("reward")}
    columns["actions"] = np.stack([read(action["name"]) for action in about["actions"]], -1)
    seen, final = ({key: read(f"{part}_{key}", *shape) for key, shape in about["observations"].items()}
                   for part in ("observation", "final"))  # fmt: skip
    check(DatasetSamples(columns, seen, final), rows)
    assert table["agent"].to_pylist() == [*range(4)] * len(rows)
    assert [each is not None for each in table["final_own"].to_pylist()] == table["last"].to_pylist()
    assert str(table.schema.field("observation_heals").type) == "fixed_size_list<element: float>[30]"


def test_flat_parquet_has_a_named_column_for_each_number(capsys: Any, recorded: Recorded, tmp_path: Path) -> None:
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


@pytest.mark.parametrize(
    ("base", "columns", "message"),
    [
        (Action, {"reward": 1}, "action 'reward' has the name of another column"),
        (Action, {"final_own": 1}, "action 'final_own' has the name of another column"),
        (Observation, {"a": (2, 1), "a_0": (1,)}, "two numbers .* would be called 'a_0_0': leave out --flat"),
        (Observation, {"final_a": (1,), "a": (1,)}, "two numbers .* would be called 'final_a_0': leave out --flat"),
    ],
)
def test_columns_of_one_name_are_refused(tmp_path: Path, base: Any, columns: dict[str, Any], message: str) -> None:
    pytest.importorskip("pyarrow", reason="needs pyarrow: outlast[data]")
    acts = base is Action
    made = {key: column("i1", "agents", low=0, high=5) if acts else column("f4", "agents", *size)
            for key, size in columns.items()}  # fmt: skip
    mine = type("Mine", (base,), made)
    brings = kind("Brings", singletons=[mine()])
    brings.system(Phase.OBSERVE)(taking("look", mine=(Read if acts else Write)[mine]))
    env = duel(game=(game := outlast.variant("ffa_1").with_(brings())))
    with outlast.record(env, tmp_path / "a.rec"):
        env.reset()
        env.step(idle(env))
    replay = Replay(Recording.open(tmp_path / "a.rec", game))
    with pytest.raises(RecordingError, match=message):
        export_dataset(str(tmp_path / "a.parquet"), replay, Selection([0], 0, 1), flat=not acts)
    assert [path.name for path in tmp_path.iterdir()] == ["a.rec"]


@pytest.mark.parametrize("name", ["a.parquet", "folder", "minari:outlast/none-v0"])
def test_a_dataset_has_samples(recorded: Recorded, tmp_path: Path, name: str, monkeypatch: Any) -> None:
    for library in ("minari", "pyarrow"):
        pytest.importorskip(library, reason=f"needs {library}: outlast[data]")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    target = name if name.startswith("minari") else str(tmp_path / name)
    with pytest.raises(RecordingError, match=r"none of the worlds .* ticks 0 to 0, so samples are empty"):
        export_dataset(target, Replay(recorded[0]), Selection([0], 0, 0))
    assert not [each for each in tmp_path.rglob("*") if each.is_file()]


def test_minari(capsys: Any, recorded: Recorded, tmp_path: Path, monkeypatch: Any) -> None:
    """What was cut off is truncated; for actions, observations and rewards, see the next test."""
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
        assert episode.terminations.tolist() == [row["terminated"] for row in own]
        assert episode.truncations.tolist() == [False] * (len(own) - 1) + [not own[-1]["terminated"]]
    env = found.recover_environment(others="noop").unwrapped
    assert env.base_env.scenario == Recording.open(path).scenario
    assert (env.observation_space, env.action_space) == (found.observation_space, found.action_space)
    status, _, err = export(capsys, path, "minari:outlast/test-v0")
    assert (status, "there is a Minari dataset outlast/test-v0" in err) == (2, True)
    status, _, err = export(capsys, path, "minari:nothing")
    assert (status, "NAME-v0 is needed" in err) == (2, True)


@pytest.mark.parametrize("kind", ["plain", "levels"])
def test_an_episode_of_a_minari_dataset_can_be_played_again(tmp_path: Path, monkeypatch: Any, kind: str) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    game = outlast.variant("ffa_3").replace(**SHORT)
    if kind == "levels":
        game = game.vary(agents_health=outlast.distributions.integers(5, 60))
    env, rng = outlast.make_vec(game, 2, seed=5, first_world=3), np.random.default_rng(0)
    with outlast.record(env, tmp_path / "a.rec"):
        for seed in (5, 6):
            if kind == "levels":
                level = outlast.levels.Level
                env.set_levels([level({"agents_health": 7}, key=(8, 0, 2)), level({"agents_health": 9})])
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
                words = rf"agent {agent} and seed \d+, not agent {learner} and .*learner={agent}"
                with pytest.raises(ValueError, match=words):
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
    ("module", "library", "name"),
    [("minari", "minari", "minari:outlast/none-v0"), ("parquet", "pyarrow", "none.parquet")],
)
def test_without_the_library_the_error_names_the_cure(
    capsys: Any, recorded: Recorded, monkeypatch: Any, module: str, library: str, name: str
) -> None:
    monkeypatch.delitem(sys.modules, f"outlast.envs.datasets.{module}", raising=False)
    monkeypatch.setitem(sys.modules, library, None)
    status, _, err = export(capsys, recorded[0], name)
    assert (status, "pip install 'outlast[data]'" in err) == (2, True)
