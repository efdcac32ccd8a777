"""outlast.rollout from a game's name; files of episodes and summaries; what is printed when something fails."""

import contextlib
import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.ecs import NumberError
from outlast.envs.errors import RecordingError, UsageError
from outlast.envs.recording.recorder import _Appender
from outlast.envs.rollout import table_file
from outlast.envs.rollout.policies import scripted_policy
from outlast.envs.rollout.summary import Summary
from tests.conftest import COMPILED, interrupted_after, run
from tests.helpers.outputs import length, rows_of

SHORT = {"safe_zone_stand": 10, "safe_zone_shrink": 5, "safe_zone_damage": 50}
COMMAND = ("rollout", "ffa_2", "--worlds=6", "--quiet", *(f"--set={name}={value}" for name, value in SHORT.items()))


def test_a_name_an_environment_and_the_command_give_the_same(capsys: Any) -> None:
    by_name = outlast.rollout("ffa_2", "scripted", worlds=6, episodes=2, seed=3, **SHORT)
    for policy in (scripted_policy, lambda env: "scripted"):
        env = outlast.make_vec(outlast.variant("ffa_2").replace(**SHORT), 6, seed=3)
        assert str(outlast.rollout(env, policy(env), episodes=2)) == str(by_name)
        assert not env.closed
        env.close()
    _, out, _ = run(capsys, *COMMAND, "--episodes=2", "--seed=3", "--policy=scripted")
    assert out.split("\n", 2)[2] == f"{by_name}\n"
    assert by_name.episodes == 12
    assert outlast.rollout("ffa_2", worlds=2, steps=5).world_steps == 10


def test_a_function_gets_observations_of_its_own() -> None:
    """As nobody knows what it does with them, nor what it returns."""
    kept = []
    with contextlib.closing(outlast.make_vec("ffa_2", 3)) as env:
        actions = np.tile(env.noop, (3, env.num_agents, 1))

    def idle(observations: dict[str, Any]) -> Any:
        kept.append(observations["own"])
        return actions

    outlast.rollout("ffa_2", idle, 4, worlds=3)
    assert len({id(array) for array in kept}) == 4
    assert not np.array_equal(kept[0], kept[3])


def test_others_are_counted_in_the_summary() -> None:
    summary = outlast.rollout("ffa_2", "scripted", worlds=8, others={"noop": 1, "random": 1}, **SHORT)
    assert sum(counts.sum() for counts in summary.outcomes.values()) == 8
    assert str(summary).splitlines()[-2].startswith("noop ")
    found = summary.as_dict()
    assert found["against"]["noop"].keys() == {"won", "drawn", "lost"}
    assert found["unbiased"] is True


def test_what_an_environment_has_decided_is_refused() -> None:
    env = outlast.make_vec("ffa_2", 2, seed=0)
    for given, name in (({"worlds": 3}, "worlds"), ({"seed": 0}, "seed"), ({"melee_damage": 3}, "melee_damage")):
        with pytest.raises(UsageError, match=f"rollout: {name}: the environment has that already"):
            outlast.rollout(env, "random", **given)
    env.close()
    with pytest.raises(UsageError, match="steps and episodes exclude each other"):
        outlast.rollout("ffa_2", steps=5, episodes=2)
    for wrong in ({"worlds": 0}, {"episodes": 1.5}, {"steps": -1}, {"seed": -1}):
        with pytest.raises(ValueError, match="an integer >= "):
            outlast.rollout("ffa_2", **wrong)
    with pytest.raises(NumberError, match="no number 'wrlds'; did you mean worlds"):
        outlast.rollout("ffa_2", wrlds=3)
    with pytest.raises(UsageError, match="scriptd: did you mean scripted"):
        outlast.rollout("ffa_2", "scriptd")


def test_a_row_of_the_file_is_an_episode(capsys: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    _, out, err = run(capsys, *COMMAND, "--episodes=3", "--csv", path)
    assert err == ""
    rows = rows_of(path)
    assert list(rows[0])[:2] == ["world", "episode"]
    pairs = [(int(row["world"]), int(row["episode"])) for row in rows]
    assert sorted(pairs) == [(w, k) for w in range(6) for k in (1, 2, 3)]
    for line in out.split("std. error\n")[1].splitlines():
        name, mean, _ = line.rsplit(maxsplit=2)
        values = [float(row[name.replace(" ", "_")]) for row in rows]
        assert float(mean) == pytest.approx(np.mean(values), abs=1e-4), name


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_episodes_have_their_own_numbers_however_worlds_restart(mode: str, tmp_path: Path) -> None:
    env = outlast.make_vec(
        "ffa_2", 3, seed=0, autoreset_mode="NextStep" if mode == "next_step" else "SameStep", **SHORT
    )
    outlast.rollout(env, "random", episodes=2, csv=tmp_path / "a.csv")
    env.close()
    rows = rows_of(tmp_path / "a.csv")
    assert sorted((int(row["world"]), int(row["episode"])) for row in rows) == [
        (w, k) for w in range(3) for k in (1, 2)
    ]


def test_the_summary_as_json(capsys: Any, tmp_path: Path) -> None:
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


def test_the_summary_says_what_differs(capsys: Any, tmp_path: Path) -> None:
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


def test_episodes_or_steps(capsys: Any) -> None:
    with pytest.raises(SystemExit):
        run(capsys, *COMMAND, "--episodes", "1", "--steps", "3")
    assert "not allowed with argument" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "name", "words"),
    [
        ("--csv", "a.txt", "episodes are written as NAME.csv"),
        ("--csv", "a.csv", "episodes overwrite nothing"),
        ("--csv", "none/b.csv", "there is no folder"),
        ("--json", "a.txt", "summaries are written as NAME.json"),
        ("--json", "a.json", "summaries overwrite nothing"),
    ],
)
def test_files_that_cannot_be_are_refused_before_anything_is_played(
    capsys: Any, tmp_path: Path, option: str, name: str, words: str
) -> None:
    for kept in ("a.csv", "a.json"):
        (tmp_path / kept).write_text("mine")
    status, out, err = run(capsys, *COMMAND, option, tmp_path / name)
    assert (status, out) == (2, "")
    assert words in err
    assert len(err.splitlines()) == 1
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.csv", "a.json"]
    assert (tmp_path / "a.csv").read_text() == "mine"


def test_a_full_disk_costs_no_statistics(capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    def full_later(file: _Appender) -> None:
        flush(file) if not file.written else full()

    flush = _Appender._flush
    monkeypatch.setattr(_Appender, "_flush", full_later)
    monkeypatch.setattr(table_file.TableFile, "flush", full)
    for option, name in (("--record", "a.rec"), ("--csv", "a.csv"), ("--events", "b.csv")):
        status, out, err = run(capsys, *COMMAND, option, tmp_path / name)
        assert status == 2
        assert "No space left on device" in err
        assert len(err.splitlines()) == 1
        assert "6 whole episodes, the first of every world" in out
        assert "length" in out
    assert not [file.name for file in tmp_path.iterdir() if file.suffix == ".csv"]
    latest: list[Summary] = []
    with pytest.raises(RecordingError):
        outlast.rollout("ffa_2", worlds=2, record=tmp_path / "b.rec", progress=latest.append, **SHORT)
    assert latest[-1].episodes == 2


def test_what_a_full_disk_stops_is_reported_as_stopped(capsys: Any, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(table_file, "ROWS", 3)

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(table_file._Csv, "write", full)
    status, out, err = run(capsys, *COMMAND, "--csv", tmp_path / "a.csv")
    assert status == 2
    assert "there are no episodes" in err
    assert "episodes ended; those cut off at the end are missing, so means lean towards short episodes" in out


def test_one_file_is_not_written_twice(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"events and csv are both .*a\.csv: give another name for one"):
        outlast.rollout("ffa_2", worlds=2, csv=tmp_path / "a.csv", events=tmp_path / "." / "a.csv", **SHORT)
    assert not (tmp_path / "a.csv").exists()


def test_ctrl_c_while_files_are_closed_leaves_all_of_them_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes behind the last step, as often as somebody presses it, and the exception has the summary."""
    write, files = table_file._Csv.write, {name: tmp_path / f"{name}.csv" for name in ("csv", "events")}

    def interrupted(self: Any, table: Any) -> None:
        write(self, table)
        signal.raise_signal(signal.SIGINT)

    whole = outlast.rollout("ffa_2", worlds=4, csv=tmp_path / "a.csv", events=tmp_path / "b.csv", **SHORT)
    monkeypatch.setattr(table_file._Csv, "write", interrupted)
    with pytest.raises(KeyboardInterrupt) as stopped:
        outlast.rollout("ffa_2", worlds=4, **files, **SHORT)
    assert stopped.value.args[0].as_dict() == whole.as_dict()
    assert files["csv"].read_bytes() == (tmp_path / "a.csv").read_bytes()
    assert files["events"].read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_a_second_ctrl_c_costs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one stops the play, the second comes while its files are written."""
    write, files = table_file._Csv.write, {name: tmp_path / f"{name}.csv" for name in ("csv", "events")}

    def interrupted(self: Any, table: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        write(self, table)

    monkeypatch.setattr(table_file._Csv, "write", interrupted)
    env = outlast.make_vec("ffa_2", 6, seed=0, **SHORT)
    with pytest.raises(KeyboardInterrupt) as stopped:
        outlast.rollout(env, interrupted_after(40)(env, 0), episodes=5, **files)
    assert stopped.value.args[0].episodes == len(rows_of(files["csv"])) > 0
    assert rows_of(files["events"])
    env.close()


def test_the_callers_own_handler_gets_every_ctrl_c(tmp_path: Path) -> None:
    """One that raises nothing does not stop a rollout; only of those that interrupt it the second is dropped."""
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: came.append(number))

    def press(summary: Summary) -> None:
        signal.raise_signal(signal.SIGINT)

    try:
        outlast.rollout("ffa_2", "noop", 5, press, worlds=2, csv=tmp_path / "a.csv", **SHORT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(came) >= 5


def test_what_another_process_wrote_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    message = r"a\.csv exists, as another process has written it meanwhile; this is in .*a-2\.csv"
    with pytest.raises(UsageError, match=message):
        outlast.rollout("ffa_2", "noop", 20, lambda summary: path.write_text("theirs"), worlds=2, csv=path, **SHORT)
    assert path.read_text() == "theirs"
    assert len(rows_of(tmp_path / "a-2.csv")) > 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a-2.csv", "a.csv"]


def test_ctrl_c_leaves_whole_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    env = outlast.make_vec("ffa_2", 6, seed=0, **SHORT)
    with pytest.raises(KeyboardInterrupt) as stopped:
        outlast.rollout(env, interrupted_after(40)(env, 0), episodes=5, csv=tmp_path / "a.csv")
    lines = rows_of(tmp_path / "a.csv")
    assert stopped.value.args[0].episodes == len(lines) > 0
    env.close()


@pytest.mark.nightly
@pytest.mark.skipif(not COMPILED, reason="thousands of episodes")
def test_whole_episodes_of_the_scripted_duel_are_as_long_as_in_the_long_run() -> None:
    """455 ± 2 steps, the mean over 20,000 steps of 256 worlds; with 2000 steps it is 421."""
    mean, error = length(outlast.rollout("ffa_2", "scripted", worlds=1024))
    assert error < 8
    assert abs(mean - 455) < 3 * np.hypot(error, 2)
    cut, claimed = length(outlast.rollout("ffa_2", "scripted", 500, worlds=1024))
    assert 455 - cut > 10 * claimed


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_the_statistics_of_each_episode_are_kept_as_arrays(mode: str, tmp_path: Path) -> None:
    env = outlast.make_vec("ffa_2", 5, seed=0, first_world=7, autoreset_mode=mode, **SHORT)
    summary = outlast.rollout(env, "random", episodes=3, keep=True, csv=tmp_path / "a.csv")
    found, rows = summary.arrays(), rows_of(tmp_path / "a.csv")
    assert found["return"].shape == (15, env.num_agents)
    assert found["world"].tolist() == np.repeat(np.arange(7, 12), 3).tolist()
    assert found["episode"].tolist() == [1, 2, 3] * 5
    rows.sort(key=lambda row: (int(row["world"]), int(row["episode"])))
    assert found["length"].tolist() == [int(row["length"]) for row in rows]
    assert found["return"][:, 1].tolist() == [float(row["return_1"]) for row in rows]
    assert found["length"].mean() == pytest.approx(length(summary)[0])
    env.close()


def test_arrays_that_were_not_kept_are_refused() -> None:
    with pytest.raises(UsageError, match=r"were not kept: say outlast\.rollout\(\.\.\., keep=True\)"):
        outlast.rollout("ffa_2", worlds=2, steps=2).arrays()
    assert outlast.rollout("ffa_2", worlds=2, steps=2, keep=True).arrays() == {}


def test_summaries_merge_with_their_arrays() -> None:
    parts = []
    for first in (0, 3):
        env = outlast.make_vec("ffa_2", 3, seed=0, first_world=first, **SHORT)
        parts.append(outlast.rollout(env, "noop", keep=True))
        env.close()
    whole = outlast.rollout("ffa_2", "noop", worlds=6, seed=0, keep=True, **SHORT)
    merged, expected = Summary.merge(parts).arrays(), whole.arrays()
    assert merged.keys() == expected.keys()
    for key, values in expected.items():
        np.testing.assert_array_equal(merged[key], values)
    with pytest.raises(UsageError, match="were not kept"):
        Summary.merge([parts[0], Summary()]).arrays()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_arrays_mask_who_is_absent(mode: str) -> None:
    scenario = outlast.variant("ffa_2").replace(**SHORT).vary(n_agents=outlast.integers(2, 4))
    env = outlast.make_vec(scenario, 8, seed=0, autoreset_mode=mode)
    summary = outlast.rollout(env, "random", episodes=2, keep=True)
    found, merged = summary.arrays(), Summary.merge([summary]).arrays()
    env.close()
    absent = np.arange(4) >= found["agents_count"][:, None]
    assert 0 < absent.sum() < absent.size
    for key in ("return", "kills"):
        assert np.ma.getmaskarray(found[key]).tolist() == np.ma.getmaskarray(merged[key]).tolist() == absent.tolist()
        assert found[key].mean() == pytest.approx(found[key].data[~absent].mean())
    assert not np.ma.isMaskedArray(found["length"])


# ---- what numbers are of


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
    assert outlast.rollout("ffa_2", "scripted", worlds=4, seed=0, **SHORT).episodes_of() == {}


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_files_count_the_episodes_of_a_world(tmp_path: Path, mode: str) -> None:
    """Whatever levels they are of: a level's key has a number of an episode, too."""
    varied = (
        outlast.variant("ffa_2").replace(ending_limit=15, agents_health=5).vary(melee_damage=outlast.integers(5, 9))
    )
    env = outlast.make_vec(varied, 2, seed=0, autoreset_mode=mode)
    env.set_levels([outlast.Level(key=(9, 0, 2)), outlast.Level(key=(9, 1, 50))])
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
    found = outlast.rollout("teams_2", "scripted", others=others, worlds=8, episodes=2, csv=path, keep=True, **SHORT)
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
    plain = outlast.rollout("teams_2", "scripted", worlds=2, keep=True, **SHORT).arrays()
    assert "against" not in plain


def test_a_statistic_of_agents_may_be_called_like_a_moment() -> None:
    """Which is one number of an episode."""
    found = Summary()
    where = np.array([True, True, False])
    found.add({"first_death": np.array([[3, 0], [5, 4], [9, 9]])}, where)
    assert [mean for _, mean, _ in found.rows()] == [4, 2]
