"""Replay pages: how worlds are described and packed, and what is refused. test_page_browser.py opens them."""

import gzip
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import outlast
from docs.examples.poison import Poison
from outlast.components import Bag, Body, Health, Reward
from outlast.ecs import Clock, Entity
from outlast.envs.errors import PageError
from outlast.envs.web.pages import METRE, RADIAN, EpisodeTrack, PageRoom, _entities, pack, record_ticks, write_page
from outlast.envs.web.world_json import describe, snapshot
from tests.web.browser import ticks

Json = dict[str, Any]


def unpacked(content: bytes) -> list[Json]:
    """The recordings of a page's data, each episode with its numbers by name: arrays (ticks, entries)."""
    raw = gzip.decompress(content)
    at = 4 + int.from_bytes(raw[:4], "little")
    rooms: list[Json] = json.loads(raw[4:at])
    for episode in (e for room in rooms for world in room["worlds"] for e in world["episodes"]):
        episode["numbers"] = {}
        for name, count, width in episode["columns"]:
            size = count * (width or 4) * episode["length"]
            kind = f"<i{width}" if width else "<f4"
            steps = np.frombuffer(raw[at : at + size], kind).reshape(count, episode["length"])
            episode["numbers"][name] = (steps.astype(np.int32).cumsum(1, dtype=np.int32) if width else steps).T
            at += size
    assert at == len(raw)
    return rooms


@pytest.fixture(scope="module")
def seen() -> tuple[Json, list[Json], list[Any]]:
    """A recording as the page gets it, the statistics of its episodes, and the states that it shows, by tick."""
    env = outlast.make_vec("teams_3", 2, seed=1)
    finished: list[Json] = []
    states: list[Any] = []

    def watched() -> Iterator[None]:
        for _ in ticks(env, 700, finished):
            kept = (Clock, Entity, Body, Health, Bag, Reward)
            states.append({c: c.Table(*(column.copy() for column in env.worlds[c])) for c in kept})
            states[-1]["actions"] = env.worlds.actions.copy()
            yield

    (header,) = unpacked(pack([PageRoom("a title", record_ticks(env.worlds, watched(), [0, 1]))]))
    return header, finished, states


def test_what_is_packed_comes_out_again(seen: tuple[Json, list[Json], list[Any]]) -> None:
    header, _, states = seen
    assert header["title"] == "a title"
    assert [world["world"] for world in header["worlds"]] == [0, 1]
    for w, world in enumerate(header["worlds"]):
        clocks = [(int(s[Clock].episode[w, 0]), int(s[Clock].tick[w, 0])) for s in states]
        rows = [(e, k) for e in world["episodes"] for k in range(e["length"])]
        assert [(e["number"], e["start"] + k) for e, k in rows] == clocks
        for (episode, k), state in zip(rows, states, strict=True):
            check_row(episode, k, state, w)


def check_row(episode: Json, k: int, state: Any, w: int) -> None:
    """Row k of an episode is what the tables held."""
    numbers = {name: column[k] for name, column in episode["numbers"].items()}
    agents = np.arange(4)  # rows are in alphabetical order of kinds
    assert numbers["agent.alive"].tolist() == state[Entity].alive[w, agents].tolist()
    assert numbers["agent.health"].tolist() == state[Health].points[w, agents].tolist()
    rows = np.r_[agents, [e for e in range(len(state[Body].x[w])) if e not in agents]]  # agents first, then objects
    for name, scale in (("x", METRE), ("y", METRE), ("angle", RADIAN)):
        packed = np.r_[numbers[f"agent.{name}"], numbers[f"object.{name}"]] / scale
        off = packed - getattr(state[Body], name)[w, rows]
        off = (off + np.pi) % (2 * np.pi) - np.pi if name == "angle" else off
        np.testing.assert_allclose(off, 0, atol=1.1 / scale)
    assert numbers["agent.reward"].tolist() == state[Reward].reward[w].tolist()
    assert numbers["agent.action"].reshape(4, 6).T.tolist() == state["actions"][:, w].tolist()
    bags = numbers["agent.bag"].reshape(4, -1)
    for i, e in enumerate(agents):
        carried = state[Bag].items[w, e, : state[Bag].count[w, e]]
        assert [rows[4 + j] for j in bags[i] if j >= 0] == carried.tolist()
    here = np.r_[numbers["agent.alive"], numbers["object.here"]]
    assert here.tolist() == state[Entity].alive[w, rows].tolist()


def test_events_add_up_to_the_statistics(seen: tuple[Json, list[Json], list[Any]]) -> None:
    header, finished, _ = seen
    ended = [
        (world["world"], episode)
        for world in header["worlds"]
        for episode in world["episodes"]
        if episode["events"][-1]["kind"] == "end"
    ]
    assert len(ended) == len(finished) >= 2
    for key in ("heals_used", "boxes_placed", "kills", "deaths_melee"):
        assert sum(np.sum(statistics[key]) for statistics in finished) > 0, key
    for statistics in finished:
        w, episode = next((w, e) for w, e in ended if w == statistics["world"])
        ended.remove((w, episode))
        assert episode["length"] == statistics["length"] + 1
        counts = Counter(event["kind"] for event in episode["events"])
        kills = Counter(event["side"] for event in episode["events"] if event["kind"] == "kill")
        assert [kills[side] for side in (0, 1)] == statistics["kills"].tolist()
        assert counts["heal"] == statistics["heals_used"]
        assert counts["place"] == statistics["boxes_placed"]
        died = Counter(event["cause"] for event in episode["events"] if event["kind"] in ("kill", "death"))
        assert died["zone"] == statistics["deaths_zone"]
        assert died["melee"] == statistics["deaths_melee"]


def test_what_a_policy_attends_to_is_found_by_its_name() -> None:
    """The other agents, and rows that are called as a kind of entity, also one of one's own."""
    env = outlast.make_vec(outlast.variant("teams_3").with_(Poison()), 1, seed=1)
    env.reset()
    vials = len(env.worlds.layout.spans["vial"])
    entities = [("others", 3), ("vials", vials), ("boxes", 8), ("heals", 3), ("heal_slot", 1)]
    replay = SimpleNamespace(policy=np.zeros((1, 4)), recording=SimpleNamespace(entities=entities))
    found = {entry["key"]: entry for entry in _entities(env.worlds, replay)["entities"]}  # type: ignore[arg-type]
    kinds = [body["kind"] for body in describe(env.worlds, 0)["objects"]]
    assert [entry["rows"] for entry in found.values()] == [count for _, count in entities]
    assert [key for key, entry in found.items() if entry["others"]] == ["others"]
    for key, kind in (("vials", "vial"), ("boxes", "box")):
        first = found[key]["first"] - 4
        assert {k for k, other in enumerate(kinds) if other == kind} == {*range(first, first + found[key]["rows"])}
    assert [found[key]["first"] for key in ("heals", "heal_slot")] == [-1, -1]  # not as many, no kind


def test_angles_go_on_over_whole_turns_and_far_numbers_become_the_nearest_that_fit() -> None:
    """A page interpolates between ticks, so an angle must not jump where it wraps around."""
    worlds = outlast.make_vec("ffa_1", 1, seed=0).worlds
    episode, turned = EpisodeTrack(describe(worlds, 0), 1, 0), np.arange(40) * 0.5
    far = [np.float32(number) for number in (3e38, -3e38, np.inf, np.nan)]
    for angle, x in zip(turned, far * 10, strict=True):
        worlds[Body].angle[0, :2] = 3e5 + angle, 3.0 - angle
        worlds[Body].x[0] = x
        worlds[Health].points[0, :2] = 2**31 - 1, -(2**31) + 1
        episode.add(snapshot(worlds, 0), [])
    numbers = unpacked(pack([PageRoom("", {0: [episode]})]))[0]["worlds"][0]["episodes"][0]["numbers"]
    angles = numbers["agent.angle"] / RADIAN
    np.testing.assert_allclose(np.diff(angles[:, 1]), -0.5, atol=2 / RADIAN)
    np.testing.assert_allclose(np.diff(angles[:, 0]), 0.5, atol=0.04)  # what float32 resolves there
    np.testing.assert_allclose(np.exp(1j * angles[0]), np.exp(1j * np.array([3e5, 3.0])), atol=2 / RADIAN)
    assert numbers["agent.x"][:4, 0].tolist() == [2**31 - 1, -(2**31), 0, 0]
    assert numbers["agent.health"][0].tolist() == [2**31 - 1, -(2**31) + 1]


def test_a_page_of_a_thousand_ticks_is_small(tmp_path: Path) -> None:
    env = outlast.make_vec("teams_3", 1, seed=1)
    steps = 1000
    write_page(tmp_path / "page.html", env.worlds, ticks(env, steps), [0], title="small")
    assert (tmp_path / "page.html").stat().st_size < 150_000


def test_what_a_scenario_lacks_is_left_out() -> None:
    """And an item of a new kind has its name."""
    lacking = ["safe_zone", "heals", "cameras", "give_last", "inventory", "pickup", "death_drop", "melee"]
    worlds = outlast.variant("ffa_1").without(*lacking).worlds(1)
    description, now = describe(worlds, 0), snapshot(worlds, 0)
    assert [body["role"] for body in description["objects"]] == ["wall"] * 4
    assert (description["zone"], description["cone"], description["slots"], description["reach"]) == (False, None, 0, 0)
    assert now["zone"] is None
    assert [[agent[key] for key in ("bag", "strike", "target", "sees")] for agent in now["agents"]] == [
        [[], 0, -1, None]
    ] * 2
    description = describe(outlast.variant("teams_3").with_(Poison(count=3)).worlds(1), 0)
    assert [body["role"] for body in description["objects"] if body["kind"] == "vial"] == ["item"] * 3
    assert description["damage_types"] == ["melee", "poison", "zone"]


# ---- what is refused


def test_worlds_and_folders_that_are_not_there_are_refused(tmp_path: Path) -> None:
    env = outlast.make_vec("ffa_3", 2, seed=0)
    pulled: list[int] = []
    frames = (pulled.append(k) for k in range(3))
    with pytest.raises(PageError, match=r"worlds \[5\]; choose among 0 to 1"):
        write_page(tmp_path / "page.html", env.worlds, frames, [0, 5], title="")
    with pytest.raises(PageError, match="none; choose among 0 to 1"):
        write_page(tmp_path / "page.html", env.worlds, frames, [], title="")
    with pytest.raises(PageError, match="there is no folder"):
        write_page(tmp_path / "nowhere" / "page.html", env.worlds, frames, [0], title="")
    with pytest.raises(PageError, match="not one tick"):
        write_page(tmp_path / "page.html", env.worlds, [], [0], title="")
    assert not pulled
    assert not list(tmp_path.iterdir())
