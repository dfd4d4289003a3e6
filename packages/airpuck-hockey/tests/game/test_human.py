"""The human at the twin's table, in this process, on the test's own clock."""

import math
import time

import pytest

import airpuck
from airpuck.live.graph import SENSOR, Graph
from airpuck.live.process import Process
from airpuck.live.settings import LiveSettings
from airpuck.live.twin import BEGINS
from airpuck.physics.puck import PuckState
from airpuck.recording.message import StreamCodec
from airpuck_hockey.game.human import Human
from airpuck_hockey.game.scorekeeper import Scorekeeper

pytestmark = [pytest.mark.slow, pytest.mark.realtime]


class Table:
    """A twin with a human, and its events."""

    def __init__(self, process: Process, puck: PuckState, human: str = "easy") -> None:
        self.said: list[str] = []
        process.events.log = lambda level, text, **_: self.said.append(text)
        model = airpuck.read_model("paper:M3")
        start = {"pose": (-0.9, 0.4, 0.0), "puck": puck, "mallet": (BEGINS, 0.0)}
        self.twin = airpuck.Twin(model, **start, logs=False)
        self.human = Human(self.twin, process, human, 0)
        self.keeper, self.called = Scorekeeper(self.twin.settings), []

    @property
    def mallet(self) -> tuple[float, float]:
        """Position of the mallet."""
        return self.twin.world.mallet.x, self.twin.world.mallet.y

    def run(self, until: float) -> None:
        """Let time pass."""
        while self.twin.now < until:
            for measured in self.twin.wait_until(self.twin.now + 0.005):
                self.keeper.frame(measured.stamp)
                if measured.kind == "puck":
                    self.keeper.puck(measured.stamp, measured.values)
            self.called += self.keeper.judge()
            self.human.act(self.twin.now)

    @property
    def puck(self):
        return self.twin.world.puck


@pytest.fixture(scope="module")
def process(domain):
    with Process("airpuck twin", LiveSettings(domain=domain, quiet=True)) as process:
        yield process


@pytest.fixture(scope="module")
def table(process) -> Table:
    return Table(process, PuckState(-0.7, 0.0, vx=-3.0))


def test_the_conceding_side_serves_a_second_later(table):
    table.run(0.2)
    assert table.puck.goal == -1
    table.run(1.0)
    assert table.puck.goal == -1
    table.run(1.3)
    assert table.said == ["the puck is served on the left"]
    assert table.puck.state.x == pytest.approx(-0.3, abs=0.01)
    assert abs(table.puck.state.y) <= 0.16


def test_a_puck_that_the_craft_ignores_is_the_humans_after_fifteen_seconds(table):
    begin = table.twin.now
    table.run(begin + 14.9)
    assert table.puck.state.x < 0
    table.run(begin + 15.4)
    assert table.said == ["the puck is served on the left", "the puck is served on the right"]
    # A scorekeeper that only sees the puck makes the same call before the puck is put back.
    assert table.called == [("goal", 1), ("foul", -1)]


class Guide:
    """A process on the graph that publishes the mallet's target, while time passes."""

    def __init__(self, table: Table, process: Process, domain: int) -> None:
        self._table, self._clock = table, process.clock
        self.graph = Graph("guide", domain=domain)
        self._codec = StreamCodec("mallet_target")
        codec, topic = self._codec, process.topics.mallet_target
        self._publisher = self.graph.publisher(topic, codec.msgtype, codec.types, SENSOR)

    def lead(
        self, *place: float, seconds: float = 0.6, age: float = 0.0, data: bytes = b""
    ) -> None:
        """Publish a target a hundred times a second."""
        begin = self._clock.now
        while (now := self._clock.now) < begin + seconds:
            stamp = self._clock.stamp_ns(now - age)
            self._publisher.send(self._codec.encode(stamp, place))
            self.wait(0.01)

    def wait(self, seconds: float) -> None:
        """Publish nothing while time passes on the table."""
        time.sleep(seconds)
        self._table.run(self._clock.now)


@pytest.fixture(scope="module")
def guided(domain):
    # In a separate process the table catches up with the clock.
    with Process("airpuck twin", LiveSettings(domain=domain, quiet=True)) as process:
        table = Table(process, PuckState(-0.7, 0.4), "page")
        guide = Guide(table, process, domain)
        until = time.monotonic() + 10.0
        while not guide.graph.subscribers(process.topics.mallet_target):
            assert time.monotonic() < until
            time.sleep(0.01)
        yield table, guide
        guide.graph.close()


def test_the_mallet_follows_its_target_no_faster_than_a_hand(guided):
    table, guide = guided
    guide.wait(0.1)
    assert table.mallet == (BEGINS, 0.0)
    guide.lead(0.5, 0.2, 0.0, seconds=0.8)
    assert table.mallet == pytest.approx((0.5, 0.2), abs=1e-3)
    # The mallet stays in its half of the table, whatever its target.
    guide.lead(-100.0, 100.0, 0.0, seconds=0.8)
    assert table.mallet == pytest.approx((0.04815, 0.55 - 0.04815), abs=1e-3)
    mallet = table.twin.world.mallet
    speeds = []
    for _ in range(20):
        guide.lead(1.0, -0.5, 0.0, seconds=0.02)
        speeds.append(math.hypot(mallet.vx, mallet.vy))
    assert 0.0 < max(speeds) <= 4.0 + 1e-6


def test_without_a_target_the_mallet_stays(guided):
    table, guide = guided
    guide.lead(0.8, 0.0, 0.0, seconds=0.8)
    guide.lead(0.2, 0.4, 0.0, seconds=0.05)
    guide.wait(0.5)
    stopped = table.mallet
    guide.wait(0.5)
    assert table.mallet == pytest.approx(stopped, abs=1e-6)


@pytest.mark.parametrize(
    ("place", "age"),
    [((math.nan, 0.1, 0.0), 0), ((0.3, math.inf, 0.0), 0), ((1e5, 0, 0), 0), ((0.3, 0.3, 0), 0.3)],
)
def test_non_finite_distant_and_outdated_targets_are_rejected(guided, place, age):
    table, guide = guided
    guide.lead(0.8, 0.0, 0.0, seconds=0.8)
    guide.lead(*place, age=age, seconds=0.4)
    assert table.mallet == pytest.approx((0.8, 0.0), abs=1e-3)
    told = "rejected a position of the mallet that is far from the table"
    assert age or told in table.said
