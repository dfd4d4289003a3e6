"""A page server; the test plays the game at the other end of its pipe."""

import json
import multiprocessing
import socket
import struct
from typing import Any

from airpuck.web.requests import LOOPBACK, listen
from airpuck.web.server import ORDER, PATIENCE, PageKind, serve

#: A page whose first visitor takes the seat.
SEAT = PageKind("airpuck", "view")


def free_port() -> int:
    """Return an unused port."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


class Arena:
    """A server, and the game's end of its pipe."""

    def __init__(
        self, hello: dict[str, Any], patience: float = PATIENCE, page: PageKind = SEAT
    ) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, far = context.Pipe()
        with listen(LOOPBACK, 0) as listening:
            self.port = listening.getsockname()[1]
            arguments = far, listening, LOOPBACK, page, hello, patience
            self.process = context.Process(target=serve, args=arguments)
            self.process.start()
        far.close()

    def page(self, **options):
        """Open a page."""
        from websockets.sync.client import connect

        return connect(f"ws://127.0.0.1:{self.port}/", compression=None, **options)

    def heard(self, timeout: float = 5.0) -> tuple[bytes, Any]:
        """Return the next message that the game receives."""
        assert self.pipe.poll(timeout)
        message = self.pipe.recv_bytes()
        kind, content = message[:1], message[1:]
        return kind, json.loads(content) if kind == ORDER else struct.unpack("<Ifff", content)

    def ordered(self) -> dict[str, Any]:
        """Return the next order, skipping wishes."""
        while True:
            kind, content = self.heard()
            if kind == ORDER:
                return content

    def hears(self, *orders: str) -> None:
        """Check that the game receives these orders next."""
        for order in orders:
            assert self.ordered()["do"] == order

    def silent(self) -> bool:
        """Check that the game receives nothing more."""
        return not self.pipe.poll(0.2)

    def close(self) -> None:
        """End it."""
        self.pipe.close()
        self.process.join(5)
        ended = self.process.exitcode
        self.process.kill()
        assert ended == 0
