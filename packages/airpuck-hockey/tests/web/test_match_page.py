"""A match on a page: a spectator receives all of it, from beginning to end."""

from __future__ import annotations

import json
import struct
import threading

import pytest

import airpuck
from airpuck_hockey.game.contestant import contestant
from airpuck_hockey.game.game import Game
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.web import match_page
from airpuck_hockey.web.match_page import watch_in_browser
from airpuck_hockey.web.settings import ArenaSettings
from tests.apparatus.arena import free_port


@pytest.mark.slow
def test_a_page_sees_a_game_from_its_beginning_to_its_end(monkeypatch):
    pytest.importorskip("websockets")
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    monkeypatch.setattr(match_page, "_END", 0.2)
    players = contestant("human:hard"), contestant("human:easy")
    game, said = Game(*players, rules=Rules(limit_s=1.0)), []
    arena, ready = ArenaSettings(free_port(), browser=False), threading.Event()

    def tell(line: str) -> None:
        said.append(line)
        ready.set()

    model = airpuck.read_model("paper:M3")
    playing = threading.Thread(target=watch_in_browser, args=(game, model, arena, tell))
    playing.start()
    assert ready.wait(30.0)
    assert said == [f"Watch at http://127.0.0.1:{arena.port} (Ctrl-C ends)"]
    assert game.time == 0.0  # it waits for the page
    news, states = [], []
    with connect(f"ws://127.0.0.1:{arena.port}/", compression=None) as page:
        try:
            while True:
                message = page.recv(timeout=30)
                (states if isinstance(message, bytes) else news).append(message)
        except ConnectionClosed:
            pass
    playing.join(30.0)
    hello, *news = map(json.loads, news)
    assert hello["names"] == ["human:hard", "human:easy"]
    assert hello["sides"] == ["hand", "hand"]
    assert {one["phase"] for one in news if one["is"] == "status"} == {"watch"}
    assert news[-1] == {"is": "event", "kind": "over", "side": 0}
    seen = [struct.unpack("<dIB3x10f", state) for state in states]
    assert seen[-1][0] == pytest.approx(1.0)
    # The positions of both mallets equal those at the end of the game.
    left, right = game.sides
    assert seen[-1][6:8] == pytest.approx(right.state[:2], abs=1e-6)
    assert seen[-1][10:12] == pytest.approx(left.state[:2], abs=1e-6)
