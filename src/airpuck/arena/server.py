"""The page's server, a process of its own, so that no browser can hold up the physics.

The first page that comes has the seat: its mallet plays. All others watch, until the seat is free.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import signal
import socket
import time
from collections import deque
from http import HTTPStatus
from importlib import resources
from multiprocessing.connection import Connection
from typing import Any

from airpuck.arena.messages import LONGEST, Order, Wish, packed_wish, read_message
from airpuck.live.same_origin import refusal

#: What is served: the file and its type.
_FILES = {
    "/": ("play.html", "text/html"),
    "/play.css": ("play.css", "text/css"),
    "/play.js": ("play.js", "text/javascript"),
    "/table_canvas.js": ("table_canvas.js", "text/javascript"),
}
#: Nothing comes from elsewhere, and no other site may show the page as part of its own.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self'; "
    "frame-ancestors 'none'"
)
#: Pages at a time; a class may watch.
_PAGES = 32
#: A page sends a message for each move of the pointer: at most so many [1/s], so many at once.
_RATE, _BURST = 500.0, 500.0
#: News that wait for a page; older ones are dropped.
_NEWS = 64
#: What the system may keep of what was sent [bytes]: more would only be late.
_SENT = 16_384
#: Orders of the player that may wait for the game, while it makes a new one.
_ORDERS = 32
#: A page that does not answer for so long is gone [s].
_PATIENCE = 4.0
#: Kinds of messages from the game, and to it, by their first byte.
STATE, NEWS, THOUGHT, WISH, ORDER = b"S", b"N", b"T", b"W", b"O"


def serve(pipe: Connection, listening: socket.socket, host: str, hello: dict[str, Any]) -> None:
    """Serve pages until the other end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the game ends it
    with contextlib.suppress(BrokenPipeError, EOFError):
        asyncio.run(_Server(pipe, host, hello).run(listening))


class _Page:
    """A page that is connected: what waits for it, and how much it may still send."""

    def __init__(self, websocket: Any) -> None:
        self.websocket = websocket
        self.thinks = False
        self._state: bytes | None = None
        self._thought: str | None = None
        self._news: deque[str] = deque(maxlen=_NEWS)
        self._waits = asyncio.Event()
        self._left, self._counted = _BURST, time.monotonic()

    def show(self, state: bytes) -> None:
        """Send a state, in place of one that has not left yet."""
        self._state = state
        self._waits.set()

    def think(self, thought: str) -> None:
        """Send a thought, in place of one that has not left yet."""
        self._thought = thought
        self._waits.set()

    def tell(self, news: str) -> None:
        """Send news."""
        self._news.append(news)
        self._waits.set()

    async def send(self) -> None:
        """Send what waits, as fast as the page takes it."""
        while True:
            await self._waits.wait()
            self._waits.clear()
            while self._news:
                await self.websocket.send(self._news.popleft())
            for name in ("_state", "_thought"):
                message = getattr(self, name)
                setattr(self, name, None)
                if message is not None:
                    await self.websocket.send(message)

    def may_send(self) -> bool:
        """Count a message; return whether it is one too many."""
        now = time.monotonic()
        self._left = min(_BURST, self._left + _RATE * (now - self._counted)) - 1
        self._counted = now
        return self._left >= 0


class _Server:
    """All pages, and who of them plays."""

    def __init__(self, pipe: Connection, host: str, hello: dict[str, Any]) -> None:
        self._pipe, self._host = pipe, host
        self._hello, self._status = json.dumps({"is": "hello", **hello}), ""
        self._pages: list[_Page] = []
        self._player: _Page | None = None
        self._thinks = False
        #: What waits for the game: it stands still while it makes a new one.
        self._orders: deque[bytes] = deque()
        self._wish: bytes | None = None
        self._tells = False
        packaged = resources.files("airpuck") / "packaged"
        self._files = {
            path: ((packaged / name).read_text("utf-8"), kind)
            for path, (name, kind) in _FILES.items()
        }

    async def run(self, listening: socket.socket) -> None:
        """Serve until the game ends."""
        from websockets.asyncio.server import serve

        loop, ended = asyncio.get_running_loop(), asyncio.Event()

        def hear_game() -> None:
            try:
                while self._pipe.poll():
                    self._hear_game(self._pipe.recv_bytes())
            except (EOFError, OSError):
                loop.remove_reader(self._pipe.fileno())
                ended.set()

        quiet = logging.Logger("airpuck.arena", logging.CRITICAL + 1)
        async with serve(
            self._attend,
            sock=listening,
            process_request=self._answer,
            compression=None,
            max_size=4 * LONGEST,
            write_limit=2048,
            open_timeout=_PATIENCE,
            ping_interval=_PATIENCE / 2,
            ping_timeout=_PATIENCE,
            close_timeout=1,
            server_header=None,
            logger=quiet,
        ):
            loop.add_reader(self._pipe.fileno(), hear_game)
            await ended.wait()

    def _answer(self, connection: Any, request: Any) -> Any:
        """Refuse other sites, serve files; None opens a WebSocket."""
        headers = request.headers
        why = refusal(headers.get_all("Host"), headers.get_all("Origin"), self._host)
        if why is not None:
            return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")
        path = request.path.partition("?")[0]
        if path == "/" and "websocket" in headers.get("Upgrade", "").lower():
            if len(self._pages) < _PAGES:
                return None
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "Too many pages.\n")
        if path not in self._files:
            return connection.respond(HTTPStatus.NOT_FOUND, "There is no such file.\n")
        body, kind = self._files[path]
        response = connection.respond(HTTPStatus.OK, body)
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = f"{kind}; charset=utf-8"
        response.headers["Content-Security-Policy"] = _POLICY
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Cache-Control"] = "no-store"
        return response

    async def _attend(self, websocket: Any) -> None:
        """Attend to a page until it leaves, or sends what no page of ours would."""
        own = websocket.transport.get_extra_info("socket")
        own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SENT)
        page = _Page(websocket)
        self._pages.append(page)
        page.tell(self._hello)
        if self._status:
            page.tell(self._status)
        self._seat(page)
        sending = asyncio.create_task(page.send())
        try:
            async for message in websocket:
                asked = read_message(message) if page.may_send() else None
                if asked is None:
                    await websocket.close(1008, "not understood, or too much")
                    break
                self._obey(page, asked)
        except Exception as error:
            if not type(error).__module__.startswith("websockets"):
                raise
        finally:
            sending.cancel()
            self._pages.remove(page)
            self._leave(page)

    def _seat(self, page: _Page) -> None:
        """Give a page the seat, if that is free."""
        free = self._player is None
        if free:
            self._player = page
            self._order(b'{"do": "sit"}')
        page.tell(json.dumps({"is": "role", "role": "player" if free else "watcher"}))

    def _leave(self, page: _Page) -> None:
        """Free the seat, if the page had it."""
        if self._player is page:
            self._player = self._wish = None
            self._order(b'{"do": "leave"}')
        self._count_thinkers()

    def _obey(self, page: _Page, asked: Wish | Order) -> None:
        """Do what a page asks for, if it may."""
        if isinstance(asked, Wish):
            if page is self._player:
                self._wish = WISH + packed_wish(asked)
                self._tell_game()
        elif asked.do == "think":
            page.thinks = asked.on
            self._count_thinkers()
        elif asked.do == "sit":
            if page is not self._player:
                self._seat(page)
        elif page is self._player and len(self._orders) < _ORDERS:
            self._order(json.dumps(asked._asdict()).encode())

    def _count_thinkers(self) -> None:
        """Let the game say what the craft thinks while any page shows it."""
        thinks = any(page.thinks for page in self._pages)
        if thinks != self._thinks:
            self._thinks = thinks
            self._order(json.dumps({"do": "think", "on": thinks}).encode())

    def _order(self, content: bytes) -> None:
        """Give the game an order, as soon as it has room for it."""
        self._orders.append(ORDER + content)
        self._tell_game()

    def _tell_game(self) -> None:
        """Tell the game what waits for it, when it has room: all orders, the newest wish."""
        if not self._tells:
            self._tells = True
            asyncio.get_running_loop().add_writer(self._pipe.fileno(), self._tell_next)

    def _tell_next(self) -> None:
        """Tell the game one thing; it has room."""
        try:
            if self._orders:
                self._pipe.send_bytes(self._orders.popleft())
            elif self._wish is not None:
                self._pipe.send_bytes(self._wish)
                self._wish = None
        except OSError:  # it has ended, and whoever hears it will notice
            self._orders.clear()
            self._wish = None
        if not self._orders and self._wish is None:
            self._tells = False
            asyncio.get_running_loop().remove_writer(self._pipe.fileno())

    def _hear_game(self, message: bytes) -> None:
        """Pass on what the game says."""
        kind, content = message[:1], message[1:]
        if kind == STATE:
            for page in self._pages:
                page.show(content)
            return
        text = content.decode()
        if kind == THOUGHT:
            for page in self._pages:
                if page.thinks:
                    page.think(text)
            return
        if json.loads(text).get("is") == "status":
            self._status = text
        for page in self._pages:
            page.tell(text)
