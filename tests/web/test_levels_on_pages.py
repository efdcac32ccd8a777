"""Pages, pictures and games of episodes with other counts of agents, roles and walls."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import role
from outlast.distributions import integers
from outlast.envs.core.spaces import present, side
from outlast.envs.errors import PlayError
from outlast.envs.rendering.rgb import draw, text
from outlast.envs.rendering.words import EndLayer, ScoresStrip
from outlast.envs.web.game import Game, GamePhase
from outlast.envs.web.observation_text import observation_text
from outlast.envs.web.pages import write_page
from outlast.envs.web.world_json import describe, snapshot
from outlast.systems import Maze, Teams
from tests.web.browser import ticks
from tests.web.clients import served

HUNT = (
    outlast.variant("teams_3")
    .with_(Teams(sizes=(2, 4)), Maze(columns=4, rows=4))
    .vary(n_agents=integers(2, 6))
    .roles(hunter=role(1, agents_health=200), wolf=role(1), prey=role())
)
ALONE = outlast.variant("ffa_3").replace(n_agents=4).vary(n_agents=integers(1, 4)).roles(a=role(), drawn="anyone")
WORLDS = 12


@pytest.fixture(params=[HUNT, ALONE], ids=["hunt", "alone"])
def env(request: Any) -> Any:
    made = outlast.make_vec(request.param, WORLDS, seed=3)
    made.reset()
    assert len({*present(made.worlds).sum(1).tolist()}) > 2
    yield made
    made.close()


def test_descriptions_have_roles_and_sides_of_who_is_there(env: Any) -> None:
    for w in range(WORLDS):
        description, state = describe(env.worlds, w), snapshot(env.worlds, w)
        json.dumps([description, state], allow_nan=False)
        assert [agent["side"] for agent in description["agents"]] == side(env.worlds, w).tolist()
        there = present(env.worlds, w)
        assert [agent["alive"] for agent in state["agents"]] == there.tolist()
        names = [env.roles[number] for number in env.worlds[outlast.ecs.AgentRoles].role[w][there]]
        assert [agent["role"] for agent, here in zip(description["agents"], there, strict=True) if here] == names
    plain = outlast.make_vec("ffa_3", 1)
    plain.reset()
    assert {agent["role"] for agent in describe(plain.worlds, 0)["agents"]} == {""}


def test_text_and_pictures_leave_out_who_is_absent(env: Any) -> None:
    for w, there in enumerate(present(env.worlds).sum(1).tolist()):
        page = text(env.worlds, w)
        assert "side -1" not in page
        assert sum(line[2:].startswith("side ") for line in page.splitlines()) == there
        assert draw(env.worlds, w, 200, [ScoresStrip(), EndLayer()]).dtype == np.uint8


def test_observations_in_words_name_roles() -> None:
    """Of the agent and of those that it sees; as numbers, if nobody says what they are called."""
    env = outlast.make_vec(HUNT.replace(cameras_mode="omniscient", n_agents=6), 1, seed=3)
    seen, _ = env.reset()
    row = {key: values[0, 1] for key, values in seen.items()}
    lines = observation_text(row, env.fields, env.roles)
    assert lines["Role"] == ["wolf"]
    assert [line.rpartition(", ")[2] for line in lines["Friends"] + lines["Enemies"]] == ["hunter", *4 * ["prey"]]
    assert observation_text(row, env.fields)["Role"] == ["0, 1, 0"]


# ---- games


def test_a_person_steers_an_agent_that_every_episode_has() -> None:
    with pytest.raises(PlayError, match=r"agent 2: .* has the agents 0 to 1 in every episode; take one of them"):
        Game(HUNT, agent=2)
    with pytest.raises(PlayError, match=r"agent -1: "):
        Game(HUNT, agent=-1)


def test_a_game_alone_is_over_and_not_won() -> None:
    game, verdicts = Game(ALONE, others="noop", seed=3), {}
    for _ in range(12):
        game.begin()
        while game.tick():
            pass
        assert game.phase is GamePhase.OVER
        count = int(present(game.worlds, 0).sum())
        verdicts.setdefault(count, set()).add(game.state()["result"]["verdict"])
        assert sum(agent["side"] >= 0 for agent in game.world["agents"]) == count
        game.restart()
    game.close()
    assert verdicts[1] == {"over"}
    assert all("over" not in found for count, found in verdicts.items() if count > 1)
    assert len(verdicts) > 2


# ---- in a browser


@pytest.mark.nightly
def test_the_start_card_names_role_and_opponents(browser: Any) -> None:
    game = Game(HUNT, agent=1, seed=3)
    with served(game, fps=60) as address, browser.new_context() as context:
        page = context.new_page()
        for _ in range(6):
            page.goto(address)
            page.wait_for_selector("#card[data-phase=ready]:visible")
            words, sides = page.inner_text("#card"), side(game.worlds, 0)
            assert "You are agent 1, wolf" in words
            assert page.inner_text("#words dd[data-heading=Role]") == "wolf"
            enemies = np.flatnonzero(sides == 1).tolist()
            named = f"Against you: agent{'s' * (len(enemies) > 1)} {', '.join(map(str, enemies))}."
            assert (named in words) if enemies else ("Against you" not in words)
            game.restart()


@pytest.mark.nightly
def test_cards_show_who_is_there_and_which_role(look: Any, tmp_path: Path) -> None:
    env = outlast.make_vec(HUNT, 3, seed=3)
    write_page(tmp_path / "page.html", env.worlds, ticks(env, 40), [0, 1, 2], title="levels")
    again = outlast.make_vec(HUNT, 3, seed=3)
    again.reset()
    for w in range(3):
        screen = look(tmp_path / "page.html", f"#world={w}&tick=5")
        there = np.flatnonzero(present(again.worlds, w)).tolist()
        cards = screen.page.locator("[data-agent]")
        assert [int(card.get_attribute("data-agent")) for card in cards.all()] == there
        assert screen.page.inner_text("#agents") == str(len(there))
        shown = [card.locator(".status").inner_text() for card in cards.all()]
        roles = ["hunter, ", "wolf, ", *([""] * (len(there) - 2))]  # a team that is called prey says it already
        assert [words.startswith(own) for words, own in zip(shown, roles, strict=True)] == [True] * len(there)
        assert not any("prey" in words for words in shown)
        screen.key("t", "ArrowRight", "ArrowRight")  # trails are of who is there, too
        assert screen.page.get_attribute("canvas", "data-tick") == "7"
