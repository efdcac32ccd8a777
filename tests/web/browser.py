"""Replay pages in a browser, and the states of the simulation to compare them with."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import outlast
from outlast.components import Bag, Body, Died, Health, Zone
from outlast.ecs import Clock, Entity
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.policies import scripted_policy

STEPS = 600
WORLDS = (0, 2)
TITLE = "</title></script><img src=x onerror=alert(1)> & more"


def environment() -> SurvivalVectorEnv:
    return outlast.make_vec("teams_3", 3, seed=1)


def ticks(env: SurvivalVectorEnv, steps: int, finished: list[dict[str, Any]] | None = None) -> Iterator[int]:
    """A scripted rollout in which all agents strike all the time, and now and then use what they have.

    finished: takes the statistics of its episodes.
    """
    observations, _ = env.reset()
    act = scripted_policy(env)
    yield 0
    for step in range(steps):
        actions = act(observations).copy()
        actions[..., 3], actions[..., 4] = 1, step % 30 == 0
        observations, _, _, _, info = env.step(actions)
        if finished is not None and "statistics" in info:
            for w in np.flatnonzero(info["_statistics"]):
                finished.append({"world": int(w), **{key: value[w] for key, value in info["statistics"].items()}})
        yield step + 1


@dataclass
class Truth:
    """What the same rollout, run again, holds after each tick of world `w`."""

    w: int
    states: dict[tuple[int, int], dict[str, Any]] = field(default_factory=dict)  # by (episode, tick)
    kills: list[tuple[int, int]] = field(default_factory=list)

    def note(self, worlds: Any) -> None:
        w, alive, body = self.w, worlds[Entity].alive, worlds[Body]
        clock = int(worlds[Clock].episode[w, 0]), int(worlds[Clock].tick[w, 0])
        kinds = {row: kind for kind, span in worlds.layout.spans.items() for row in span}
        bags = [[kinds[e] for e in worlds[Bag].items[w, i, : worlds[Bag].count[w, i]]] for i in range(4)]
        names = {"heal": "heal", "box_item": "box"}
        self.states[clock] = {
            "tick": clock[1],
            "alive": int(alive[w, :4].sum()),
            "health": [int(p) if alive[w, i] else 0 for i, p in enumerate(worlds[Health].points[w, :4])],
            "bags": [[names[kind] for kind in bag] for bag in bags],
            "heals": int(alive[w, worlds.span("heal")].sum()),
            "boxes": int(alive[w, worlds.span("box")].sum()),
            "zone": float(worlds[Zone].radius[w, 0]),
            "places": [(float(body.x[w, i]), float(body.y[w, i]), float(body.angle[w, i])) for i in range(4)],
            "living": [bool(alive[w, i]) for i in range(4)],
        }
        if clock[1] and (worlds[Died].now[w, :4] * (worlds[Died].source[w, :4] >= 0)).any():
            self.kills.append(clock)


def listen(page: Any) -> tuple[list[str], list[str]]:
    """What a page complains of from now on, and the addresses that it contacts."""
    complaints, contacted = list[str](), list[str]()
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    for kind in ("request", "websocket"):
        page.on(kind, lambda other: contacted.append(other.url))
    return complaints, contacted


def wait(page: Any, condition: str) -> None:
    """Until a JavaScript expression is true. The page's own policy keeps playwright from polling it."""
    deadline = time.monotonic() + 20
    while not page.evaluate(f"!!({condition})"):
        assert time.monotonic() < deadline, condition
        page.wait_for_timeout(10)


@dataclass
class Screen:
    """A page that is open, and what it complained of and asked for."""

    page: Any
    complaints: list[str]
    requests: list[str]

    def number(self, name: str) -> int:
        return int(self.page.locator(f"#{name}").inner_text())

    def shown(self) -> dict[str, Any]:
        """The numbers on the page."""
        cards = self.page.locator(".agent").all()
        labels = [card.get_attribute("aria-label") for card in cards]
        items = self.page.locator
        return {
            "tick": self.number("tick"),
            "alive": self.number("alive"),
            "health": [int(card.locator(".points").inner_text()) for card in cards],
            "bags": [[sign_name(s) for s in card.locator(".sign").all()] for card in cards],
            "heals": int(items("[data-role=heal]").inner_text()),
            "boxes": int(items("[data-role=box]").inner_text()),
            "zone": items("#zone").inner_text(),
            "labels": labels,
        }

    def key(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)
        self.settle()

    def settle(self) -> None:
        """Two frames later everything has been painted."""
        self.page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def wait(self, condition: str) -> None:
        wait(self.page, condition)

    def seek(self, row: int) -> None:
        self.page.evaluate(f"outlast.pause(); outlast.seek({row})")
        self.settle()

    def picture(self) -> bytes:
        self.settle()
        taken: bytes = self.page.locator("#stage").screenshot()
        return taken


def sign_name(sign: Any) -> str:
    return str(sign.get_attribute("title")).split(",")[0]
