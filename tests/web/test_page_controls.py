"""The page in hands: pointer, keys and touch."""

from pathlib import Path
from typing import Any

import pytest

import outlast
from tests.web.browser import WORLDS, Screen, Truth
from tests.web.test_page_browser import HALF, check

pytestmark = pytest.mark.nightly  # each of them loads a page of its own

LEFT, RIGHT = 30, 10  # pixels of the timeline beside its strips
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True, "device_scale_factor": 3}


def place(screen: Screen, row: int, last: int) -> float:
    """Where a row lies on the timeline, in pixels from the left of the window."""
    box = screen.page.locator("#timeline").bounding_box()
    return float(box["x"] + LEFT + (box["width"] - LEFT - RIGHT) * row / last)


def strip(screen: Screen, agent: int) -> float:
    """The middle of an agent's strip, in pixels from the top of the window: below the zone's, 21 pixels each."""
    box = screen.page.locator("#timeline").bounding_box()
    return float(box["y"] + 12 + 4 + 21 * agent + 9)


def test_a_click_on_a_kill_leads_to_it(look: Any, truths: dict[int, Truth]) -> None:
    screen, truth = look(), truths[0]
    last = screen.number("length")
    tick = next(tick for episode, tick in truth.kills if episode == 1)
    before, after = truth.states[1, tick - 1]["living"], truth.states[1, tick]["living"]
    victim = next(i for i in range(4) if before[i] and not after[i])
    screen.page.mouse.click(place(screen, tick, last) + 2, strip(screen, victim) - 1)  # near it is enough
    screen.settle()
    assert screen.number("tick") == tick
    check(screen, truth, 1)
    assert screen.page.locator("#tip").inner_text().startswith(f"{tick}: agent ")
    assert "killed by" in screen.page.locator(f".agent[data-agent='{victim}'] .status").inner_text()


def test_every_event_in_the_list_leads_to_its_tick(look: Any, truths: dict[int, Truth]) -> None:
    screen = look()
    kills = []
    for button in screen.page.locator("#events button").all():
        button.click()
        screen.settle()
        assert screen.number("tick") == int(button.locator("time").inner_text())
        check(screen, truths[0], 1)
        if button.get_attribute("data-kind") == "kill":
            kills.append((1, screen.number("tick")))
    assert sorted(set(kills)) == sorted({(e, tick) for e, tick in truths[0].kills if e == 1})


def test_an_agent_is_followed_by_key_card_and_click(look: Any, truths: dict[int, Truth]) -> None:
    screen = look()
    screen.seek(20)
    whole = screen.picture()
    screen.key("2")
    assert followed(screen) == ["2"]
    near = screen.picture()
    assert near != whole
    screen.key("c")  # no close-up: all of the room, but agent 2 stands out
    assert screen.picture() not in (whole, near)
    screen.key("c", "2")
    assert followed(screen) == []
    assert screen.picture() == whole
    screen.page.locator(".agent[data-agent='1']").click()
    assert followed(screen) == ["1"]
    screen.key("Escape")
    x, y, _ = truths[0].states[1, 20]["places"][3]
    box = screen.page.locator("#stage").bounding_box()
    scale = min(box["width"], box["height"]) / (2 * HALF)
    screen.page.locator("#stage").click(
        position={"x": box["width"] / 2 + x * scale, "y": box["height"] / 2 - y * scale}
    )
    assert followed(screen) == ["3"]


def followed(screen: Screen) -> list[str]:
    screen.settle()
    return [card.get_attribute("data-agent") for card in screen.page.locator(".agent[aria-pressed=true]").all()]


def test_views_are_switched_by_key_and_button(look: Any, truths: dict[int, Truth]) -> None:
    screen = look()
    full = (tick for (episode, tick), state in truths[0].states.items() if episode == 1 and any(state["bags"]))
    screen.seek(next(full))
    for key, name in zip("vlzihbt", ("cones", "lines", "zone", "ids", "health", "bags", "trails"), strict=True):
        button = screen.page.locator(f"[data-view={name}]")
        before, pressed = screen.picture(), button.get_attribute("aria-pressed")
        screen.key(key)
        assert button.get_attribute("aria-pressed") != pressed
        assert screen.picture() != before, name
        button.click()
        assert screen.picture() == before, name
    assert screen.page.locator("[data-view=blind]").is_disabled()
    screen.key("0")
    before = screen.picture()
    screen.key("x")
    assert screen.picture() != before


def test_worlds_and_episodes_are_chosen(look: Any, truths: dict[int, Truth]) -> None:
    screen = look()
    page = screen.page
    assert page.locator("#world option").all_inner_texts() == [f"World {w}" for w in WORLDS]
    for index, w in enumerate(WORLDS):
        page.locator("#world").select_option(str(index))
        numbers = sorted({episode for episode, _ in truths[w].states})
        assert page.locator("#episode option").all_inner_texts() == [f"Episode {number}" for number in numbers]
        for k, number in enumerate(numbers):
            if len(numbers) > 1:
                page.locator("#episode").select_option(str(k))
            screen.key("Home", "Shift+ArrowRight")
            check(screen, truths[w], number)
            screen.key("End")
            assert screen.number("tick") == max(tick for episode, tick in truths[w].states if episode == number)
            check(screen, truths[w], number)
    page.locator("#world").select_option("0")
    screen.key("]")
    assert page.locator("#episode").input_value() == "1"
    page.locator("#episodes button").first.click()
    assert page.locator("#episode").input_value() == "0"


def test_keys_are_explained_and_none_is_lost_in_the_dialog(look: Any) -> None:
    screen = look()
    screen.key("?")
    assert "follow an agent" in screen.page.locator("#keys").inner_text()
    screen.key("ArrowRight")
    assert screen.number("tick") == 0
    screen.key("Escape", "ArrowRight")
    assert not screen.page.locator("#keys").is_visible()
    assert screen.number("tick") == 1
    screen.page.get_by_role("button", name="Help").click()
    screen.page.get_by_role("button", name="Close", exact=True).click()
    assert not screen.page.locator("#keys").is_visible()


def test_every_control_is_reached_by_tab_and_has_a_name(look: Any) -> None:
    screen = look()
    controls = screen.page.evaluate("document.querySelectorAll('button:not(:disabled), select').length")
    names = set()
    for _ in range(controls + 5):
        screen.page.keyboard.press("Tab")
        names.add(
            screen.page.evaluate(
                """(() => {
                  const one = document.activeElement;
                  return one === document.body ? "body" : one.getAttribute("aria-label") || one.textContent.trim();
                })()"""
            )
        )
    assert "" not in names
    assert {"Play", "Step back", "Step forward", "Slower", "Faster", "Timeline", "World", "Episode", "Help"} <= names


def test_a_phone_shows_all_of_it_and_a_finger_drags_the_timeline(look: Any, truths: dict[int, Truth]) -> None:
    screen = look(**PHONE)
    assert screen.page.evaluate("document.documentElement.scrollWidth") == 390
    stage = screen.page.locator("#stage").bounding_box()
    assert stage["width"] <= 390
    assert stage["height"] > 350
    assert screen.page.evaluate("document.getElementById('stage').width") == round(3 * stage["width"])
    last, y = screen.number("length"), strip(screen, 3) + 14
    screen.page.touchscreen.tap(place(screen, 100, last), y)
    screen.settle()
    assert abs(screen.number("tick") - 100) <= 1
    check(screen, truths[0], 1)
    session = screen.page.context.new_cdp_session(screen.page)
    for kind, row in (("touchStart", 50), ("touchMove", 100), ("touchMove", 150), ("touchMove", 200)):
        points = [{"x": place(screen, row, last), "y": y}]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        screen.settle()
    assert abs(screen.number("tick") - 200) <= 2


def test_what_is_counted_from_within_an_episode_says_so(look: Any, tmp_path: Path) -> None:
    outlast.rollout("ffa_3", "scripted", steps=300, worlds=17, seed=3, record=tmp_path / "a.rec")
    for first, words in ((0, ""), (150, " since step 150")):
        screen = look(outlast.replay_page(tmp_path / "a.rec", tmp_path / "a.html", worlds=[16], first=first))
        screen.key("End")
        done = [text for text in screen.page.locator(".agent .tally").all_inner_texts() if text]
        assert done
        assert all(text.endswith(words) and ("since" in text) == bool(words) for text in done)
