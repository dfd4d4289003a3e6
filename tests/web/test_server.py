"""The page server against hostile pages; the test plays the game at the other end of its pipe."""

import asyncio
import contextlib
import http.client
import json
import multiprocessing
import os
import signal
import socket
import struct
import time
from collections.abc import Iterator

import pytest

from airpuck.web.server import EVENT, ORDER, SCENE, STATE, THOUGHT, WISH
from airpuck.web.view import VIEW_PAGE

from ..apparatus.arena import Arena
from ..apparatus.handshakes import websocket as opened

client = pytest.importorskip("websockets.sync.client")
exceptions = pytest.importorskip("websockets.exceptions")

HELLO = {"names": ["airpuck", "you"]}


@pytest.fixture
def arena() -> Iterator[Arena]:
    """A separate server for each test: some abort connections."""
    with contextlib.closing(Arena(HELLO)) as made:
        yield made


def news(page, kind: str) -> dict:
    """Return the next message of a kind."""
    while True:
        message = page.recv(timeout=5)
        if isinstance(message, str) and (found := json.loads(message))["is"] == kind:
            return found


def test_only_the_listed_files_are_served(arena):
    connection = http.client.HTTPConnection("127.0.0.1", arena.port, timeout=5)

    def get(path: str, **headers: str) -> http.client.HTTPResponse:
        connection.close()
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        answer.body = answer.read()
        return answer

    for path, kind in [("/", "html"), ("/view.js", "javascript"), ("/view.css", "css")]:
        answer = get(path)
        assert answer.status == 200
        assert kind in answer.headers["Content-Type"]
        assert len(answer.headers.get_all("Content-Length")) == 1
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        # No request goes to another host.
        assert b"//" not in answer.body.replace(b"http://www.w3.org/2000/svg", b"") or path != "/"
    assert b"class TableCanvas" in get("/table_canvas.js").body
    for path in ("/../pyproject.toml", "/paper.toml", "/%2e%2e/x", "//", "/x" * 500):
        assert get(path).status == 404
    assert get("/", Host="evil.example").status == 403
    assert get("/view.js", Origin="http://evil.example").status == 403


def test_another_site_cannot_play(arena):
    here = f"127.0.0.1:{arena.port}"
    assert opened(arena.port, {"Origin": f"http://{here}"}) == 101
    arena.hears("sit", "leave")
    assert opened(arena.port, {"Origin": "http://evil.example"}) == 403
    assert opened(arena.port, {"Host": "evil.example", "Origin": "http://evil.example"}) == 403
    assert opened(arena.port, {"Host": "evil.example"}) == 403
    assert opened(arena.port, {"Origin": "null"}) == 403
    assert arena.silent()


def test_the_second_page_watches_until_the_seat_is_free(arena):
    with arena.page() as first:
        assert news(first, "hello")["names"] == HELLO["names"]
        assert news(first, "role")["role"] == "player"
        arena.hears("sit")
        with arena.page() as second:
            assert news(second, "role")["role"] == "spectator"
            second.send(struct.pack("<Ifff", 1, 0.5, 0.0, 0.0))
            for deed in ("pause", "restart", "go", "sit"):
                second.send(json.dumps({"do": deed}))
            assert news(second, "role")["role"] == "spectator"  # the answer to "sit"
            first.send(struct.pack("<Ifff", 3, 0.25, 0.5, 0.0))
            assert arena.heard() == (WISH, (3, 0.25, 0.5, 0.0))  # and nothing of the second's
            first.send('{"do": "pause"}')
            arena.hears("pause")
            # Both see.
            arena.pipe.send_bytes(STATE + b"where")
            assert first.recv(timeout=5) == second.recv(timeout=5) == b"where"
            first.close()
            arena.hears("leave")
            second.send('{"do": "sit"}')
            assert news(second, "role")["role"] == "player"
            arena.hears("sit")
    arena.hears("leave")


def test_every_page_of_the_live_view_may_move_the_set_point():
    with contextlib.closing(Arena({"reach": [1, 0.5]}, page=VIEW_PAGE)) as arena:
        with arena.page() as first:
            assert news(first, "hello")["reach"] == [1, 0.5]
            arena.pipe.send_bytes(SCENE + b'{"is": "scene", "plan": null}')
            assert news(first, "scene")["plan"] is None
            with arena.page() as second:
                assert news(second, "scene")["plan"] is None  # sent before this page came
                for number, page in enumerate((first, second)):
                    page.send(struct.pack("<Ifff", number, 0.5, 0.25, 2.0))
                    assert arena.heard() == (WISH, (number, 0.5, 0.25, 2.0))
        assert arena.silent()


def test_a_late_page_receives_the_status(arena):
    status = {"is": "status", "phase": "play", "score": [2, 3]}
    with arena.page() as first:
        arena.pipe.send_bytes(SCENE + json.dumps(status).encode())
        assert news(first, "status") == status
        with arena.page() as second:
            assert news(second, "status") == status


def test_thoughts_are_sent_only_to_pages_that_requested_them(arena):
    with arena.page() as first, arena.page() as second:
        arena.hears("sit")
        news(second, "role")
        second.send('{"do": "think", "on": true}')
        assert arena.heard() == (ORDER, {"do": "think", "on": True})
        arena.pipe.send_bytes(THOUGHT + b'{"is": "thought"}')
        arena.pipe.send_bytes(EVENT + b'{"is": "event"}')
        news(second, "thought")
        assert [json.loads(first.recv(timeout=5))["is"] for _ in range(3)] == [
            "hello",
            "role",
            "event",
        ]
        second.close()
        assert arena.heard() == (ORDER, {"do": "think", "on": False})


@pytest.mark.parametrize(
    "garbage",
    ["", "{", '{"do": "leave"}', "x" * 200, b"\xff" * 16, b"\0" * 100, "\N{BILLIARDS}" * 20],
)
def test_an_invalid_message_closes_only_its_connection(arena, garbage):
    with arena.page() as good:
        news(good, "role")
        arena.hears("sit")
        with arena.page() as bad:
            bad.send(garbage)
            with pytest.raises(exceptions.ConnectionClosed):
                while True:
                    bad.recv(timeout=5)
        good.send('{"do": "pause"}')
        arena.hears("pause")
        assert arena.silent()


def test_an_endless_message_closes_its_connection(arena):
    with arena.page() as bad, contextlib.suppress(exceptions.ConnectionClosed, OSError):
        # Never complete: one fragment after the other.
        bad.send(b"\0" * 1000 for _ in range(10_000))
        while True:
            bad.recv(timeout=5)
    arena.hears("sit", "leave")


def test_bytes_that_are_not_frames_harm_no_other_page(arena):
    with socket.create_connection(("127.0.0.1", arena.port), timeout=5) as bare:
        bare.sendall(os.urandom(4096))
        with contextlib.suppress(OSError):
            while bare.recv(4096):
                pass
    with arena.page() as page:
        assert news(page, "role")["role"] == "player"


def test_a_flooding_page_is_disconnected_and_others_continue(arena):
    with arena.page() as good:
        news(good, "role")
        arena.hears("sit")
        with arena.page() as flood:
            began = time.monotonic()
            with contextlib.suppress(exceptions.ConnectionClosed):
                for _ in range(100_000):
                    flood.send(b"\0" * 16)
            assert time.monotonic() - began < 5
        good.send(struct.pack("<Ifff", 1, 0.5, 0.5, 0.0))
        assert arena.heard() == (WISH, (1, 0.5, 0.5, 0.0))


def test_pages_beyond_the_limit_are_rejected(arena):
    from websockets.asyncio.client import connect

    async def come() -> list[int]:
        statuses = []
        async with contextlib.AsyncExitStack() as stack:
            for _ in range(40):
                try:
                    await stack.enter_async_context(connect(f"ws://127.0.0.1:{arena.port}/"))
                    statuses.append(101)
                except exceptions.InvalidStatus as error:
                    statuses.append(error.response.status_code)
        return statuses

    assert asyncio.run(come()) == [101] * 32 + [503] * 8


def test_a_slow_page_gets_the_newest_state_instead_of_a_queue(arena):
    """It reads nothing for two seconds, in which 60 MB are sent."""
    size, count = 30_000, 2000
    with arena.page(max_queue=1) as slow, arena.page() as quick:
        news(slow, "role"), news(quick, "role")
        arena.hears("sit")
        seen = []
        for k in range(count):
            arena.pipe.send_bytes(STATE + struct.pack("<I", k) + b"\0" * size)
            if k % 4 == 0:
                seen.append(struct.unpack_from("<I", quick.recv(timeout=5))[0])
        while seen[-1] < count - 1:
            seen.append(struct.unpack_from("<I", quick.recv(timeout=5))[0])
        late = []
        while not late or late[-1] < count - 1:
            late.append(struct.unpack_from("<I", slow.recv(timeout=5))[0])
        assert late == sorted(late)
        # System and client buffer a few megabytes; everything else was dropped.
        assert len(late) < count / 4


def asleep(port: int) -> socket.socket:
    """A page that connects and reads nothing, such as one on a phone that fell asleep."""
    page = socket.create_connection(("127.0.0.1", port), timeout=5)
    page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    page.sendall(
        f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
    )
    return page


@pytest.mark.parametrize("busy", [False, True], ids=["paused", "playing"])
def test_a_page_that_stops_responding_loses_its_seat(busy):
    """Either its buffer is full, so that no ping arrives, or it does not answer pings."""
    with (
        contextlib.closing(Arena(HELLO, patience=0.3)) as arena,
        asleep(arena.port),
        arena.page() as awake,
    ):
        arena.hears("sit")
        assert news(awake, "role")["role"] == "spectator"
        deadline = time.monotonic() + 10
        while not arena.pipe.poll(0.005):
            assert time.monotonic() < deadline
            if busy:
                arena.pipe.send_bytes(STATE + b"\0" * 30_000)
                awake.recv(timeout=5)
        arena.hears("leave")
        awake.send('{"do": "sit"}')
        assert news(awake, "role")["role"] == "player"


def test_the_server_ends_with_the_game(arena):
    with arena.page() as page:
        news(page, "role")
        os.kill(arena.process.pid, signal.SIGINT)  # only the game reacts to Ctrl-C
        page.send('{"do": "pause"}')
        arena.hears("sit", "pause")
        arena.pipe.close()
        arena.process.join(5)
        assert arena.process.exitcode == 0
    arena.pipe = multiprocessing.Pipe()[0]


def test_a_stalled_game_receives_all_orders_but_only_the_newest_target(arena):
    with arena.page() as page:
        news(page, "role")
        page.send('{"do": "level", "level": "easy"}')
        for number in range(450):
            page.send(struct.pack("<Ifff", number, 0.5, 0.5, 0.0))
            time.sleep(0.001)
        page.send('{"do": "think", "on": true}')
        arena.pipe.send_bytes(SCENE + b'{"is": "status"}')
        news(page, "status")
        time.sleep(0.2)
        arena.hears("sit", "level", "think")
        # The pipe was full of older wishes; the newest arrives nevertheless.
        assert arena.heard() == (WISH, (449, 0.5, 0.5, 0.0))
