"""A connection to pages in browsers: address, and messages in both directions."""

from __future__ import annotations

import json
import multiprocessing
import select
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from multiprocessing.connection import Connection
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.craft.table import AirHockey, Table
from airpuck.model.model_file import Model
from airpuck.report.table_canvas import color_scheme, craft_shape, hockey_shape
from airpuck.web.requests import Wish, listen, read_message
from airpuck.web.server import EVENT, SCENE, STATE, THOUGHT, WISH, PageKind, serve

#: Number of steps between plans that are shown.
_THOUGHTS_EVERY = 3


class Pages:
    """The pages of a game: messages to them, and their wishes.

    If `waits` is false, messages that do not fit into the pipe are dropped, because the caller is a
    control loop. When the page server ends, `lost` is set, and all other calls have no effect.
    """

    def __init__(self, pipe: Connection, *, waits: bool = True, url: str = "") -> None:
        self._pipe, self._waits, self.url = pipe, waits, url
        #: Last message sent, by name.
        self._sent: dict[str, bytes] = {}
        self._thoughts = 0
        #: Whether any page shows plans.
        self.thinks = False
        #: Whether the page server has ended.
        self.lost = False

    def hear(self) -> tuple[list[dict[str, Any]], Wish | None]:
        """Return the pages' requests: orders, and the newest wish, if any."""
        orders, wish = [], None
        while (message := self._receive()) is not None:
            if message[:1] == WISH:
                wish = read_message(message[1:])
                continue
            order = json.loads(message[1:])
            if order["do"] == "think":
                self.thinks = order["on"]
            else:
                orders.append(order)
        return orders, wish if isinstance(wish, Wish) else None

    def show(self, state: bytes) -> None:
        """Show all positions."""
        self._send(STATE + state)

    def say(self, event: dict[str, Any]) -> None:
        """Send an event."""
        self._send(EVENT + json.dumps(event).encode())

    def say_status(self, phase: str, score: tuple[int, int], level: str) -> None:
        """Send the status of the game if it has changed."""
        self.update("status", {"phase": phase, "score": list(score), "level": level})

    def update(self, name: str, scene: dict[str, Any]) -> None:
        """Send a lasting message if it has changed; only the newest of a name counts."""
        message = json.dumps({"is": name, **scene}).encode()
        if self._sent.get(name) != message and self._send(SCENE + message):
            self._sent[name] = message

    def think(self, thought: Callable[[], dict[str, Any]]) -> None:
        """Send every third plan of the craft if any page shows plans."""
        self._thoughts = (self._thoughts + 1) % _THOUGHTS_EVERY
        if self.thinks and not self._thoughts:
            self._send(THOUGHT + json.dumps(thought()).encode())

    def _receive(self) -> bytes | None:
        """Return the next message of the page server, or None."""
        try:
            return self._pipe.recv_bytes() if not self.lost and self._pipe.poll() else None
        except (EOFError, OSError):
            self.lost = True
            return None

    def _send(self, message: bytes) -> bool:
        """Send a message; return whether it was sent."""
        try:
            if self.lost or not (self._waits or select.select([], [self._pipe], [], 0)[1]):
                return False
            self._pipe.send_bytes(message)
        except OSError:
            self.lost = True
        return not self.lost


@contextmanager
def served(
    host: str,
    port: int,
    hello: dict[str, Any],
    *,
    page: PageKind,
    waits: bool = True,
    without: str = "",
) -> Iterator[Pages]:
    """Serve pages of a kind from another process; `hello` is the first message to a page.

    `without` explains how to run without pages if websockets is not installed.
    """
    if find_spec("websockets") is None:
        raise InputError(f"the page needs websockets: pip install 'airpuck[pages]'{without}")
    with listen(host, port) as listening:
        port = listening.getsockname()[1]
        context = multiprocessing.get_context("spawn")
        pipe, far = context.Pipe()
        arguments = far, listening, host, page, hello
        server = context.Process(target=serve, args=arguments, daemon=True)
        server.start()
        far.close()
    try:
        yield Pages(pipe, waits=waits, url=f"http://{host}:{port}")
    finally:
        pipe.close()
        server.join(2)
        server.kill()


def invite(pages: Pages, browser: bool, tell: Any, what: str = "Play") -> None:
    """Print the page's address, and open it in a browser."""
    tell(f"{what} at {pages.url} (Ctrl-C ends)")
    if browser:
        webbrowser.open(pages.url)


def table_of(model: Model, table: Table, game: AirHockey | None = None) -> dict[str, Any]:
    """Return the data that a page needs to draw a craft on its table, and a game's if given."""
    x, y = table.length_m / 2, table.width_m / 2
    return {
        "table": [table.length_m, table.width_m],
        "view": [-x, x, -y, y],
        "craft": craft_shape(model.vehicle),
        "hockey": game and hockey_shape(game),
        "schemes": {name: color_scheme(name) for name in ("light", "dark")},
    }
