"""The session: one game at its pace, one page that steers, and others that watch."""

import asyncio
import contextlib
import json

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from ...errors import MessageError
from .game import Game
from .messages import Command, Message, Speed, Steer, parse

PAGES = 8  # at a time
POLICY_VIOLATION, TRY_AGAIN_LATER = 1008, 1013  # RFC 6455, section 7.4.1, and the IANA registry


class Session:
    """`game`, `fps` ticks a second, times the speed that the person chose.

    The page that came first steers; those that came later watch, and the next of them steers when it leaves. While
    nobody is there the world stands still.
    """

    def __init__(self, game: Game, fps: float) -> None:
        self.game, self.fps = game, fps
        self.speed: float = 1
        self.pages: list[ServerConnection] = []
        self._news = asyncio.Event()

    async def run(self) -> None:
        """Tick for ever. A tick that comes late is not made up for: the world slows down."""
        clock = asyncio.get_running_loop().time
        due = clock()
        while True:
            period = 1 / (self.fps * self.speed)
            due = max(due + period, clock())
            await asyncio.sleep(due - clock())
            if self.game.tick():
                self._publish()

    async def attend(self, page: ServerConnection) -> None:
        """Serve a page until it goes."""
        if len(self.pages) >= PAGES:
            await page.close(TRY_AGAIN_LATER, f"{PAGES} pages are open already")
            return
        self.pages.append(page)
        try:
            async with asyncio.TaskGroup() as group:
                teller = group.create_task(self._tell(page))
                await self._listen(page)
                teller.cancel()
        finally:
            self._leave(page)

    async def _listen(self, page: ServerConnection) -> None:
        """Until the page goes, or says what it should not."""
        with contextlib.suppress(ConnectionClosed):
            async for text in page:
                try:
                    message = parse(text, self.game.ranges)
                except MessageError as error:
                    await page.close(POLICY_VIOLATION, str(error))
                    return
                if page is self.pages[0]:
                    self._obey(message)

    async def _tell(self, page: ServerConnection) -> None:
        """Send the news, the latest only: a slow page misses ticks instead of falling behind."""
        world = None
        with contextlib.suppress(ConnectionClosed):
            while True:
                news = self._news
                if world is not self.game.world:
                    world = self.game.world
                    await page.send(json.dumps({"world": world}))
                role = {"steers": page is self.pages[0], "speed": self.speed}
                await page.send(json.dumps(self.game.state() | role))
                await news.wait()

    def _obey(self, message: Message) -> None:
        game = self.game
        match message:
            case Steer(held, tapped):
                game.hold(held, tapped)
            case Speed(times):
                self.speed = times
            case Command(name):
                {"pause": game.pause, "resume": game.resume, "restart": game.restart}[name]()
        self._publish()

    def _leave(self, page: ServerConnection) -> None:
        if page is self.pages[0]:
            self.game.hold({}, {})
            self.game.pause()
        self.pages.remove(page)
        self._publish()

    def _publish(self) -> None:
        """Wake up who waits for this news; the next news is another event."""
        self._news.set()
        self._news = asyncio.Event()
