"""What the page says of the followed agent, links to a tick, and two recordings side by side."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Reward
from outlast.ecs import Clock
from outlast.envs.errors import RecordingError
from outlast.envs.rollout.policies import random_policy, scripted_policy
from outlast.systems import Respawn
from tests.conftest import run
from tests.helpers.thinker import Thinker
from tests.web.browser import Screen

STEPS, WORLD = 80, 1
NAMES = ("ahead", "left", "turn", "attack", "use", "give")
Thoughts = list[dict[str, Any]]


def recorded(path: Path, variant: str, steps: int = STEPS, policy: Any = None, **numbers: Any) -> Thoughts:
    """A recording of two worlds; of world 1 after each tick: clock, actions, rewards, and what was thought before."""
    env = outlast.make_vec(outlast.variant(variant).replace(**numbers), 2, seed=3)
    act, found, thought = random_policy(env, 1) if policy else scripted_policy(env), Thoughts(), None
    with outlast.record(env, path, policy=policy):
        observations, _ = env.reset()
        for step in range(steps + 1):
            clock = env.worlds[Clock]
            found.append(
                {"clock": (int(clock.episode[WORLD, 0]), int(clock.tick[WORLD, 0]))}
                | {"actions": env.worlds.actions[:, WORLD].T.copy(), "rewards": env.worlds[Reward].reward[WORLD].copy()}
                | {"thought": thought}
            )
            thought = [each[WORLD] for each in Thinker()(observations)]
            if step < steps:
                observations, *_ = env.step(act(observations))
    return found


@pytest.fixture(scope="module")
def page(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Thoughts]:
    """A page of both worlds with a recorded policy, and the truth about world 1."""
    folder = tmp_path_factory.mktemp("mind")
    truth = recorded(folder / "a.rec", "ffa_2", policy=Thinker(), ending_limit=50)
    return outlast.replay_page(folder / "a.rec", folder / "a.html", worlds=[0, WORLD]), truth


def mind(screen: Screen) -> dict[str, Any]:
    """What the page says of the followed agent."""
    facts = screen.page.locator("#mind .facts div:not([hidden])").all()
    acts = screen.page.locator("#mind .acts .act").all()
    shares = "(row) => [...row.querySelectorAll('.value')].map((part) => Number(part.style.flexGrow))"
    return {
        "facts": {f.locator("dt").inner_text(): number(f.locator("b").inner_text()) for f in facts},
        "chosen": {act.get_attribute("data-action"): act.get_attribute("data-chosen") for act in acts},
        "likely": [share for act in acts for share in act.evaluate(shares)],
        "note": screen.page.locator("#mind .note").inner_text() if acts else "",
    }


def number(text: str) -> float:
    return float(text.replace("−", "-"))


@pytest.mark.nightly
def test_actions_rewards_and_thoughts_are_those_of_the_simulation(look: Any, page: tuple[Path, Thoughts]) -> None:
    path, truth = page
    screen = look(path, f"#world={WORLD}&episode=1&tick=0&agent=1")
    paid: dict[int, float] = {}
    for state in truth:
        episode, tick = state["clock"]
        paid[episode] = paid.get(episode, 0.0) + float(state["rewards"][1])
        if tick % 7 and tick > 1:
            continue
        screen.page.evaluate(f"location.hash = '#world={WORLD}&episode={episode}&tick={tick}&agent=1'")
        screen.wait(f"document.getElementById('tick').textContent === '{tick}'")
        screen.settle()
        assert int(screen.page.locator("#episode").input_value()) == episode - 1
        shown = mind(screen)
        assert shown["facts"]["Reward"] == pytest.approx(float(state["rewards"][1]), abs=0.051)
        assert shown["facts"]["Return"] == pytest.approx(paid[episode], abs=0.051)
        if not tick:
            assert set(shown["chosen"].values()) == {""}
            assert shown["note"] == "The episode is about to begin."
            continue
        assert shown["chosen"] == {n: str(a) for n, a in zip(NAMES, state["actions"][1], strict=True)}
        value, likely, _ = (each[1] for each in state["thought"])
        assert shown["facts"]["Value"] == pytest.approx(value, rel=0.01, abs=0.051)
        np.testing.assert_allclose(shown["likely"], np.maximum(np.rint(100 * likely) / 100, 0.001), atol=0.011)
    assert len(paid) == 2


def test_who_comes_back_acts_in_that_tick(look: Any, tmp_path: Path) -> None:
    zone = {"safe_zone_radii": (0.1,), "safe_zone_damage": 100}
    game = outlast.variant("ffa_1").with_(Respawn(ticks=3)).replace(ending_rule="never", ending_limit=50, **zone)
    env, back, dead = outlast.make_vec(game, 1, seed=0), 0, 0
    with outlast.record(env, tmp_path / "a.rec"):
        env.reset()
        while not back:
            *_, info = env.step(np.full((1, 2, len(env.noop)), 1))
            back = next((event["tick"] for event in env.events()["respawned"] if event["agent"] == 1), 0)
            dead = dead if info["alive"][0, 1] else env.worlds[Clock].tick[0, 0]
    screen = look(outlast.replay_page(tmp_path / "a.rec", tmp_path / "a.html"), f"#tick={back}&agent=1")
    assert mind(screen)["note"] == ""
    assert mind(screen)["chosen"] == {name: str(0 if name in NAMES[:3] else 1) for name in NAMES}
    screen.seek(dead)
    assert mind(screen)["note"] == "It is dead, and does nothing."


def test_attention_is_listed_and_painted(look: Any, page: tuple[Path, Thoughts]) -> None:
    screen = look(page[0], "#world=1&episode=1&tick=20&agent=0")
    assert screen.page.locator("#mind .attends .act").count() > 0
    before = screen.picture()
    screen.key("a")
    assert screen.picture() != before
    screen.key("Escape")
    assert not screen.page.locator("#mind").is_visible()
    assert screen.page.locator("[data-view=attention]").is_disabled()


# ---- links


def test_the_address_follows_what_is_shown_and_leads_there(look: Any, page: tuple[Path, Thoughts]) -> None:
    screen = look(page[0], permissions=["clipboard-read", "clipboard-write"])
    assert screen.page.evaluate("location.hash") == "#tick=0&world=0&episode=1"
    screen.page.locator("#world").select_option("1")
    screen.key("ArrowRight", "Shift+ArrowRight", "1")
    assert screen.page.evaluate("location.hash") == "#tick=31&world=1&episode=1&agent=1"
    screen.page.get_by_role("button", name="Copy a link to this tick").click()
    screen.wait("!document.getElementById('said').hidden")
    assert screen.page.locator("#said").inner_text() == "The link to this tick is copied."
    copied = screen.page.evaluate("navigator.clipboard.readText()")
    assert copied == f"{page[0].as_uri()}#tick=31&world=1&episode=1&agent=1"
    other = look(page[0], copied[copied.index("#") :], reduced_motion="no-preference")  # it rests there
    assert other.number("tick") == 31
    assert other.page.locator(".agent[aria-pressed=true]").get_attribute("data-agent") == "1"
    assert other.page.locator("#world").input_value() == "1"


@pytest.mark.parametrize(
    ("place", "words", "tick"),
    [
        ("#world=7&tick=3", "This page does not have world 7.", 0),
        ("#tick=999", "This page does not have tick 999.", 0),
        ("#episode=1&tick=51&agent=9", "This page does not have episode 1, tick 51, agent 9.", 0),
        ("#tick=12&agent=9", "This page does not have agent 9.", 12),
        ("#tick=<b>1</b>&what=1&world=-1", "", 0),
    ],
)
@pytest.mark.by_day(2)
def test_what_an_address_names_in_vain_is_said(
    look: Any, page: tuple[Path, Thoughts], place: str, words: str, tick: int
) -> None:
    screen = look(page[0], place)
    assert screen.page.locator("#said").inner_text() == words
    assert screen.number("tick") == tick


# ---- side by side


def test_two_recordings_are_in_step(look: Any, tmp_path: Path, capsys: Any) -> None:
    """Of different scenarios and lengths; the shorter one rests at its end."""
    recorded(tmp_path / "a.rec", "ffa_1", 60)
    recorded(tmp_path / "b.rec", "teams_3", 40)
    target = tmp_path / "page.html"
    status, *_ = run(capsys, "replay", tmp_path / "a.rec", "--beside", tmp_path / "b.rec", "--html", target, "--quiet")
    assert status == 0
    screen = look(target)
    canvas = "[...document.querySelectorAll('.stage canvas')].map((canvas) => Number(canvas.dataset.tick))"
    for row, ticks in ((0, [0, 0]), (25, [25, 25]), (60, [60, 40])):
        screen.seek(row)
        assert screen.page.evaluate(canvas) == ticks
    captions = [caption.inner_text() for caption in screen.page.locator(".caption").all()]
    assert captions == ["ffa_1: a.rec · tick 60", "teams_3: b.rec · ended at tick 40"]
    assert screen.page.locator(".agent").count() == 2
    screen.seek(25)
    screen.key("o")
    assert screen.page.evaluate("location.hash") == "#tick=25&world=0&episode=1&beside=1"
    other = look(target, "#tick=25&world=0&episode=1&beside=1")
    assert (other.page.locator(".agent").count(), other.number("tick")) == (4, 25)
    screen.seek(60)
    assert screen.page.evaluate("location.hash") == "#tick=60&world=0&episode=1"  # only the other one goes on
    assert screen.page.locator(".agent").count() == 4
    assert (screen.number("tick"), screen.number("length")) == (40, 40)
    screen.page.locator(".caption").first.click()
    screen.key("1")
    assert screen.page.locator(".agent").count() == 2
    assert screen.page.locator("#mind h2").inner_text() == "Agent 1"


# ---- the call


def test_what_cannot_be_shown_is_refused(tmp_path: Path, capsys: Any) -> None:
    recorded(tmp_path / "a.rec", "ffa_1", 12)
    recorded(tmp_path / "b.rec", "ffa_1", 5)
    page = tmp_path / "page.html"
    with pytest.raises(RecordingError, match=r"a.rec: world 2 does not exist; they are 0 to 1"):
        outlast.replay_page(tmp_path / "a.rec", page, worlds=[2])
    with pytest.raises(
        RecordingError, match=r"ticks 0 to 12: 0 <= from <= to <= 5 is needed, the last tick of .*b.rec"
    ):
        outlast.replay_page(tmp_path / "a.rec", page, beside=tmp_path / "b.rec", last=12)
    status, _, err = run(capsys, "replay", tmp_path / "a.rec", "--beside", tmp_path / "b.rec")
    assert (status, "--beside is for pages: give --html PATH, too" in err) == (2, True)
    assert not page.exists()
    assert outlast.replay_page(outlast.Recording.open(tmp_path / "a.rec"), page, title="<mine>", last=3) == page
    assert "&lt;mine&gt;" in page.read_text(encoding="utf-8")
