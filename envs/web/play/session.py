"""A session: one game in real time, a page that steers it, and other pages that watch."""

import asyncio
import contextlib
import json
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from ...errors import MessageError
from .game import Game
from .messages import STEER, parse

MAX_PAGES = 8
POLICY_VIOLATION, TRY_AGAIN_LATER = 1008, 1013  # RFC 6455, section 7.4.1, and the IANA registry


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
            self._leave(page)

    async def _receive(self, page: ServerConnection) -> None:
        """Receive messages until the page leaves or sends an invalid one."""
        with contextlib.suppress(ConnectionClosed):
            async for text in page:
                try:
                    message = parse(text, self.game.ranges)
                except MessageError as error:
                    await page.close(POLICY_VIOLATION, str(error))
                    return
                if message == {"command": STEER}:
                    self._lead(page)
                elif page is self.pages[0]:
                    self._apply(message)

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

    def _apply(self, message: dict[str, Any]) -> None:
        match message:
            case {"held": held, "tapped": tapped}:
                self.game.hold(held, tapped)
            case {"speed": times}:
                self.speed = times
            case {"command": name}:  # a method of Game, see COMMANDS
                getattr(self.game, name)()
        self._notify()

    def _lead(self, page: ServerConnection) -> None:
        """Let a page steer in place of the one that does."""
        if page is not self.pages[0]:
            self._release()
            self.pages.sort(key=lambda each: each is not page)
            self._notify()

    def _leave(self, page: ServerConnection) -> None:
        if page is self.pages[0]:
            self._release()
        self.pages.remove(page)
        self._notify()

    def _release(self) -> None:
        """Release the keys, and wait for the next player."""
        self.game.hold({}, {})
        self.game.pause()

    def _notify(self) -> None:
        """Wake up everything that waits for this update; the next update gets a new event."""
        self._update.set()
        self._update = asyncio.Event()
