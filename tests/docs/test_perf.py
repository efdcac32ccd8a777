"""perf.step beside the original: a small package with the original's interface stands in for it."""

import csv
import json
import re
import sys
from pathlib import Path

import pytest

from perf import compare, edit, interfaces, peer_steps, peers, profile, step, vector_step
from perf.original import Original

# Prints, and empties parts of its configuration, as the original does; logs its arguments. A step takes 2 ms of wall
# time, and very little processor time.
STAND_IN = """
import json, time
from pathlib import Path

class Space:
    def seed(self, seed): self.count = 1000 * seed
    def sample(self):
        self.count += 1
        return (self.count,)

class MaSurvival:
    def __init__(self, config=None):
        self.asked = [config["agents"].pop("n_agents"), config["heals"]["reset_spawns"]["n_items"],
                      config["boxes"]["reset_spawns"]["n_boxes"], config["ends_after"]]
        self.action_space, self.ends, self.steps = Space(), config["ends_after"], None
        self.log = Path(__file__).with_name("log")
        print("Splitting agents into 2 teams.")
    def reset(self):
        time.sleep(0.01)
        self.first, self.steps, self.over = float(self.np_random.random()), 0, False
    def step(self, actions):
        if self.over or self.steps == 100:
            raise RuntimeError("played on after the end")
        time.sleep(0.002)
        self.steps += 1
        self.over = self.steps == self.ends
        if self.over or self.steps == 100:
            print("done")
            with self.log.open("a") as file:
                print(json.dumps([*self.asked, self.steps, actions[0], self.first]), file=file)
        return {}, (), self.over, {}
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder like the original's, with two experiments: of long episodes, and of episodes of 40 steps."""
    folder = tmp_path / "check out"
    (folder / "masurvival" / "envs").mkdir(parents=True)
    (folder / "masurvival" / "envs" / "masurvival_env.py").write_text(STAND_IN)
    items = {"heals": {"reset_spawns": {"n_items": 15}}, "boxes": {"reset_spawns": {"n_boxes": 8}}}
    for name, ends in (("1v1_heals_low", 1000), ("1v1_all_mid", 40)):
        (folder / "experiments" / name).mkdir(parents=True)
        config = json.dumps({"agents": {"n_agents": 2}, "ends_after": ends} | items)
        (folder / "experiments" / name / "env.json").write_text(config)
    return folder


def log(checkout: Path) -> list[list[float]]:
    return [json.loads(line) for line in (checkout / "masurvival" / "envs" / "log").read_text().splitlines()]


def printed(text: str) -> list[list[str]]:
    """The cells of each line."""
    return [re.split(r"\s{2,}", line.strip()) for line in text.splitlines() if line.strip()]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Calls of perf.step with one row, ffa_1."""
    monkeypatch.setattr(step, "ROWS", [row for row in step.ROWS if row.name == "ffa_1"])
    monkeypatch.setattr(step, "STEPS", 150)

    def call(*options: str) -> str:
        monkeypatch.setattr(sys, "argv", ["perf.step", "--worlds", "2", "3", *options])
        step.main()
        return capsys.readouterr().out

    return call


@pytest.mark.nightly
def test_both_are_timed_in_one_run(run, checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perf.table.FOLDER", tmp_path)
    out = printed(run("--original", f"{sys.executable}:{checkout}", "--save", "here"))
    heads = [k for k, line in enumerate(out) if line[0] == "row"]
    assert [out[k] for k in heads] == [
        ["row", "paper", "2 worlds", "3 worlds", "outlast"],
        ["row", "original", "outlast", "times faster", "round by round"],
    ]
    name, original, ours, ratio, spread = out[heads[1] + 1]
    assert name == "ffa_1"
    assert 0 < float(original) < 1500  # microseconds of the processor; a step lasts 2000
    assert ours == out[heads[0] + 1][-1]
    assert float(ratio) == pytest.approx(float(original) / float(ours), rel=2e-3)
    least, most = map(float, spread.split(" to "))
    assert 0 < least <= most
    assert out[heads[1] + 2] == ["geometric mean of the variants", ratio]
    with (tmp_path / "here" / "original.csv").open() as file:
        assert list(csv.reader(file))[1] == out[heads[1] + 1]
    assert f"; the original: Python {sys.version.split()[0]}, numpy" in (tmp_path / "here" / "original.txt").read_text()
    # five rounds of two whole episodes, the same ones in each
    episodes = log(checkout)
    assert [line[:5] for line in episodes] == [[2, 15, 8, 1000, 100]] * 10
    assert episodes[:2] * 5 == episodes
    assert episodes[0][-1] != episodes[1][-1]


def test_counts_are_changed_and_ended_episodes_are_left(checkout: Path) -> None:
    with Original(f"{sys.executable}:{checkout}") as original:
        process = original._process
        ask = original.timer("1v1_all_mid", {"agents": 5, "heals": 0, "boxes": 10}, steps=90, limit=100)
        assert ask() > 0
    assert process.poll() == 0
    assert [line[:5] for line in log(checkout)] == [[5, 0, 10, 40, 40]] * 3


def test_what_cannot_be_measured_or_kept_is_said_ahead_of_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "taken").touch()
    monkeypatch.setattr("perf.table.FOLDER", tmp_path)
    mistakes = [
        (vector_step, ("--worlds", "0"), "a whole number from 1 is needed"),
        (vector_step, ("--save", "taken"), "give another name"),
        (profile, ("ffa_9",), "argument scenario: there is no variant 'ffa_9'"),
        (step, ("--original", sys.executable), "expected PYTHON:CHECKOUT, an interpreter and the original's folder"),
        (step, ("--original", f"{sys.executable}:{tmp_path}"), f"there is no {tmp_path}/masurvival"),
    ]
    for script, given, message in mistakes:
        monkeypatch.setattr(sys, "argv", [script.__name__, *given])
        with pytest.raises(SystemExit):
            script.main()
        assert message in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore")  # of the libraries
def test_every_interface_is_timed_that_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interfaces, "SECONDS", 0.001)
    monkeypatch.setattr(interfaces, "STEPS", 2)
    found = {label: row for label, *row in interfaces.rows("ffa_1", 3)}
    assert found.keys() >= {"make_vec", "make_vec(copy=False)", "make_agents", "gymnasium.make", "gymnasium.make_vec"}
    assert found.keys() <= interfaces.INTERFACES.keys()
    for us, rate, share in found.values():
        assert us > 0
        assert float(rate.replace(",", "")) > 0
        assert float(share.rstrip("%")) > 0


STEP = """
import time
from types import SimpleNamespace

def make_vec(name, worlds, seed, threads):
    step = lambda actions: time.sleep({seconds})
    return SimpleNamespace(reset=lambda: None, action_sizes=[2] * 6, num_agents=2, step=step)
"""


def test_two_checkouts_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The code of each, here of stand-ins that take no time, and 20 ms a step."""
    folders = [tmp_path / name for name in ("old", "new")]
    for folder, seconds in zip(folders, (0, 0.02), strict=True):
        (folder / ".src" / "outlast").mkdir(parents=True)
        (folder / ".src" / "outlast" / "__init__.py").write_text(STEP.format(seconds=seconds))
        (folder / "perf").mkdir()
        (folder / "perf" / "rows.py").write_text("scenario = str")
    for name, value in (("STARTS", 2), ("ROUNDS", 3), ("SECONDS", 0.05)):
        monkeypatch.setattr(compare, name, value)
    times = compare.compared(*folders, "ffa_1", 2, threads=2, specialize=True)  # which these cannot
    assert times.shape == (6, 2)
    assert times[:, 1].min() > max(9_000, times[:, 0].min())  # microseconds of one of two worlds
    monkeypatch.setattr(sys, "argv", ["perf.compare", str(tmp_path), str(folders[0])])
    with pytest.raises(SystemExit):
        compare.main()
    assert f"{tmp_path} is no checkout of outlast: there is no .src/outlast in it" in capsys.readouterr().err


def test_what_the_edit_loop_edits_is_there(tmp_path: Path) -> None:
    game = edit.Game(tmp_path)
    for name, old, _, _ in edit.EDITS.values():
        assert old in (game.folder / name).read_text(), (name, old)


@pytest.mark.nightly
def test_simulators_are_timed_in_processes_of_their_own() -> None:
    for row in peers.ROWS:
        assert row.library in peers.LIBRARIES
        assert callable(getattr(peer_steps, row.maker))
    timed = peers.Timed(sys.executable, peers.Row("outlast", "", "outlast", "football:FOOTBALL", 4))
    timed.measure()
    assert timed.agents == 4
    assert timed.seconds[0] > 0
    timed.process.communicate()
