"""The live page in a real browser: it shows the simulation, and its keys steer it."""

from contextlib import contextmanager
from urllib.parse import urlsplit

import numpy as np
import pytest

import outlast
from outlast.components import Body, Heal, Health, Phase, Reward, Side
from outlast.ecs import Action, Array, Clock, Module, Read, Write, column
from outlast.envs.rendering.style import SIZES, WHOLE
from outlast.envs.web.game import Game, GamePhase
from outlast.systems import Respawn
from tests.helpers.beasts import Beasts
from tests.helpers.own_bodies import Mine
from tests.web.browser import listen, wait
from tests.web.clients import enemy_shown, has, heals_shown, picture, served


def shows(page, tick):
    """Wait until the picture is that of this tick, or a later one."""
    wait(page, f"Number(document.querySelector('#stage').dataset.tick || -1) >= {tick}")


@contextmanager
def opened(browser, game, script="", **options):
    """A page that shows the game, at 60 ticks a second. script: What runs in it first.

    At the end it has logged nothing and contacted no other host.
    """
    options = {"viewport": {"width": 1400, "height": 900}} | options
    with served(game, fps=60) as address, browser.new_context(**options) as context:
        page = context.new_page()
        complaints, contacted = listen(page)
        page.add_init_script(script)
        page.goto(address)
        shows(page, 0)
        yield page
        assert complaints == []
        hosts = {urlsplit(url).netloc for url in contacted} - {""}  # without a host: the icon, which is in the page
        assert hosts == {urlsplit(address).netloc}


@pytest.fixture
def page(browser, game):
    with opened(browser, game) as page:
        yield page


def picture_of_everything(page):
    """What the page shows of the game's world without cameras, uint8 (height, width, 3)."""
    page.keyboard.press("v")
    page.wait_for_selector("#view[aria-pressed=false]")
    return picture(page)


def card(page, phase):
    page.wait_for_selector(f"#card[data-phase={phase}]:visible")
    return page.inner_text("#card")


def word(page, heading):
    return page.inner_text(f"#words dd[data-heading='{heading}']")


def test_the_start_card_says_what_the_game_is_and_any_key_begins(page, game):
    text = card(page, "ready")
    for words in ("ffa_3: two agents, heals and boxes; outliving pays.", "Against you: agent 1.", "forward"):
        assert words in text
    page.keyboard.press("Shift")
    page.wait_for_timeout(100)
    assert game.phase is GamePhase.READY
    page.keyboard.press("Enter")
    shows(page, 2)
    assert "half speed" in page.inner_text("#badge")
    assert tuple(game.action()) == (1, 1, 1, 0, 0, 0)
    shows(page, 46)
    page.wait_for_selector("#badge", state="hidden")


def test_keys_are_held_until_they_are_let_go(page, game):
    """Also where another window gets that; and one press uses one item."""
    keys = {"s": (0, 1, 1, 0, 0, 0), "ArrowUp": (2, 1, 1, 0, 0, 0), "a": (1, 2, 1, 0, 0, 0), "d": (1, 0, 1, 0, 0, 0)}
    keys |= {"q": (1, 1, 2, 0, 0, 0), "ArrowRight": (1, 1, 0, 0, 0, 0), " ": (1, 1, 1, 1, 0, 0)}
    for key, action in keys.items():
        page.keyboard.down(key)
        shows(page, int(game.worlds[Clock].tick[0, 0]) + 2)
        assert tuple(game.action()) == action
        page.evaluate("dispatchEvent(new Event('blur'))") if key == "ArrowUp" else page.keyboard.up(key)
        shows(page, int(game.worlds[Clock].tick[0, 0]) + 3)
        assert tuple(game.action()) == (1, 1, 1, 0, 0, 0)
        page.keyboard.up(key)
    actions, action = [], game.action
    game.action = lambda: actions.append(action()) or actions[-1]
    page.keyboard.down("f")
    shows(page, int(game.worlds[Clock].tick[0, 0]) + 15)
    assert sum(row[4] for row in actions) == 1


def test_it_shows_what_the_agent_sees_or_everything(page, game):
    row_of = game.worlds.layout.rows(Heal).tolist()
    seen = dict(zip(row_of, (game.env.observe()["heals_mask"][0, 0] > 0).tolist(), strict=True))
    assert {True, False} == set(seen.values())  # or this would show nothing
    shown = heals_shown(game, picture(page))
    assert shown == seen
    assert not game.env.observe()["others_mask"][0, 0, 0]
    assert not enemy_shown(game, picture(page))
    page.keyboard.press("v")
    page.wait_for_selector("#view[aria-pressed=false]")
    assert enemy_shown(game, picture(page))
    assert all(heals_shown(game, picture(page)).values())
    page.click("#view")
    page.wait_for_selector("#view[aria-pressed=true]")
    assert heals_shown(game, picture(page)) == seen


def test_the_end_is_shown_and_r_goes_on(page, game):
    row = game.worlds.layout.rows(Side)[0]
    game.worlds[Health].points[0, row] = 0  # it dies in the next tick
    page.keyboard.press("w")
    text = card(page, "over")
    assert "You lost" in text
    assert "1 ticks" in text
    assert game.phase is GamePhase.OVER
    assert word(page, "Health") == "dead"
    page.keyboard.press("r")
    assert "You are agent 0" in card(page, "ready")
    assert game.worlds[Clock].episode[0, 0] == 2
    assert word(page, "Health") == "100"


def test_pause_speed_and_next_episode_have_buttons(page, game):
    page.keyboard.press("q")
    shows(page, 2)
    page.click("#pause")
    assert "Paused" in card(page, "paused")
    assert page.inner_text("#tick") == str(game.worlds[Clock].tick[0, 0])
    assert page.inner_text("#pause").startswith("Go on")
    page.focus("#pause")
    page.keyboard.press("Space")  # presses what has the focus while the world stands still
    page.wait_for_selector("#card", state="hidden")
    assert game.phase is GamePhase.RUNNING
    page.select_option("#pace", "4")
    page.click(".buttons [data-command=restart]")
    card(page, "ready")
    assert (page.input_value("#pace"), int(game.worlds[Clock].episode[0, 0])) == ("4", 2)


@pytest.mark.nightly
def test_a_second_page_watches_and_may_take_over(page, game, browser):
    with browser.new_context() as context:
        other = context.new_page()
        other.goto(page.url)
        shows(other, 0)
        assert "Another page steers" in other.inner_text("#badge")
        assert page.is_hidden("#steer")
        other.click("#steer")
        page.wait_for_selector("#steer:visible")
        assert "Another page steers" in page.inner_text("#badge")
        assert other.is_hidden("#steer")
        other.keyboard.press("r")
        card(other, "ready")
        assert game.worlds[Clock].episode[0, 0] == 2


PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}


def test_a_phone_has_a_stick_and_buttons(browser, game):
    with opened(browser, game, **PHONE) as page:
        box = page.locator("#stick").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x + 5, y - 50)
        page.mouse.down()
        for place, action in (((x + 5, y - 50), (2, 1, 1, 0, 0, 0)), ((x - 45, y - 45), (2, 2, 1, 0, 0, 0))):
            page.mouse.move(*place)
            shows(page, int(game.worlds[Clock].tick[0, 0]) + 3)
            assert tuple(game.action()) == action
        page.mouse.up()
        page.locator("#buttons [data-action=attack]").hover()
        page.mouse.down()
        shows(page, int(game.worlds[Clock].tick[0, 0]) + 3)
        assert tuple(game.action()) == (1, 1, 1, 1, 0, 0)
        page.mouse.up()


WRITTEN = """
window.written = []; const write = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (words, x, y) {
  window.written.push([words, x, y, x + this.measureText(words).width]); write.call(this, words, x, y); }
"""


def test_own_items_and_bodies_are_shown_as_in_pictures(browser):
    """And their kinds are named once, however many bodies they have."""
    game = Game(outlast.variant("ffa_1").with_(Mine()), others="noop", seed=1)
    kinds, body = {each["kind"]: each for each in game.world["objects"]}, game.worlds[Body]
    roles = {"big_gem": "item", "ball": "other", "crate": "other", "door": "wall"}
    assert {name: kinds[name]["role"] for name in roles} == roles
    with opened(browser, game, WRITTEN) as page:
        image = picture_of_everything(page)
        page.evaluate("written = []; dispatchEvent(new Event('resize'))")
        page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        names = [entry for entry in page.evaluate("written") if entry[0] in ("big gem", "ball", "crate", "door")]
        wide = page.locator("#stage").bounding_box()["width"]
    for kind in ("ball", "crate"):
        row, color = game.worlds.span(kind).start, kinds[kind]["color"]
        rgb = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
        assert has(game, image, rgb, body.x[0, row] + 0.6, body.y[0, row])
        assert not has(game, image, rgb, body.x[0, row], body.y[0, row] + 0.9)
    assert sorted(words for words, *_ in names) == ["ball", "big gem", "crate"]
    assert max(end for *_, end in names) < wide
    assert {y for _, _, y, _ in names} == {12}


def test_what_is_wounded_has_a_bar_as_in_pictures(browser):
    game = Game(outlast.variant("ffa_1").with_(Beasts()), others="noop", seed=1)
    rows = game.worlds.span("beast")
    game.worlds[Body].x[0, rows], game.worlds[Body].y[0, rows] = (-6, 6), 3
    game.worlds[Health].points[0, rows] = (3, 5)  # of 5
    with opened(browser, game) as page:
        image = picture_of_everything(page)
    up = 3 + 0.5 + SIZES.bar_height * (SIZES.bar_gap + 0.5)
    assert [has(game, image, WHOLE, x - 0.3, up) for x in (-6, 6)] == [True, False]
    drawn = outlast.draw(game.worlds, 0, size=min(image.shape[:2]))
    assert [has(game, drawn, WHOLE, x - 0.3, up) for x in (-6, 6)] == [True, False]


class Bell(Action):
    ring_it: Array = column("i1", "agents", low=0, high=9)
    lock: Array = column("i1", "agents", low=-2, high=1)


class Bells(Module):
    """A mechanic that the page knows nothing of, whose actions have more values than there are digits."""

    def singletons(self):
        return [Bell()]


@Bells.system(Phase.EFFECT)
def ring(bell: Read[Bell]) -> None:
    pass


def test_own_actions_have_digits(browser):
    """Both ends of each; and what has none is said."""
    game = Game(outlast.variant("ffa_1").with_(Bells()), others="noop", seed=1)
    with opened(browser, game) as page:
        text = card(page, "ready")
        assert all(words in text for words in ("ring it 9", "lock +1", "No key: ring it 1, 2, 3"))
        for key, expected in {"1": [9, 0], "2": [0, 1], "3": [0, -2]}.items():
            page.keyboard.down(key)
            shows(page, int(game.worlds[Clock].tick[0, 0]) + 3)
            held = dict(zip(game.ranges, game.action(), strict=True))
            assert [held[name] + game.ranges[name][0] for name in ("ring_it", "lock")] == expected
            page.keyboard.up(key)


def test_who_comes_back_is_not_dead_for_good(browser):
    """While it waits, the person sees no more than the agent; once it is back, nothing says that it died."""
    scenario = outlast.variant("ffa_2").with_(Respawn(ticks=40)).replace(ending_rule="never", ending_limit=90)
    game = Game(scenario, others="noop", seed=1)
    with opened(browser, game) as page:
        game.worlds[Health].points[0, game.worlds.layout.rows(Side)[0]] = 0
        page.click("#card [data-command=begin]")
        shows(page, 3)
        page.keyboard.press("p")
        assert "Paused" in card(page, "paused")
        assert not enemy_shown(game, picture(page))
        page.keyboard.press("p")
        page.wait_for_selector("#badge:has-text('You died')")
        shows(page, 48)
        page.wait_for_selector("#badge", state="hidden")
        page.wait_for_selector("#card[data-phase=over]", state="attached")
        text = page.text_content("#card")
    assert "The episode is over" in text  # whoever lived longest
    assert "You died" not in text


class Broken(Module):
    """Pays what is no number."""


@Broken.system(Phase.REWARD, after=Reward)
def pay_nothing(reward: Write[Reward]) -> None:
    reward.reward[:] = np.nan


def test_an_episode_whose_return_is_no_number_ends(browser):
    game = Game(outlast.variant("ffa_1").with_(Broken()).replace(ending_limit=5), others="noop", seed=1)
    with opened(browser, game) as page:
        page.click("#card [data-command=begin]")
        assert "return not a finite number" in card(page, "over")


def test_keys_are_called_what_is_printed_on_them(browser, game):
    """Of an AZERTY keyboard, whose W and Q are elsewhere; where a key is decides what it does."""
    azerty = {"KeyW": "z", "KeyA": "q", "KeyQ": "a"}
    script = f"navigator.keyboard.getLayoutMap = () => Promise.resolve(new Map(Object.entries({azerty})))"
    with opened(browser, game, script) as page:
        page.wait_for_function("document.querySelector('#card .keys').textContent.startsWith('Z↑forward')")
        assert "Qto the left" in page.inner_text("#card .keys").replace("\n", "")
        page.keyboard.press("v")  # commands go by letter
        page.wait_for_selector("#view[aria-pressed=false]")


@pytest.mark.parametrize("size", [(844, 390), (320, 568), (390, 844)])
def test_nothing_is_covered_on_small_screens(browser, game, size):
    width, height = size
    with opened(browser, game, **PHONE | {"viewport": {"width": width, "height": height}}) as page:
        page.click("#card [data-command=begin]")
        shows(page, 1)
        if height > 800:  # all at once
            whole = "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
            assert page.evaluate(whole) == [*size]
        for part in ("#view", "#pause", "#pace", "#stick"):
            box = page.locator(part).bounding_box()
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= width
            middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
            assert page.evaluate(f"document.elementFromPoint(...{middle}).closest('{part}') !== null")


def test_a_page_too_many_is_told_so(browser, game, monkeypatch):
    monkeypatch.setattr("outlast.envs.web.game.MAX_PAGES", 1)
    with served(game, fps=60) as address, browser.new_context() as context:
        first, second = context.new_page(), context.new_page()
        first.goto(address)
        shows(first, 0)
        second.goto(address)
        second.wait_for_selector("#badge:visible")
        assert second.inner_text("#badge").startswith("There is no place for this page: 1 pages are open already.")
