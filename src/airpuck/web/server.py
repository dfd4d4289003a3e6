"""The page server: a separate process, so that no browser can delay the physics.

The first page that connects takes the seat, and its mallet plays. All others are spectators until
the seat is free.
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
from typing import Any, NamedTuple

from airpuck.flight.clock import TokenBucket
from airpuck.web.requests import LONGEST, Order, Wish, packed_wish, read_message, refusal

#: Types of files by extension. Each page has three files of its own, and shares three with all
#: pages.
_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
_ALL_PAGES = ("page.css", "page.js", "table_canvas.js")
#: The page loads nothing from other sites, and no other site may embed it.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self'; "
    "frame-ancestors 'none'"
)
#: Maximum number of pages; a whole class may watch.
_PAGES = 32
#: Rate limit of each page's messages [1/s], and its burst; a mouse reports at most 125 Hz to 1 kHz.
_RATE, _BURST = 500.0, 500.0
#: Number of events that wait for a slow page; older ones are dropped.
_EVENTS = 64
#: Send buffers of the system and of a connection [bytes]: states in larger ones would be outdated.
_SENT, _BUFFERED = 16_384, 2048
#: Close code of a page that breaks the rules (RFC 6455, 7.4.1).
_POLICY_VIOLATION = 1008
#: Number of orders that may wait for the game while it starts a new one.
_ORDERS = 32
#: Timeout of a page that reads nothing or answers no ping, such as a sleeping phone [s].
PATIENCE = 4.0
#: Kinds of messages from the game and to the game: the first byte of each. A `SCENE` is JSON of
#: which only the newest of each name counts; pages that connect later also receive it.
STATE, EVENT, SCENE, THOUGHT, WISH, ORDER = b"S", b"E", b"C", b"T", b"W", b"O"

_log = logging.getLogger("airpuck.web")


def serve(
    pipe: Connection,
    listening: socket.socket,
    host: str,
    page: PageKind,
    hello: dict[str, Any],
    patience: float = PATIENCE,
) -> None:
    """Serve pages until the other end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the game closes the pipe after Ctrl-C
    with contextlib.suppress(BrokenPipeError, EOFError):
        asyncio.run(_Server(pipe, host, page, hello, patience).run(listening))


class PageKind(NamedTuple):
    """A kind of page: its three files, in a package, and who may use it."""

    #: The package that holds ``packaged/NAME.html``, ``NAME.css`` and ``NAME.js``.
    package: str
    name: str
    #: Whether all pages may send wishes; otherwise the first one takes the seat.
    shared: bool = False


class _Page:
    """A connected page: pending messages, and its rate limit."""

    def __init__(self, websocket: Any, patience: float) -> None:
        self.websocket, self._patience = websocket, patience
        self.thinks = False
        #: The newest message of each name; older ones are worthless.
        self._newest: dict[str, str | bytes] = {}
        self._events: deque[str | bytes] = deque(maxlen=_EVENTS)
        self._waits = asyncio.Event()
        self.limit = TokenBucket(_RATE, _BURST)

    def show(self, name: str, message: str | bytes) -> None:
        """Send a message that replaces an unsent older one of its name."""
        self._newest[name] = message
        self._waits.set()

    def tell(self, news: str | bytes) -> None:
        """Send an event."""
        self._events.append(news)
        self._waits.set()

    async def send(self) -> None:
        """Send pending messages as fast as the page reads; raise TimeoutError if it stalls."""
        while True:
            await self._waits.wait()
            self._waits.clear()
            while self._events or self._newest:
                if self._events:
                    message = self._events.popleft()
                else:
                    message = self._newest.pop(next(iter(self._newest)))
                # The WebSocket's own keep-alive waits for the same full buffer, without a limit.
                async with asyncio.timeout(self._patience):
                    await self.websocket.send(message)


class _Server:
    """All pages, and the page that plays."""

    def __init__(
        self, pipe: Connection, host: str, page: PageKind, hello: dict[str, Any], patience: float
    ) -> None:
        self._pipe, self._host, self._patience = pipe, host, patience
        self._shared = page.shared
        #: First messages to a page: the newest lasting message of each name.
        self._remembered: dict[str, str | bytes] = {"hello": json.dumps({"is": "hello", **hello})}
        self._pages: list[_Page] = []
        self._player: _Page | None = None
        self._thinks = False
        #: Orders that wait for the game, which accepts none while it starts a new one.
        self._orders: deque[bytes] = deque()
        self._wish: bytes | None = None
        self._tells = False
        names = [("airpuck", name) for name in _ALL_PAGES]
        names += [(page.package, f"{page.name}.{kind}") for kind in _TYPES]
        self._files: dict[str, tuple[str, str]] = {}
        for package, name in names:
            text = (resources.files(package) / "packaged" / name).read_text("utf-8")
            self._files[f"/{name}"] = text, _TYPES[name.rpartition(".")[2]]
        self._files["/"] = self._files.pop(f"/{page.name}.html")

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

        quiet = logging.Logger("airpuck.web", logging.CRITICAL + 1)
        async with serve(
            self._attend,
            sock=listening,
            process_request=self._answer,
            compression=None,
            max_size=4 * LONGEST,
            write_limit=_BUFFERED,
            open_timeout=self._patience,
            ping_interval=self._patience / 2,
            ping_timeout=self._patience,
            close_timeout=1,
            server_header=None,
            logger=quiet,
        ):
            loop.add_reader(self._pipe.fileno(), hear_game)
            await ended.wait()

    def _answer(self, connection: Any, request: Any) -> Any:
        """Reject other sites and serve files; None opens a WebSocket."""
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
            return connection.respond(HTTPStatus.NOT_FOUND, "No such file.\n")
        body, kind = self._files[path]
        response = connection.respond(HTTPStatus.OK, body)
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = f"{kind}; charset=utf-8"
        response.headers["Content-Security-Policy"] = _POLICY
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Cache-Control"] = "no-store"
        return response

    async def _attend(self, websocket: Any) -> None:
        """Serve a page until it leaves, stops reading, or sends an invalid message."""
        from websockets.exceptions import ConnectionClosed

        own = websocket.transport.get_extra_info("socket")
        own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SENT)
        page = _Page(websocket, self._patience)
        self._pages.append(page)
        for message in self._remembered.values():
            page.tell(message)
        if not self._shared:
            self._seat(page)
        try:
            async with asyncio.TaskGroup() as tasks:
                sending = tasks.create_task(page.send())
                await self._read(page)
                sending.cancel()
        except* ConnectionClosed:
            pass
        except* TimeoutError:
            websocket.transport.abort()  # an orderly close would wait for the page
        except* Exception:
            _log.exception("the connection of a page failed")
        finally:
            self._pages.remove(page)
            self._leave(page)

    async def _read(self, page: _Page) -> None:
        """Process a page's messages until it leaves, exceeds its rate limit, or sends garbage."""
        async for message in page.websocket:
            parsed = read_message(message) if page.limit.take(time.monotonic()) else None
            if parsed is None:
                await page.websocket.close(
                    _POLICY_VIOLATION, "invalid message, or rate limit exceeded"
                )
                return
            self._obey(page, parsed)

    def _seat(self, page: _Page) -> None:
        """Give a page the seat if the seat is free."""
        free = self._player is None
        if free:
            self._player = page
            self._order(b'{"do": "sit"}')
        page.tell(json.dumps({"is": "role", "role": "player" if free else "spectator"}))

    def _leave(self, page: _Page) -> None:
        """Free the seat, if the page had it."""
        if self._player is page:
            self._player = self._wish = None
            self._order(b'{"do": "leave"}')
        self._count_thinkers()

    def _obey(self, page: _Page, parsed: Wish | Order) -> None:
        """Carry out a page's request, if permitted."""
        if isinstance(parsed, Wish):
            if self._shared or page is self._player:
                self._wish = WISH + packed_wish(parsed)
                self._tell_game()
        elif parsed.do == "think":
            page.thinks = parsed.on
            self._count_thinkers()
        elif parsed.do == "sit":
            if page is not self._player:
                self._seat(page)
        elif page is self._player and len(self._orders) < _ORDERS:
            self._order(json.dumps(parsed._asdict()).encode())

    def _count_thinkers(self) -> None:
        """Ask the game to publish plans while any page shows them."""
        thinks = any(page.thinks for page in self._pages)
        if thinks != self._thinks:
            self._thinks = thinks
            self._order(json.dumps({"do": "think", "on": thinks}).encode())

    def _order(self, content: bytes) -> None:
        """Send the game an order as soon as the pipe has room."""
        self._orders.append(ORDER + content)
        self._tell_game()

    def _tell_game(self) -> None:
        """Send all waiting orders and the newest wish as soon as the pipe has room."""
        if not self._tells:
            self._tells = True
            asyncio.get_running_loop().add_writer(self._pipe.fileno(), self._tell_next)

    def _tell_next(self) -> None:
        """Send one waiting message; the pipe has room."""
        try:
            if self._orders:
                self._pipe.send_bytes(self._orders.popleft())
            elif self._wish is not None:
                self._pipe.send_bytes(self._wish)
                self._wish = None
        except OSError:  # the game has ended; the reader of the pipe notices
            self._orders.clear()
            self._wish = None
        if not self._orders and self._wish is None:
            self._tells = False
            asyncio.get_running_loop().remove_writer(self._pipe.fileno())

    def _hear_game(self, message: bytes) -> None:
        """Forward a message from the game to the pages."""
        kind, content = message[:1], message[1:]
        text = content if kind == STATE else content.decode()
        if kind == EVENT:
            for page in self._pages:
                page.tell(text)
            return
        name = {STATE: "state", THOUGHT: "thought"}.get(kind) or json.loads(text)["is"]
        if kind == SCENE:
            self._remembered[name] = text
        for page in self._pages:
            if page.thinks or kind != THOUGHT:
                page.show(name, text)
