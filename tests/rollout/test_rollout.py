"""Rollouts: the same numbers however worlds are divided, and the right ones; their files, and what fails."""

import json
import signal
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.ecs import NumberError
from outlast.envs.cli import main as cli
from outlast.envs.errors import EndlessError, RecordingError, UsageError
from outlast.envs.recording.file_format import RecordingWriter
from outlast.envs.rollout import local as rollouts
from outlast.envs.rollout import table_file
from outlast.envs.rollout.local import MAX_BATCH, RolloutTask, rollout, run_task, split_worlds
from outlast.envs.rollout.policies import POLICIES, random_policy, scripted_policy
from outlast.envs.rollout.summary import Summary
from tests.conftest import interrupted_after, run
from tests.helpers.execution_modes import short
from tests.helpers.outputs import length, rows_of

WORLDS, STEPS = 13, 160


def task(policy: str = "random", variant: str = "ffa_1") -> RolloutTask:
    return RolloutTask(short(variant).replace(ending_limit=25), POLICIES[policy], STEPS, seed=3)


def whole_episodes(policy: str = "random", variant: str = "ffa_1", seed: int = 3, episodes: int = 1) -> RolloutTask:
    """Whole episodes of very different lengths: agents strike each other dead, or the zone gets them in the end."""
    numbers = {"safe_zone_radii": (9.0, 4.0), "safe_zone_stand": 100, "safe_zone_shrink": 50}
    numbers |= {"agents_health": 5, "room_size": 20.0}
    return RolloutTask(outlast.variant(variant).replace(**numbers), POLICIES[policy], 0, seed, episodes)


def equal(one: Summary, other: Summary) -> bool:
    tables = ((one.sums, other.sums), (one.squares, other.squares))
    same = all(a.keys() == b.keys() and all(np.array_equal(a[key], b[key]) for key in a) for a, b in tables)
    numbers = [(summary.episodes, summary.episodes_per_world, summary.world_steps) for summary in (one, other)]
    return same and numbers[0] == numbers[1] and one.rows() == other.rows()


@pytest.mark.parametrize("policy", sorted(POLICIES))
@pytest.mark.parametrize("variant", ["ffa_1", "teams_3"])
@pytest.mark.by_day(4)
def test_batches_of_worlds_add_up_to_the_whole(policy, variant):
    work = task(policy, variant)
    whole = run_task(work, 0, WORLDS)
    assert whole.episodes >= WORLDS
    for parts in ([(0, 2), (2, WORLDS - 2)], [(0, 1), (1, WORLDS - 2), (WORLDS - 1, 1)]):
        assert equal(whole, Summary.merge(run_task(work, *part) for part in parts))
    assert not equal(whole, run_task(work, 1, WORLDS))


@pytest.mark.parametrize(("worlds", "workers"), [(1, 1), (1, 8), (5, 2), (256, 1), (257, 1), (1000, 3), (1024, 64)])
def test_batches_have_every_world_once_and_work_for_all(worlds, workers):
    parts = split_worlds(worlds, workers)
    assert [w for first, count in parts for w in range(first, first + count)] == list(range(worlds))
    assert max(count for _, count in parts) <= MAX_BATCH
    assert len(parts) >= min(workers, worlds) / 2


def test_sums_do_not_depend_on_the_order_of_worlds():
    """Of numbers for which they would, if they were rounded on the way."""
    rng = np.random.default_rng(0)
    values, ended = rng.normal(size=(50, 1000, 2)) * 10.0 ** rng.integers(-9, 9, (1000, 2)), np.ones(1000, bool)
    summaries = []
    for order in (np.arange(1000), rng.permutation(1000)):
        parts = []
        for worlds in np.split(order, [100, 300, 301]):
            parts.append(Summary())
            for row in values:
                parts[-1].add({"value": row[worlds]}, ended[worlds])
        summaries.append(Summary.merge(parts))
    assert summaries[0].rows() == summaries[1].rows()
    naive = [values.sum(0)[order].sum(0).tolist() for order in (np.arange(1000), rng.permutation(1000))]
    assert naive[0] != naive[1]


def test_means_and_errors_are_those_of_the_single_episodes():
    work = task(variant="teams_3")
    env = outlast.make_vec(work.scenario, WORLDS, seed=3)
    policy, episodes = random_policy(env, 3), []
    observations, _ = env.reset()
    for _ in range(STEPS):
        observations, _, _, _, info = env.step(policy(observations))
        for w in np.flatnonzero(info.get("_statistics", ())):
            episodes.append({key: values[w] for key, values in info["statistics"].items()})
    summary = run_task(work, 0, WORLDS)
    assert summary.episodes == len(episodes)
    for name, mean, error in summary.rows():
        key, _, k = name.partition(" ")
        values = np.array([np.atleast_1d(episode[key])[int(k or 0)] for episode in episodes], float)
        assert mean == pytest.approx(values.mean())
        assert error == pytest.approx(values.std(ddof=1) / np.sqrt(len(values)), abs=1e-7)
    assert {name for name, _, _ in summary.rows()} >= {"length", "return 0", "return 3", "kills 1", "deaths_zone"}


def test_progress_counts_world_steps_and_that_nothing_ended_is_said() -> None:
    assert "no episode ended" in str(run_task(RolloutTask(outlast.variant("ffa_1"), POLICIES["noop"], 2, 0), 0, 2))
    assert "no episode ended" in str(Summary.merge([]))
    env, seen = outlast.make_vec("ffa_1", 3, seed=0), []
    rollout(env, random_policy(env), 4, lambda summary: seen.append(summary.world_steps))
    assert seen == [3, 6, 9, 12]


def test_of_every_world_as_many_are_counted():
    work = whole_episodes(episodes=3)
    env, lengths = outlast.make_vec(work.scenario, WORLDS, seed=3), [[] for _ in range(WORLDS)]
    policy = random_policy(env, 3)
    observations, _ = env.reset()
    while min(map(len, lengths)) < 3:
        observations, _, _, _, info = env.step(policy(observations))
        for w in np.flatnonzero(info.get("_statistics", ())):
            lengths[w].append(int(info["statistics"]["length"][w]))
    summary = run_task(work, 0, WORLDS)
    assert max(map(len, lengths)) > 3
    assert summary.sums["length"].tolist() == [sum(each[:3]) for each in lengths]
    assert str(summary).startswith(f"{3 * WORLDS} whole episodes, the first 3 of every world\n")
    assert summary.rows() == Summary.merge([run_task(work, 0, 2), run_task(work, 2, WORLDS - 2)]).rows()


def test_whole_episodes_are_unbiased_and_those_that_fit_into_a_time_are_not():
    wide = run_task(whole_episodes(seed=11), 0, 2000)
    truth, error = length(wide)
    mean, own = length(run_task(whole_episodes(seed=12, episodes=2), 0, 300))
    assert abs(mean - truth) < 3 * np.hypot(own, error)
    env = outlast.make_vec(whole_episodes().scenario, 300, seed=12)
    cut = rollout(env, random_policy(env, 12), int(truth))
    short, claimed = length(cut)
    assert truth - short > 10 * np.hypot(claimed, error)
    assert "those cut off at the end are missing, so means lean towards short episodes" in str(cut)


def test_an_episode_without_an_end_is_not_waited_for_in_silence(monkeypatch, capsys):
    monkeypatch.setattr(rollouts, "MAX_STEPS", 40)
    never = outlast.variant("ffa_1").replace(safe_zone_damage=0)
    env = outlast.make_vec(never, 2, seed=0, first_world=7)
    with pytest.raises(EndlessError, match=r"world 7 has been in one episode for 40 steps, .* set ending_limit, or"):
        rollout(env, POLICIES["noop"](env, 0))
    assert rollout(env, POLICIES["noop"](env, 0), 50).episodes == 0
    env = outlast.make_vec(never.replace(ending_limit=60), 2, seed=0)
    assert length(rollout(env, POLICIES["noop"](env, 0))) == (60, 0)
    arguments = ("rollout", "ffa_1", "--set", "safe_zone_damage=0", "--worlds", "2", "--policy", "noop", "--quiet")
    assert cli.main(arguments) == 2
    assert capsys.readouterr().err.startswith("outlast: world 0 has been in one episode for 40 steps")


def test_worlds_whose_limits_differ_are_waited_for_each_by_its_own(monkeypatch):
    monkeypatch.setattr(rollouts, "MAX_STEPS", 40)
    never = outlast.variant("ffa_1").replace(safe_zone_damage=0, ending_limit=50)
    env = outlast.make_vec(never.vary(ending_limit=outlast.distributions.integers(50, 60)), 8, seed=0)
    assert 50 < length(rollout(env, POLICIES["noop"](env, 0)))[0] < 60
    env = outlast.make_vec(never.vary(ending_limit=outlast.distributions.choice(0, 50)), 8, seed=0)
    env.reset()
    endless = np.flatnonzero(env.numbers()["ending_limit"] == 0)
    assert 0 < endless.size < 8
    with pytest.raises(EndlessError, match=f"world {endless[0]} has been in one episode for 40 steps"):
        rollout(env, POLICIES["noop"](env, 0))


def test_the_limit_is_of_one_episode(monkeypatch):
    work = whole_episodes(episodes=10)
    expected = run_task(work, 0, 1)
    assert expected.world_steps > 700
    monkeypatch.setattr(rollouts, "MAX_STEPS", 700)
    assert equal(expected, run_task(work, 0, 1))


@pytest.mark.skipif(find_spec("ray") is not None, reason="Ray is installed")
def test_a_missing_ray_is_named_with_its_cure(capsys):
    assert cli.main(("rollout", "ffa_1", "--ray")) == 2
    cure = "pip install 'outlast[ray]' (ray[rllib]>=2.40, torch>=2.4)"
    assert capsys.readouterr().err == f"outlast: --ray needs Ray: {cure}\n"


@pytest.mark.parametrize("seed", [0, 1])
def test_chance_is_uniform_and_independent(seed):
    """Chi-squared of joint actions, and of pairs of them: of two steps, two agents, two worlds, two seeds."""
    env = outlast.make_vec("teams_1", 512, seed=0)
    policy, other = random_policy(env, seed), random_policy(env, seed + 1)
    weights = np.cumprod([1, *env.action_sizes[:-1]])
    draws = np.array([policy({}) @ weights for _ in range(100)])
    others = np.array([other({}) @ weights for _ in range(100)])
    assert deviation(draws, 216) < 5
    pairs = [(draws[1:], draws[:-1]), (draws[:, 1:], draws[:, :-1]), (draws[..., 1:], draws[..., :-1]), (draws, others)]
    for one, two in pairs:
        assert deviation(one * 216 + two, 216**2) < 5


def deviation(values: np.ndarray, count: int) -> float:
    """Standard deviations by which chi-squared of a uniform draw among `count` is off its mean."""
    counts = np.bincount(values.ravel(), minlength=count)
    expected = values.size / count
    return abs(((counts - expected) ** 2 / expected).sum() - (count - 1)) / np.sqrt(2 * (count - 1))


QUICK = {"safe_zone_stand": 10, "safe_zone_shrink": 5, "safe_zone_damage": 50}
COMMAND = ("rollout", "ffa_2", "--worlds=6", "--quiet", *(f"--set={name}={value}" for name, value in QUICK.items()))


def test_a_name_an_environment_and_the_command_give_the_same(capsys) -> None:
    by_name = outlast.rollout("ffa_2", "scripted", worlds=6, episodes=2, seed=3, **QUICK)
    for policy in (scripted_policy, lambda env: "scripted"):
        env = outlast.make_vec(outlast.variant("ffa_2").replace(**QUICK), 6, seed=3)
        assert str(outlast.rollout(env, policy(env), episodes=2)) == str(by_name)
        assert not env.closed
        env.close()
    _, out, _ = run(capsys, *COMMAND, "--episodes=2", "--seed=3", "--policy=scripted")
    assert out.split("\n", 2)[2] == f"{by_name}\n"
    assert by_name.episodes == 12
    assert outlast.rollout("ffa_2", worlds=2, steps=5).world_steps == 10


def test_what_an_environment_has_decided_is_refused() -> None:
    env = outlast.make_vec("ffa_2", 2, seed=0)
    for given, name in (({"worlds": 3}, "worlds"), ({"seed": 0}, "seed"), ({"melee_damage": 3}, "melee_damage")):
        with pytest.raises(UsageError, match=f"{name}: the environment has that already"):
            outlast.rollout(env, "random", **given)
    env.close()
    with pytest.raises(UsageError, match="steps and episodes exclude each other"):
        outlast.rollout("ffa_2", steps=5, episodes=2)
    with pytest.raises(UsageError, match=r"events and csv are both a\.csv: give another name for one"):
        outlast.rollout("ffa_2", csv="a.csv", events="./a.csv")
    for wrong in ({"worlds": 0}, {"episodes": 1.5}, {"steps": -1}, {"seed": -1}):
        with pytest.raises(ValueError, match="an integer >= "):
            outlast.rollout("ffa_2", **wrong)
    with pytest.raises(NumberError, match="no number 'wrlds'; did you mean worlds"):
        outlast.rollout("ffa_2", wrlds=3)
    with pytest.raises(UsageError, match="scriptd: did you mean scripted"):
        outlast.rollout("ffa_2", "scriptd")
    with pytest.raises(NumberError, match="the time limit of a scenario is its number ending_limit"):
        outlast.make_vec("ffa_2", 2, max_episode_steps=5)


def test_a_row_of_the_file_is_an_episode(capsys, tmp_path: Path) -> None:
    path, events = tmp_path / "a.csv", tmp_path / "b.csv"
    _, out, err = run(capsys, *COMMAND, "--episodes=3", "--csv", path, "--events", events)
    assert err == ""
    rows = rows_of(path)
    assert list(rows[0])[:2] == ["world", "episode"]
    pairs = [(int(row["world"]), int(row["episode"])) for row in rows]
    assert sorted(pairs) == [(w, k) for w in range(6) for k in (1, 2, 3)]
    assert {(int(row["world"]), int(row["episode"])) for row in rows_of(events)} == {*pairs}  # and of no others
    for line in out.split("std. error\n")[1].splitlines():
        name, mean, _ = line.rsplit(maxsplit=2)
        values = [float(row[name.replace(" ", "_")]) for row in rows]
        assert float(mean) == pytest.approx(np.mean(values), abs=1e-4), name


def test_the_summary_as_json(capsys, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    _, out, _ = run(capsys, *COMMAND, "--json", path, "--policy=scripted")
    found = json.loads(path.read_text())
    assert found["scenario"].startswith("ffa_2")
    assert found["numbers"]["safe_zone_damage"] == 50
    assert found["asked"]["policy"] == "scripted"
    assert (found["asked"]["episodes"], found["asked"]["steps"]) == (1, None)
    assert (found["episodes"], found["unbiased"]) == (6, True)
    mean = float(out.split("\nlength")[1].split()[0])
    assert found["statistics"]["length"]["mean"] == pytest.approx(mean, abs=1e-4)
    assert {"return_0", "return_1"} <= found["statistics"].keys()
    _, out, _ = run(capsys, *COMMAND, "--json", "-", "--policy=scripted")  # and nothing else on standard output
    assert json.loads(out)["statistics"] == found["statistics"]
    _, out, _ = run(capsys, *COMMAND[:-3], "--json=-", "--steps=1e1")
    assert json.loads(out)["unbiased"] is False


def test_the_summary_says_what_differs(capsys, tmp_path: Path) -> None:
    (tmp_path / "roles.json").write_text(
        '{"drawn": "never", "roles": [{"name": "a", "count": 1, "numbers": {"melee_damage": 7, "melee_reach": 1}}, '
        '{"name": "b", "count": 1, "numbers": {"melee_damage": 3}}]}'
    )
    more = ("--vary", "heals_amount=integers(5, 9)", "--roles", tmp_path / "roles.json", "--json", "-")
    found = json.loads(run(capsys, *COMMAND, *more)[1])
    assert found["varied"] == {"heals_amount": ["integers", 5, 9]}
    assert found["roles"]["roles"][0]["numbers"] == {"melee_damage": 7, "melee_reach": 1.0}
    assert {"heals_amount", "melee_damage"}.isdisjoint(found["numbers"])
    assert found["numbers"]["melee_reach"] == 2.0


def test_files_are_never_overwritten(capsys, tmp_path: Path) -> None:
    for option, name in (("--csv", "a.csv"), ("--events", "a.csv"), ("--json", "a.json"), ("--record", "a.rec")):
        (tmp_path / name).write_text("mine")
        status, out, err = run(capsys, *COMMAND, option, tmp_path / name)
        assert (status, out, "never overwrite files" in err) == (2, "", True)
        assert (tmp_path / name).read_text() == "mine"


def test_a_full_disk_costs_no_statistics(capsys, tmp_path: Path, monkeypatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    def full_later(file: RecordingWriter) -> None:
        flush(file) if not file.written else full()

    flush = RecordingWriter._flush
    monkeypatch.setattr(RecordingWriter, "_flush", full_later)
    monkeypatch.setattr(table_file._Csv, "write", full)
    for option, name in (("--record", "a.rec"), ("--csv", "a.csv"), ("--events", "b.csv")):
        status, out, err = run(capsys, *COMMAND, option, tmp_path / name)
        assert status == 2
        assert "No space left on device" in err
        assert len(err.splitlines()) == 1
        assert "6 whole episodes, the first of every world" in out
        assert "length" in out
    assert not [file.name for file in tmp_path.iterdir() if file.suffix == ".csv"]
    monkeypatch.setattr(table_file, "ROWS", 3)  # written while worlds are played, which this ends
    _, out, err = run(capsys, *COMMAND, "--csv", tmp_path / "a.csv")
    assert "there are no episodes" in err
    assert "episodes ended; those cut off at the end are missing, so means lean towards short episodes" in out
    latest: list[Summary] = []
    with pytest.raises(RecordingError):
        outlast.rollout("ffa_2", worlds=2, record=tmp_path / "b.rec", progress=latest.append, **QUICK)
    assert latest[-1].episodes == 2


def test_parquet_has_the_same_rows_with_types(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow: outlast[data]")
    for kind in ("csv", "parquet"):
        files = {name: tmp_path / f"{name}.{kind}" for name in ("csv", "events")}
        outlast.rollout("ffa_2", "noop", others="scripted", worlds=4, **files, **QUICK)
    for name in ("csv", "events"):
        table, rows = parquet.read_table(tmp_path / f"{name}.parquet"), rows_of(tmp_path / f"{name}.csv")
        types = {field.name: str(field.type) for field in table.schema}
        assert list(types) == list(rows[0])
        if name == "csv":
            assert {types[key] for key in ("world", "episode", "own_side")} == {"int64"}
            assert (types["against"], types["return_0"]) == ("string", "double")
        else:
            assert list(types.values()) == [*3 * ["int64"], *3 * ["string"], "double", *2 * ["string"]]
        for found, row in zip(table.to_pylist(), rows, strict=True):
            written = {key: f"{value:g}" if key == "amount" and value else value for key, value in found.items()}
            assert {key: "" if value is None else str(value) for key, value in written.items()} == row


def test_ctrl_c_while_files_are_closed_leaves_all_of_them_whole(tmp_path: Path, monkeypatch) -> None:
    """It comes behind the last step, as often as somebody presses it, and the exception has the summary."""
    write, files = table_file._Csv.write, {name: tmp_path / f"{name}.csv" for name in ("csv", "events")}

    def interrupted(self: Any, table: Any) -> None:
        write(self, table)
        signal.raise_signal(signal.SIGINT)

    whole = outlast.rollout("ffa_2", worlds=4, csv=tmp_path / "a.csv", events=tmp_path / "b.csv", **QUICK)
    monkeypatch.setattr(table_file._Csv, "write", interrupted)
    with pytest.raises(KeyboardInterrupt) as stopped:
        outlast.rollout("ffa_2", worlds=4, **files, **QUICK)
    assert stopped.value.args[0].as_dict() == whole.as_dict()
    assert files["csv"].read_bytes() == (tmp_path / "a.csv").read_bytes()
    assert files["events"].read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_a_second_ctrl_c_costs_nothing(tmp_path: Path, monkeypatch) -> None:
    """The first one stops the play, the second comes while its files are written."""
    write, files = table_file._Csv.write, {name: tmp_path / f"{name}.csv" for name in ("csv", "events")}

    def interrupted(self: Any, table: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        write(self, table)

    monkeypatch.setattr(table_file._Csv, "write", interrupted)
    env = outlast.make_vec("ffa_2", 6, seed=0, **QUICK)
    with pytest.raises(KeyboardInterrupt) as stopped:
        outlast.rollout(env, interrupted_after(40)(env, 0), episodes=5, **files)
    partial = stopped.value.args[0]
    assert partial.episodes == len(rows_of(files["csv"])) > 0
    assert str(partial).startswith(f"{partial.episodes} episodes ended; those cut off at the end are missing, so")
    assert rows_of(files["events"])


def test_the_callers_own_handler_gets_every_ctrl_c(tmp_path: Path) -> None:
    """One that raises nothing does not stop a rollout; only of those that interrupt it the second is dropped."""
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: came.append(number))

    def press(summary: Summary) -> None:
        signal.raise_signal(signal.SIGINT)

    try:
        outlast.rollout("ffa_2", "noop", 5, press, worlds=2, csv=tmp_path / "a.csv", **QUICK)
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(came) >= 5


def test_what_another_process_wrote_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    message = r"a\.csv exists, as another process has just written it; this is in .*a-2\.csv"
    with pytest.raises(UsageError, match=message):
        outlast.rollout("ffa_2", "noop", 20, lambda summary: path.write_text("theirs"), worlds=2, csv=path, **QUICK)
    assert path.read_text() == "theirs"
    assert len(rows_of(tmp_path / "a-2.csv")) > 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a-2.csv", "a.csv"]


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_the_statistics_of_each_episode_are_kept_as_arrays(mode: str, tmp_path: Path) -> None:
    """Masked where an agent is absent, and as in the file."""
    scenario = outlast.variant("ffa_2").replace(**QUICK).vary(n_agents=outlast.distributions.integers(2, 4))
    env = outlast.make_vec(scenario, 5, seed=0, first_world=7, autoreset_mode=mode)
    summary = outlast.rollout(env, "random", episodes=3, keep=True, csv=tmp_path / "a.csv")
    found, rows = summary.arrays(), rows_of(tmp_path / "a.csv")
    assert found["world"].tolist() == np.repeat(np.arange(7, 12), 3).tolist()
    assert found["episode"].tolist() == [1, 2, 3] * 5
    rows.sort(key=lambda row: (int(row["world"]), int(row["episode"])))
    assert found["length"].tolist() == [int(row["length"]) for row in rows]
    assert not np.ma.isMaskedArray(found["length"])
    assert found["length"].mean() == pytest.approx(length(summary)[0])
    absent = np.arange(4) >= found["agents_count"][:, None]
    assert 0 < absent.sum() < absent.size
    for key in ("return", "kills"):
        for arrays in (found, Summary.merge([summary]).arrays()):
            assert np.ma.getmaskarray(arrays[key]).tolist() == absent.tolist()
        cells = [[row[f"{key}_{i}"] for i in range(4)] for row in rows]
        assert [["" if value is None else str(value) for value in row] for row in found[key].tolist()] == cells


def test_summaries_merge_with_their_arrays() -> None:
    parts = []
    for first in (0, 3):
        env = outlast.make_vec("ffa_2", 3, seed=0, first_world=first, **QUICK)
        parts.append(outlast.rollout(env, "noop", keep=True))
        env.close()
    whole = outlast.rollout("ffa_2", "noop", worlds=6, seed=0, keep=True, **QUICK)
    merged, expected = Summary.merge(parts).arrays(), whole.arrays()
    assert merged.keys() == expected.keys()
    for key, values in expected.items():
        np.testing.assert_array_equal(merged[key], values)
    with pytest.raises(UsageError, match="were not kept"):
        Summary.merge([parts[0], Summary()]).arrays()
    with pytest.raises(UsageError, match=r"were not kept: call outlast\.rollout\(\.\.\., keep=True\)"):
        outlast.rollout("ffa_2", worlds=2, steps=2).arrays()
    assert outlast.rollout("ffa_2", worlds=2, steps=2, keep=True).arrays() == {}


def test_the_first_death_is_of_episodes_with_a_death() -> None:
    numbers = {"ending_limit": 150, "agents_health": 60, "melee_damage": 3}
    found = outlast.rollout("ffa_2", "scripted", worlds=16, seed=0, keep=True, **numbers)
    each = found.arrays()["first_death"]
    died = each[each > 0]
    assert 0 < len(died) < len(each)
    mean, error = next((mean, error) for name, mean, error in found.rows() if name == "first_death")
    assert mean == pytest.approx(died.mean())
    assert error == pytest.approx(died.std() / (len(died) - 1) ** 0.5 if len(died) > 1 else np.nan, nan_ok=True)
    assert found.as_dict()["statistics"]["first_death"]["episodes"] == len(died)
    assert "episodes" in str(found).splitlines()[2]
    assert outlast.rollout("ffa_2", "scripted", worlds=4, seed=0, **QUICK).episodes_of() == {}


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_files_count_the_episodes_of_a_world(tmp_path: Path, mode: str) -> None:
    """Whatever levels they are of: a level's key has a number of an episode, too."""
    varied = outlast.variant("ffa_2").replace(ending_limit=15, agents_health=5)
    varied = varied.vary(melee_damage=outlast.distributions.integers(5, 9))
    env = outlast.make_vec(varied, 2, seed=0, autoreset_mode=mode)
    env.set_levels([outlast.levels.Level(key=(9, 0, 2)), outlast.levels.Level(key=(9, 1, 50))])
    files = {name: tmp_path / f"{name}.csv" for name in ("csv", "events")}
    found = outlast.rollout(env, "hunter", episodes=3, keep=True, **files)
    numbers = [(int(row["world"]), int(row["episode"])) for row in rows_of(files["csv"])]
    assert sorted(numbers) == [(w, e) for w in range(2) for e in (1, 2, 3)]
    assert found.arrays()["episode"].tolist() == [1, 2, 3] * 2
    ended = {(row["world"], row["episode"]): row["first_death"] for row in rows_of(files["csv"])}
    died = {(row["world"], row["episode"]): row["tick"] for row in rows_of(files["events"]) if row["event"] == "death"}
    assert died
    assert ended == {episode: died.get(episode, "") for episode in ended}  # nothing where nobody died


def test_files_say_who_played_and_how_it_ended(tmp_path: Path) -> None:
    path, others = tmp_path / "league.csv", {"hunter": 1.0, "noop": 2.0}
    found = outlast.rollout("teams_2", "scripted", others=others, worlds=8, episodes=2, csv=path, keep=True, **QUICK)
    rows, arrays = rows_of(path), found.arrays()
    assert list(rows[0])[:5] == ["world", "episode", "against", "own_side", "result"]
    for name, counts in found.outcomes.items():
        results = [row["result"] for row in rows if row["against"] == name]
        assert [results.count(result) for result in ("won", "drawn", "lost")] == counts.tolist()
    for row in rows:  # sides take turns
        assert int(row["own_side"]) == (int(row["world"]) + int(row["episode"])) % 2
    key = {(int(row["world"]), int(row["episode"])): row for row in rows}
    for k in range(16):
        row = key[int(arrays["world"][k]), int(arrays["episode"][k])]
        kept = [str(arrays[name][k]) for name in ("against", "own_side", "result")]
        assert kept == [row["against"], row["own_side"], row["result"]]
    assert found.as_dict()["against"]["noop"].keys() == {"won", "drawn", "lost"}
    assert sum(counts.sum() for counts in found.outcomes.values()) == 16
    assert "against" not in outlast.rollout("teams_2", "scripted", worlds=2, keep=True, **QUICK).arrays()


def test_a_statistic_of_agents_may_be_called_like_a_moment() -> None:
    found = Summary()
    where = np.array([True, True, False])
    found.add({"first_death": np.array([[3, 0], [5, 4], [9, 9]])}, where)
    assert [mean for _, mean, _ in found.rows()] == [4, 2]
