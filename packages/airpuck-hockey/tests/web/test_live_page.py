"""The page of a game on the graph; the test plays the page server and the table."""

import json
import math
import multiprocessing
import os
import struct
import time

import numpy as np
import pytest

import airpuck
from airpuck import AirHockey, Measurement, Step
from airpuck.flight.loop import Action
from airpuck.live.graph import SENSOR, Graph
from airpuck.live.process import Process
from airpuck.live.settings import LiveSettings
from airpuck.recording.message import StreamCodec
from airpuck.web.page import Pages
from airpuck.web.requests import Wish, packed_wish
from airpuck.web.server import EVENT, ORDER, SCENE, STATE, THOUGHT, WISH
from airpuck_hockey import Player
from airpuck_hockey.game.rules import Ruling
from airpuck_hockey.game.scorekeeper import Score
from airpuck_hockey.web.live_page import LivePage

pytestmark = pytest.mark.slow

PLAY = AirHockey()
IDLE = np.full(6, 0.03)


@pytest.fixture(scope="module")
def domain() -> int:
    """A domain for this module."""
    pytest.importorskip("cyclonedds")
    return 201 + os.getpid() % 30


@pytest.fixture(scope="module")
def player() -> Player:
    return Player(airpuck.read_model("paper:M3"), PLAY)


class Flight:
    """A flight with its page, step by step."""

    def __init__(self, domain: int, player: Player) -> None:
        self.near, self.far = multiprocessing.Pipe()
        self.process = Process("airpuck play", LiveSettings(domain=domain, quiet=True))
        self.score = Score(PLAY)
        self.page = LivePage(Pages(self.near, waits=False), self.score, "hard")
        self.page.begin(self.process, player)
        self.time = 0.0

    def step(self, **poses: tuple[float, float, float]) -> None:
        """Advance by a period in which bodies are seen at given places."""
        self.time += 0.01
        for kind, pose in poses.items():
            kind = "pose" if kind == "craft" else kind
            self.page.measured(Measurement(kind, self.time, np.array(pose)))
        step = Step(IDLE, "optimal", np.zeros(3), None)
        self.page.after(Action(self.time, self.time, step, np.zeros(6), 0.0))

    def ask(self, do: str, **more: object) -> None:
        """Send a request as a page does."""
        self.far.send_bytes(ORDER + json.dumps({"do": do, "level": "", **more}).encode())

    def wish(self, x: float, y: float) -> None:
        """Move the pointer."""
        self.far.send_bytes(WISH + packed_wish(Wish(1, x, y)))

    def said(self) -> dict[bytes, list]:
        """Return messages to pages since the last call, by kind."""
        found: dict[bytes, list] = {STATE: [], EVENT: [], SCENE: [], THOUGHT: []}
        while self.far.poll():
            message = self.far.recv_bytes()
            kind, content = message[:1], message[1:]
            found[kind].append(
                struct.unpack("<dIB3x16f", content) if kind == STATE else json.loads(content)
            )
        return found

    def close(self) -> None:
        """End it."""
        self.process.graph.close()
        self.near.close(), self.far.close()


@pytest.fixture
def flight(domain, player):
    made = Flight(domain, player)
    yield made
    made.close()


class Table:
    """A table whose mallet a page may move, or a recorder of where a page wants it."""

    def __init__(self, domain: int, *, sees: bool = True, guided: bool = False) -> None:
        self.graph, self._codec = Graph("table", domain=domain), StreamCodec("mallet_target")
        kind = self._codec.msgtype, self._codec.types, SENSOR
        if sees:
            self.graph.publisher("/optitrack/mallet/pose", *kind)
        self._heard = self.graph.subscription("/mallet/target", *kind) if guided else None

    def wanted(self) -> list:
        """Return the page's targets for the mallet since the last call."""
        return [self._codec.decode(one.data)[1][:2].tolist() for one in self._heard.take()]


def until(flight: Flight, condition, timeout: float = 10.0):
    """Let the flight continue until a condition holds; return it."""
    stop = time.monotonic() + timeout
    while not (found := condition()):
        assert time.monotonic() < stop
        flight.step(craft=(-0.8, 0.1, 0.2))
        time.sleep(0.005)
    return found


def phase_of(flight: Flight, wanted: str) -> bool:
    """Return whether a phase was reported since the last call."""
    return any(one.get("phase") == wanted for one in flight.said()[SCENE])


def test_everything_is_drawn_where_it_was_seen(flight):
    assert flight.said()[SCENE][0]["phase"] == "starting"
    flight.step(craft=(-0.8, 0.1, 0.2), puck=(0.3, 0.2, 1.0), mallet=(0.8, -0.1, 0.0))
    flight.step(craft=(-0.8, 0.1, 0.2), puck=(0.3, 0.2, 1.0), mallet=(0.82, -0.1, 0.0))
    said = flight.said()
    stamp, heard, hidden, *numbers = said[STATE][-1]
    assert (stamp, heard, hidden) == (pytest.approx(0.02), 0, 0)
    places = [0.3, 0.2, 1.0, 0.82, -0.1, 2.0, 0.0, -0.8, 0.1, 0.2, *IDLE]
    assert numbers == pytest.approx(places, abs=1e-5)
    status = said[SCENE][-1]
    assert (status["phase"], status["score"], status["level"]) == ("watch", [0, 0], "hard")


def test_unseen_objects_are_not_drawn(flight):
    flight.step(craft=(-0.8, 0.1, 0.2), puck=(0.3, 0.2, 1.0))
    for _ in range(20):
        flight.step(craft=(-0.8, 0.1, 0.2))
    flight.step(craft=(-0.8, 0.1, 0.2), mallet=(math.nan, 0.0, 0.0))
    _, _, hidden, *numbers = flight.said()[STATE][-1]
    assert hidden
    assert all(math.isnan(number) for number in numbers[3:5])
    assert numbers[7] == pytest.approx(-0.8)
    # Cameras that see nothing show nothing new.
    flight.step()
    assert flight.said()[STATE] == []


def test_goals_are_announced(flight):
    flight.score.rulings = [Ruling("goal", -1), Ruling("over", -1)]
    flight.step(craft=(-0.8, 0.1, 0.2))
    events = flight.said()[EVENT]
    assert [(one["kind"], one["side"]) for one in events] == [("goal", -1), ("over", -1)]


def test_thoughts_are_sent_on_request(flight):
    flight.ask("think", on=True)
    for _ in range(4):
        flight.step(craft=(-0.8, 0.1, 0.2))
    assert flight.said()[THOUGHT][-1]["is"] == "thought"
    flight.ask("think", on=False)
    flight.step()
    flight.said()
    for _ in range(4):
        flight.step(craft=(-0.8, 0.1, 0.2))
    assert flight.said()[THOUGHT] == []


def test_a_player_at_a_page_moves_a_guided_mallet(flight, domain):
    table = Table(domain, guided=True)
    try:
        flight.wish(0.5, 0.3)  # no page is seated
        until(flight, lambda: phase_of(flight, "waiting"))
        flight.ask("sit")
        until(flight, lambda: phase_of(flight, "play"))
        assert table.wanted() == []
        flight.wish(0.5, 0.25)
        assert until(flight, table.wanted)[-1] == pytest.approx((0.5, 0.25))
        # It repeats the target, whether the pointer moves or not.
        assert until(flight, table.wanted)[-1] == pytest.approx((0.5, 0.25))
        flight.ask("leave")
        until(flight, lambda: phase_of(flight, "waiting"))
        table.wanted()
        for _ in range(10):
            flight.step(craft=(-0.8, 0.1, 0.2))
            time.sleep(0.005)
        assert table.wanted() == []
    finally:
        table.graph.close()


def test_pages_only_watch_if_a_human_plays_at_the_table(flight, domain):
    """A recorder receives everything, but sends no poses of a mallet."""
    table, recorder = Table(domain), Table(domain, sees=False, guided=True)
    try:
        flight.ask("sit")
        graph = flight.process.graph
        until(flight, lambda: graph.subscribers("/mallet/target") and graph.publishers())
        flight.said()
        for _ in range(60):
            flight.wish(0.5, 0.3)
            flight.step(craft=(-0.8, 0.1, 0.2))
            time.sleep(0.01)
        assert not phase_of(flight, "play")
        assert recorder.wanted() == []
    finally:
        table.graph.close()
        recorder.graph.close()


def test_a_flight_does_not_wait_for_its_pages(flight):
    """The server stalls: it reads nothing for a minute."""
    begin = time.monotonic()
    for _ in range(6000):
        flight.step(craft=(-0.8, 0.1, 0.2))
    assert time.monotonic() - begin < 30.0
    assert len(flight.said()[STATE]) < 6000
    flight.step(craft=(-0.8, 0.1, 0.2))
    assert len(flight.said()[STATE]) == 1


def test_a_flight_continues_without_its_pages(flight):
    flight.far.close()
    for _ in range(3):
        flight.step(craft=(-0.8, 0.1, 0.2))
    assert flight.process.events.counts["warning"] == 1
