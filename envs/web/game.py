"""Play: one world in which a person steers one agent, in real time, from a page that other pages may watch."""

import asyncio
import contextlib
import json
import math
import os
from collections import deque
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any

import numpy as np
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from outlast.components import Respawned
from outlast.components.score import End, Episode, Kills, Outcome
from outlast.ecs import Action, Clock
from outlast.systems.ending import outliving_wins

from .. import recording
from ..core.spaces import alive, fewest_agents, published, side
from ..core.vector_env import SurvivalVectorEnv
from ..errors import MessageError, PlayError
from ..rollout.lineup import Lineup, Others, Standings, entries_of, own_wins
from ..rollout.summary import RESULTS
from ..scenarios.scenario import Scenario
from ..storage import inputs
from .assets import SHARED, STYLE, assemble
from .gate import Site, listening
from .observation_text import observation_text
from .server import answering
from .world_json import Json, describe, events, snapshot

RECENT = 8  # the newest events, all of which are sent each time, as a page may miss ticks
SLOW, SLOWLY = 1.5, 0.5  # an episode begins slowly: seconds, and share of the usual speed
COMMANDS = ("begin", "pause", "resume", "restart", "steer")  # with the last one, a page takes over
SPEEDS = (0.25, 0.5, 1, 2, 4)
MAX_PAGES = 8
POLICY_VIOLATION, TRY_AGAIN_LATER = 1008, 1013  # RFC 6455, section 7.4.1, and the IANA registry


class GamePhase(StrEnum):
    """States of play: running, or why not."""

    READY = "ready"  # a new episode, which waits for a key
    RUNNING = "running"
    PAUSED = "paused"
    OVER = "over"  # the episode has ended; restart begins the next one


class Game:
    """World 0 of `scenario`, seeded. agent: the number of the agent that a person steers.

    others: who plays the other agents, see lineup.Lineup. record: a new file for a recording of the game, see
    outlast.record. name: what the recording calls the others. Keys set actions by name, in the engine's own values
    (ahead: -1, 0, 1). Raises PlayError if there is no such agent, RecordingError if the file cannot be written, and
    what environments raise.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        agent: int = 0,
        others: Others = "scripted",
        seed: int = 0,
        record: str | os.PathLike[str] | None = None,
        name: str = "",
    ) -> None:
        self.env = SurvivalVectorEnv(scenario, 1, seed=seed, autoreset_mode="Disabled", copy=False)
        try:
            if Episode not in self.env.worlds:
                raise PlayError(f"{scenario.name} has no 'record', by which episodes are judged here: add Record()")
            last = fewest_agents(self.env.worlds) - 1
            if not 0 <= agent <= last:
                where = " in every episode" if last < self.env.num_agents - 1 else ""
                raise PlayError(f"agent {agent}: {scenario.name} has the agents 0 to {last}{where}; take one of them")
            if record is not None:
                recording.record(self.env, record, played={"agent": agent, "others": name})
        except BaseException:
            self.env.close()
            raise
        self.agent, self.worlds, self._standings = agent, self.env.worlds, Standings(self.env.worlds)
        self.ranges = {key: (int(c.low), int(c.high)) for key, _, _, c in published(self.worlds, Action)}
        self._others = Lineup(entries_of(others), self.env, agent)
        self.restart()

    def restart(self) -> None:
        """Go on to the next episode, even if the present one has not ended."""
        self.env.reset()
        self.phase = GamePhase.READY
        self.death: Json | None = None
        self._recent: deque[Json] = deque(maxlen=RECENT)
        self._held: Mapping[str, int] = {}
        self._tapped: dict[str, int] = {}
        self._standings.begin(np.ones(1, bool))
        game = self.env.scenario
        world = {"name": game.name, "about": game.about, "agent": self.agent, "actions": self.ranges}
        world["comes_back"] = Respawned in self.worlds
        self.world = describe(self.worlds, 0) | world

    def hold(self, held: Mapping[str, int], tapped: Mapping[str, int]) -> None:
        """Set the keys that are held from now on, and those tapped, which count in the next tick even if up by then.

        The first key begins the episode, as `begin` does. Keys that come while the world stands still are not kept.
        """
        if any(held.values()) or any(tapped.values()):
            self.begin()
        self._held = held
        if self.phase is GamePhase.RUNNING:
            self._tapped.update(tapped)

    def begin(self) -> None:
        """Begin the episode, without taking an action."""
        if self.phase is GamePhase.READY:
            self.phase = GamePhase.RUNNING

    @property
    def pace(self) -> float:
        """The world's speed as a multiple of the usual one: the start of an episode is slow."""
        return SLOWLY if self.worlds[Clock].tick[0, 0] * self.world["seconds"] < SLOW else 1

    def pause(self) -> None:
        """Stand still until `resume`."""
        if self.phase is GamePhase.RUNNING:
            self.phase = GamePhase.PAUSED
            self._tapped.clear()

    def resume(self) -> None:
        """Go on where `pause` stopped."""
        if self.phase is GamePhase.PAUSED:
            self.phase = GamePhase.RUNNING

    def tick(self) -> bool:
        """Run one tick of the world; unless it is running, do nothing and return False."""
        if self.phase is not GamePhase.RUNNING:
            return False
        actions = np.zeros((1, self.env.num_agents, len(self.ranges)), np.int64)
        actions[:, self._others.agents] = self._others.actions()
        actions[0, self.agent] = self.action()
        self._tapped.clear()
        _, _, terminated, truncated, _ = self.env.step(actions)
        self._standings.watch()
        for event in events(self.worlds, 0):
            self._recent.append(event | {"tick": int(self.worlds[Clock].tick[0, 0])})
            if event["kind"] in ("kill", "death") and event["agent"] == self.agent:
                self.death = self._recent[-1]
        if terminated[0] or truncated[0]:
            self.phase = GamePhase.OVER
        return True

    def action(self) -> list[int]:
        """Return the person's action in the next tick, as the environment takes it: numbers from 0."""
        keys = {**self._held, **self._tapped}
        return [keys.get(name, 0) - low for name, (low, _) in self.ranges.items()]

    def state(self) -> Json:
        """Return all that a page shows after a tick: the world, the person's observation as text, events, result."""
        observation = {key: values[0, self.agent] for key, values in self.env.observe().items()}
        return {
            "phase": self.phase,
            "slow": self.pace < 1,
            "snapshot": snapshot(self.worlds, 0),
            "text": observation_text(observation, self.env.fields, self.env.roles),
            "death": None if alive(self.worlds, 0)[self.agent] else self.death,
            "events": list(self._recent),
            "result": self._result() if self.phase is GamePhase.OVER else None,
        }

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def _result(self) -> Json:
        """Return the result of the episode that has ended, as the person's side sees it.

        verdict: "won" if this side came farther than all others, by living longer or by components.Outcome,
        "drawn" if as far as the best other one, else "lost"; "over" without another side or a result.
        kills: None if agents cannot die. return: None if it is not finite.
        """
        episode, mine = self.worlds[Episode], int(side(self.worlds, 0)[self.agent])
        come, paid = self._standings.of(np.array([0])), float(episode.returns[0, self.agent])
        decided = Outcome in self.worlds or outliving_wins(self.worlds.layout)
        contested = decided and np.isfinite(come).sum() > 1
        return {
            "verdict": RESULTS[int(2 - 2 * own_wins(come, np.array([mine]))[0])] if contested else "over",
            "truncated": bool(self.worlds[End].truncated[0, 0]),
            "kills": int(self.worlds[Kills].kills[0, mine]) if Kills in self.worlds else None,
            "length": int(episode.length[0, 0]),
            "return": round(paid, 2) if math.isfinite(paid) else None,
        }


def parse(text: Any, ranges: Mapping[str, tuple[int, int]]) -> dict[str, Any]:
    """Return the message in `text`: {"held": {name: value}, "tapped": {...}}, {"command": name} or {"speed": times}.

    held: actions in every tick from now on. tapped: actions in the next tick only. Others are 0. speed: how many times
    as fast as usual. ranges: the lowest and highest value of each action. Raises MessageError for everything else.
    """
    if not isinstance(text, str):
        raise MessageError("messages are text, not bytes")
    try:
        content = json.loads(text)
    except inputs.BROKEN_JSON:
        raise MessageError("messages are JSON") from None
    if not isinstance(content, dict):
        raise MessageError("messages are JSON objects")
    if content.keys() == {"held", "tapped"}:
        for given in content.values():
            if not isinstance(given, dict) or given.keys() - ranges.keys():
                raise MessageError(f"held and tapped name actions: {', '.join(ranges)}"[:123])
            for name, value in given.items():
                low, high = ranges[name]
                if type(value) is not int or not low <= value <= high:
                    raise MessageError(f"{name} is an integer from {low} to {high}"[:123])
        return content
    if content.keys() == {"command"} and content["command"] in COMMANDS:
        return content
    if content.keys() == {"speed"} and type(content["speed"]) in (int, float) and content["speed"] in SPEEDS:
        return content
    raise MessageError('held and tapped, a known command, or a known speed is needed, as in {"command": "pause"}')


class Session:
    """The loop of `game` at `fps` ticks per second, times the speed that the person chose, times Game.pace.

    The first of `pages` steers, and the others watch: the one that was opened first, or that took over last. When it
    leaves, the next one steers. Without pages the world stands still.
    """

    def __init__(self, game: Game, fps: float) -> None:
        self.game, self.fps = game, fps
        self.speed: float = 1
        self.pages: list[ServerConnection] = []
        self._update = asyncio.Event()

    async def run(self) -> None:
        """Run ticks until cancelled. If ticks are late, they are not caught up with: the world runs more slowly."""
        clock = asyncio.get_running_loop().time
        due = clock()
        while True:
            period = 1 / (self.fps * self.speed * self.game.pace)
            due = max(due + period, clock())
            await asyncio.sleep(due - clock())
            if self.game.tick():
                self._notify()

    async def serve_page(self, page: ServerConnection) -> None:
        """Serve a page until it leaves."""
        if len(self.pages) >= MAX_PAGES:
            await page.close(TRY_AGAIN_LATER, f"{MAX_PAGES} pages are open already")
            return
        self.pages.append(page)
        try:
            async with asyncio.TaskGroup() as group:
                sender = group.create_task(self._send(page))
                await self._receive(page)
                sender.cancel()
        finally:
            if page is self.pages[0]:
                self._release()
            self.pages.remove(page)
            self._notify()

    async def _receive(self, page: ServerConnection) -> None:
        """Receive messages until the page leaves or sends an invalid one."""
        with contextlib.suppress(ConnectionClosed):
            async for text in page:
                try:
                    message = parse(text, self.game.ranges)
                except MessageError as error:
                    await page.close(POLICY_VIOLATION, str(error))
                    return
                leads = page is self.pages[0]
                match message:
                    case {"command": "steer"} if not leads:
                        self._release()
                        self.pages.sort(key=lambda each: each is not page)
                    case {"held": held, "tapped": tapped} if leads:
                        self.game.hold(held, tapped)
                    case {"speed": times} if leads:
                        self.speed = times
                    case {"command": name} if leads and name != "steer":  # a method of Game, see COMMANDS
                        getattr(self.game, name)()
                    case _:
                        continue
                self._notify()

    async def _send(self, page: ServerConnection) -> None:
        """Send the latest state: a slow page misses ticks instead of falling behind."""
        world = None
        with contextlib.suppress(ConnectionClosed):
            while True:
                update = self._update
                if world is not self.game.world:
                    world = self.game.world
                    await page.send(json.dumps({"world": world}))
                role = {"steers": page is self.pages[0], "speed": self.speed}
                await page.send(json.dumps(self.game.state() | role))
                await update.wait()

    def _release(self) -> None:
        """Release the keys, and wait for the next player."""
        self.game.hold({}, {})
        self.game.pause()

    def _notify(self) -> None:
        """Wake up everything that waits for this update; the next update gets a new event."""
        self._update.set()
        self._update = asyncio.Event()


async def play(
    game: Game, fps: float, site: Site | None = None, opened: Callable[[str], object] = lambda address: None
) -> None:
    """Serve `game` at a site until cancelled; `opened` is called with the address.

    fps: ticks per second. Raises PlayError if the site is not available.
    """
    session, scripts = Session(game, fps), (*SHARED, "keys.js", "visible.js", "play.js")
    with listening(site or Site()) as (listener, gate):
        page = assemble("outlast", "play", scripts, (STYLE, "play.css"), connect=gate.live, SPEEDS=SPEEDS)
        async with answering(listener, gate, {"": lambda: ("text/html", page)}, session.serve_page):
            opened(gate.address)
            await session.run()
