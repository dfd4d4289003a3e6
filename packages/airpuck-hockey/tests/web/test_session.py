"""A game in real time: seat, pause, levels, a leaving player; the test plays the server."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import multiprocessing
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.twin.settings import default_twin_settings
from airpuck.web.page import Pages
from airpuck.web.requests import LOOPBACK, Wish, address_of, listen, packed_wish
from airpuck.web.server import EVENT, ORDER, SCENE, STATE, THOUGHT, WISH
from airpuck_hockey.player.player import Player
from airpuck_hockey.web import page as session_module
from airpuck_hockey.web.page import Session, play_in_browser
from airpuck_hockey.web.settings import ArenaSettings

pytestmark = [pytest.mark.slow, pytest.mark.realtime]


@dataclass
class State:
    """A state as the page reads it."""

    time: float
    heard: int
    hidden: bool
    puck: tuple[float, ...]
    mallet: tuple[float, ...]
    craft: tuple[float, ...]

    @classmethod
    def of(cls, data: bytes) -> State:
        """Unpack it."""
        numbers = struct.unpack_from("<10f", data, 16)
        time, heard, flags = struct.unpack_from("<dIB", data)
        return cls(time, heard, bool(flags), numbers[:3], numbers[3:7], numbers[7:10])


@dataclass
class Table:
    """A session, and its messages."""

    session: Session
    pipe: object
    states: list[State] = field(default_factory=list)
    news: list[dict] = field(default_factory=list)
    thoughts: list[dict] = field(default_factory=list)

    def order(self, do: str, **more) -> None:
        """Send a request, as the server does."""
        order = {"do": do, "level": "", "on": False, **more}
        self.pipe.send_bytes(ORDER + json.dumps(order).encode())

    def wish(self, number: int, x: float, y: float) -> None:
        """Move the pointer."""
        self.pipe.send_bytes(WISH + packed_wish(Wish(number, x, y)))

    def run(self, duration: float) -> dict:
        """Run the session for a while."""
        self.states.clear(), self.news.clear(), self.thoughts.clear()
        listening = threading.Thread(target=self._listen)
        listening.start()
        try:
            return self.session.run(duration)
        finally:
            self.session._pages._pipe.send_bytes(b"end")
            listening.join()

    def _listen(self) -> None:
        while (message := self.pipe.recv_bytes()) != b"end":
            kind, content = message[:1], message[1:]
            if kind == STATE:
                self.states.append(State.of(content))
            else:
                {EVENT: self.news, SCENE: self.news, THOUGHT: self.thoughts}[kind].append(
                    json.loads(content)
                )

    @property
    def phases(self) -> list[str]:
        """Return the phases that it reported."""
        return [one["phase"] for one in self.news if one["is"] == "status"]


@contextlib.contextmanager
def session(level: str, tactic: str | None = None, record: Path | None = None) -> Iterator[Table]:
    """A session at a table of its own."""
    near, far = multiprocessing.Pipe()
    model, settings = airpuck.read_model("paper:M3"), default_twin_settings()
    yield Table(Session(Pages(near), model, settings, level, 0, tactic, record), far)
    near.close()
    far.close()


@pytest.fixture(scope="module")
def table() -> Iterator[Table]:
    """One session for all tests, since making a player takes a while; each starts a new game."""
    pytest.MonkeyPatch().setattr(session_module, "prioritize", lambda **_: None)
    with session("medium") as table:
        yield table


@pytest.fixture
def begun(table) -> Table:
    """A game that runs."""
    table.order("sit")
    table.order("restart")
    phases = []
    while "play" not in phases:  # new games are rate-limited
        table.run(0.05)
        phases += table.phases
    return table


def test_nothing_moves_before_the_player_starts(table):
    table.run(0.1)
    assert table.phases[-1] == "waiting"
    table.order("sit")
    table.wish(1, 0.2, 0.2)
    table.run(0.2)
    assert table.phases == ["ready"]
    assert len({state.time for state in table.states}) == 1
    table.order("go")
    figures = table.run(0.3)
    assert table.phases == ["play"]
    assert figures["periods"] == len({state.time for state in table.states})


def test_time_passes_no_faster_than_the_clock(begun):
    figures = begun.run(1.0)
    times = [state.time for state in begun.states]
    # The slowdown depends on the load of the machine; the study measures it.
    assert 0.1 < times[-1] - times[0] < figures["duration_s"] + 0.01
    # One state per control period, as of its last event, without omissions.
    steps = [after - before for before, after in itertools.pairwise(times)]
    assert steps == pytest.approx([0.01] * len(steps), abs=5e-3)


def test_the_mallet_follows_the_pointer_as_fast_as_a_hand(begun):
    begun.wish(7, 0.3, 0.35)
    begun.run(1.5)
    assert begun.states[-1].heard == 7
    assert begun.states[-1].mallet[:2] == pytest.approx((0.3, 0.35), abs=1e-3)
    speeds = [math.hypot(*state.mallet[2:]) for state in begun.states]
    assert max(speeds) <= 4.0 + 1e-4
    gained = [abs(b - a) for a, b in itertools.pairwise(speeds)]
    assert max(gained) <= 40.0 * 0.015 + 1e-4
    # The mallet stops at the centre line, wherever the pointer is.
    begun.wish(8, -1e30, 1e30)
    begun.run(1.5)
    x, y = begun.states[-1].mallet[:2]
    assert (x, y) == pytest.approx((0.04815, 0.55 - 0.04815), abs=1e-3)


def test_a_pause_stops_the_game(begun):
    begun.order("pause")
    begun.run(0.1)
    assert begun.phases == ["paused"]
    assert len({state.time for state in begun.states}) == 1
    begun.wish(9, 0.6, 0.3)  # the pointer moves meanwhile, and then rests
    begun.run(0.05)
    begun.order("go")
    begun.run(0.8)
    assert begun.phases == ["play"]
    assert begun.states[-1].mallet[:2] == pytest.approx((0.6, 0.3), abs=1e-3)


def test_choosing_a_level_starts_a_new_game(begun):
    assert begun.news[-1]["level"] == "medium"
    begun.order("level", level="easy")
    begun.run(0.1)
    assert begun.phases == ["starting", "ready"]
    assert begun.news[-1]["level"] == "easy"
    assert begun.news[-1]["score"] == [0, 0]
    begun.order("level", level="nonsense")
    begun.run(0.05)
    assert begun.phases == []


def test_games_are_recorded_with_the_names_of_their_players(tmp_path):
    with session("easy", record=tmp_path) as table:
        table.order("sit")
        table.order("go")
        table.wish(1, 0.3, 0.35)
        table.run(0.5)  # ends a game
        names = {"left": "airpuck:easy", "right": "you", "written_by": "airpuck"}
        recording = airpuck.read_recording(tmp_path / "game-1", needs=("mallet", "puck", "pose"))
        assert recording.about == names
        target, place = np.array([0.3, 0.35]), recording["mallet"].values[:, :2]
        assert np.hypot(*(place[-1] - target)) < np.hypot(*(place[0] - target)) - 0.1
        table.order("level", level="hard")  # saves the previous game; no player starts another
        table.run(0.2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["game-1", "game-2"]


def test_a_game_is_recorded_even_if_the_tactic_fails(tmp_path):
    tactic = tmp_path / "late.py"
    tactic.write_text(
        "import airpuck\nimport airpuck_hockey\n\n\nclass Late:\n    def decide(self, view):\n"
        "        assert view.time < 0.4\n"
        '        return airpuck_hockey.Intention("home", airpuck.SetPoint(*view.pitch.home, 0.0))\n'
    )
    with session("easy", f"{tactic}:Late", tmp_path / "games") as table:
        table.order("sit")
        table.order("go")
        with pytest.raises(InputError, match="tactic: line 7: decide"):
            table.run(1.0)
    recording = airpuck.read_recording(tmp_path / "games" / "game-1", needs=("mallet", "game"))
    assert 0.3 < np.ptp(recording["mallet"].stamp_ns) / 1e9 < 0.6


def test_thoughts_are_sent_on_request(begun):
    begun.run(0.1)
    assert begun.thoughts == []
    begun.order("think", on=True)
    begun.run(0.5)
    thought = begun.thoughts[-1]
    assert set(thought) == {"is", "words", "meet", "path", "predicted", "said"}
    x, y = thought["predicted"][0]
    state = begun.states[-1]
    assert (x, y) == pytest.approx(state.puck[:2], abs=0.3)
    begun.order("think", on=False)
    begun.run(0.05)


def test_the_craft_goes_home_and_waits_while_the_player_is_away(begun):
    begun.run(0.3)
    begun.order("leave")
    begun.run(2.9)
    assert begun.phases == ["waiting"]
    while begun.session._moves:  # a busy machine takes longer
        begun.run(0.2)
    home = begun.session._player.pitch.home
    assert begun.states[-1].craft[:2] == pytest.approx(home, abs=0.03)
    assert begun.states[-1].puck[:2] == pytest.approx((0.3, 0.0), abs=0.05)
    at = begun.states[-1].time
    begun.run(0.2)
    assert {state.time for state in begun.states} == {at}
    begun.order("sit")
    begun.run(0.05)
    assert begun.phases == ["paused"]
    begun.order("go")
    begun.run(0.1)
    assert begun.phases == ["play"]
    assert isinstance(begun.session._player, Player)
    assert begun.session._player.tactic is begun.session._tactic


@pytest.mark.parametrize("ends", [False, True])
def test_the_next_visitor_gets_a_new_game_at_the_first_level(begun, monkeypatch, ends):
    begun.order("level", level="hard")
    begun.order("go")
    while begun.session.phase != "play":
        begun.run(0.1)
    if ends:
        begun.session._game.referee.phase = "over"
    monkeypatch.setattr(session_module, "_KEPT", 0.5)
    begun.order("leave")
    begun.run(0.2)
    # A player who leaves for a moment can resume the game.
    assert (begun.news[-1]["level"] == "hard") is not ends
    begun.run(1.5)
    begun.order("sit")
    begun.run(0.1)
    assert (begun.news[-1]["phase"], begun.news[-1]["level"]) == ("ready", "medium")


def test_a_goal_is_announced_and_counted(begun):
    puck = begun.session._game.world.puck
    puck.place(puck.state._replace(x=1.05, y=0.0, vx=5.0, vy=0.0))
    begun.wish(1, 0.6, 0.4)
    begun.run(0.2)
    events = [(one["kind"], one["side"]) for one in begun.news if one["is"] == "event"]
    assert ("goal", -1) in events
    assert begun.news[-1]["score"] == [1, 0]
    assert begun.states[-1].hidden
    # The results are those of the last game that was played, not of one that waits.
    begun.order("level", level="easy")
    begun.run(0.1)
    assert begun.session.run(0.0)["score"] == [1, 0]


def test_a_flood_of_restarts_starts_few_games(begun):
    games = begun.session.run(0.0)["games"]
    for _ in range(200):
        begun.order("restart")
    figures = begun.run(1.0)
    assert figures["games"] - games <= 4
    # Time on the table does not stop meanwhile.
    begun.run(1.0)
    assert begun.states[-1].time > 0.2


def test_the_last_order_waiting_for_a_new_game_counts(begun):
    for deed in ("restart", "restart", "go", "pause"):
        begun.order(deed)
    phases = []
    while "ready" not in phases:
        begun.run(0.1)
        phases += begun.phases
    assert "play" not in phases


def test_the_session_ends_with_the_page_server_and_keeps_its_figures():
    with session("hard") as table:
        table.pipe.close()
        figures = table.session.run(60.0)
    assert figures["page_server_ended"]
    assert figures["duration_s"] < 1.0
    assert figures["score"] == [0, 0]


def test_impossible_server_settings_are_rejected():
    model = airpuck.read_model("paper:M3")
    with pytest.raises(InputError, match="--level"):
        play_in_browser(model, level="impossible")
    with pytest.raises(InputError, match="port"):
        ArenaSettings(port=0)
    with pytest.raises(InputError, match="no network interface 'nonsense'"):
        address_of("nonsense")
    with listen(LOOPBACK, 0) as taken:
        host, port = taken.getsockname()
        assert host == "127.0.0.1"
        with pytest.raises(InputError, match="choose another --port"):
            listen(LOOPBACK, port)
