"""What recordings, replays and their products once did otherwise than they said."""

from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast.components import Bag, Body, Health, Phase
from outlast.ecs import (
    Action,
    Array,
    Event,
    Module,
    Read,
    Rows,
    Write,
    column,
    emit,
)
from outlast.envs.cli.main import main
from outlast.envs.datasets.export import export_dataset
from outlast.envs.datasets.samples import Selection
from outlast.envs.errors import FilmError, PageError, PlayError, RecordingError
from outlast.envs.inspect.world_json import events
from outlast.envs.recording import Recording, Replay
from outlast.envs.rendering.scene import Scene
from outlast.envs.web.play.game import Game
from outlast.systems import Agents, Record
from tests.helpers.beasts import Beasts

# ---- mechanics of one's own


class Speak(Action, order=9):
    reward: Array = column("i1", "agents", low=0, high=5)


class Say(Module):
    def singletons(self) -> Any:
        return [Speak()]


@Say.system(Phase.LOOK)
def listen(speak: Read[Speak], body: Read[Body], agents: Rows[Bag]) -> None:
    pass


class Look(Action, order=9):
    final_own: Array = column("i1", "agents", low=0, high=5)


class Watch(Module):
    def singletons(self) -> Any:
        return [Look()]


@Watch.system(Phase.LOOK)
def watch(look: Read[Look], body: Read[Body], agents: Rows[Bag]) -> None:
    pass


class Meeting(Event, capacity="agents"):
    agent: Array = column("i4", unit="entity")
    amount: Array = column("f4", 2)


class Meetings(Module):
    def singletons(self) -> Any:
        return [Meeting()]


@Meetings.system(Phase.LOOK)
def meet(meetings: Write[Meeting], body: Read[Body], agents: Rows[Bag]) -> None:
    for i in range(agents.size):
        k = emit(meetings)
        meetings.agent[k] = agents[i]
        meetings.amount[k, 1] = 2.5


def recorded(path: Path, scenario: Any, steps: int = 8) -> Path:
    env = outlast.make_vec(scenario, 1, seed=0)
    with outlast.record(env, path):
        env.reset()
        for _ in range(steps):
            env.step(env.noop[None].repeat(env.num_agents, 0)[None] if env.noop.ndim == 1 else env.noop[None])
    return path


# ---- what they do


@pytest.mark.parametrize(("mechanic", "name"), [(Say(), "reward"), (Watch(), "final_own")])
def test_an_action_does_not_replace_a_column_of_a_table(tmp_path: Path, mechanic: Module, name: str) -> None:
    pytest.importorskip("pyarrow", reason="needs pyarrow: outlast[data]")
    game = outlast.variant("ffa_1").with_(mechanic)
    replay = Replay(Recording.open(recorded(tmp_path / "a.rec", game), game))
    with pytest.raises(RecordingError, match=f"action '{name}' has the name of another column"):
        export_dataset(str(tmp_path / "a.parquet"), replay, Selection([0], 0, 7))
    assert [path.name for path in tmp_path.iterdir()] == ["a.rec"]


def test_an_event_may_have_several_amounts(tmp_path: Path) -> None:
    env = outlast.make_vec(outlast.variant("ffa_1").with_(Meetings()), 1, seed=0)
    env.reset()
    (first, _) = [event for event in events(env.worlds, 0) if event["kind"] == "other"]
    assert "meeting" in first["cause"]
    assert "2.5" in first["cause"]


def test_what_dies_need_not_be_an_agent(caplog: Any) -> None:
    caplog.set_level("INFO", "outlast.deaths")
    env = outlast.make_vec(outlast.variant("ffa_2").with_(Beasts()), 1, seed=0)
    env.reset()
    found: list[Any] = []
    for _ in range(10):
        env.step(env.action_space.sample() * 0 + env.noop)
        found += [event for event in events(env.worlds, 0) if "beast" in event["cause"]]
    assert [(event["kind"], event["agent"]) for event in found] == [("other", -1)] * 2
    assert found[0]["cause"] == "death beast 0 melee"
    assert caplog.messages == [f"world 0, tick 5: beast {k} died of melee" for k in range(2)]


def test_a_page_does_not_replace_its_recording(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.html", "ffa_1")
    other, before = recorded(tmp_path / "b.rec", "ffa_1"), path.read_bytes()
    for source, beside in ((path, None), (other, path)):
        with pytest.raises(PageError, match=r"a\.html is the recording itself"):
            outlast.replay_page(source, path, beside=beside)
    for name in ("b.rec", "page"):
        with pytest.raises(PageError, match=r"pages are written as NAME\.html"):
            outlast.replay_page(path, tmp_path / name)
    with pytest.raises(PageError, match="title = 3: a text is needed"):
        outlast.replay_page(path, tmp_path / "page.html", title=3)  # type: ignore[arg-type]
    assert path.read_bytes() == before


@pytest.mark.parametrize("steps", [-1, "5", 2.5, True])
def test_steps_of_a_film_are_whole_numbers(tmp_path: Path, steps: Any) -> None:
    with pytest.raises(FilmError, match=r"steps = .* an integer >= 0 is needed"):
        outlast.film("ffa_1", tmp_path / "a.webm", steps=steps)
    assert not [*tmp_path.iterdir()]


def test_ticks_of_a_page_are_whole_numbers(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.rec", "ffa_1")
    with pytest.raises(RecordingError, match=r"tick 2\.5: integers are needed"):
        outlast.replay_page(path, tmp_path / "a.html", last=2.5)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["a.parquet", "folder", "minari:outlast/none-v0"])
def test_a_dataset_has_samples(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = recorded(tmp_path / "a.rec", "ffa_1")
    if name.startswith("minari"):
        pytest.importorskip("minari", reason="needs Minari: outlast[data]")
    if name.endswith(".parquet"):
        pytest.importorskip("pyarrow", reason="needs pyarrow: outlast[data]")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    target = name if name.startswith("minari") else str(tmp_path / name)
    with pytest.raises(RecordingError, match=r"none of the worlds .* ticks 0 to 0, so samples are empty"):
        export_dataset(target, Replay(Recording.open(path)), Selection([0], 0, 0))
    assert not [each for each in tmp_path.rglob("*") if each.is_file() and each != path]


def test_worlds_begin_with_hit_points_of_their_own() -> None:
    drawn = {
        "agents_health": outlast.distributions.integers(20, 90),
        "ending_limit": outlast.distributions.integers(2, 4),
    }
    env = outlast.make_vec(outlast.variant("ffa_1").vary(**drawn), 3, seed=0)
    env.reset()
    for _ in range(6):
        whole = [Scene(env.worlds, w).prefab(Health).points[0] for w in range(3)]
        assert whole == [Scene(env.worlds, w).mechanic(Agents).health for w in range(3)]
        assert len({*whole}) > 1
        env.step(env.action_space.sample() * 0 + env.noop)


def test_who_plays_needs_the_record_of_an_episode() -> None:
    with pytest.raises(PlayError, match=r"has no 'record', .* add Record\(\)"):
        Game(outlast.variant("ffa_1").without(Record))


def test_a_stopped_replay_makes_nothing_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = recorded(tmp_path / "a.rec", "ffa_1")

    def stop(*arguments: Any, **named: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("outlast.envs.api.film.footage", stop)
    words = ["--out", tmp_path / "a.webm", "--html", tmp_path / "a.html", "--quiet"]
    assert main(["replay", str(path), *map(str, words)]) == 130
    assert [each.name for each in tmp_path.iterdir()] == ["a.rec"]
